"""The tour-guide robot: 41 services, the five actions of its work cycle, on Docker."""

from __future__ import annotations

import json
import random
import shutil
import time

import commands
import pytest
import yaml
from common import ROOT, alone_on_the_machine, free_port, wait_for
from image_trees import Heard
from robots import RealRobot
from ros_master import NODES

from rorg.engines.docker.engine import DockerEngine
from rorg.images.graph import descendants, hierarchy
from rorg.images.order import LABEL_BUILDER
from rorg.images.references import references_for
from rorg.images.supply import Supplier
from rorg.manifest.load import load_or_raise
from rorg.model.graph import stands_on
from rorg.store.state_dir import StateDir

CYCLE = yaml.safe_load((ROOT / "tests" / "cases" / "tour_cycle.yaml").read_text())
CLIENT = ROOT / "clients/python/rorg_client"


def expected(action: dict) -> set[str]:
    """What must be active during an action, and nothing else."""
    return {*CYCLE["always_on"], "behavioral", *(action["requests"])}


@pytest.fixture(scope="module")
def images(dockerd, tmp_path_factory):
    """The 45 stand-in images, built once."""
    catalog, engine = load_or_raise(ROOT / "manifests"), DockerEngine("test", dockerd.host)
    state = StateDir(tmp_path_factory.mktemp("images")).prepare()
    heard, content = Heard(), references_for("docker", state.path).of(catalog)
    supplier = Supplier(engine, state, "test", jobs=2)
    results = supplier.supply(catalog, content, sorted(catalog.images), listener=heard)
    assert {r.outcome for r in results} <= {"built", "imported", "present"}, results
    assert len(results) == 45


@pytest.fixture
def triton(dockerd, images, tmp_path):
    """Its services answer at fixed ports of the machine, which are those of `rorg demo` too."""
    with alone_on_the_machine("demo"):
        found = RealRobot(tmp_path, "docker", dockerd.host)
        shutil.copytree(ROOT / "manifests", found.tree)
        shutil.copytree(ROOT / "images", found.tree.parent / "images")
        profile = found.tree / "profiles" / "standin.yaml"
        profile.write_text(profile.read_text() + '      STANDIN_SCALE: "0.05"\n')
        yield found
        found.close()


def rorg(robot: RealRobot, *args: str, code: int = 0) -> str:
    environment = {"RORG_STATE_DIR": str(robot.state.path), "RORG_ENGINE": robot.kind, "DOCKER_HOST": robot.host}
    return commands.rorg(*args, code=code, **environment).stdout


def ask(robot: RealRobot, action: dict) -> None:
    who = action["who"]
    robot.request(*action["requests"], id=f"cycle-{who}", by=who)


def test_diff_apply_diff(triton):
    plan = json.loads(rorg(triton, "diff", str(triton.tree), "-o", "json", code=1))
    assert sum(a["verb"] == "create" for a in plan["actions"]) <= 41
    rorg(triton, "apply", str(triton.tree), "--yes", "--wait")
    assert json.loads(rorg(triton, "diff", str(triton.tree), "-o", "json", code=0))["actions"] == []
    assert triton.active() == set(CYCLE["always_on"])


def test_the_work_cycle_leaves_exactly_what_each_action_needs(triton):
    triton.start()
    triton.wait(lambda: triton.loop.tree.loaded and triton.active() == set(CYCLE["always_on"]), 60)
    for action in [*CYCLE["actions"], CYCLE["actions"][1]]:
        ask(triton, action)
        want = expected(action) if action["action"] > 1 else {*CYCLE["always_on"], "behavioral"}
        triton.wait(lambda want=want: triton.active() == want, 60)
        triton.settle()
        assert triton.active() == want, action["name"]
    starts = [line for line in triton.lines if line.startswith(("> start cartographer_localization", "> start navi"))]
    assert "cartographer_localization" in starts[0], "localization comes before navigation"


def test_damage_in_the_middle_of_a_tour_is_repaired(triton):
    triton.start()
    triton.wait(lambda: triton.loop.tree.loaded and triton.active() == set(CYCLE["always_on"]), 60)
    tour = CYCLE["actions"][3]
    ask(triton, CYCLE["actions"][0])
    triton.wait(lambda: "behavioral" in triton.active())
    ask(triton, tour)
    triton.wait(lambda: triton.active() == expected(tour), 60)
    triton.settle()
    api = triton.engine.api()
    before = {c.service: c for c in triton.containers()}
    api.kill(before["navigation"].id)
    api.pause(before["leg_tracker"].id)
    api.remove_container(before["back_laser"].id, force=True)
    api.rename(before["laser_repub"].id, "somewhere-else")
    triton.wait(
        lambda: (
            triton.active() == expected(tour)
            and len(triton.containers()) == 41
            and triton.container("laser_repub").name == "laser_repub"
            and triton.container("navigation").incarnation != before["navigation"].incarnation
        ),
        60,
    )
    triton.settle()
    after = {c.service: c for c in triton.containers()}
    touched = {n for n, c in after.items() if c.incarnation != before[n].incarnation}
    assert touched == {"navigation", "back_laser"}
    api.stop(before["behavioral"].id)
    triton.wait(lambda: triton.active() == {*CYCLE["always_on"], "behavioral"}, 60)
    assert [r.id for r in triton.requests()] == ["cycle-developer"]


def test_kill_9_at_20_random_moments_of_the_cycle(triton):
    """Four in each action. What was up all the time is never started again, and each action ends up complete."""
    chance = random.Random(41)
    log = (triton.state.path.parent / "run.log").open("ab")

    words = ["run", triton.tree, "--state-dir", triton.state.path, "--engine", "docker"]

    def start() -> commands.Forked:
        return commands.Forked(words, stdout=log, stderr=log)

    process = start()
    try:
        wait_for(lambda: triton.active() == set(CYCLE["always_on"]), 60)
        before = {c.service: c.incarnation for c in triton.containers() if c.alive}
        for action in CYCLE["actions"]:
            ask(triton, action)
            for _ in range(4):
                time.sleep(chance.random() * 0.8)  # any moment of starting, reading, planning or acting
                process.kill()
                process.wait()
                process = start()
            want = expected(action) if action["action"] > 1 else {*CYCLE["always_on"], "behavioral"}
            wait_for(lambda want=want: triton.active() == want, 60, action["name"])
        after = {c.service: c.incarnation for c in triton.containers()}
        assert {n: after[n] for n in before} == before
        assert len(triton.containers()) == 41
        assert {r.id for r in triton.requests()} == {"cycle-developer", "cycle-behavioral"}
    finally:
        process.kill()
        process.wait()


@pytest.mark.parametrize("language", ["python", "cpp"])
def test_a_behaviour_program_plays_the_cycle_through_the_api(triton, request, language):
    """In its container, with the rights that its manifest gives it; then it is killed while it holds a tour."""
    steps = triton.tree.parent / "steps"
    steps.mkdir()
    actions = [a for a in CYCLE["actions"] if a["who"] == "behavioral"]
    words = [f"{a['name']}={','.join(a['requests'])}" for a in actions]
    if language == "python":
        command, mounts = (
            ["python3", "/program/tour.py"],
            [
                f"{ROOT / 'tests/support/programs/tour.py'}:/program/tour.py:ro",
                f"{ROOT / 'rorg'}:/program/rorg:ro",
                f"{CLIENT}:/program/rorg_client:ro",
            ],
        )
    else:
        programs = request.getfixturevalue("cpp_programs")
        command, mounts = ["/program/tour"], [f"{programs}/tour:/program/tour:ro"]
    edit(
        triton,
        "behavioral",
        image="rorg-base",
        command=[*command, str(steps), *words],
        restart="never",
        profile="common",
        may_request=sorted({s for a in actions for s in a["requests"]}),
        container={"volumes": [*mounts, f"{steps}:{steps}"]},
    )
    play(triton, steps, actions)


def play(triton: RealRobot, steps, actions: list[dict], also: tuple[str, ...] = ()) -> None:
    """Steps a behaviour program through its actions, then kills it while it holds the last. `also` is what runs
    besides."""
    always = {*CYCLE["always_on"], *also}
    triton.with_server = True
    triton.start()
    triton.wait(lambda: triton.loop.tree.loaded and triton.active() == set(CYCLE["always_on"]), 60)
    ask(triton, CYCLE["actions"][0])
    for action in actions:
        try:
            triton.wait(lambda action=action: (steps / f"ready-{action['name']}").exists(), 60)
        except AssertionError:
            print(
                b"".join(
                    line.text for line in triton.engine.log_lines(triton.container("behavioral").id, None, None, False)
                ).decode()
            )
            raise
        triton.wait(lambda action=action: triton.active() == expected(action) | always, 60)
        if action is not actions[-1]:
            (steps / f"next-{action['name']}").touch()
    assert [r.requester for r in triton.requests()] == ["developer", "behavioral"]
    triton.kill("behavioral")
    killed = time.monotonic()
    triton.wait(lambda: [r.requester for r in triton.requests()] == ["developer"])
    assert time.monotonic() - killed < 5, "by its end, not by its lease"
    triton.wait(lambda: triton.active() <= always)


def test_a_behaviour_program_plays_the_cycle_through_ros(triton, ros_image, package):
    """With a real roscore in place of the stand-in, and rorg's ROS node as one service more."""
    steps = triton.tree.parent / "steps"
    steps.mkdir()
    master = f"http://localhost:{free_port()}"
    actions = [a for a in CYCLE["actions"] if a["who"] == "behavioral"]
    words = [f"{a['name']}={','.join(a['requests'])}" for a in actions]
    edit(
        triton,
        "roscore",
        image=ros_image,
        command=f"roscore -p {master.rpartition(':')[2]}",
        profile="common",
        ready={"ros_node": "/rosout"},
        container={"environment": {"ROS_MASTER_URI": master}},
    )
    ros = {
        "environment": {
            "ROS_MASTER_URI": master,
            "ROS_HOSTNAME": "localhost",
            "PYTHONPATH": "/bridge/lib/python3/dist-packages:/program",
        },
        "volumes": [
            f"{package}:/bridge:ro",
            f"{ROOT / 'rorg'}:/program/rorg:ro",
            f"{NODES}:/nodes:ro",
            f"{CLIENT}:/program/rorg_client:ro",
            f"{steps}:{steps}",
        ],
    }
    bridge = {
        "image": ros_image,
        "command": "/bridge/lib/rorg_ros/rorg_node.py",
        "profile": "common",
        "needs": ["roscore"],
        "ready": {"ros_node": "/rorg"},
        "container": ros,
        "may_act_for": ["*"],
    }
    (triton.tree / "services/rorg_ros.yaml").write_text(
        yaml.safe_dump({"apiVersion": "rorg/v1", "kind": "Service", "metadata": {"name": "rorg_ros"}, "spec": bridge})
    )
    edit(
        triton,
        "behavioral",
        image=ros_image,
        command=["python3", "/nodes/cycle.py", str(steps), *words],
        restart="never",
        profile="common",
        needs=["rorg_ros"],
        container=ros,
        may_request=sorted({s for a in actions for s in a["requests"]}),
    )
    play(triton, steps, actions, ("rorg_ros",))


def edit(robot: RealRobot, name: str, **fields) -> None:
    """Sets fields of a service's manifest."""
    path = robot.tree / "services" / f"{name}.yaml"
    manifest = yaml.safe_load(path.read_text())
    manifest["spec"] |= fields
    path.write_text(yaml.safe_dump(manifest))


def test_the_hierarchy_of_images_is_built_in_order_once_and_again_where_it_changes(dockerd, images, tmp_path):
    """45 stand-ins, 36 of them the robot's (paper, Section III): parents before children, as the engine tells it; a
    second time nothing; after a change of one file exactly what descends from it."""
    copy = tmp_path / "robot"
    shutil.copytree(ROOT / "manifests", copy / "manifests")
    shutil.copytree(ROOT / "images", copy / "images")
    (copy / "images/standin/salt").write_text(str(tmp_path))  # so all but the root are images that nobody has built
    dockerfile = copy / "images/standin/Dockerfile"
    dockerfile.write_text(dockerfile.read_text() + f"LABEL salt={tmp_path.name}\n")
    engine, state = DockerEngine("hierarchy", dockerd.host), StateDir(tmp_path / "state").prepare()
    supplier, references = Supplier(engine, state, "hierarchy", jobs=2), references_for("docker", state.path)

    def build() -> list[str]:
        catalog = load_or_raise(copy / "manifests")
        results = supplier.supply(catalog, references.of(catalog), sorted(catalog.images), listener=Heard())
        assert all(r.good for r in results), results
        return [r.reference.partition(":")[0] for r in results if r.outcome == "built"]

    api = engine.api()
    since = int(time.time())
    built = build()
    assert len(built) == 44
    events = api.events(since=since, until=int(time.time()) + 1, filters={"type": "image", "event": "tag"}, decode=True)
    tagged = [e["Actor"]["Attributes"]["name"] for e in events]
    first = {name: place for place, name in reversed(list(enumerate(tagged)))}
    stands = stands_on(load_or_raise(copy / "manifests").images)
    below = [(name, parent) for name, parents in stands.items() for parent in parents if parent in built]
    assert len(below) >= 36
    assert [(n, p) for n, p in below if not first[f"{p}:latest"] < first[f"{n}:latest"]] == []
    assert build() == []
    middle = copy / "images/fetch_deploy_base/Dockerfile"
    middle.write_text(middle.read_text() + "LABEL changed=yes\n")
    graph = hierarchy(stands_on(load_or_raise(copy / "manifests").images))
    assert set(build()) == {"fetch_deploy_base", *descendants(graph, "fetch_deploy_base")}
    for row in api.images(filters={"label": f"{LABEL_BUILDER}=hierarchy"}):
        for tag in row["RepoTags"] or ():
            api.remove_image(tag, force=True)
