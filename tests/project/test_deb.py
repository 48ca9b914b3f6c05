"""The Debian package installs on a bare bookworm without a network, works there, and goes without a trace."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from common import ROOT, alone_on_the_machine
from tools import tool

WHOLE = pytest.mark.skipif(
    not os.environ.get("RORG_TEST_PACKAGES"),
    reason="`make packages` and `.ci/run` make whole packages, for some minutes",
)
LEFT = {"/etc/group", "/etc/gshadow", "/etc/group-", "/etc/gshadow-", "/etc/.pwd.lock"}
"""What a purge may leave: the group, since files of people may be its."""
NOT_OURS = ("/dev/", "/proc/", "/run/systemd/", "/tmp/", "/var/lib/dpkg/", "/var/log/")
"""Not looked at: what dpkg, systemd and the test keep."""
PACKAGES = "python3,git,systemd,iproute2"
"""On the machine before; nothing is fetched for the package."""
UNPACKED = """import subprocess, tarfile
from pathlib import Path
from rorg.engines.docker.archive import unpack
made = subprocess.Popen(["tar", "c", "robot"], stdout=subprocess.PIPE)
unpack(tarfile.open(fileobj=made.stdout, mode="r|"), Path("unpacked"), True)
"""
"""What comes out of a container is unpacked: with Debian's Python, whose tarfile is older than 3.11.4."""
MAINTAINER_SCRIPTS = ("postinst", "prerm", "postrm")


@pytest.fixture(scope="module")
def deb(tmp_path_factory) -> Path:
    if sys.version_info[:2] != (3, 11) or not shutil.which("dpkg-deb"):
        pytest.skip("the package is made with Python 3.11 and dpkg-deb")
    folder = tmp_path_factory.mktemp("deb")
    build = ROOT / "images/rorg/deb/build.py"
    subprocess.run([sys.executable, build, folder], check=True, stdout=subprocess.DEVNULL)
    return next(folder.glob("rorg_*.deb"))


ELF = b"\x7fELF\x02\x01"
"""How each shared object of a 64-bit machine begins."""
MACHINE = slice(18, 20)
AARCH64 = (183).to_bytes(2, "little")


@WHOLE
def test_a_package_for_arm64_holds_nothing_of_another_machine(tmp_path):
    if sys.version_info[:2] != (3, 11) or not shutil.which("dpkg-deb"):
        pytest.skip("the package is made with Python 3.11 and dpkg-deb")
    command = [sys.executable, ROOT / "images/rorg/deb/build.py", tmp_path, "--architecture", "arm64"]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    made = next(tmp_path.glob("rorg_*_arm64.deb"))
    assert subprocess.check_output(["dpkg-deb", "--field", made, "Architecture"], text=True) == "arm64\n"
    subprocess.run(["dpkg-deb", "--extract", made, tmp_path / "root"], check=True)
    heads = {}
    for path in (tmp_path / "root").rglob("*"):
        if path.is_file() and not path.is_symlink() and (head := path.read_bytes()[:20]).startswith(ELF[:4]):
            heads[path.name] = head
    assert {name.partition(".")[0] for name in heads} >= {"_pydantic_core", "_re2", "loop", "_yaml"}, heads.keys()
    assert not {name for name, head in heads.items() if not head.startswith(ELF) or head[MACHINE] != AARCH64}


class Bookworm:
    """A Debian that debootstrap made: a folder, whose programs have no network and end with the one that began them."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def sh(self, script: str) -> str:
        """What root's shell says to both; fails on another exit code than 0."""
        alone = ["unshare", "--mount", "--net", "--pid", "--fork", "--kill-child", f"--mount-proc={self.root}/proc"]
        done = subprocess.run(
            [*alone, "chroot", self.root, "sh", "-ec", f"ip link set lo up\n{script}"],
            env={"PATH": "/usr/sbin:/usr/bin:/sbin:/bin", "HOME": "/root", "LC_ALL": "C.UTF-8"},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=150,
        )
        assert done.returncode == 0, done.stdout
        return done.stdout

    def files(self) -> dict[str, object]:
        """Path -> time of change and size of all that is no folder; folders have neither."""
        found: dict[str, object] = {}
        for folder, _, names in os.walk(self.root):
            found[folder] = None
            for path in (Path(folder, name) for name in names):
                found[str(path)] = (path.lstat().st_mtime_ns, path.lstat().st_size)
        inside = {path.removeprefix(str(self.root)): value for path, value in found.items()}
        return {path: value for path, value in inside.items() if not path.startswith(NOT_OURS)}


def debootstrapped() -> Path:
    """A minimal Debian as a tar file. Made once a machine."""
    kept = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / f"rorg-tests/bookworm-{PACKAGES}.tar"
    if not kept.exists():
        kept.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix="rorg-debootstrap-") as folder:
            command = ["debootstrap", "--variant=minbase", f"--include={PACKAGES}", "bookworm", folder]
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
            shutil.rmtree(f"{folder}/var/cache/apt")
            subprocess.run(["tar", "-C", folder, "-cf", kept.with_suffix(".new"), "."], check=True)
        kept.with_suffix(".new").rename(kept)
    return kept


@pytest.fixture(scope="module")
def bookworm(deb, tmp_path_factory) -> Bookworm:
    os.environ["PATH"] += os.pathsep + "/usr/sbin"
    if os.geteuid() != 0 or not shutil.which("debootstrap"):
        pytest.skip("a chroot takes root and debootstrap")
    root = tmp_path_factory.mktemp("bookworm")
    subprocess.run(["tar", "-C", root, "-xf", debootstrapped()], check=True)
    root.chmod(0o755)
    shutil.copy(deb, root / "tmp/rorg.deb")
    yield Bookworm(root)
    shutil.rmtree(root)


@WHOLE
def test_it_installs_works_and_goes(bookworm):
    before = bookworm.files()
    said = bookworm.sh("dpkg -i /tmp/rorg.deb")
    assert "warning" not in said.lower()
    for step in (it_is_all_there, commands_work, demo_runs, an_upgrade_changes_nothing, nothing_is_left):
        step(bookworm)
    after = bookworm.files()
    assert {path for path in before.keys() | after.keys() if before.get(path) != after.get(path)} <= LEFT


def it_is_all_there(bookworm: Bookworm) -> None:
    bookworm.sh("getent group rorg")
    assert bookworm.sh("stat -c '%a %U' /run/rorg /var/lib/rorg").splitlines() == ["755 root", "750 root"]
    assert bookworm.sh("systemd-analyze verify --man=no rorg.service") == ""
    bookworm.sh("test -L /etc/systemd/system/multi-user.target.wants/rorg.service")
    for path in (
        "share/bash-completion/completions/rorg",
        "share/zsh/vendor-completions/_rorg",
        "share/fish/vendor_completions.d/rorg.fish",
        "share/doc/rorg/copyright",
        "lib/sysusers.d/rorg.conf",
        "lib/tmpfiles.d/rorg.conf",
    ):
        bookworm.sh(f"test -s /usr/{path}")
    page = bookworm.sh("zcat /usr/share/man/man1/rorg.1.gz")
    assert page.startswith(".TH RORG 1")
    assert ".SS rorg request " in page
    script = ". /usr/share/bash-completion/completions/rorg; COMP_WORDS=(rorg rele) COMP_CWORD=1; _rorg rorg"
    assert "release" in bookworm.sh(f"bash -c '{script}; echo ${{COMPREPLY[@]}}'")


def commands_work(bookworm: Bookworm) -> None:
    """Also in a shell that is set up for other Python packages, as ROS does it; and beside a user's."""
    assert bookworm.sh("rorg --version").startswith("rorg ")
    bookworm.sh(
        "mkdir /tmp/ros && echo 'raise SystemExit(9)' >/tmp/ros/yaml.py && cp /tmp/ros/yaml.py /tmp/ros/rich.py"
    )
    bookworm.sh("cd /tmp && rorg init robot && PYTHONPATH=/tmp/ros rorg validate robot && rorg schema /tmp/schemas")
    bookworm.sh("cd /tmp && rorg apply robot --engine process --yes && rorg get -o name")
    bookworm.sh("cd /tmp && mkdir copied && tar c robot | rorg cp - base:/tmp/copied && ls copied/robot/services")
    bookworm.sh(f"cd /tmp && /usr/lib/rorg/bin/python -I -c '{UNPACKED}' && ls unpacked/services")
    assert bookworm.sh("ls -A /var/lib/rorg")


def demo_runs(bookworm: Bookworm) -> None:
    with alone_on_the_machine("demo"):
        said = bookworm.sh("rorg demo --engine process --speed 10")
    assert "services ran on" in said
    assert "on demand" in said


def an_upgrade_changes_nothing(bookworm: Bookworm) -> None:
    """A service that somebody has disabled stays so; state stays. No file has changed by being used."""
    bookworm.sh("rm /etc/systemd/system/multi-user.target.wants/rorg.service; dpkg -i /tmp/rorg.deb")
    bookworm.sh("test ! -e /etc/systemd/system/multi-user.target.wants/rorg.service")
    assert bookworm.sh("ls -A /var/lib/rorg")
    assert bookworm.sh("dpkg --verify rorg") == ""


def nothing_is_left(bookworm: Bookworm) -> None:
    """But the state, until it is purged."""
    said = bookworm.sh("dpkg -r rorg")
    assert "warning" not in said.lower()
    bookworm.sh("test ! -e /usr/lib/rorg && test ! -e /usr/bin/rorg && ls /var/lib/rorg/*")
    bookworm.sh("dpkg -P rorg && getent group rorg && test ! -e /var/lib/rorg")


@pytest.mark.parametrize("name", MAINTAINER_SCRIPTS)
def test_maintainer_scripts_are_of_posix(name):
    """As dash reads them, Debian's sh."""
    script = ROOT / "images/rorg/deb" / name
    assert script.read_text().startswith("#!/bin/sh\nset -e\n")
    subprocess.run([shutil.which("dash") or "sh", "-n", script], check=True)


def manual_page() -> str:
    return subprocess.check_output([sys.executable, ROOT / "docs/reference/man.py"], text=True)


@pytest.mark.slow
def test_the_manual_page_has_every_command():
    from rorg.cli.commands import COMMANDS

    page = manual_page()
    assert [line for line in page.splitlines() if line.startswith((".SH EXIT", ".SH FILES", ".SH ENVIRONMENT"))]
    assert {line.split()[2].replace("\\", "") for line in page.splitlines() if line.startswith(".SS rorg ")} == set(
        COMMANDS
    )


@pytest.mark.slow
def test_the_manual_page_is_what_man_takes_without_a_complaint():
    done = subprocess.run(
        [tool("groff"), "-man", "-ww", "-Tascii", "-P-cbu"],
        input=manual_page(),
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stderr == ""
    assert "--state-dir" in done.stdout
