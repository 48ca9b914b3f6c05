"""`rorg exec`, `rorg shell` and `rorg cp`: as on a terminal, and in pipes, on both engines."""

from __future__ import annotations

import os
import signal
import stat
import subprocess
import sys
import termios

import pytest
from common import wait_for
from terminals import Terminal, environment

CAT = (
    *("python3", "-S", "-c"),
    "import shutil, sys\nfile = open(sys.argv[1], 'rb') if sys.argv[1:] else sys.stdin.buffer\n"
    "shutil.copyfileobj(file, sys.stdout.buffer)",
)
SERVICES = {"arm": {"always_on": True, "container": {"environment": {"WHERE": "inside"}}}, "idle": {}}


@pytest.fixture
def robot(real_robot):
    real_robot.declare(SERVICES, groups={"both": {"services": ["arm", "idle"]}})
    real_robot.wait(lambda: "arm" in real_robot.active())
    return real_robot


def rorg(robot, *words: str, code: int = 0, said: bytes = b"", **more) -> subprocess.CompletedProcess[bytes]:
    done = subprocess.run(
        [sys.executable, "-m", "rorg", *words],
        env=environment(robot),
        input=said,
        capture_output=True,
        timeout=60,
        cwd=robot.tree,
        **more,
    )
    assert done.returncode == code, f"exit {done.returncode}\n{done.stdout!r}\n{done.stderr!r}"
    return done


# -- in pipes --------------------------------------------------------------------------------------------------


@pytest.mark.smoke
def test_what_it_prints_comes_apart_and_its_exit_code_is_ours(robot):
    done = rorg(robot, "exec", "arm", "--", "sh", "-c", 'echo "out $WHERE"; echo err >&2; exit 7', code=7)
    assert (done.stdout, done.stderr) == (b"out inside\n", b"err\n")


def test_standard_input_goes_in_when_asked_for_and_comes_out_whole(robot):
    content = os.urandom(1 << 20)
    assert rorg(robot, "exec", "-i", "arm", "--", *CAT, said=content).stdout == content
    assert rorg(robot, "exec", "arm", "--", *CAT, said=content).stdout == b""


def test_a_reader_that_leaves_ends_the_command(robot):
    with subprocess.Popen(
        [sys.executable, "-m", "rorg", "exec", "arm", "--", "sh", "-c", "while :; do echo y; done"],
        env=environment(robot),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as process:
        assert process.stdout.read(4) == b"y\ny\n"
        process.stdout.close()
        assert process.wait(30) == 128 + signal.SIGPIPE
        assert process.stderr.read() == b""


def test_a_program_that_is_not_there_gives_127(robot):
    assert b"no such program; try" in rorg(robot, "exec", "arm", "--", "nosuch", code=127).stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "code", "told"),
    [
        (("exec", "idle", "--", "ls"), 4, "idle does not run (created); try `rorg request idle --wait` first"),
        (("exec", "both", "--", "ls"), 2, "both is a group; try one of arm, idle"),
        (("exec", "amr", "--", "ls"), 2, "no such service; try 'arm'"),
        (("exec", "-t", "arm", "--", "ls"), 2, "this is not a terminal; try it without -t"),
        (("exec", "arm", "ls", "-la"), 2, "try `rorg exec SERVICE -- COMMAND`"),
        (("shell", "idle"), 4, "idle does not run"),
        (("cp", "arm:/nosuch", "."), 2, "; try"),
        (("cp", "arm:/etc/hostname", "/nosuch/place"), 2, "no directory /nosuch"),
        (("cp", "/nosuch", "arm:/tmp"), 2, "no such file: /nosuch"),
        (("cp", "a", "b"), 2, "one of the two must be SERVICE:PATH"),
        (("cp", "arm:/a", "arm:/b"), 2, "one of the two must be SERVICE:PATH"),
    ],
    ids=lambda v: " ".join(v) if isinstance(v, tuple) else "",
)
def test_what_cannot_be_is_told_with_a_remedy(robot, words, code, told):
    said = rorg(robot, *words, code=code).stderr.decode()
    assert told in said
    assert len(said.splitlines()) == 1


def test_a_paused_service_says_how_it_goes_on(robot):
    robot.stop()
    arm = robot.container("arm").id
    robot.engine.pause(arm)
    assert b"arm is paused; try `rorg request arm --wait`" in rorg(robot, "exec", "arm", "--", "ls", code=4).stderr
    robot.engine.resume(arm)


# -- on a terminal ---------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_shell_has_a_real_terminal_and_the_services_environment(robot):
    shell = Terminal(robot, "shell", "arm", columns=123)
    shell.type(b"echo $WHERE-$((40+2))\r")  # before anything listens: it is not lost
    shell.expect(rb"inside-42")
    shell.type(b"python3 -S -c 'import os; print(os.isatty(0), os.get_terminal_size().columns)'\r")
    shell.expect(rb"True \d+")
    shell.resize(50, 99)
    asked = "import os, sys; sys.exit(os.get_terminal_size().columns != 99)"
    shell.type(f"until python3 -S -c '{asked}'; do :; done; echo si''ze\r".encode())
    shell.expect(rb"\bsize\b")
    shell.type(b"exit 3\r")
    assert shell.end() == 3


def test_ctrl_c_goes_inside_and_the_terminal_is_as_before(robot):
    program = (
        "import signal, sys, time\nsignal.signal(2, lambda *_: sys.exit(5))\nprint('be''gins', flush=True)\n"
        "while True: time.sleep(0.01)"  # a signal right before signal.pause() would be handled after the next one
    )
    found = Terminal(robot, "exec", "arm", "-it", "--", "python3", "-S", "-c", program)
    before = termios.tcgetattr(found.fd)
    found.expect(rb"begins")
    found.type(b"\x03")
    code = found.end
    wait_for(lambda: termios.tcgetattr(found.fd)[:4] == before[:4], 30, "the terminal as before")
    assert code() == 5


# -- files -----------------------------------------------------------------------------------------------------


@pytest.fixture
def inside(robot, tmp_path):
    """A directory as the service sees it."""
    place = str(tmp_path / "inside") if robot.kind == "process" else "/tmp/inside"
    rorg(robot, "exec", "arm", "--", "python3", "-S", "-c", f"import os; os.makedirs({place!r})")
    return place


@pytest.mark.slow
def test_files_and_directories_go_in_and_out_with_their_modes(robot, tmp_path, inside):
    source = tmp_path / "source"
    (source / "deep").mkdir(parents=True)
    (source / "deep/map.yaml").write_text("x: 1\n")
    (source / "run.sh").write_text("#!/bin/sh\n")
    (source / "run.sh").chmod(0o755)
    (source / "secret").write_text("s")
    (source / "secret").chmod(0o600)
    (source / "link").symlink_to("deep/map.yaml")
    rorg(robot, "cp", str(source), f"arm:{inside}")
    assert rorg(robot, "exec", "arm", "--", *CAT, f"{inside}/source/link").stdout == b"x: 1\n"
    rorg(robot, "cp", f"arm:{inside}/source", str(tmp_path / "back"))
    back = tmp_path / "back"
    assert (back / "deep/map.yaml").read_text() == "x: 1\n"
    assert os.readlink(back / "link") == "deep/map.yaml"
    modes = {p.name: stat.S_IMODE(p.stat().st_mode) for p in back.iterdir()}
    assert (modes["run.sh"], modes["secret"]) == (0o755, 0o600)


def test_one_file_gets_the_name_that_is_asked_for(robot, tmp_path, inside):
    (tmp_path / "a").write_text("one")
    rorg(robot, "cp", str(tmp_path / "a"), f"arm:{inside}/b")
    rorg(robot, "cp", f"arm:{inside}/b", str(tmp_path / "c"))
    (tmp_path / "folder").mkdir()
    rorg(robot, "cp", f"arm:{inside}/b", str(tmp_path / "folder"))
    rorg(robot, "cp", f"arm:{inside}/.", str(tmp_path / "folder"))
    assert [p.read_text() for p in (tmp_path / "c", tmp_path / "folder/b")] == ["one", "one"]


def test_a_relative_path_begins_at_the_working_directory(robot, tmp_path):
    folder = rorg(robot, "exec", "arm", "--", "sh", "-c", "pwd").stdout.decode().strip()
    there = os.path.relpath("/etc/hostname", folder)
    rorg(robot, "cp", f"arm:{there}", str(tmp_path / "name"))
    assert (tmp_path / "name").read_bytes() == rorg(robot, "exec", "arm", "--", *CAT, "/etc/hostname").stdout


def test_nothing_that_comes_out_is_written_elsewhere(tmp_path):
    import io
    import tarfile

    from rorg.engines.docker.archive import unpack
    from rorg.engines.places import refused
    from rorg.errors import Invalid

    def archive(*entries: tuple[str, str, str]) -> tarfile.TarFile:
        file = io.BytesIO()
        with tarfile.open(fileobj=file, mode="w") as made:
            for name, kind, link in entries:
                member = tarfile.TarInfo(name)
                member.type, member.linkname, member.mode = getattr(tarfile, kind), link, 0o755
                made.addfile(member)
        file.seek(0)
        return tarfile.open(fileobj=file, mode="r|")

    for number, bad in enumerate(
        [
            [("d", "DIRTYPE", ""), ("d/../../x", "REGTYPE", "")],
            [("d", "DIRTYPE", ""), ("/x", "REGTYPE", ""), ("../x", "REGTYPE", "")],
            [("d", "DIRTYPE", ""), ("d/l", "SYMTYPE", "../.."), ("d/l/x", "REGTYPE", "")],
            [("d", "DIRTYPE", ""), ("d/l", "SYMTYPE", "/etc")],
            [("d", "DIRTYPE", ""), ("d/l", "LNKTYPE", "../../etc/passwd")],
            [("d", "DIRTYPE", ""), ("d/l", "SYMTYPE", "m/.."), ("d/m", "SYMTYPE", "../..")],
            [
                ("d", "DIRTYPE", ""),
                *[(f"d/{path}", "DIRTYPE", "") for path in ("a", "a/b")],
                ("d/a/b/up", "SYMTYPE", "../.."),
                ("d/l", "SYMTYPE", "a/b/up/../x"),
                ("d/l", "REGTYPE", ""),
            ],
            [("d", "DIRTYPE", ""), ("d/n", "CHRTYPE", "")],
        ]
    ):
        target = tmp_path / str(number) / "target"
        target.parent.mkdir()
        with pytest.raises(Invalid), refused("copy"):
            unpack(archive(*bad), target, True)
        assert [p.name for p in target.parent.iterdir()] == ["target"]
    assert not (tmp_path / "x").exists()
