"""`rorg dev`: a shell in the very image of a service, as somebody types it, on a real engine."""

from __future__ import annotations

import io
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
from pathlib import Path
from typing import NamedTuple

import docker
import pytest
from all_commands import Commands
from common import BASE_IMAGE, wait_for
from robots import WORK, RealRobot
from terminals import Terminal, environment

from rorg.engines.docker.body import create_body
from rorg.host.git import configured_identity
from rorg.host.person import Person, caller
from rorg.images.dev import COVERED, HOME, STAY, Developer, declared_digest, dev_spec, drift, name_for
from rorg.images.devcontainer import document
from rorg.model.dev import DevContainer

UID = 47_001
"""A number that no user of the machine has, and no image."""
BEHIND_SUDO = {"SUDO_UID": str(UID), "SUDO_GID": str(UID)} if os.geteuid() == 0 else {}
TOOLS = "rorg-tools"
ARM = {
    "image": TOOLS,
    "container": {"environment": {"WHERE": "inside"}, "mem_limit": "300Mi", "container_name": "the-arm"},
}
SERVICES = {
    "arm": ARM,
    "laser": {"always_on": True, "driver": {"groups": ["dialout"]}},
    "caller": {"may_request": ["arm"]},
    "duty": {"type": "meta"},
}
GROUPS = {"all": {"services": ["arm", "laser"]}}
COMES = "python3", "-S", "-c"


@pytest.fixture(scope="module")
def tools(dockerd) -> str:
    """The test image with bash and sleep in it."""
    api = docker.APIClient(dockerd.host, version="auto")
    programs = [shutil.which("bash"), shutil.which("sleep")]
    asked = subprocess.run(["ldd", *programs], capture_output=True, text=True).stdout
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w", dereference=True) as tar:
        for path in {*programs, *re.findall(r"=> (/\S+) \(0x", asked)}:
            tar.add(path, os.path.realpath(os.path.dirname(path)) + "/" + os.path.basename(path))
    made = api.create_container(BASE_IMAGE, WORK)["Id"]
    api.put_archive(made, "/", stream.getvalue())
    api.commit(made, TOOLS)
    api.remove_container(made)
    return TOOLS


@pytest.fixture
def workspace(tmp_path) -> Path:
    found = tmp_path / "my ws"
    (found / "src").mkdir(parents=True)
    for path in (found, found / "src"):
        os.chown(path, UID if BEHIND_SUDO else -1, UID if BEHIND_SUDO else -1)
    return found


@pytest.fixture(scope="module")
def commands(tmp_path_factory):
    return Commands(tmp_path_factory.mktemp("commands"), Path("/nonexistent"))


@pytest.fixture(scope="module")
def running(dockerd, tools, commands, tmp_path_factory):
    """A robot, and commands to it."""
    found = RealRobot(tmp_path_factory.mktemp("robot"), "docker", dockerd.host)
    found.declare(SERVICES, groups=GROUPS)
    found.wait(lambda: "laser" in found.active() and found.container("arm"))
    found.commands = commands
    yield found
    found.close()


@pytest.fixture
def robot(running):
    """With nothing to develop in yet."""
    running.declare(SERVICES, groups=GROUPS)
    yield running
    api = running.engine.api()
    for row in api.containers(all=True, filters={"label": "rorg.io/dev"}):
        api.remove_container(row["Id"], force=True)


class Said(NamedTuple):
    stdout: str
    stderr: str


def rorg(robot, folder, *words: str, code: int = 0, **more: str) -> Said:
    """In a folder, as the person behind sudo."""
    robot.commands.folder = folder
    got, out, err = robot.commands(list(words), **{**environment(robot), **BEHIND_SUDO, **more})
    assert got == code, f"exit {got}\n{out}\n{err}"
    return Said(out, err)


def shell_in(robot, folder) -> Terminal:
    """A shell for arm, once it has a prompt."""
    found = Terminal(robot, "dev", "arm", cwd=folder, columns=400, **BEHIND_SUDO)
    # Docker 20.10 tells the shell the size of the terminal after its start, so the first prompt may be cut on its left.
    found.expect(rb"\$ $")
    found.type(b"\r")
    found.expect(rb"\(arm-dev\) [^$]*" + folder.name.encode() + rb"\$ $")
    return found


def inspect(robot, name: str) -> dict:
    return robot.engine.api().inspect_container(name)


def names(robot, workspace) -> list[str]:
    return rorg(robot, workspace, "dev", "-o", "name").stdout.split()


# -- a shell ---------------------------------------------------------------------------------------------------


def test_a_shell_in_the_image_with_the_workspace_and_the_hand_of_the_caller(robot, workspace):
    (workspace / "outside").write_text("edited-outside\n")
    shell = shell_in(robot, workspace)
    shell.type(b'read line <outside; echo "$line-$WHERE-$PWD"\r')
    shell.expect(rb"edited-outside-inside-" + str(workspace).encode() + rb"\r")
    shell.type(b"echo edited-inside >src/new; echo made-$?\r")
    shell.expect(rb"made-0")
    made = workspace / "src/new"
    assert made.read_text() == "edited-inside\n"
    assert made.stat().st_uid == made.stat().st_gid == (UID if BEHIND_SUDO else os.getuid())
    (workspace / "outside").write_text("edited-again\n")
    shell.type(b"echo $(<outside)\r")
    shell.expect(rb"\nedited-again")
    shell.type(b"echo $USER at $HOME; touch=1; : >$HOME/kept && exit 3\r")
    shell.expect(rf"{UID if BEHIND_SUDO else ''}.* at {HOME}".encode())
    assert shell.end() == 3
    found = inspect(robot, "arm-dev")
    assert found["State"]["Running"], "the shell's end leaves it"
    assert found["Image"] == inspect(robot, "the-arm")["Image"]
    host = found["HostConfig"]
    assert (host["Memory"], host["NetworkMode"]) == (300 << 20, "host")
    assert "rorg.io/owner" not in found["Config"]["Labels"]
    assert found["Config"]["Labels"]["rorg.io/dev-of"] == "arm"


def test_the_same_container_until_it_is_wanted_fresh_and_history_stays(robot, workspace):
    shell = shell_in(robot, workspace)
    shell.type(b"echo contaminated >/tmp/mess; echo there-$?\r")
    shell.expect(rb"there-0")
    first = inspect(robot, "arm-dev")["Id"]
    again = shell_in(robot, workspace / "src")  # a second shell beside the first
    again.type(b"echo $(</tmp/mess)-of-$HOSTNAME\r")
    again.expect(rb"contaminated-of-")
    for terminal in (shell, again):
        terminal.type(b"exit\r")
        assert terminal.end() == 0
    looks = "import os; print(os.path.exists('/tmp/mess'), 'contaminated' in open(os.environ['HISTFILE']).read())"
    assert rorg(robot, workspace, "dev", "arm", "--", *COMES, looks).stdout == "True True\n"
    assert inspect(robot, "arm-dev")["Id"] == first
    assert rorg(robot, workspace, "dev", "arm", "--fresh", "--", *COMES, looks).stdout == "False True\n"
    assert inspect(robot, "arm-dev")["Id"] != first
    assert names(robot, workspace) == ["arm-dev"]


def test_one_that_ended_or_is_paused_goes_on(robot, workspace):
    rorg(robot, workspace, "dev", "arm", "--", "sh", "-c", ":")
    api = robot.engine.api()
    for put in (api.kill, api.pause):
        put("arm-dev")
        assert rorg(robot, workspace, "dev", "arm", "--", "sh", "-c", "echo here; exit 7", code=7).stdout == "here\n"


def test_the_socket_of_a_service_is_made_by_nobody_but_rorg(robot, workspace):
    asked = "import os; print(os.path.exists(os.path.dirname(os.environ['RORG_SOCKET'])))"
    assert rorg(robot, workspace, "dev", "caller", "--", *COMES, asked).stdout == "False\n"
    assert not (robot.state.run / "services").exists(), "the engine makes what it is to mount, as root"
    (robot.state.run / "services/caller").mkdir(parents=True)
    assert rorg(robot, workspace, "dev", "caller", "--fresh", "--", *COMES, asked).stdout == "True\n"


def test_a_command_that_is_not_there_gives_127(robot, workspace):
    assert (
        "no such program; try `rorg dev arm`" in rorg(robot, workspace, "dev", "arm", "--", "nosuch", code=127).stderr
    )


# -- several, listed and ended ---------------------------------------------------------------------------------


def test_several_at_once_each_ends_alone_or_all_together(robot, workspace):
    rorg(robot, workspace, "dev", "arm", "--", "sh", "-c", ":")
    rorg(robot, workspace, "dev", "arm", "--name", "another", "--", "sh", "-c", ":")
    rorg(robot, workspace, "dev", f"image/{BASE_IMAGE}", "--", "sh", "-c", ":")
    listed = json.loads(rorg(robot, workspace, "dev", "-o", "json").stdout)
    assert [(row["name"], row["of"], row["state"]) for row in listed] == [
        ("another", "arm", "running"),
        ("arm-dev", "arm", "running"),
        (f"{BASE_IMAGE}-dev", f"image/{BASE_IMAGE}", "running"),
    ]
    assert {row["workspace"] for row in listed} == {str(workspace)}
    taken = rorg(robot, workspace, "dev", "laser", "--yes", "--name", "another", code=5).stderr
    assert "another belongs to arm, not to laser; try --name NAME" in taken
    if BEHIND_SUDO:
        other = rorg(robot, workspace, "dev", "arm", code=5, SUDO_UID="47009").stderr
        assert f"arm-dev belongs to user {UID}:{UID}, not to user 47009:{UID}; try --name NAME" in other
    rorg(robot, workspace, "dev", "arm", "--stop")
    assert names(robot, workspace) == ["another", f"{BASE_IMAGE}-dev"]
    told = rorg(robot, workspace, "dev", "--stop").stderr
    assert "another of arm (running" in told
    assert names(robot, workspace) == []
    assert "nothing to stop" in rorg(robot, workspace, "dev", "--stop").stderr


@pytest.mark.parametrize("image", [BASE_IMAGE, TOOLS], ids=["only a shell", "with sleep"])
def test_it_stays_and_ends_when_told_to(robot, workspace, image):
    rorg(robot, workspace, "dev", f"image/{image}", "--", "sh", "-c", ":")
    name = f"{image}-dev"
    robot.engine.stop(inspect(robot, name)["Id"], "SIGTERM", 30.0)
    state = inspect(robot, name)["State"]
    assert (state["Running"], state["ExitCode"]) == (False, 0)


def test_the_loop_and_down_leave_it_alone(docker_robot, commands, workspace):
    docker_robot.declare({"arm": {}})
    docker_robot.commands = commands
    docker_robot.settle()
    rorg(docker_robot, workspace, "dev", "arm", "--", "sh", "-c", ":")
    docker_robot.settle()
    assert [c.name for c in docker_robot.containers()] == ["arm"]
    docker_robot.stop()
    assert rorg(docker_robot, workspace, "dev", "arm", "--", "sh", "-c", "echo $PWD").stdout == f"{workspace}\n"
    assert "dev containers remain: arm-dev" in rorg(docker_robot, workspace, "down", "--yes").stderr
    assert docker_robot.containers() == []
    assert inspect(docker_robot, "arm-dev")["State"]["Running"]
    rorg(docker_robot, workspace, "dev", "--stop")
    with pytest.raises(docker.errors.NotFound):
        inspect(docker_robot, "arm-dev")


# -- drift -----------------------------------------------------------------------------------------------------


def test_drift_is_told_in_one_line_and_goes_with_fresh(robot, workspace):
    api = robot.engine.api()
    api.tag(BASE_IMAGE, "rorg-moving")
    robot.declare({**SERVICES, "arm": {**ARM, "image": "rorg-moving"}})

    def enter(*words: str) -> str:
        return rorg(robot, workspace, "dev", "arm", *words, "--", "sh", "-c", ":").stderr

    assert enter() == ""
    api.tag(TOOLS, "rorg-moving")
    image = "rorg-moving has changed since"
    assert enter() == f"arm-dev: {image}; `rorg dev arm --fresh` renews it\n"
    robot.declare({**SERVICES, "arm": {**ARM, "image": "rorg-moving", "container": {}}})
    manifests = "the manifests have changed since"
    assert enter() == f"arm-dev: {image}; {manifests}; `rorg dev arm --fresh` renews it\n"
    assert enter("--fresh") == ""
    assert enter() == ""
    elsewhere = rorg(robot, workspace.parent, "dev", "arm", "--", "sh", "-c", "pwd")
    assert elsewhere.stderr == f"arm-dev: its workspace is {workspace}; `rorg dev arm --fresh` renews it\n"
    assert elsewhere.stdout == f"{workspace}\n"


def test_what_an_image_that_moved_or_is_not_there_means():
    spec = {"image": "tool", "network_mode": "host"}
    found = DevContainer("1", "arm-dev", "running", "arm", declared_digest(spec), "sha256:1", "/ws", "1:1", ("gpu",))
    assert drift(found, spec, "sha256:1", "/ws/src", ("gpu",)) == []
    assert drift(found, {**spec, "image": "tool:2"}, "sha256:1", "/ws", ()) == [], "the same image by another name"
    assert drift(found, spec, "", "/ws", ("x11",)) == ["image tool is not on this machine", "it was made without x11"]
    assert drift(found, spec, "sha256:1", "/wss", ()) == ["its workspace is /ws"]


# -- what is refused -------------------------------------------------------------------------------------------


def test_a_driver_that_runs_is_not_joined_unasked(robot, workspace):
    told = rorg(robot, workspace, "dev", "laser", "--", "sh", "-c", ":", code=5).stderr
    assert "laser runs" in told
    assert told.endswith("try --yes\n")
    assert names(robot, workspace) == []
    rorg(robot, workspace, "dev", "laser", "--yes", "--", "sh", "-c", ":")
    assert inspect(robot, "laser-dev")["HostConfig"]["GroupAdd"] == ["dialout"]


def test_what_cannot_be_is_told_with_a_remedy_and_changes_nothing(robot, workspace):
    rorg(robot, workspace, "dev", "arm", "--", "sh", "-c", ":")
    before = inspect(robot, "arm-dev")["Id"]
    robot.declare({**SERVICES, "ghost": {"image": "rorg-no-such-image"}}, groups=GROUPS)
    for words, code, told in [
        (["ghost"], 4, "no image rorg-no-such-image on this machine; try `rorg build rorg-no-such-image`"),
        (["all"], 2, "all is a group; try one of arm, laser"),
        (["duty"], 2, "duty is a meta-service"),
        (["amr"], 2, "no such service or image; try 'arm'"),
        (["arm", "--name", "the-arm"], 2, "the container of a service is called the-arm; try --name NAME"),
        (["arm", "--name", "a/b"], 2, "'a/b' is not a valid container name"),
        (["arm", "--workspace", "/nosuch"], 2, "cannot work in /nosuch: there is no such directory; try"),
        (["arm", "--workspace", "/usr/"], 2, "cannot work in /usr: it would hide what the image has there; try"),
        (["arm", "--x11"], 2, "DISPLAY is not set"),
        (["arm", "--stop", "--fresh"], 2, "cannot combine these options"),
        (["arm", "--", ""], 2, "it has no name; try `rorg dev arm -- COMMAND`"),
        (["--fresh"], 2, "no service or image is named; try `rorg dev NAME`"),
        (["arm", "--fresh", "--gpu"], 4, "try an engine with that runtime, or leave gpus out"),
        (["arm", "--engine", "process"], 2, "the process engine has none; try --engine docker"),
    ]:
        said = rorg(robot, workspace, "dev", *words, code=code, DISPLAY="").stderr
        assert told in said
        assert len(said.splitlines()) == 1
    assert inspect(robot, "arm-dev")["Id"] == before
    assert inspect(robot, "arm-dev")["State"]["Running"]
    assert names(robot, workspace) == ["arm-dev"]


def test_a_workspace_on_another_machine_is_refused(robot, workspace):
    (robot.state.path / "engine").unlink()  # of a robot whose engine is elsewhere
    told = rorg(robot, workspace, "dev", "arm", code=2, DOCKER_HOST="tcp://192.0.2.1:2375").stderr
    assert "the engine is on another machine, and the workspace is here; try it there" in told


# -- whose it is -----------------------------------------------------------------------------------------------


def test_who_is_at_the_keyboard():
    assert caller({"SUDO_UID": "47001", "SUDO_GID": "47002", "HOME": "/x"}, 0, 0) == Person(47001, 47002, "47001", "")
    assert caller({"SUDO_UID": "0", "SUDO_GID": "0", "HOME": "/x"}, 47001, 5) == Person(47001, 5, "47001", "/x")
    assert caller({"SUDO_UID": "x", "SUDO_GID": "", "HOME": "/x"}, 0, 0) == Person(0, 0, "root", "/x")


def test_git_knows_the_person_and_x11_the_screen(robot, workspace, tmp_path):
    """As the one who runs it, without sudo."""
    (tmp_path / ".gitconfig").write_text("[user]\n\tname = A. Person\n\temail = person@example.org\n")
    (tmp_path / ".Xauthority").write_text("cookie")
    asked = "import os; print(*(os.environ.get(n) for n in ('GIT_AUTHOR_NAME', 'GIT_COMMITTER_EMAIL', 'DISPLAY')))"
    asked += "; print(open(os.environ['XAUTHORITY']).read(), os.getuid())"
    alone = {"HOME": str(tmp_path), "DISPLAY": ":7", "XAUTHORITY": "", "SUDO_UID": ""}
    done = rorg(robot, workspace, "dev", "arm", "--x11", "--", *COMES, asked, **alone)
    assert done.stdout == f"A. Person person@example.org :7\ncookie {os.getuid()}\n"
    mounts = {m["Destination"]: m["RW"] for m in inspect(robot, "arm-dev")["Mounts"]}
    assert mounts["/tmp/.rorg-xauthority"] is False
    assert mounts.get("/tmp/.X11-unix") is (False if os.path.exists("/tmp/.X11-unix") else None)


def test_whom_git_does_not_know_has_no_variables(tmp_path):
    assert configured_identity(str(tmp_path)) == configured_identity("") == configured_identity("/nosuch") == {}


# -- for editors -----------------------------------------------------------------------------------------------


def test_an_editors_file_has_the_image_and_is_never_written_over_another(robot, workspace):
    assert "is written" in rorg(robot, workspace, "dev", "arm", "--devcontainer").stderr
    path = workspace / ".devcontainer/devcontainer.json"
    found = json.loads(path.read_text())
    assert (found["image"], found["workspaceFolder"]) == (TOOLS, str(workspace))
    assert found["remoteUser"] == (f"{UID}:{UID}" if BEHIND_SUDO else f"{os.getuid()}:{os.getgid()}")
    assert {"--network=host", f"--memory={300 << 20}", "--init"} <= set(found["runArgs"])
    assert found["containerEnv"]["WHERE"] == "inside"
    assert path.stat().st_uid == (UID if BEHIND_SUDO else os.getuid())
    rorg(robot, workspace, "dev", "laser", "--devcontainer")
    assert json.loads(path.read_text())["image"] == BASE_IMAGE, "its own is written anew"
    path.write_text('// mine\n{"image": "x"}\n')
    told = rorg(robot, workspace, "dev", "arm", "--devcontainer", code=5).stderr
    assert "that file is not rorg's, and there is no terminal; try --yes" in told
    assert path.read_text().startswith("// mine")
    rorg(robot, workspace, "dev", "arm", "--devcontainer", "--yes")
    assert json.loads(path.read_text())["image"] == TOOLS
    assert names(robot, workspace) == []


# -- the pure part ---------------------------------------------------------------------------------------------

WHO = Developer(user="1000:1000", name="anna", workspace="/ws", home="/state/dev/1000/arm-dev", git={}, gpu=True)
SPEC = {
    "image": "arm",
    "command": ["roslaunch"],
    "entrypoint": ["/entry.sh"],
    "restart": "always",
    "ports": ["8080:80"],
    "publish_all_ports": True,
    "networks": {"lab": {"aliases": ["arm"], "ipv4_address": "172.20.0.9", "driver_opts": {"a": "b"}}},
    "volumes": ["/robot/maps:/maps:ro", "/elsewhere:/ws/", {"type": "tmpfs", "target": "/scratch"}],
    "environment": {"SPEED": "3", "HOME": "/root"},
    "user": "root",
    "stop_signal": "SIGINT",
    "devices": ["/dev/null:/dev/arm"],
    "ulimits": {"rtprio": {"soft": 99, "hard": 99}},
    "group_add": ["dialout"],
    "healthcheck": {"test": ["CMD", "x"]},
}


def test_what_only_one_container_may_have_stays_with_the_service():
    found = dev_spec(SPEC, "arm-dev", WHO)
    assert not {"ports", "publish_all_ports", "restart"} & found.keys()
    assert found["networks"] == {"lab": {"driver_opts": {"a": "b"}}}
    assert (found["entrypoint"], found["command"], found["user"]) == (list(STAY), [], "1000:1000")
    assert (found["devices"], found["group_add"]) == (SPEC["devices"], SPEC["group_add"])
    assert (found["environment"]["SPEED"], found["environment"]["HOME"]) == ("3", HOME)
    body = create_body(found, {})
    assert body["HostConfig"]["Binds"] == ["/robot/maps:/maps:ro"], "the workspace goes before a mount at its place"
    assert body["HostConfig"]["DeviceRequests"][0]["Count"] == -1
    assert body["Healthcheck"] == {"Test": ["NONE"]}


def test_an_editors_file_says_what_it_leaves_out():
    found, left = document("arm-dev", "arm", {**dev_spec(SPEC, "arm-dev", WHO), "masked_paths": ["/proc/kcore"]})
    assert left == ["masked_paths"]
    assert found["workspaceMount"] == "type=bind,source=/ws,target=/ws"
    assert {
        "--device=/dev/null:/dev/arm",
        "--ulimit=rtprio=99:99",
        "--gpus=all",
        "--network=lab",
        "--volume=/robot/maps:/maps:ro",
        "--stop-signal=SIGTERM",
    } <= set(found["runArgs"])
    assert f"type=bind,source={WHO.home},target={HOME}" in found["mounts"]


def test_names_of_containers_are_such_for_every_image():
    assert [name_for(n) for n in ("arm", "image/lab/base:2", "image/a@b")] == ["arm-dev", "lab-base-2-dev", "a-b-dev"]
    assert "/" in COVERED


def test_two_that_begin_at_once_enter_one_container(robot, workspace):
    begun = [
        subprocess.Popen(
            [sys.executable, "-m", "rorg", "dev", "arm", "--", "sh", "-c", "echo $HOSTNAME"],
            env={**environment(robot), **BEHIND_SUDO},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            cwd=workspace,
        )
        for _ in range(2)
    ]
    wait_for(lambda: all(p.poll() is not None for p in begun), 120, "both to end")
    assert [(p.returncode, p.stderr.read()) for p in begun] == [(0, b"")] * 2
    assert names(robot, workspace) == ["arm-dev"]
