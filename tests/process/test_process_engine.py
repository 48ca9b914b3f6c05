"""The process engine by itself: commands beside a service, and what its programs print."""

from __future__ import annotations

import contextlib
import itertools
import os
import re
import resource
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from common import wait_for
from histories import small_disk
from robots import RealRobot
from rorg_process import RorgProcess

from rorg.core.observed import LABEL_OWNER, LABEL_SERVICE
from rorg.engines.log_lines import Reading
from rorg.engines.make import make_engine
from rorg.engines.process.engine import ProcessEngine
from rorg.engines.process.log import KEPT, SLACK, follow_lines, read_lines, trim_log
from rorg.engines.process.table import MARK, marked, pids
from rorg.errors import EngineError
from rorg.store.state_dir import StateDir

MANY, FEW_FILES = 80, 96
"""Services, and descriptors of rorg."""

LABELS = {LABEL_OWNER: "me", LABEL_SERVICE: "x"}


@pytest.fixture
def engine(process_engine):
    return process_engine


def start(engine, *command: str) -> str:
    made = engine.create("x", {"image": "x", "command": command}, LABELS)
    engine.start(made)
    return made


def start_unless_removed(engine, container: str) -> None:
    with contextlib.suppress(EngineError):
        engine.start(container)


def test_a_command_that_takes_too_long_is_ended_with_all_that_it_began(engine):
    container = start(engine, "sleep", "600")
    began = time.monotonic()
    code, output = engine.exec(container, ["sh", "-c", "sleep 601 & echo $!; setsid sleep 602 & echo $!; wait"], 0.5)
    assert time.monotonic() - began < 5
    child, session, said = output.splitlines()
    assert (code, said) == (124, b"no end within 0.5 s")
    for pid in child, session:
        wait_for(lambda pid=pid: _state(int(pid)) in "ZX", what="the children of the command to end")
    assert engine.inspect(container).state == "running"


def test_no_program_starts_whose_run_the_disk_does_not_take(tmp_path):
    """Otherwise the next try starts a second copy, and nobody ends the first."""
    with small_disk(tmp_path / "disk", "256k") as disk:
        engine = ProcessEngine("me", disk / "containers")
        program = ["sh", "-c", f"echo begun >> {tmp_path}/begun; exec sleep 600"]
        container = engine.create("x", {"image": "x", "command": program}, LABELS)
        with contextlib.suppress(OSError), (disk / "log").open("wb", 0) as file:
            while file.write(bytes(4096)):
                pass
        for _ in range(3):
            with pytest.raises(EngineError, match="No space left"):
                engine.start(container)
        with pytest.raises(EngineError, match="No space left"):
            engine.create("y", {"image": "x", "command": program}, LABELS)
        assert [path.name for path in engine.records.directory.iterdir()] == [container]
        assert not (tmp_path / "begun").exists()
        assert not [pid for pid in pids() if marked(pid, MARK, container)]
        assert engine.inspect(container).state == "created"
        (disk / "log").unlink()
        engine.start(container)
        begun = tmp_path / "begun"
        wait_for(lambda: begun.exists() and begun.read_text())
        engine.stop(container, "SIGKILL", 0)
        assert begun.read_text() == "begun\n"


def _state(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return "X"


def test_exit_codes_and_output_of_commands(engine):
    container = start(engine, "sleep", "600")
    assert engine.exec(container, ["sh", "-c", "echo out; echo err >&2; exit 3"], 5.0) == (3, b"out\nerr\n")
    assert engine.exec(container, ["no-such-program"], 5.0)[0] == 127
    assert os.listdir(engine.records.folder(container)) != []


TALKS = """
import signal, sys, time
line = 0
def talk(*_):
    global line
    for _ in range(1 << 14):  # a MiB, in 64 bytes each
        line += 1
        print(f"{line:<63}")
    sys.stdout.flush()
for _ in range(16): talk()
for _ in range(16): talk(); time.sleep(0.1)
print("now serving", flush=True)
for _ in range(16): talk(); time.sleep(0.1)
print("the end", flush=True)
signal.pause()
"""


def numbers(text: bytes) -> list[int]:
    assert b"\0" not in text
    return [int(line) for line in text.splitlines() if line.strip().isdigit()]


@pytest.mark.slow
def test_the_log_of_a_program_that_never_stops_talking_is_kept_small(engine):
    stop, followed = threading.Event(), []
    threading.Thread(target=lambda: list(engine.events(stop)), daemon=True).start()
    container = start(engine, "python3", "-S", "-c", TALKS)
    log = engine.records.log(container)
    threading.Thread(
        target=lambda: [followed.append(line.text) for line in engine.log_follow(container, "", Reading())], daemon=True
    ).start()
    seen, place, most = bytearray(), "", 0
    while b"the end" not in seen:  # as a probe of the log goes on reading, from place to place
        for text, after in engine.log_since(container, place):
            seen += text[: text.rfind(b"\n") + 1]
            place = after
        most = max(most, log.stat().st_blocks * 512)
        time.sleep(0.02)
    wait_for(lambda: log.stat().st_blocks * 512 <= KEPT + SLACK, what="the log to be trimmed")
    stop.set()
    assert log.stat().st_size > 48 << 20
    assert most < 48 << 20, "while it talks"
    last = 48 << 14
    assert numbers(bytes(seen)) == list(range(1, last + 1)), "a probe that goes on reading misses nothing"
    assert b"now serving" in seen
    wait_for(lambda: b"the end" in followed[-1])
    lines = numbers(b"".join(followed))
    assert lines == sorted(set(lines)), "who follows gets whole lines, each once, also after what was given back"
    assert lines[-1] == last
    kept = numbers(b"".join(line.text for line in engine.log_lines(container, None, None, False)))
    assert kept == list(range(kept[0], last + 1))
    assert len(kept) * 64 > KEPT - (1 << 17)
    assert numbers(b"".join(text for text, _ in engine.log_since(container, ""))) == kept
    assert [line.text for line in engine.log_lines(container, 1, None, False)] == [b"the end\n", b""]


def test_who_is_behind_goes_on_with_the_next_whole_line(tmp_path):
    log = tmp_path / "log"
    with log.open("ab", buffering=0) as file:
        file.write(b"".join(b"%-62d.\n" % n for n in range(1 << 18)))
        end = log.stat().st_size
        reading, behind = (follow_lines(log, place, lambda: False, Reading()) for place in (end - 64, 0))
        assert next(reading).text.startswith(b"262143 ")
        assert next(behind).text.startswith(b"0 ")
        trim_log(log)
        file.write(b"after\n")
        assert next(reading).text == b"after\n"
    kept = [line.text for line in read_lines(log, None, False)]
    assert kept[-2:] == [b"after\n", b""]
    assert all(re.fullmatch(rb"\d+ +\.\n", line) for line in kept[:-2])
    late = b"".join(itertools.takewhile(lambda text: text != b"after\n", (line.text for line in behind)))
    assert all(re.fullmatch(rb"\d+ +\.", line) for line in late.splitlines())
    assert log.stat().st_blocks * 512 <= KEPT + SLACK


def test_a_log_that_was_emptied_is_read_from_its_beginning(engine):
    """As somebody does who wants the room; and as we do where the file system gives nothing back."""
    container = start(engine, "sh", "-c", "echo one; echo two; exec sleep 600")
    wait_for(lambda: next(engine.log_since(container, ""))[0] == b"one\ntwo\n")
    _, place = next(engine.log_since(container, ""))
    log = engine.records.log(container)
    os.truncate(log, 0)
    with log.open("ab") as file:
        file.write(b"new\n")
    assert list(engine.log_since(container, place)) == [(b"new\n", "4")]


def test_services_hear_signals_that_rorg_was_begun_to_ignore(tmp_path):
    code = f"""
import os, signal
from pathlib import Path
signal.signal(signal.SIGINT, signal.SIG_IGN)
from rorg.engines.process.engine import ProcessEngine
from rorg.core.observed import LABEL_OWNER, LABEL_SERVICE
engine = ProcessEngine("me", Path({str(tmp_path)!r}))
spec = {{"image": "x", "command": ["sleep", "1000"]}}
made = engine.create("s", spec, {{LABEL_OWNER: "me", LABEL_SERVICE: "s"}})
engine.start(made)
os.kill(os.getpid(), signal.SIGINT)
engine.stop(made, "SIGINT", 20.0)
print(engine.inspect(made).state)
"""
    began = time.monotonic()
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.stdout == "exited\n", done.stderr
    assert time.monotonic() - began < 20


def test_without_a_descriptor_left_nothing_is_said_of_a_container(tmp_path):
    code = f"""
import os, resource
from pathlib import Path
from rorg.engines.process.engine import ProcessEngine
from rorg.core.observed import LABEL_OWNER, LABEL_SERVICE
from rorg.errors import Unreachable
engine = ProcessEngine("me", Path({str(tmp_path)!r}))
spec = {{"image": "x", "command": ["sleep", "1000"]}}
made = engine.create("s", spec, {{LABEL_OWNER: "me", LABEL_SERVICE: "s"}})
engine.start(made)
free, limits = os.dup(0), resource.getrlimit(resource.RLIMIT_NOFILE)
for call in (lambda: engine.inspect(made), engine.list, lambda: engine.stop(made, "SIGKILL", 1.0)):
    os.close(free)
    resource.setrlimit(resource.RLIMIT_NOFILE, (free, limits[1]))
    try:
        print(call())
    except Unreachable as error:
        print("not known")
    resource.setrlimit(resource.RLIMIT_NOFILE, limits)
    free = os.dup(0)
print(engine.inspect(made).state)
engine.stop(made, "SIGKILL", 10.0)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.stdout == "not known\n" * 3 + "running\n", done.stderr


def test_only_what_somebody_asked_for_is_told_to_mean_nothing_here(tmp_path):
    robot = RealRobot(tmp_path, "process", None)
    try:
        robot.declare({"arm": {"container": {"cap_add": ["KILL"]}}, "camera": {}})
        robot.settle()
        robot.declare({"arm": {"container": {"cap_add": ["KILL"]}}})
        robot.settle()
        told = [line for line in robot.log() if "ignores options" in line]
        assert [line.partition("options: ")[2] for line in told] == ["cap_add (1 service)"]
    finally:
        robot.close()


LEAVES = """
import os, signal, subprocess, sys, time
own = subprocess.Popen(["sleep", "1000"], start_new_session=True).pid
same = subprocess.Popen(["sleep", "1000"]).pid
orphan = "env -i setsid sleep 1000 > /dev/null & echo $!"
said = subprocess.run(["sh", "-c", orphan], stdout=subprocess.PIPE, text=True).stdout
print(own, same, said, flush=True)
if sys.argv[1] == "crash": os._exit(3)
signal.pause()
"""
"""Leaves a process in a session of its own, one in its session, and an orphan without any environment."""


def left_by(engine, container: str) -> list[int]:
    """The processes that the last run of LEAVES names."""

    def named() -> list[bytes]:
        return next(engine.log_since(container, ""), (b"", ""))[0].split()[-3:]

    return [int(pid) for pid in wait_for(named)]


def leave(engine, how: str) -> tuple[str, list[int]]:
    """A run of LEAVES, and its processes."""
    container = start(engine, "python3", "-S", "-c", LEAVES, how)
    return container, left_by(engine, container)


def lives(pid: int) -> bool:
    return _state(pid) not in "ZX"


def test_a_stop_ends_all_processes_of_a_run(engine):
    container, left = leave(engine, "stay")
    assert all(lives(p) for p in left)
    began = time.monotonic()
    engine.stop(container, "SIGTERM", 20.0)
    assert not [p for p in left if lives(p)]
    assert time.monotonic() - began < 10, "who is in a session of its own receives the signal after the program's end"
    assert engine.inspect(container).state == "exited"


def test_a_crash_ends_all_processes_of_a_run_before_it_counts_as_exited(engine):
    container, left = leave(engine, "crash")
    wait_for(lambda: engine.inspect(container).state == "exited")
    assert not [p for p in left if lives(p)]
    assert engine.inspect(container).exit_code == 3


def test_the_exit_code_is_kept_below_a_relative_state_directory(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    engine = ProcessEngine("me", Path("process"))
    container = start(engine, "sh", "-c", "exit 3")
    wait_for(lambda: engine.inspect(container).state == "exited")
    assert engine.inspect(container).exit_code == 3


def test_a_killed_rorg_does_not_keep_a_crashed_run_from_ending_whole(tmp_path):
    code = f"""
import os
from pathlib import Path
from rorg.engines.process.engine import ProcessEngine
from rorg.core.observed import LABEL_OWNER, LABEL_SERVICE
engine = ProcessEngine("me", Path({str(tmp_path)!r}))
program = "(env -i setsid sleep 1000 & echo $!); echo; read line < {tmp_path}/go; exit 3"
made = engine.create("s", {{"image": "x", "command": ["sh", "-c", program]}}, {{LABEL_OWNER: "me", LABEL_SERVICE: "s"}})
engine.start(made)
print(made, flush=True)
os.kill(os.getpid(), 9)
"""
    os.mkfifo(tmp_path / "go")
    done = subprocess.run([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, timeout=60, check=False)
    engine = ProcessEngine("me", tmp_path)
    container = done.stdout.strip()
    (pid,) = wait_for(lambda: [int(n) for n in (tmp_path / container / "log").read_text().split()])
    assert lives(pid)
    (tmp_path / "go").write_text("go\n")
    wait_for(lambda: engine.inspect(container).state == "exited")
    assert engine.inspect(container).exit_code == 3
    assert _state(pid) in "ZX"


def test_what_is_removed_while_it_starts_is_gone_or_was_not_removed(engine):
    for _ in range(30):
        made = engine.create("x", {"image": "x", "command": ["sleep", "600"]}, LABELS)
        starting = threading.Thread(target=start_unless_removed, args=(engine, made))
        starting.start()
        refused = False
        try:
            engine.remove(made)
        except EngineError:
            refused = True
        starting.join()
        assert refused == bool(engine.list()), engine.list()
        if refused:
            engine.stop(made, "SIGKILL", 5.0)
            engine.remove(made)


def test_the_processes_of_a_killed_leader_end_at_once_or_before_the_next_run(engine):
    container, (own, same, _) = leave(engine, "stay")
    os.kill(engine.inspect(container).pid, signal.SIGKILL)
    wait_for(lambda: engine.inspect(container).state == "exited")
    engine.start(container)
    assert not lives(own)
    assert not lives(same)
    stop = threading.Event()
    threading.Thread(target=lambda: list(engine.events(stop)), daemon=True).start()
    try:
        wait_for(lambda: left_by(engine, container)[0] != own)
        own, same, _ = left_by(engine, container)
        os.kill(engine.inspect(container).pid, signal.SIGKILL)
        wait_for(lambda: not lives(own) and not lives(same))
    finally:
        stop.set()


def test_the_children_of_a_launcher_keep_the_grace_period(engine):
    slow = "trap 'read line < go; echo finished; exit' INT; echo ready; while :; do sleep 0.1; done"
    folder = engine.records.directory
    os.mkfifo(folder / "go")
    words = [
        "python3",
        "-S",
        "-c",
        f"import signal, subprocess; subprocess.Popen(['sh', '-c', {slow!r}]); signal.pause()",
    ]
    container = engine.create("x", {"image": "x", "command": words, "working_dir": str(folder)}, LABELS)
    engine.start(container)
    log = engine.records.log(container)
    wait_for(lambda: log.read_text() == "ready\n")
    stopping = threading.Thread(target=lambda: engine.stop(container, "SIGINT", 30.0))
    stopping.start()
    wait_for(lambda: (engine.records.folder(container) / "exit.new").exists(), what="the launcher to end")
    assert engine.inspect(container).state == "running"
    (folder / "go").write_text("go\n")
    stopping.join()
    assert log.read_text().splitlines()[-1] == "finished"


def test_a_pause_stops_sessions_of_their_own_too_and_use_counts_them(engine):
    busy = "['sh', '-c', 'echo $$; while :; do :; done'], start_new_session=True"
    container = start(engine, "python3", "-S", "-c", f"import subprocess; subprocess.Popen({busy}).wait()")
    (pid,) = wait_for(lambda: [int(n) for n in engine.records.log(container).read_text().split()])
    wait_for(lambda: engine.usage([engine.inspect(container)])[container].cpu > 0.3)
    engine.pause(container)
    wait_for(lambda: _state(pid) == "T")
    engine.resume(container)
    wait_for(lambda: _state(pid) == "R")


def test_the_programs_of_a_service_hear_that_a_pipe_is_closed(engine):
    """Python ignores SIGPIPE, and what leads a run begins as a Python."""
    container = start(engine, "sh", "-c", "grep SigIgn /proc/self/status; grep SigIgn /proc/$PPID/status")
    wait_for(lambda: engine.inspect(container).state == "exited")
    for line in engine.records.log(container).read_text().splitlines():
        assert int(line.split()[1], 16) & (1 << (signal.SIGPIPE - 1) | 1 << (signal.SIGXFSZ - 1)) == 0


def test_restarts_of_a_crashing_service_leave_nothing(tmp_path):
    robot = RealRobot(tmp_path, "process", None)
    try:
        robot.declare(
            {"arm": {"command": ["python3", "-S", "-c", LEAVES, "crash"], "always_on": True, "restart": "always"}}
        )
        container = wait_for(lambda: robot.engine.list())[0].id
        log = robot.engine.records.log(container)
        wait_for(lambda: log.exists() and len(log.read_bytes().split()) >= 9, what="two restarts")
        pids = [int(pid) for pid in log.read_bytes().split()]
        assert all(_state(pid) in "ZX" for pid in pids[:-3])
    finally:
        robot.close()
    assert all(_state(int(pid)) in "ZX" for pid in pids)


@pytest.mark.slow
def test_more_services_run_than_rorg_may_have_files_open(tmp_path):
    """Each run had a descriptor, until none was left for manifests, the status and the next start."""
    services = {f"s{number:02}": {"always_on": True} for number in range(MANY)}
    robot = RorgProcess(tmp_path, services)
    few = lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (FEW_FILES, FEW_FILES))  # noqa: E731
    try:
        robot.start(preexec_fn=few)
        client = robot.client(patience=60.0)
        client.wait(*services, timeout=120.0)
        runs = {service["incarnation"] for service in client.services()} - {""}
        engine = make_engine("process", StateDir(robot.state))
        for container in engine.list():
            os.killpg(container.pid, signal.SIGKILL)
        wait_for(lambda: not {s["incarnation"] for s in client.services()} & runs, 120, "new runs of all")
        client.wait(*services, timeout=120.0)
        (robot.tree / "services/s00.yaml").write_text("kind: [")
        wait_for(lambda: client.status()["tree"]["errors"], 60, "the manifests to be read again")
        assert "Too many open files" not in (tmp_path / "rorg.log").read_text()
    finally:
        robot.close()
