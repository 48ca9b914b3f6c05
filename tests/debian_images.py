"""Images made of Debian's packages where no registry can be reached: built once a machine, then kept as files, since
each session has an empty daemon."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
from pathlib import Path

from conftest import ROOT, no_docker

BASE = "debian:bookworm-slim"
ROOTFS = ROOT / "images/ros1/rootfs.sh"


def bring(host: str, folder: Path, name: str) -> str:
    """The image of a folder's Dockerfile, which is FROM the base, on the daemon at `host`."""
    import docker

    api = docker.APIClient(host, version="auto", timeout=600)
    kept = _kept(name, [ROOTFS, *sorted(p for p in folder.iterdir() if p.is_file())])
    if not (api.images(name) or _load(api, kept)):
        _bring_base(api)
        lines = list(api.build(path=str(folder), tag=name, network_mode="host", decode=True, rm=True))
        assert api.images(name), lines[-5:]
        _keep(api, name, kept)
    return name


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
