"""Figures, each beside what it is to be compared with, measured in the same run: `make bench`."""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from pathlib import Path

from common import BASE_IMAGE, ROOT, wait_for
from cpp_program import compile_all
from robots import WORK, RealRobot, write_tree

from rorg.core.decide import decide
from rorg.core.desired import desire
from rorg.manifest.load import load_or_raise
from rorg.tools.sim.robot import SimRobot


def timed(call, times: int) -> list[float]:
    found = []
    for _ in range(times):
        began = time.perf_counter()
        call()
        found.append((time.perf_counter() - began) * 1000)
    return sorted(found)


def show(what: str, found: list[float], beside: list[float] | None = None) -> None:
    median, p95 = statistics.median(found), found[int(len(found) * 0.95)]
    ratio = f", {median / statistics.median(beside):.2f} times the other" if beside else ""
    print(f"\n{what}: median {median:.1f} ms, p95 {p95:.1f} ms of {len(found)}{ratio}", end="")


def test_help():
    bare = timed(lambda: subprocess.run([sys.executable, "-c", ""]), 15)
    helped = timed(lambda: subprocess.run([sys.executable, "-m", "rorg", "--help"], stdout=subprocess.DEVNULL), 15)
    show("bare python", bare)
    show("rorg --help", helped, bare)


def test_a_pass_over_200_unchanged_services(tmp_path):
    specs = {f"s{n:03}": {"needs": [f"s{n - 1:03}"] if n % 5 else [], "always_on": n % 4 == 0} for n in range(200)}
    robot = SimRobot(load_or_raise(write_tree(tmp_path, specs)))
    robot.settle()
    calls = len(robot.engine.calls)
    inputs = robot.inputs()
    show("one pass over 200 services", timed(lambda: decide(inputs), 50))
    show("reading 200 manifests", timed(lambda: desire(load_or_raise(tmp_path)), 5))
    assert len(robot.engine.calls) == calls


def test_response_on_docker_at_41_services(dockerd, tmp_path):
    specs = {f"s{n:02}": {"always_on": n >= 2} for n in range(41)}
    specs["s00"]["idle"] = {"action": "pause"}
    robot = RealRobot(tmp_path, "docker", dockerd.host)
    try:
        robot.declare(specs)
        robot.wait(lambda: len(robot.containers()) == 41 and len(robot.active()) == 39, 120)
        robot.settle()
        api, events = robot.engine.api(), robot.loop.observer
        # The bare call goes to a container of the same image that is nobody's service, in turn with ours.
        bare = api.create_container(BASE_IMAGE, WORK, host_config=api.create_host_config(network_mode="host"))["Id"]
        api.start(bare)
        for name, verb in (("s00", "resume"), ("s01", "start")):
            robot.request(name)
            robot.wait(lambda name=name: name in robot.active())
            robot.release()
            robot.wait(lambda name=name: name not in robot.active())
            away, call = (api.pause, api.unpause) if verb == "resume" else (api.kill, api.start)
            away(bare)

            def state(name=name, events=events):
                return next(c.state for c in events.snapshot().containers if c.service == name)

            def once(name=name, state=state):
                robot.request(name)
                while state() != "running":
                    time.sleep(0.0002)

            ours, theirs = [], []
            for _ in range(40):
                ours += timed(once, 1)
                robot.release()
                wait_for(
                    lambda name=name, state=state: (
                        state() != "running" and name not in robot.loop.running.memory.in_flight
                    )
                )
                theirs += timed(lambda call=call: call(bare), 1)
                away(bare)
                wait_for(
                    lambda: (
                        not api.inspect_container(bare)["State"]["Running"]
                        or api.inspect_container(bare)["State"]["Paused"]
                    )
                )
            show(f"bare {verb}", sorted(theirs))
            show(f"request to running, by {verb}", sorted(ours), theirs)
            (api.unpause if verb == "resume" else api.start)(bare)
        api.remove_container(bare, force=True)
    finally:
        robot.close()


def test_a_request_while_41_services_are_replaced(dockerd, tmp_path):
    specs = {f"s{n:02}": {"always_on": n >= 1} for n in range(42)}
    specs["s00"]["idle"] = {"action": "pause"}
    robot = RealRobot(tmp_path, "docker", dockerd.host)
    try:
        robot.declare(specs)
        robot.wait(lambda: len(robot.active()) == 41, 120)
        robot.request("s00")
        robot.wait(lambda: "s00" in robot.active())
        robot.release()
        robot.wait(lambda: "s00" not in robot.active())
        robot.settle()

        def state() -> str:
            return next(c.state for c in robot.loop.observer.snapshot().containers if c.service == "s00")

        def once() -> None:
            robot.request("s00")
            while state() != "running":
                time.sleep(0.0002)

        old = {c.id for c in robot.containers()}
        for n in range(1, 42):
            specs[f"s{n:02}"]["container"] = {"environment": {"VERSION": "2"}}
        robot.declare(specs)
        wait_for(lambda: any(f.action.part_of for f in robot.loop.running.memory.in_flight.values()), 10)
        found = []
        while len({c.id for c in robot.loop.observer.snapshot().containers} & old) > 1:
            found += timed(once, 1)
            robot.release()
            wait_for(lambda: state() != "running" and "s00" not in robot.loop.running.memory.in_flight)
        show("request to resumed while 41 are replaced", sorted(found))
        robot.wait(lambda: len({c.id for c in robot.containers()} & old) == 1 and len(robot.containers()) == 42, 120)
    finally:
        robot.close()


def test_a_crash_is_answered(dockerd, tmp_path):
    """From the engine's own time of the `die` event to the call that starts it again."""
    import rorg.daemon.workers as module

    robot = RealRobot(tmp_path, "docker", dockerd.host)
    begun: list[float] = []
    perform = module.perform
    module.perform = lambda *args: (begun.append(time.time()), perform(*args))[1]
    try:
        robot.declare({f"s{n:02}": {"always_on": True} for n in range(41)})
        robot.wait(lambda: len(robot.active()) == 41, 120)
        robot.settle()
        api, found = robot.engine.api(), []
        for n in range(20):
            container = robot.container(f"s{n:02}").id
            since = time.time()
            begun.clear()
            api.kill(container)
            robot.wait(lambda: len(begun) >= 1)
            event = next(
                e
                for e in api.events(
                    since=since - 1,
                    until=time.time() + 1,
                    decode=True,
                    filters={"container": container, "event": "die"},
                )
            )
            found.append((begun[0] - event["timeNano"] / 1e9) * 1000)
        show("crash event to start call", sorted(found))
    finally:
        module.perform = perform
        robot.close()


def test_an_idle_loop_over_200_services(dockerd, tmp_path):
    """Twenty of them run, ten of those are probed for life."""
    import psutil

    robot = RealRobot(tmp_path, "docker", dockerd.host)
    try:
        write_tree(
            robot.tree,
            {
                f"s{n:03}": {
                    "always_on": n < 20,
                    **({"live": {"exec": ["python3", "-S", "-c", ""], "interval": "1h"}} if n < 10 else {}),
                }
                for n in range(200)
            },
            policies={"policy": {"pressure": {}}},
        )
        process = subprocess.Popen(
            [
                sys.executable,
                "-m",
                "rorg",
                "run",
                str(robot.tree),
                "--state-dir",
                str(robot.state.path),
                "--engine",
                "docker",
            ],
            stderr=subprocess.DEVNULL,
        )
        wait_for(lambda: len(robot.containers()) == 200 and len(robot.active()) == 20, 120)
        time.sleep(3)
        of = psutil.Process(process.pid)
        before, began = of.cpu_times(), time.monotonic()
        time.sleep(20)
        used = sum(of.cpu_times()[:2]) - sum(before[:2])
        print(
            f"\nidle loop, 200 services: {100 * used / (time.monotonic() - began):.2f} % of a core, "
            f"{of.memory_info().rss >> 20} MiB",
            end="",
        )
        process.kill()
        process.wait()
    finally:
        robot.close()


def test_latency_of_the_api_from_cpp(tmp_path):
    """Beside 41 declared services. A put is durable (fsync) when it is answered."""
    compile_all([[ROOT / "clients/cpp/tests/latency.cpp", "-O2", "-o", tmp_path / "latency"]])
    robot = RealRobot(tmp_path, "process", None)
    write_tree(robot.tree, {"camera": {}, **{f"s{n:02}": {} for n in range(40)}})
    log = (tmp_path / "log").open("w")
    process = subprocess.Popen(
        [
            sys.executable,
            "-m",
            "rorg",
            "run",
            str(robot.tree),
            "--state-dir",
            str(robot.state.path),
            "--engine",
            "process",
        ],
        stderr=log,
    )
    try:
        wait_for(lambda: len(robot.containers()) == 41, 60)
        time.sleep(2)
        for what, clients, calls in (("query", 1, 3000), ("query", 50, 100), ("put", 1, 300), ("put", 50, 20)):
            said = subprocess.check_output(
                [tmp_path / "latency", what, str(clients), str(calls)],
                text=True,
                env={"RORG_SOCKET": robot.socket()},
            )
            median, p95 = map(float, said.split())
            print(f"\n{what} from C++, {clients} client(s): median {median:.2f} ms, p95 {p95:.2f} ms", end="")
    finally:
        process.terminate()
        process.wait()
        robot.close()


def test_fuzz_of_the_openapi_document(tmp_path):
    """schemathesis over every route, by way of a bridge from loopback TCP to the socket."""
    import shutil
    import socket
    import threading

    import pytest

    tool = Path(sys.executable).with_name("schemathesis")
    if not tool.exists():
        pytest.skip("`pip install schemathesis` first")
    robot = RealRobot(tmp_path, "process", None, with_server=True)
    robot.declare({"camera": {}, "arm": {"driver": {}}}, groups={"seeing": {"services": ["camera"]}})
    robot.wait(lambda: len(robot.containers()) == 2)
    listener = socket.create_server(("127.0.0.1", 0))

    def pump(one: socket.socket, other: socket.socket) -> None:
        try:
            shutil.copyfileobj(one.makefile("rb", buffering=0), other.makefile("wb", buffering=0))
            other.shutdown(socket.SHUT_WR)
        except OSError:
            pass

    def accept() -> None:
        while True:
            try:
                outside, _ = listener.accept()
            except OSError:
                return
            inside = socket.socket(socket.AF_UNIX)
            inside.connect(robot.socket())
            for pair in ((outside, inside), (inside, outside)):
                threading.Thread(target=pump, args=pair, daemon=True).start()

    threading.Thread(target=accept, daemon=True).start()
    try:
        checks = (
            "not_a_server_error,status_code_conformance,content_type_conformance,response_schema_conformance,"
            "response_headers_conformance"
        )
        done = subprocess.run(
            [
                tool,
                "run",
                str(ROOT / "schemas/openapi.json"),
                "--url",
                f"http://127.0.0.1:{listener.getsockname()[1]}",
                "--max-examples",
                "400",
                "--phases",
                "fuzzing,coverage",
                "--checks",
                checks,
                "--exclude-path",
                "/v1/events",
                "--seed",
                "7",
                "--request-timeout",
                "10",
            ],
            capture_output=True,
            text=True,
            cwd=tmp_path,
        )
        print("\n".join(line for line in done.stdout.splitlines() if "generated" in line or "❌" in line), end="")
        assert done.returncode == 0, done.stdout[-3000:]
    finally:
        listener.close()
        robot.close()
