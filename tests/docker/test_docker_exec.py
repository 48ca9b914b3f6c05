"""Commands inside a container: what they print, and that they end."""

from __future__ import annotations

import os
import threading
import time

import psutil
import pytest
from common import BASE_IMAGE, wait_for
from forwarder import Forwarder
from robots import WORK

from rorg.core.observed import LABEL_OWNER, LABEL_SERVICE
from rorg.engines.docker.engine import DockerEngine

FOREVER = ["python3", "-S", "-c", "import signal\nprint('begins', flush=True)\nsignal.pause()"]
SHELL = ["sh", "-c", f'{FOREVER[0]} -S -c "{FOREVER[3]}" & wait; true']


@pytest.fixture(params=["unix", "tcp"])
def engine(request, dockerd):
    """An engine of this machine; and the same as if it were on another one."""
    forwarder = Forwarder(dockerd.host)
    found = DockerEngine(f"exec-{request.param}", dockerd.host if request.param == "unix" else forwarder.host)
    assert found.local is (request.param == "unix")
    yield found
    forwarder.close()


@pytest.fixture
def container(engine):
    spec = {"image": BASE_IMAGE, "command": WORK, "network_mode": "host"}
    made = engine.create(engine.owner, spec, {LABEL_OWNER: engine.owner, LABEL_SERVICE: "x"})
    engine.start(made)
    yield made
    engine.stop(made, "SIGKILL", 5.0)
    engine.remove(made)


def programs(engine, container: str) -> list[int]:
    """Its processes, by their namespace: docker-py cannot read Podman's answer to `top`."""
    inside = os.readlink(f"/proc/{engine.client.get(f'/containers/{container}/json')['State']['Pid']}/ns/pid")
    alive = [p.pid for p in psutil.process_iter(["status"]) if p.info["status"] != psutil.STATUS_ZOMBIE]
    return [pid for pid in alive if namespace(pid) == inside]


def namespace(pid: int) -> str:
    try:
        return os.readlink(f"/proc/{pid}/ns/pid")
    except OSError:
        return ""  # it has ended


def within(seconds: float, call):
    """What a call returns, if it does in time."""
    found: list = []
    threading.Thread(target=lambda: found.append(call()), daemon=True).start()
    return wait_for(lambda: found, seconds, "the call to return")[0]


@pytest.mark.parametrize("command", [FOREVER, SHELL], ids=["program", "shell"])
def test_a_command_that_does_not_end_is_ended_and_all_that_it_began(engine, container, command):
    assert len(programs(engine, container)) == 1
    began = time.monotonic()
    code, output = within(15, lambda: engine.exec(container, command, 1.0))
    assert time.monotonic() - began < 6
    assert code == 124
    assert output.splitlines() == [b"begins", b"no end within 1 s"]
    assert len(programs(engine, container)) == 1


def test_a_command_that_never_stops_talking_is_ended(engine, container):
    talk = ["python3", "-S", "-c", "import time\nwhile True: print('x' * 99, flush=True); time.sleep(0.01)"]
    code, output = within(15, lambda: engine.exec(container, talk, 1.0))
    assert code == 124
    assert output.startswith(b"x" * 99)
    assert len(programs(engine, container)) == 1


@pytest.mark.parametrize("engine", ["unix"], indirect=True)
def test_a_command_that_cleared_its_environment_is_ended_here(engine, container):
    """Its mark is gone, and its number with its control group tells it from others; not on another machine."""
    clear = "import os; os.execve('/usr/bin/python3', ['python3', '-S', '-c', 'import signal; signal.pause()'], {})"
    assert within(15, lambda: engine.exec(container, ["python3", "-S", "-c", clear], 1.0))[0] == 124
    wait_for(lambda: len(programs(engine, container)) == 1)


@pytest.mark.smoke
def test_exit_codes_and_the_whole_output_come_back(engine, container):
    for number in range(10):
        said = engine.exec(container, ["sh", "-c", f"echo out; echo err >&2; exit {number}"], 10.0)
        assert (said[0], sorted(said[1].split())) == (number, [b"err", b"out"])
    code, output = engine.exec(container, ["python3", "-S", "-c", "print('y' * 200_000)"], 20.0)
    assert (code, len(output)) == (0, 200_001)
    for _ in range(10):
        code, output = engine.exec(container, ["no-such-program"], 10.0)
        assert code in (126, 127)
        assert "executable file not found" in output.decode().splitlines()[-1], "probes show the last line"
