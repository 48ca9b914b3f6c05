"""Images made of Debian's packages where no registry can be reached: built once a machine, then kept as files, since
each session has an empty daemon."""

from __future__ import annotations

import hashlib
import io
import os
import platform
import shutil
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path

from common import ROOT, alone_on_the_machine, no_docker
from wheels import selection

BASE = "debian:bookworm-slim"
ROOTFS = ROOT / "images/ros1/rootfs.sh"
ROS2 = ROOT / "images/ros2"
INTERFACES = ROOT / "clients/ros2/rorg_ros2_interfaces"


def bring(
    host: str,
    folder: Path,
    name: str,
    more: Iterable[Path] = (),
    complete: Callable[[Path], None] = lambda context: None,
) -> str:
    """The image of a folder's Dockerfile, which is FROM the base, on the daemon at `host`. `complete` adds to a copy of
    the folder what else the image is built from, as `more` files say."""
    import docker

    api = docker.APIClient(host, version="auto", timeout=600)
    kept = _kept(name, [ROOTFS, *sorted(p for p in folder.iterdir() if p.is_file()), *more])
    if api.images(name) or _load(api, kept):
        return name
    with alone_on_the_machine("debian-images"), tempfile.TemporaryDirectory() as context:
        if _load(api, kept):  # another worker has made it meanwhile
            return name
        _bring_base(api)
        shutil.copytree(folder, context, dirs_exist_ok=True)
        complete(Path(context))
        lines = list(api.build(path=context, tag=name, network_mode="host", decode=True, rm=True))
        assert api.images(name), lines[-5:]
        _keep(api, name, kept)
    return name


def bring_ros2(host: str) -> str:
    """The image of images/ros2, with wheels that pip downloads on this machine."""
    if platform.machine() != "x86_64":
        no_docker("ROS 2 has wheels for x86_64 only")
    more = sorted(path for path in INTERFACES.rglob("*") if path.is_file())
    return bring(host, ROS2, "ros2-base", more, _add_wheels_and_interfaces)


def of_this_machine(host: str, ros: Path) -> tuple[str, tuple[str, ...]]:
    """An image without files that runs the machine's own ROS 2, and what it mounts for that. Its entry point sources
    the setup of ROS 2 and of rorg's node. Tried with Kilted's wheels only, not with a distribution's ROS 2."""
    import docker

    content = io.BytesIO()
    with tarfile.open(fileobj=content, mode="w") as tar:
        for name in ("bin", "lib", "lib64"):  # not sbin: the engine puts its init there
            link = tarfile.TarInfo(name)
            link.type, link.linkname = tarfile.SYMTYPE, f"usr/{name}"
            tar.addfile(link)
        script = f'#!/bin/bash\n. {ros}/setup.bash\n[ ! -e /rorg_ros2 ] || . /rorg_ros2/local_setup.bash\nexec "$@"\n'
        entry = tarfile.TarInfo("entry")
        entry.size, entry.mode = len(script), 0o755
        tar.addfile(entry, io.BytesIO(script.encode()))
        tmp = tarfile.TarInfo("tmp")
        tmp.type, tmp.mode = tarfile.DIRTYPE, 0o1777
        tar.addfile(tmp)
    api = docker.APIClient(host, version="auto", timeout=600)
    api.import_image_from_data(content.getvalue(), repository="ros2-own", changes=['ENTRYPOINT ["/entry"]'])
    return "ros2-own", ("/usr:/usr:ro", "/etc:/etc:ro", f"{ros}:{ros}:ro")


def _add_wheels_and_interfaces(context: Path) -> None:
    shutil.copytree(INTERFACES, context / INTERFACES.name)
    wheels, pip = context / "wheels", [sys.executable, "-m", "pip", "--quiet"]
    wanted = [f"--requirement={context / name}" for name in ("runtime.txt", "build.txt")]
    for words in (
        ["wheel", "--no-deps", f"--wheel-dir={wheels}", "empy<4"],  # the only one without a wheel of its own
        ["download", f"--dest={wheels}", f"--find-links={wheels}", *selection("amd64", 11), *wanted],
    ):
        done = subprocess.run([*pip, *words], capture_output=True, text=True)
        if done.returncode:
            no_docker(f"the wheels of ROS 2 cannot be downloaded: {done.stderr[-500:]}")


def _bring_base(api) -> None:
    kept = _kept(BASE, [ROOTFS])
    if api.images(BASE) or _load(api, kept):
        return
    if not shutil.which("debootstrap"):
        no_docker("debootstrap is not installed, so no image with ROS can be made")
    made = subprocess.Popen([str(ROOTFS)], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    repository, _, tag = BASE.partition(":")
    api.import_image(src=made.stdout, repository=repository, tag=tag, stream_src=True)
    assert made.wait() == 0
    _keep(api, BASE, kept)


def _kept(name: str, files: list[Path]) -> Path:
    """Where it is kept, by the content of all that it is made of."""
    key = hashlib.sha256(b"".join(p.read_bytes() for p in files)).hexdigest()[:16]
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return cache / f"rorg-tests/{name.replace(':', '-')}-{key}.tar"


def _load(api, kept: Path) -> bool:
    if kept.exists():
        with kept.open("rb") as file:
            api.load_image(file)
    return kept.exists()


def _keep(api, name: str, kept: Path) -> None:
    kept.parent.mkdir(parents=True, exist_ok=True)
    new = kept.with_suffix(f".{os.getpid()}")
    with new.open("wb") as file:
        for chunk in api.get_image(name):
            file.write(chunk)
    new.rename(kept)
