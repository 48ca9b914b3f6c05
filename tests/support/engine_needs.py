"""What rorg needs of an engine: one function for each row of docs/reference/engines.md. The first line of its docstring
is the row's text.

A function returns "" if the engine has what is needed, and otherwise says what rorg does instead. It raises
AssertionError if the engine neither does it nor is known not to."""

from __future__ import annotations

import itertools
import os
import signal
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from common import BASE_IMAGE, wait_for
from robots import WORK

from rorg.core.observed import LABEL_OWNER, LABEL_SERVICE, Container
from rorg.engines.log_lines import Reading
from rorg.engines.protocol import RealEngine
from rorg.errors import EngineError

Need = Callable[["Bench"], str]
IGNORED = "no: `engine-lacks`"
"""The cell of an option that has no effect, which `rorg validate --machine` says by this code."""
OUT = ["python3", "-S", "-u", "-c"]
AWAIT = "import time\nwhile True: time.sleep(0.01)"
"""Waits for a signal. One that comes right before `signal.pause()` would be handled only after the next one."""


class Bench:
    """An engine to try; what it made is gone at the end."""

    def __init__(self, engine: RealEngine, folder: Path, lacking: dict[str, str]) -> None:
        """`lacking`: what rorg knows that the engine does not do, by option."""
        self.engine, self.folder, self.lacking = engine, folder, lacking
        self._numbers = itertools.count()
        self.can = engine.capabilities

    def made(self, command: list[str] = WORK, before: str = "", **options: Any) -> str:
        name = f"needs-{os.getpid()}-{next(self._numbers)}"
        spec = {"image": BASE_IMAGE, "command": command, "network_mode": "host", "container_name": name, **options}
        if "networks" in options:
            del spec["network_mode"]
        return self.engine.create(name, spec, {LABEL_OWNER: self.engine.owner, LABEL_SERVICE: "needs"}, before)

    def started(self, command: list[str] = WORK, **options: Any) -> str:
        made = self.made(command, **options)
        self.engine.start(made)
        return made

    def look(self, container: str) -> Container:
        found = self.engine.inspect(container)
        assert found is not None
        return found

    def becomes(self, container: str, state: str) -> Container:
        return wait_for(lambda: (c := self.look(container)).state == state and c, 20, f"the state {state}")

    def output(self, container: str) -> str:
        """All that a program printed, once it has ended."""
        self.becomes(container, "exited")
        return "".join(line.text.decode() for line in self.engine.log_lines(container, None, None, True))

    def close(self) -> None:
        """The newest first: Podman removes no container that another one has joined."""
        for container in sorted(self.engine.list(), key=lambda c: c.created_at, reverse=True):
            if container.alive:
                self.engine.stop(container.id, "SIGKILL", 10.0)
            self.engine.remove(container.id, volumes=True)


def run_and_stop(bench: Bench) -> str:
    """Run a program, and stop it by its own signal"""
    script = f"import signal, sys\nsignal.signal(signal.SIGUSR1, lambda *_: sys.exit(7))\nprint('up')\n{AWAIT}"
    container = bench.started([*OUT, script])
    wait_for(lambda: b"up" in b"".join(o for o, _ in bench.engine.log_since(container, "")), 20)
    bench.engine.stop(container, "SIGUSR1", 10.0)
    ended = bench.becomes(container, "exited")
    assert ended.exit_code == 7
    assert ended.started_at
    return ""


def start_again(bench: Bench) -> str:
    """Start a container again that has ended"""
    container = bench.started()
    first = bench.look(container).started_at
    bench.engine.stop(container, "SIGTERM", 10.0)
    bench.engine.start(container)
    assert bench.becomes(container, "running").started_at != first
    return ""


def exit_code_of_killed(bench: Bench) -> str:
    """Say how a killed program ended"""
    container = bench.started()
    os.kill(child_of(bench, container), signal.SIGKILL)
    assert bench.becomes(container, "exited").exit_code == 137
    return ""


def child_of(bench: Bench, container: str) -> int:
    """The program's process: of the process engine, the child of the shell that leads it."""
    import psutil

    pid = bench.becomes(container, "running").pid
    if bench.can.isolation:
        return pid
    return wait_for(lambda: [c.pid for c in psutil.Process(pid).children()], 10)[0]


def pause(bench: Bench) -> str:
    """Pause a program and resume it"""
    container = bench.started()
    if not bench.can.pause:
        with pytest.raises(EngineError):
            bench.engine.pause(container)
        return "no: stopped instead"
    bench.engine.pause(container)
    bench.becomes(container, "paused")
    bench.engine.resume(container)
    bench.becomes(container, "running")
    return ""


def stop_while_paused(bench: Bench) -> str:
    """Stop a paused program by its own signal"""
    if not bench.can.pause:
        return "no: never paused"
    script = f"import signal, sys\nsignal.signal(2, lambda *_: sys.exit(7))\nprint('up')\n{AWAIT}"
    container = bench.started([*OUT, script])
    wait_for(lambda: b"up" in b"".join(o for o, _ in bench.engine.log_since(container, "")), 20)
    bench.engine.pause(container)
    bench.engine.stop(container, "SIGINT", 10.0)
    assert bench.becomes(container, "exited").exit_code == 7
    return ""


def rename(bench: Bench) -> str:
    """Give a container another name"""
    container = bench.started()
    name = f"renamed-{os.getpid()}"
    bench.engine.rename(container, name)
    assert bench.look(container).name == name
    return ""


def names_are_unique(bench: Bench) -> str:
    """Refuse a name that is taken"""
    one, two = bench.made(), bench.made()
    if not bench.can.isolation:
        return "no: names mean nothing"
    with pytest.raises(EngineError) as refused:
        bench.engine.rename(two, bench.look(one).name)
    assert refused.value.kind == "name_taken"
    return ""


def update(bench: Bench) -> str:
    """Change limits of a running container"""
    if not bench.can.isolation:
        return IGNORED
    container = bench.started(cpu_shares=512)
    if bench.can.update:
        bench.engine.update(container, {"cpu_shares": 256})
        assert bench.look(container).live["cpu_shares"] == 256
        return ""
    with pytest.raises(EngineError):
        bench.engine.update(container, {"cpu_shares": 256})
    return "no: a new container"


def memory_limit(bench: Bench) -> str:
    """Limit memory"""
    container = bench.started(mem_limit=64 << 20)
    limit = (64 << 20) in control_group_values(bench, container, ("memory.max", "memory.limit_in_bytes"))
    return known(bench, "mem_limit", limit)


def processes_limit(bench: Bench) -> str:
    """Limit the number of processes"""
    container = bench.started(pids_limit=99)
    return known(bench, "pids_limit", 99 in control_group_values(bench, container, ("pids.max",)))


def known(bench: Bench, option: str, works: bool) -> str:
    """An option either works, or rorg says that it does not."""
    assert works != (option in bench.lacking), f"{option} works: {works}; rorg says {bench.lacking.get(option)}"
    return "" if works else IGNORED


def control_group_values(bench: Bench, container: str, names: tuple[str, ...]) -> set[int]:
    """Numbers in the files of these names of the container's own control groups."""
    pid, found = bench.look(container).pid, set[int]()
    for line in Path(f"/proc/{pid}/cgroup").read_text().splitlines():
        _, controllers, path = line.split(":", 2)
        for folder in (controllers, "unified", ""):
            for name in names:
                file = Path("/sys/fs/cgroup", folder, path.lstrip("/"), name)
                if file.exists() and (text := file.read_text().strip()).isdigit():
                    found.add(int(text))
    return found


def usage(bench: Bench) -> str:
    """Tell CPU and memory of each container"""
    container = bench.started([*OUT, "block = b'x' * (40 << 20)\nprint('up')\nwhile True: pass"])
    found = bench.look(container)
    if "mem_limit" in bench.lacking and bench.can.isolation:
        assert not bench.engine.usage([found])
        return "no: no figures"
    wait_for(lambda: (u := bench.engine.usage([found]).get(container)) and u.memory > 40 << 20 and u.cpu > 0.05, 30)
    return ""


def only_ours(bench: Bench) -> str:
    """List the containers of one rorg, and no others"""
    container = bench.made()
    assert [c.id for c in bench.engine.list()] == [container]
    assert bench.engine.inspect("f" * 64) is None
    return ""


def events(bench: Bench) -> str:
    """Tell at once when a program begins or ends"""
    container, heard, reading = bench.made(), list[str](), Reading()

    def listen() -> None:
        for name, _ in bench.engine.events(reading):
            heard.append(name)

    listener = threading.Thread(target=listen, daemon=True)
    listener.start()
    wait_for(lambda: heard, 20, "the beginning of the events")
    for act in (lambda: bench.engine.start(container), lambda: os.kill(child_of(bench, container), signal.SIGKILL)):
        count = len(heard)
        act()
        wait_for(lambda count=count: container in heard[count:], 20, f"an event of {container}: {heard}")
    reading.set()
    listener.join(20)
    assert not listener.is_alive()
    return ""


def commands_inside(bench: Bench) -> str:
    """Run a command inside, with its exit code"""
    container = bench.started()
    code, output = bench.engine.exec(container, [*OUT, "print('inside')\nraise SystemExit(3)"], 10.0)
    assert (code, output.strip()) == (3, b"inside")
    return ""


def commands_end(bench: Bench) -> str:
    """End a command inside that takes too long"""
    container = bench.started()
    began = time.monotonic()
    code, _ = bench.engine.exec(container, [*OUT, "import signal\nsignal.pause()"], 0.5)
    assert code == 124
    assert time.monotonic() - began < 15
    return ""


def logs(bench: Bench) -> str:
    """Keep what programs print"""
    container = bench.started([*OUT, "print('one')\nprint('two')"])
    assert bench.output(container) == "one\ntwo\n"
    return ""


def log_times(bench: Bench) -> str:
    """Know when each line was printed"""
    if not bench.can.log_times:
        return "no: one service after the other"
    before = time.time()
    container = bench.started([*OUT, "print('one')"])
    bench.becomes(container, "exited")
    for since, expected in ((before - 1, b"one\n"), (time.time() + 60, b"")):
        lines = bench.engine.log_lines(container, None, since, True)
        assert b"".join(line.text for line in lines) == expected
    return ""


def log_follow(bench: Bench) -> str:
    """Follow what a program prints"""
    container = bench.started([*OUT, "import time\nfor n in range(20):\n print(n)\n time.sleep(0.02)"])
    texts = [line.text for line in bench.engine.log_follow(container, "", Reading())]
    assert b"".join(texts) == b"".join(f"{n}\n".encode() for n in range(20))  # Podman may part what is written in parts
    return ""


def files(bench: Bench) -> str:
    """Copy files in and out"""
    container = bench.started()
    source, back = bench.folder / "in.txt", bench.folder / "out.txt"
    source.write_text("map")
    inside = str(bench.folder / "there.txt") if not bench.can.isolation else "/tmp/there.txt"
    bench.engine.put(container, source, inside)
    bench.engine.fetch(container, inside, back)
    assert back.read_text() == "map"
    return ""


def devices(bench: Bench) -> str:
    """Give a device, and none of the others"""
    if not bench.can.isolation:
        return IGNORED
    script = "import os\nprint(os.path.exists('/dev/given'), os.path.exists('/dev/kmsg'))"
    container = bench.started([*OUT, script], devices=["/dev/zero:/dev/given"])
    assert bench.output(container) == "True False\n"
    return ""


def init(bench: Bench) -> str:
    """Reap orphaned processes (`init`)"""
    if "init" in bench.lacking and bench.can.isolation:
        with pytest.raises(EngineError):
            bench.started(init=True)
        return IGNORED
    container = bench.started([*OUT, "import os\nprint(os.getpid() != 1)"], init=True)
    assert bench.output(container) == "True\n"
    return ""


def healthcheck(bench: Bench) -> str:
    """Check the health of programs by itself"""
    check = {"test": ["CMD", "python3", "-S", "-c", "pass"], "interval": 0.2, "timeout": 10.0, "retries": 1}
    container = bench.started(healthcheck=check)
    if "healthcheck" in bench.lacking:
        assert bench.look(container).health != "healthy"
        return IGNORED
    wait_for(lambda: bench.look(container).health == "healthy", 60)
    return ""


def runtimes(bench: Bench) -> str:
    """Use another runtime (`runtime`), and give GPUs (`gpus`)"""
    if not bench.can.isolation:
        return IGNORED
    refused = 0
    for option in ({"runtime": "nosuch"}, {"gpus": [{"count": "all"}]}):  # there are none on the machine
        try:
            bench.started(**option)
        except EngineError:
            refused += 1
    known(bench, "gpus", refused == 2)
    return known(bench, "runtime", refused == 2)


def limits_of_programs(bench: Bench) -> str:
    """Limit open files (`ulimits`), and set the size of /dev/shm"""
    if not bench.can.isolation:
        return IGNORED
    script = "import os, resource\ns = os.statvfs('/dev/shm')\n"
    script += "print(resource.getrlimit(resource.RLIMIT_NOFILE), s.f_blocks * s.f_frsize >> 20)"
    limits = {"nofile": {"soft": 512, "hard": 1024}, "nproc": {"soft": 16384, "hard": 16384}}
    container = bench.started([*OUT, script], ulimits=limits, shm_size=8 << 20, ipc="private")
    output = bench.output(container)
    assert output.endswith(" 8\n"), output
    return known(bench, "ulimits", output.startswith("(512, 1024)"))


def joined_network(bench: Bench) -> str:
    """Let a container use the network of another"""
    if not bench.can.isolation:
        return IGNORED
    other = bench.started(network_mode="none")
    container = bench.started(network_mode=f"container:{other}")
    names = [Path(f"/proc/{bench.look(c).pid}/ns/net").readlink() for c in (other, container)]
    assert names[0] == names[1] != Path("/proc/self/ns/net").readlink()
    return ""


def no_shell_of_the_host(bench: Bench) -> str:
    """Keep the host's processes and files out of sight"""
    if not bench.can.isolation:
        return "no: plain processes"
    container = bench.started([*OUT, f"import os\nprint(os.path.exists('/proc/{os.getpid()}/stat'), os.getpid())"])
    assert bench.output(container) in ("False 1\n", "True 1\n" if os.getpid() < 3 else "False 1\n")
    return ""


LIFE: tuple[Need, ...] = (
    *(run_and_stop, start_again, exit_code_of_killed, pause, stop_while_paused, rename, names_are_unique, update),
    *(memory_limit, processes_limit, usage, only_ours, events, commands_inside, commands_end, logs, log_times),
    *(log_follow, files, devices, init, healthcheck, runtimes, limits_of_programs, joined_network),
    no_shell_of_the_host,
)
"""Needs that every engine is asked for; tests/support/engine_objects.py has those of networks, volumes and images."""
