"""In place of each program of the tour guide: answers each connection to a port with its software and configuration.

standin.py PORT. The file /edition has the number of the software and, if it is bad, what is wrong with it; EDITION is
the number of the configuration."""

import contextlib
import os
import signal
import socket
import sys

with open("/edition") as file:
    software, _, bad = file.read().strip().partition(" ")
for number in (signal.SIGINT, signal.SIGTERM):
    signal.signal(number, lambda *_: os._exit(0))
if bad == "exits":
    sys.exit("cannot find its library")
if bad == "never ready":
    while True:
        signal.pause()
listener = socket.socket()
listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
listener.bind(("127.0.0.1", int(sys.argv[1])))
listener.listen(64)
answer = f"{software} {os.environ['EDITION']}\n".encode()
while True:
    asker, _ = listener.accept()
    with contextlib.suppress(OSError):  # it has hung up while this service was paused
        asker.sendall(answer)
    asker.close()
