"""Makes dist/rorg_VERSION_ARCHITECTURE.deb for Debian bookworm: `make deb`. The architecture is that of this machine,
unless another one is named: `make deb ARCH=arm64`. No program of that architecture runs here.

Everything of Python is in /usr/lib/rorg, a virtual environment of Debian's Python 3.11: the releases that
images/rorg/constraints.txt pins by content, and the wheel of rorg. Nothing of the system is needed beyond Python, and
nothing there gets in its way. The same sources make the same file: times are that of the last commit, or
SOURCE_DATE_EPOCH."""

from __future__ import annotations

import argparse
import compileall
import gzip
import os
import re
import shutil
import subprocess
import sys
import tempfile
from importlib.metadata import Distribution, distributions
from pathlib import Path
from py_compile import PycInvalidationMode

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from wheels import MACHINES, selection

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[2]
HOME = "usr/lib/rorg"
SITE = f"{HOME}/lib/python3.11/site-packages"
SOURCES = ("pyproject.toml", "README.md", "rorg", "manifests", "images", "clients/python")
"""What the wheel is made of, as images/rorg/Dockerfile copies it."""
FILES = {
    "images/rorg/rorg.service": "lib/systemd/system/rorg.service",
    "images/rorg/sysusers.conf": "usr/lib/sysusers.d/rorg.conf",
    "images/rorg/tmpfiles.conf": "usr/lib/tmpfiles.d/rorg.conf",
    "images/rorg/process.conf": "usr/share/doc/rorg/examples/process.conf",
}
COMPLETIONS = {
    "bash": "usr/share/bash-completion/completions/rorg",
    "zsh": "usr/share/zsh/vendor-completions/_rorg",
    "fish": "usr/share/fish/vendor_completions.d/rorg.fish",
}
# -I: what a shell has set up for ROS, as PYTHONPATH, is not for rorg.
COMMAND = f"""#!/{HOME}/bin/python -I
from rorg.cli.main import run

run()
"""
CONTROL = """Package: rorg
Version: {version}
Architecture: {architecture}
Maintainer: rorg <rorg@localhost>
Installed-Size: {kilobytes}
Depends: python3 (>= 3.11~), python3 (<< 3.12~), git, libc6 (>= 2.28), libgcc-s1, libstdc++6,
 systemd | systemd-standalone-sysusers | systemd-sysusers
Recommends: docker.io, openssl
Suggests: bash-completion
Section: misc
Priority: optional
Description: services of a robot, run while something needs them
 Services of a robot are declared in YAML, in git, and run as containers or as
 plain processes. A service runs while something requests it, or needs it.
"""
COPYRIGHT = """rorg is under the Apache License, version 2.0: /usr/share/common-licenses/Apache-2.0.

Packages of others are in /{site}, and their licenses
in the folders NAME.dist-info there:

{others}"""


def run(*words: str | Path, **environment: str) -> None:
    subprocess.run(words, check=True, stdout=subprocess.DEVNULL, env={**os.environ, **environment})


def pip(*words: str | Path, **environment: str) -> None:
    quiet = ("--quiet", "--quiet", "--disable-pip-version-check", "--no-input")
    run(sys.executable, "-m", "pip", *words[:1], *quiet, *words[1:], **environment)


def pinned(folder: Path) -> tuple[Path, Path]:
    """The pins of what runs, and those of the tool that builds the wheel, as files for pip."""
    entries = re.split(r"\n(?=\w)", (ROOT / "images/rorg/constraints.txt").read_text())[1:]
    tools = [entry for entry in entries if entry.startswith("setuptools==")]
    for name, found in (("run.txt", [e for e in entries if e not in tools]), ("build.txt", tools)):
        (folder / name).write_text("\n".join(found) + "\n")
    return folder / "run.txt", folder / "build.txt"


def wheel(folder: Path, pins: Path) -> None:
    """Makes the wheel of rorg, of a copy: setuptools writes into what it builds, and packs what it finds there."""
    for name in SOURCES:
        made = folder / "source" / name
        made.parent.mkdir(parents=True, exist_ok=True)
        ignored = shutil.ignore_patterns("__pycache__", "build", "*.egg-info")
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, made, symlinks=True, ignore=ignored)
        else:
            shutil.copy(ROOT / name, made)
    pip("install", "--require-hashes", "--no-compile", "--target", folder / "tools", "-r", pins)
    options = ("--no-deps", "--no-build-isolation", "--no-index", "--wheel-dir", folder)
    pip("wheel", *options, folder / "source", PYTHONPATH=str(folder / "tools"))


def environment(root: Path, folder: Path, architecture: str) -> None:
    """/usr/lib/rorg: what venv would make, without its tools."""
    site, pins = root / SITE, pinned(folder)
    chosen = selection(architecture, 11)
    pip("install", "--require-hashes", *chosen, "--no-compile", "--target", site, "-r", pins[0])
    wheel(folder, pins[1])
    # By its name: of a path pip would write down where that was.
    pip("install", "--no-deps", "--no-index", "--find-links", folder, "--no-compile", "--target", site, "rorg")
    shutil.rmtree(site / "bin")  # commands of others, and what /usr/bin/rorg is here
    (root / HOME / "bin").mkdir()
    (root / HOME / "bin/python").symlink_to("/usr/bin/python3")
    write(root / HOME / "pyvenv.cfg", "home = /usr/bin\ninclude-system-site-packages = false\n")


def write(path: Path, text: str | bytes, mode: int = 0o644) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    path.chmod(mode)


def output(*words: str | Path) -> str:
    """What Python prints, with these sources and the packages of this machine: the new ones may be for another."""
    sources = os.pathsep.join(str(ROOT / name) for name in (".", "clients/python"))
    found = {**os.environ, "PYTHONPATH": sources, "PYTHONDONTWRITEBYTECODE": "1"}
    return subprocess.check_output([sys.executable, *words], env=found, text=True)


def system_files(root: Path) -> None:
    """The command, its page, its completions, and what systemd reads."""
    site, doc = root / SITE, root / "usr/share/doc/rorg"
    write(root / "usr/bin/rorg", COMMAND, 0o755)
    for source, place in FILES.items():
        write(root / place, (ROOT / source).read_bytes())
    for shell, place in COMPLETIONS.items():
        script = output("-m", "rorg", "completion", shell)
        # zsh calls this file the first time that rorg is completed: it has to answer too, not only to define.
        write(root / place, script + ('$_comps[rorg] "$@"\n' if shell == "zsh" else ""))
    page = output(ROOT / "docs/reference/man.py")
    write(root / "usr/share/man/man1/rorg.1.gz", gzip.compress(page.encode(), mtime=0))
    write(doc / "changelog.gz", gzip.compress((ROOT / "CHANGELOG.md").read_bytes(), mtime=0))
    others = (d for d in distributions(path=[str(site)]) if d.name != "rorg")
    lines = sorted((f"  {d.name} {d.version}: {license_of(d)}\n" for d in others), key=str.lower)
    write(doc / "copyright", COPYRIGHT.format(site=SITE, others="".join(lines)))


def license_of(found: Distribution) -> str:
    """What a package says of itself."""
    about = found.metadata.json
    classes = [c.split(" :: ") for c in about.get("classifier", ())]
    named = ", ".join(words[-1] for words in classes if words[0] == "License")
    return str(about.get("license_expression") or named or about.get("license") or "see there")


def compile_all(root: Path, epoch: int) -> None:
    """What Python would write beside its files otherwise, where it may. It names their time, so they get theirs first;
    dpkg-deb sees to that of all other files."""
    for path in sorted((root / SITE).rglob("*")):
        path.chmod(0o755 if path.is_dir() or path.stat().st_mode & 0o100 else 0o644)
        os.utime(path, (epoch, epoch))
    mode = PycInvalidationMode.TIMESTAMP
    compileall.compile_dir(root / SITE, quiet=2, workers=0, stripdir=str(root), prependdir="/", invalidation_mode=mode)


def last_commit() -> int:
    """Seconds since the epoch; 1980, the oldest that archives know, where there is no git."""
    done = subprocess.run(["git", "-C", ROOT, "log", "-1", "--format=%ct"], capture_output=True, text=True)
    return int(done.stdout) if done.returncode == 0 and done.stdout.strip() else 315532800


def control(root: Path, architecture: str) -> str:
    """Writes the folder DEBIAN; returns the name of the file to be."""
    about = next(d for d in distributions(path=[str(root / SITE)]) if d.name == "rorg").metadata
    bytes_ = sum(p.lstat().st_size for p in root.rglob("*"))
    text = CONTROL.format(
        version=about["Version"],
        architecture=architecture,
        kilobytes=bytes_ // 1024,
    )
    write(root / "DEBIAN/control", text)
    for name in ("postinst", "prerm", "postrm"):
        write(root / "DEBIAN" / name, (HERE / name).read_bytes(), 0o755)
    return f"rorg_{about['Version']}_{architecture}.deb"


def arguments() -> argparse.Namespace:
    """Where the package goes, and for which machines it is."""
    here = subprocess.check_output(["dpkg", "--print-architecture"], text=True).strip()
    parser = argparse.ArgumentParser(description="Make rorg's package for Debian bookworm.")
    parser.add_argument("folder", nargs="?", type=Path, default=ROOT / "dist")
    parser.add_argument("--architecture", choices=MACHINES, default=here)
    found = parser.parse_args()
    if found.architecture not in MACHINES:
        parser.error(f"there are no wheels for {here}; try `make deb ARCH=arm64`")
    return found


def main() -> None:
    if sys.version_info[:2] != (3, 11) or not shutil.which("dpkg-deb"):
        sys.exit("cannot make the package: it takes dpkg-deb and Python 3.11; try `make deb PYTHON=python3.11`")
    os.umask(0o022)
    chosen = arguments()
    epoch = int(os.environ.get("SOURCE_DATE_EPOCH") or last_commit())
    with tempfile.TemporaryDirectory(prefix="rorg-deb-") as temporary:
        folder = Path(temporary)
        root = folder / "root"
        root.mkdir()
        environment(root, folder, chosen.architecture)
        compile_all(root, epoch)
        system_files(root)
        made = chosen.folder / control(root, chosen.architecture)
        chosen.folder.mkdir(parents=True, exist_ok=True)
        options = ("--root-owner-group", "-Zxz", "-z2")
        run("dpkg-deb", *options, "--build", root, made, SOURCE_DATE_EPOCH=str(epoch))
    print(made)


if __name__ == "__main__":
    main()
