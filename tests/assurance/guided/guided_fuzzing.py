"""`make fuzz-guided`: atheris changes inputs of a target towards code that none has reached yet.

Usage: guided_fuzzing.py MINUTES [TARGET...], by default all of them, for so many minutes together. What breaks a target
is kept in tests/cases/fuzz, where test_guided_cases.py tries it. The corpus stays in the temporary directory.
"""

from __future__ import annotations

import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path

TESTS = Path(__file__).parents[2]
ROOT = TESTS.parent
PATHS = [str(TESTS / "assurance"), str(TESTS / "support")]
"""As of pytest: this is a program of its own, in a venv of its own."""
KEPT = ROOT / "tests/cases/fuzz"
CORPUS = Path(tempfile.gettempdir(), "rorg-fuzz-guided")
NAMES = ("manifests", "requests", "bodies", "answers", "journal", "compose", "launch", "launch2", "units")
SHARES = {"manifests": 3, "compose": 2}
"""How much more time than the others a target gets."""
MOST_KEPT = 5
"""Findings of a run that are kept of each target."""


def main(minutes: float, names: list[str]) -> int:
    """Fuzz each target in a process of its own. 1 if anything was found."""
    weights = {name: SHARES.get(name, 1) for name in names or NAMES}
    before = set(KEPT.glob("*/*"))
    for name, weight in weights.items():
        seconds = max(10, round(60 * minutes * weight / sum(weights.values())))
        words = [sys.executable, __file__, "--target", name, str(seconds)]
        code = subprocess.run(words, cwd=ROOT, check=False).returncode
        if code:
            print(f"{name}: ended with {code}", flush=True)
            return 1
    found = sorted(path for path in set(KEPT.glob("*/*")) - before if breaks(path))
    print(f"{len(found)} findings", *found, sep="\n")
    return int(bool(found))


def breaks(path: Path) -> bool:
    """Whether a case is a finding without atheris too, whose changes of the code are not always right; else it goes."""
    words = [sys.executable, __file__, "--try", path.parent.name, str(path)]
    bad = subprocess.run(words, cwd=ROOT, check=False).returncode != 0
    if not bad:
        print(f"{path}: breaks nothing without atheris")
        path.unlink()
    return bad


def attempt(name: str, path: Path) -> None:
    """Try one case in this process. Raises for a defect."""
    sys.path[:0] = PATHS
    from guided import (
        guided_servers,  # noqa: F401
        guided_targets,
    )

    target = guided_targets.make(name, Path(tempfile.mkdtemp(prefix=f"rorg-fuzz-{name}.")))
    try:
        target.attempt(path.read_bytes())
    finally:
        target.close()


def share(venv: Path) -> None:
    """Let another venv use the packages of this one, for atheris alone is in that."""
    ours = sysconfig.get_path("purelib")
    theirs = sysconfig.get_path("purelib", vars={"base": str(venv)})
    Path(theirs, "shared.pth").write_text(f"import site; site.addsitedir({ours!r})\n")


def fuzz(name: str, seconds: int) -> None:
    """Fuzz one target in this process, which ends with it."""
    import atheris

    sys.path[:0] = PATHS
    with atheris.instrument_imports(include=["rorg"]):
        from guided import guided_targets

        if name in ("bodies", "answers"):
            from guided import guided_servers  # noqa: F401
    from guided.guided_run import Run

    corpus = CORPUS / name
    corpus.mkdir(parents=True, exist_ok=True)
    folder = Path(tempfile.mkdtemp(prefix=f"rorg-fuzz-{name}."))
    run = Run(name, guided_targets.make(name, folder), KEPT / name, MOST_KEPT)
    for number, seed in enumerate(run.target.seeds()):
        (corpus / f"seed-{number}").write_bytes(seed)
    arguments = [
        *(sys.argv[0], str(corpus), f"-max_total_time={seconds}", f"-max_len={guided_targets.MOST_INPUT}"),
        *("-timeout=0", "-rss_limit_mb=4096", "-print_final_stats=1", "-verbosity=1"),
    ]
    atheris.Setup(arguments, run.attempt, custom_mutator=lambda *given: run.mutated(atheris.Mutate, *given))
    atheris.Fuzz()


if __name__ == "__main__":
    if sys.argv[1] == "--venv":
        share(Path(sys.argv[2]))
    elif sys.argv[1] == "--try":
        attempt(sys.argv[2], Path(sys.argv[3]))
    elif sys.argv[1] == "--target":
        fuzz(sys.argv[2], int(sys.argv[3]))
    else:
        sys.exit(main(float(sys.argv[1]), sys.argv[2:]))
