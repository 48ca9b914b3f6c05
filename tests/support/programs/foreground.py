"""The foreground tasks of docs/evaluation/contention.py. They run in containers with nothing but Python:

foreground.py control FILE   a control loop at 50 Hz, which writes when each round was due and done
foreground.py guide PORT     does as much work as a connection asks for, and answers when it is done
"""

from __future__ import annotations

import math
import socket
import struct
import sys
import time

PERIOD, WORK = 0.02, 0.002
"""Seconds between two rounds of the control loop, and CPU seconds of one."""
RECORD = struct.Struct("dd")
"""When a round was due and when it was done, in seconds of the monotonic clock, which all containers share."""


def burn(seconds: float) -> None:
    """Uses so much CPU time, however long that takes."""
    until = time.thread_time() + seconds
    while time.thread_time() < until:
        pass


def control(path: str) -> None:
    """After a late round it goes on with the next that is not due yet, like a ROS Rate."""
    with open(path, "ab", buffering=0) as file:
        began, number = time.monotonic(), 0
        while True:
            due = began + number * PERIOD
            time.sleep(max(0.0, due - time.monotonic()))
            burn(WORK)
            done = time.monotonic()
            file.write(RECORD.pack(due, done))
            number = max(number, math.floor((done - began) / PERIOD)) + 1


def guide(port: int) -> None:
    with socket.create_server(("127.0.0.1", port)) as listener:
        while True:
            connection, _ = listener.accept()
            with connection, connection.makefile("rw") as stream:
                if line := stream.readline():
                    burn(float(line))
                    stream.write("done\n")


if __name__ == "__main__":
    what, where = sys.argv[1:]
    control(where) if what == "control" else guide(int(where))
