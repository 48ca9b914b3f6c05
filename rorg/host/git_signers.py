"""Who signed a commit. git asks ssh-keygen or gpg; only those count that were named."""

from __future__ import annotations

import os
from pathlib import Path

from rorg.host.git_process import run_git

SSH = ("-c", "gpg.program=false", "-c", "gpg.x509.program=false", "-c", "gpg.minTrustLevel=fully")
"""A signature of another kind is none."""
PGP = ("-c", "gpg.ssh.program=false", "-c", "gpg.x509.program=false")


def signed(git: Path, commit: str, signers: Path) -> str:
    """Why a commit does not verify; empty when it does. `git` is the directory of its repository. `signers` is a file
    as ssh-keygen has it (ALLOWED SIGNERS in its manual: only keys in there count), or a GnuPG home: every key in it
    counts, as long as it is neither expired nor revoked."""
    words: tuple[str, ...] = (*SSH, "-c", f"gpg.ssh.allowedSignersFile={signers}")
    keys = os.devnull
    if os.path.isdir(signers):
        words, keys = PGP, str(signers)
    said = run_git(
        ["--git-dir", str(git), *words, "verify-commit", commit],
        environment={"HOME": os.devnull, "GIT_CONFIG_GLOBAL": os.devnull, "GNUPGHOME": keys},
        errors=True,
    )
    if said.yes:
        return ""
    lines = [line for line in said.text.splitlines() if line.strip()]
    return lines[-1].strip() if lines else "it has no signature"
