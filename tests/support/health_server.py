"""A server whose health tests set."""

from __future__ import annotations

from common import free_port

SERVER = [
    "python3",
    "-S",
    "-c",
    """
import os, signal, sys, time
state = {'ready': False, 'alive': True}
def on(number, frame):
    if number == signal.SIGUSR1: state['ready'] = True
    elif number == signal.SIGUSR2: state['alive'] = False
    else: sys.exit(0)
for number in (2, 10, 12, 15): signal.signal(number, on)
print('begins', flush=True)
told = False
while True:
    if state['ready'] and not told:
        told = True
        print('now serving on port 80', flush=True)
        open(os.environ['READY_FILE'], 'w').close()
        import socket
        listener = socket.socket(); listener.setsockopt(1, 2, 1)
        listener.bind(('127.0.0.1', int(os.environ['PORT']))); listener.listen(9)
    if state['alive']:
        open(os.environ['ALIVE_FILE'], 'w').close()
    signal.sigtimedwait([34], 0.05)
""",
]


def server(tmp_path, robot, **more) -> dict:
    """A program that becomes ready at SIGUSR1 and hangs at SIGUSR2."""
    folder = "/tmp" if robot.kind == "docker" else str(tmp_path)
    return {
        "command": SERVER,
        "container": {
            "environment": {"READY_FILE": f"{folder}/ready", "ALIVE_FILE": f"{folder}/alive", "PORT": str(free_port())}
        },
        **more,
    }


def tell(robot, service: str, name: str) -> None:
    """Signals the program of now, once it can take signals."""
    robot.wait(lambda: b"begins" in next(robot.engine.log_since(robot.container(service).id, ""))[0])
    robot.signal(service, name)


def health(robot, service: str) -> str:
    return robot.status().get("services", {}).get(service, {}).get("health", "")
