"""An update never hurts a running robot: what a new container does not manage, the one before it goes on doing."""

from __future__ import annotations

import io
import os
import random
import time
from dataclasses import replace

import commands
import pytest
from common import BASE_IMAGE, wait_for
from robots import WORK, Daemon, RealRobot, VirtualRobot, handed_on, write_tree
from updates import failed, identity, later, retry, running

from rorg.core.memory import Memory
from rorg.daemon.saved_memory import remembered
from rorg.model.units import stamp


def look(robot, container: str) -> dict:
    return robot.engine.api().inspect_container(container)


# -- a start failure has a way back ------------------------------------------------------------------------------

BAD = {
    "program": {"command": ["rosluanch", "x.launch"]},
    "user": {"container": {"user": "nosuch"}},
    "device": {"container": {"devices": ["/dev/nosuch:/dev/nosuch"]}},
    "crash": {"command": ["python3", "-S", "-c", "raise SystemExit(3)"]},
    "never ready": {
        "command": WORK,
        "ready": {"exec": "false", "timeout": "1s"},
        "container": {"environment": {"NEW": "1"}},
    },
    "image": {"image": "nosuch-image"},
}


@pytest.mark.smoke
def test_what_cannot_start_leaves_the_old_container_in_service(docker_robot, dockerd):
    """All of BAD at once: the container of before is the one that runs afterwards, and the robot comes to rest."""
    robot = docker_robot
    names = {kind: kind.replace(" ", "-") for kind in BAD}
    robot.declare({n: {"always_on": True} for n in names.values()})
    robot.wait(lambda: robot.active() == {*names.values()})
    before = {n: identity(robot, n)[0] for n in names.values()}
    robot.declare({n: {"always_on": True, **BAD[kind]} for kind, n in names.items()})
    # Podman refuses to make a container without its device, so rorg tries that again, as it does with a missing image.
    not_made = {"image", "device"} if dockerd.podman else {"image"}
    started = [n for kind, n in names.items() if kind not in not_made]
    robot.wait(lambda: all(failed(robot, n) for n in started), 60)
    robot.wait(
        lambda: (
            not robot.status()["in_flight"]
            and not robot.status()["plan"]["actions"]
            and {c.id for c in robot.containers()} == {*before.values()}
        ),
        60,
    )
    for name, container in before.items():
        data = look(robot, container)
        assert data["State"]["Running"]
        assert data["Name"] == f"/{name}"
    # With Podman it is catatonit that cannot start the program, and does not name it.
    assert any("printed last" in line and ("rosluanch" in line or dockerd.podman) for line in robot.lines)
    assert ("exit code 1" if dockerd.podman else "exit code 127") in failed(robot, "program")
    assert "nosuch" in failed(robot, "user")
    assert "exit code 3" in failed(robot, "crash")
    assert "not ready within 1 s" in failed(robot, "never-ready")
    assert "cannot be pulled" in robot.waits("image")
    assert "plug the device in" in (robot.waits("device") if dockerd.podman else failed(robot, "device"))
    assert "stays as it was" in robot.waits("user")
    # It does not try again by itself, also not after a restart of rorg.
    held = {n: identity(robot, n) for n in names.values()}
    robot.stop()
    robot.start()
    robot.wait(lambda: all(failed(robot, n) for n in started))
    assert {n: identity(robot, n) for n in names.values()} == held
    # A revert ends it without touching anything; another change is tried at once.
    good = {n: {"always_on": True} for n in names.values()}
    robot.declare(good)
    robot.wait(lambda: not any(failed(robot, n) for n in started) and robot.quiet())
    assert {n: identity(robot, n) for n in names.values()} == held
    robot.declare({**good, "user": {"always_on": True, "container": {"user": "0"}}})
    robot.wait(lambda: held["user"][0] not in {c.id for c in robot.containers()})
    assert {n: identity(robot, n) for n in names.values() if n != "user"} == {
        n: run for n, run in held.items() if n != "user"
    }
    assert len(robot.containers()) == len(names)


def test_processes_have_the_same_way_back(tmp_path):
    robot = RealRobot(tmp_path, "process", None)
    try:
        robot.declare({"arm": {"always_on": True}, "cam": {"always_on": True}})
        robot.wait(lambda: robot.active() == {"arm", "cam"})
        before = {n: identity(robot, n)[0] for n in ("arm", "cam")}
        robot.declare(
            {
                "arm": {"always_on": True, "command": "rosluanch x"},
                "cam": {"always_on": True, "command": "sh -c 'exit 3'"},
            }
        )
        robot.wait(lambda: failed(robot, "arm") and failed(robot, "cam"))
        robot.wait(lambda: {c.id for c in robot.containers()} == {*before.values()})
        robot.wait(lambda: robot.active() == {"arm", "cam"})
    finally:
        robot.close()


def test_apply_says_that_a_change_failed(docker_robot):
    robot = docker_robot
    write_tree(robot.tree, {"arm": {"always_on": True}})
    apply = ["apply", str(robot.tree), "--yes", "--wait", "--state-dir", str(robot.state.path), "--engine", "docker"]
    commands.rorg(*apply)
    before = identity(robot, "arm")[0]
    write_tree(robot.tree, {"arm": {"always_on": True, "container": {"user": "nosuch"}}})
    assert "its change failed" in commands.rorg(*apply, "--timeout", "60", code=4).stderr
    assert identity(robot, "arm")[0] == before
    assert running(robot, "arm")
    robot.start()
    robot.wait(lambda: failed(robot, "arm"))
    write_tree(robot.tree, {"arm": {"always_on": True, "command": ["sh", "-c", "sleep .3; exit 5"]}})
    assert "exit code 5" in commands.rorg(*apply, "--timeout", "60", code=4).stderr
    assert identity(robot, "arm")[0] == before
    assert running(robot, "arm")


@pytest.mark.slow
def test_what_runs_goes_on_until_the_new_one_can_begin(virtual):
    """A new need that is never ready ends nothing."""
    virtual.declare({"nav": {"always_on": True}, "gps": {"ready": {"tcp": 1}}})
    virtual.settle()
    virtual.sim.ready_after["gps"] = 1e9
    run = virtual.container("nav").incarnation
    virtual.declare(
        {
            "nav": {"always_on": True, "needs": ["gps"], "container": {"environment": {"N": "1"}}},
            "gps": {"ready": {"tcp": 1}},
        }
    )
    later(virtual, 60)
    assert running(virtual, "nav").incarnation == run
    assert "gps is not ready" in virtual.waits("nav")


def test_while_the_new_one_cannot_be_made_the_old_one_is_kept_running(virtual):
    virtual.declare({"nav": {"always_on": True}})
    virtual.settle()
    later(virtual, 100)
    before = virtual.container("nav")
    virtual.sim.faults.fail["create", "nav"] = ["no such image"] * 1000
    virtual.declare({"nav": {"always_on": True, "image": "nosuch"}})
    later(virtual, 10)
    assert virtual.container("nav").incarnation == before.incarnation
    virtual.kill("nav")
    virtual.wait(lambda: running(virtual, "nav") is not None)
    assert virtual.container("nav").id == before.id
    assert "no such image" in virtual.waits("nav")


def test_what_changed_while_idle_can_go_back_too(virtual):
    virtual.declare({"nav": {}})
    virtual.request("nav")
    virtual.settle()
    virtual.release()
    virtual.settle()
    before = virtual.container("nav").id
    virtual.declare({"nav": {"container": {"environment": {"N": "1"}}}})
    virtual.sim.faults.bad[virtual.sim.desired.digests["nav"]] = "start"
    virtual.settle()
    virtual.request("nav")
    virtual.wait(lambda: (c := running(virtual, "nav")) is not None and c.id == before)
    later(virtual, 10)
    assert [c.id for c in virtual.containers()] == [before]


@pytest.mark.parametrize("bad", ["", "start", "exit"])
def test_a_kill_of_rorg_at_any_moment_of_a_swap(virtual, bad):
    """rorg is killed before each of its actions in turn; what the next one finds always leads to the same end."""
    for kill_at in range(1, 12):
        virtual.sim = None
        virtual.declare({"nav": {"always_on": True}})
        virtual.settle()
        later(virtual, 5)
        before = virtual.container("nav").id
        virtual.declare({"nav": {"always_on": True, "container": {"environment": {"N": "1"}}}})
        if bad:
            virtual.sim.faults.bad[virtual.sim.desired.digests["nav"]] = bad
        done, end = len(virtual.sim.log) + kill_at, virtual.now() + 20
        virtual.sim.at(end, lambda: None)
        virtual.wait(lambda done=done, end=end: len(virtual.sim.log) >= done or virtual.now() >= end)
        # Nothing that it published but the state of before: the worst that a kill can leave.
        virtual.sim.reborn(Memory())
        virtual.wait(lambda: running(virtual, "nav") and len(virtual.containers()) == 1, 120)
        later(virtual, 10)
        assert [c.name for c in virtual.containers()] == ["nav"]
        assert (virtual.container("nav").id == before) == bool(bad), f"killed before action {kill_at}"


def test_kill_9_of_rorg_during_updates_on_docker(docker_robot):
    """Good and bad changes in turn, rorg killed at random in each: the service always comes to what it should be."""
    robot, chance, daemon = docker_robot, random.Random(20261121), Daemon(docker_robot)
    write_tree(robot.tree, {"arm": {"always_on": True}})
    try:
        daemon.start()
        wait_for(lambda: running(robot, "arm"), 60)
        for n in range(4):
            wait_for(daemon.settled, 60)
            before, bad = robot.container("arm").id, n % 2 == 0
            options = {"environment": {"N": str(n)}, **({"user": "nosuch"} if bad else {})}
            write_tree(robot.tree, {"arm": {"always_on": True, "container": options}})
            # The moment is random on purpose: any point of a pass, a call or a write.
            time.sleep(0.2 + chance.random() * 0.5)
            daemon.kill()
            daemon.start()
            wait_for(
                lambda bad=bad: (
                    bool(failed(robot, "arm")) == bad
                    and daemon.status()
                    and running(robot, "arm")
                    and [c.name for c in robot.containers()] == ["arm"]
                ),
                60,
            )
            found = look(robot, robot.container("arm").id)
            assert (found["Id"] == before) == bad
            if bad:
                write_tree(
                    robot.tree,
                    {"arm": {"always_on": True, "container": {"environment": {"N": str(n - 1)}}}}
                    if n
                    else {"arm": {"always_on": True}},
                )
    finally:
        daemon.kill()


def test_what_failed_is_remembered_by_the_next_rorg(virtual):
    virtual.declare({"nav": {"always_on": True}})
    virtual.settle()
    virtual.declare({"nav": {"always_on": True, "container": {"environment": {"N": "1"}}}})
    virtual.sim.faults.bad[virtual.sim.desired.digests["nav"]] = "start"
    later(virtual, 10)
    calls = len(virtual.sim.engine.calls)
    virtual.sim.reborn(handed_on(virtual.sim.decision))
    later(virtual, 200)
    assert len(virtual.sim.engine.calls) == calls
    assert "its change failed" in virtual.waits("nav")
    # A person who asks for a restart wants what runs restarted; one who asks for another try gets that.
    before = virtual.container("nav")
    restart(virtual, "nav")
    later(virtual, 10)
    assert virtual.container("nav").id == before.id
    assert virtual.container("nav").incarnation != before.incarnation
    del virtual.sim.faults.bad[virtual.sim.desired.digests["nav"]]
    retry(virtual, "nav")
    later(virtual, 10)
    assert virtual.container("nav").digest == virtual.sim.desired.digests["nav"]


@pytest.fixture
def virtual(tmp_path):
    return VirtualRobot(tmp_path)


def restart(virtual, name: str) -> None:
    virtual.change(lambda asked: replace(asked, restarts={name: stamp(virtual.wall())}))


# -- what is mended does not wait --------------------------------------------------------------------------------


def test_a_mended_manifest_is_tried_at_once(docker_robot):
    robot = docker_robot
    bad = {"container": {"devices": ["/dev/nosuch:/dev/nosuch"]}}
    robot.declare({"arm": {"always_on": True, **bad}, "cam": {"always_on": True, "image": "nosuch"}})
    # Until the next attempt is some seconds away.
    robot.wait(lambda: robot.loop.running.memory.of("arm").retry_at > robot.loop.clock() + 7.0, 60)
    robot.wait(lambda: "cannot be pulled" in robot.waits("cam"))
    until = robot.loop.running.memory.of("arm").retry_at
    wait_for(lambda: "again in" in diff(robot), 5, "diff says that the start waits")
    robot.declare({"arm": {"always_on": True}, "cam": {"always_on": True}})
    robot.wait(lambda: robot.active() == {"arm", "cam"})
    assert robot.loop.clock() < until


def diff(robot) -> str:
    words = ["diff", str(robot.tree), "--state-dir", str(robot.state.path), "--engine", robot.kind]
    return commands.run(words).stdout


def test_attempts_may_go_on_for_days():
    from rorg.core.memory import CAP, delay

    assert delay(100_000) == CAP


def test_a_restart_of_what_does_not_start_keeps_to_the_back_off(virtual):
    virtual.declare({"nav": {"always_on": True}})
    virtual.sim.faults.bad[virtual.sim.desired.digests["nav"]] = "start"
    later(virtual, 1)
    restart(virtual, "nav")
    before = len(virtual.log())
    later(virtual, 100)
    assert len(virtual.log()) - before < 20


# -- volumes that nobody named -----------------------------------------------------------------------------------


def volumes(robot) -> set[str]:
    return {v["Name"] for v in robot.engine.api().volumes()["Volumes"] or []}


@pytest.fixture
def image_with_volume(dockerd):
    import docker

    api = docker.APIClient(dockerd.host, version="auto")
    text = f"FROM {BASE_IMAGE}\nVOLUME /data\n"
    list(api.build(fileobj=io.BytesIO(text.encode()), tag="with-volume", decode=True, rm=True))
    return "with-volume"


def put(robot, service: str, path: str, text: str) -> None:
    code, said = robot.engine.exec(
        robot.container(service).id, ["python3", "-S", "-c", f"open({path!r}, 'w').write({text!r})"], 30
    )
    assert code == 0, said


def get(robot, service: str, path: str) -> str:
    return (
        robot.engine.exec(robot.container(service).id, ["python3", "-S", "-c", f"print(open({path!r}).read())"], 30)[1]
        .decode()
        .strip()
    )


def test_unnamed_volumes_go_with_the_service_not_with_a_container(docker_robot, image_with_volume):
    robot, at_first = docker_robot, volumes(docker_robot)
    spec = {"image": image_with_volume, "always_on": True, "container": {"volumes": ["/more"]}}
    robot.declare({"map": spec, "other": {"always_on": True}})
    robot.settle()
    put(robot, "map", "/data/map", "here")
    put(robot, "map", "/more/map", "there")
    for n in range(2):
        before = robot.container("map").id
        robot.declare(
            {
                "map": {**spec, "container": {**spec["container"], "environment": {"N": str(n)}}},
                "other": {"always_on": True},
            }
        )
        robot.wait(lambda before=before: before not in {c.id for c in robot.containers()})
        assert (get(robot, "map", "/data/map"), get(robot, "map", "/more/map")) == ("here", "there")
    assert len(volumes(robot) - at_first) == 2
    robot.declare({"other": {"always_on": True}})
    robot.wait(lambda: volumes(robot) == at_first)


def test_volumes_of_a_container_that_an_older_rorg_made(docker_robot, image_with_volume):
    """There the engine gave them their names; they are found all the same."""
    robot, at_first = docker_robot, volumes(docker_robot)
    spec = {"image": image_with_volume, "always_on": True}
    robot.declare({"map": spec})
    robot.settle()
    robot.stop()
    found = robot.container("map")
    data = look(robot, found.id)
    robot.engine.stop(found.id, "SIGKILL", 5)
    robot.engine.remove(found.id, volumes=True)
    body = {"Image": image_with_volume, "Cmd": WORK, "Labels": data["Config"]["Labels"], "HostConfig": {}}
    made = robot.engine.api().create_container_from_config(body, "map")["Id"]
    robot.engine.start(made)
    put(robot, "map", "/data/map", "here")
    robot.start()
    robot.declare({"map": {**spec, "container": {"environment": {"N": "1"}}}})
    robot.wait(lambda: made not in {c.id for c in robot.containers()})
    assert get(robot, "map", "/data/map") == "here"
    before = robot.container("map").id
    robot.declare({"map": {**spec, "container": {"environment": {"N": "2"}}}})
    robot.wait(lambda: before not in {c.id for c in robot.containers()})
    assert get(robot, "map", "/data/map") == "here"
    robot.declare({"other": {}})
    robot.wait(lambda: volumes(robot) == at_first)


# -- files that a service mounts from the tree -------------------------------------------------------------------


@pytest.mark.slow
def test_changed_files_restart_signal_or_nothing(real_robot):
    """Also by a rorg that was not there when they changed; a revert counts as a change."""
    robot = real_robot
    folder = robot.tree / "services/config"
    (folder / "deep").mkdir(parents=True)
    (folder / "deep/a.yaml").write_text("speed: 1\n")
    seen = robot.tree.parent / "hups"
    seen.mkdir()
    counts = (
        "import signal, sys, pathlib\nout = pathlib.Path('/seen')\nout = out if out.exists() else "
        f"pathlib.Path({str(seen)!r})\n"
        "def hup(*_): (out / 'n').write_text(str(int((out / 'n').read_text() or 0) + 1))\n"
        "(out / 'n').write_text('0')\nsignal.signal(signal.SIGHUP, hup)\n"
        "for s in (2, 15): signal.signal(s, lambda *_: sys.exit(0))\n(out / 'up').write_text('')\n"
        "while True: signal.pause()"
    )
    spec = {"always_on": True, "mounts": ["./config:/config"]}
    tree = {
        "again": spec,
        "quiet": {**spec, "on_change": "none"},
        "other": {"always_on": True},
        "file": {"always_on": True, "container": {"volumes": ["./config/deep/a.yaml:/a.yaml:ro"]}},
        "single": {
            "always_on": True,
            "on_change": "signal HUP",
            "container": {"volumes": ["./config/deep/a.yaml:/a.yaml:ro"]},
        },
        "writes": {"always_on": True, "container": {"volumes": ["./config:/config"]}},
        "told": {
            **spec,
            "on_change": "signal HUP",
            "command": ["python3", "-S", "-c", counts],
            "container": {"volumes": [f"{seen}:/seen"]},
        },
    }
    robot.declare(tree)
    robot.wait(lambda: robot.active() == {*tree} and (seen / "up").exists())
    robot.wait(robot.quiet)
    runs = {n: identity(robot, n) for n in tree}
    restarted = ("again", "file", "single")

    def expect(hups: int) -> None:
        """Those that read it are another run of the same container, `told` was told, nobody else noticed."""
        robot.wait(lambda: all(identity(robot, n)[1] > runs[n][1] for n in restarted))
        robot.wait(lambda: (seen / "n").read_text() == str(hups))
        robot.wait(robot.quiet)
        assert {n: identity(robot, n) for n in tree if n not in restarted} == {
            n: run for n, run in runs.items() if n not in restarted
        }
        assert all(identity(robot, n)[0] == runs[n][0] for n in tree)
        runs.update({n: identity(robot, n) for n in tree})

    (folder / "deep/a.yaml").write_text("speed: 2\n")
    expect(1)
    os.utime(folder / "deep/a.yaml")  # nothing of it changed
    (folder / ".a.yaml.swp").write_text("an editor's own")
    robot.loop.wakes.files_changed()
    robot.settle()
    assert {n: identity(robot, n) for n in tree} == runs
    robot.stop()
    (folder / "deep/a.yaml").write_text("speed: 1\n")
    shown = diff(robot)
    assert "changed: services/config" in shown, shown
    assert "quiet" not in shown, shown
    assert "signal  told" in shown, shown
    robot.start()
    expect(2)


def test_only_files_that_changed_are_read_again(tmp_path):
    from rorg.host.contents import Contents
    from rorg.manifest.load import load_or_raise

    write_tree(tmp_path, {"nav": {"mounts": ["./config:/config"]}, "twin": {"mounts": ["./config:/config"]}})
    config = tmp_path / "services/config"
    config.mkdir()
    for n in range(20):
        (config / f"{n}.yaml").write_text(str(n))
    os.mkfifo(config / "pipe")
    (config / "gone").symlink_to("nowhere")
    catalog, contents = load_or_raise(tmp_path), Contents()
    first = contents.of(catalog, tmp_path)
    assert contents.files.read == 20
    assert first["nav"] == first["twin"]
    assert contents.of(catalog, tmp_path) == first
    assert contents.files.read == 20
    (config / "3.yaml").write_text("x")
    second = contents.of(catalog, tmp_path)
    assert contents.files.read == 21
    assert second != first
    (config / "3.yaml").write_text("3")
    assert contents.of(catalog, tmp_path) == first
    (config / "3.yaml").chmod(0)
    assert contents.of(catalog, tmp_path).keys() == first.keys()
    (config / "big").open("wb").truncate(1 << 40)
    assert contents.of(catalog, tmp_path) == {}, "what is too big is not looked at"


def test_a_container_of_an_older_rorg_is_taken_as_it_is(virtual):
    """What it has read is not known; nothing restarts by itself, and from then on changes count."""
    from rorg.core.desired import desire

    virtual.declare({"nav": {"always_on": True}})
    virtual.settle()
    run = virtual.container("nav").incarnation
    catalog = virtual.sim.desired.catalog
    virtual.sim.reborn(remembered({"nav": {"run": "", "needs": {}, "stopped": ""}}, 0.0, ""))
    virtual.sim.desired = desire(catalog, contents={"nav": {"services/nav": "1"}})
    later(virtual, 5)
    assert virtual.container("nav").incarnation == run
    virtual.sim.desired = desire(catalog, contents={"nav": {"services/nav": "2"}})
    later(virtual, 5)
    assert virtual.container("nav").incarnation != run


@pytest.mark.parametrize("said", ["signal", "signal NOSUCH", "sometimes", 5])
def test_on_change_says_what_it_takes(tmp_path, said):
    from rorg.manifest.load import load

    write_tree(tmp_path, {"nav": {"on_change": said}})
    assert "signal SIGHUP" in str(load(tmp_path).errors[0])
