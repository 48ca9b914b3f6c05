"""The local copy of a repository that is followed: a store of its commits, and the files of the commit in force, always
in the same place. If a process is killed at any point, the next prepare() repairs it."""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
import signal
import threading
from dataclasses import dataclass
from pathlib import Path

import psutil

from rorg.host.commands import MOST_OUTPUT
from rorg.host.git_process import PATIENCE, Said, run_git
from rorg.host.git_remote import Remote, without_user

FETCH_PATIENCE = 600.0
"""Seconds for a fetch: the first one fetches everything."""
WRITE_PATIENCE = 120.0
"""Seconds for writing the files of a commit, and for packing."""
FETCHED, TARGET = "refs/rorg/fetched", "refs/rorg/target"
"""References: the last fetched commit; the commit that is in force, or being written."""
LEFT = ("*.lock", "refs/**/*.lock", "logs/**/*.lock", "objects/pack/tmp_*", "objects/*/tmp_obj_*")
"""What a killed git leaves behind."""
PASSED_ON = (
    *("PATH", "XDG_CONFIG_HOME", "XDG_RUNTIME_DIR", "SSH_AUTH_SOCK", "GIT_SSH", "GIT_SSH_COMMAND", "GIT_ASKPASS"),
    *("GIT_SSL_CAINFO", "GIT_SSL_NO_VERIFY", "SSL_CERT_FILE", "GIT_CONFIG_GLOBAL", "GIT_CONFIG_SYSTEM"),
    *("http_proxy", "https_proxy", "all_proxy", "no_proxy", "HTTPS_PROXY", "ALL_PROXY", "NO_PROXY"),
)
"""Variables of our own environment that give access: for ssh, credential helpers, proxies."""
BOUNDED = ("-c", "http.lowSpeedLimit=100", "-c", "http.lowSpeedTime=60", "-c", "fetch.unpackLimit=1")
"""Give up on a server that stops sending. Fetch into one pack, which git writes to the disk before it counts."""


class Unreachable(Exception):
    """The repository cannot be asked, or the cache cannot be written: try again later."""


class Unacceptable(Exception):
    """A commit that must not come into force, and why."""


@dataclass(frozen=True, slots=True)
class Followed:
    """The repository and branch to follow, and which of its commits are accepted."""

    remote: Remote
    path: str = "."
    """Where its manifests are."""
    signers: Path | None = None
    """One of these must have signed each commit: a file of ssh signers, or a GnuPG home."""
    forward: bool = True
    """Accept only commits that have the commit in force among their ancestors."""

    @property
    def shown(self) -> str:
        """Its name for people."""
        remote = self.remote
        inner = "" if self.path == "." else f", {self.path}"
        return f"{remote.shown}{f'@{remote.branch}' if remote.branch else ''}{inner}"

    @property
    def identity(self) -> str:
        """Identifies the repository and the branch, without showing them."""
        return hashlib.sha256(f"{self.remote.url}\n{self.remote.branch}".encode()).hexdigest()


class GitCache:
    """`stop` ends a git that runs. Its methods are called by one thread at a time; they raise Unreachable, and OSError
    for what the disk refuses."""

    def __init__(self, folder: Path, followed: Followed, stop: threading.Event) -> None:
        self.folder, self.followed, self.stop = folder.absolute(), followed, stop
        self.store, self.tree = self.folder / "store", self.folder / "tree"
        self._writing = self.folder / "writing"
        """Exists while files may be half of one commit and half of another."""

    @property
    def commit(self) -> str:
        """The commit in force; empty if it is not known."""
        return self._hash(TARGET)

    @property
    def empty(self) -> bool:
        """Whether there are no files yet."""
        return not any(path.name != ".git" for path in self.tree.iterdir())

    def prepare(self) -> None:
        """Create it, or repair what was left half done, so that the files are those of the commit in force. Remove what
        is of another repository."""
        source, identity = self.folder / "source", self.followed.identity
        if self.folder.exists() and _text(source) != identity:
            shutil.rmtree(self.folder)
        self.tree.mkdir(parents=True, exist_ok=True)
        if not self._git("rev-parse", "--git-dir").yes:
            self._begin()
        gitfile = self.tree / ".git"
        if _text(gitfile) != f"gitdir: {self.store}":
            gitfile.write_text(f"gitdir: {self.store}\n")
        self._end_orphans()
        for left in (p for pattern in LEFT for p in self.store.glob(pattern)):
            left.unlink(missing_ok=True)
        source.write_text(f"{identity}\n")
        if self.commit:
            try:
                self._write(self.commit)
            except Unreachable:
                if self._git("fsck", "--no-dangling", "--no-progress", patience=WRITE_PATIENCE).yes:
                    raise
                self._begin()

    def _end_orphans(self) -> None:
        """End git processes that a killed rorg left: nothing limits them any more, and they hold locks."""
        for process in psutil.process_iter(["cmdline"]):
            words = process.info["cmdline"] or []
            if words[:1] == ["git"] and str(self.store) in words:
                with contextlib.suppress(psutil.Error, OSError):
                    os.killpg(process.pid, signal.SIGKILL)
                    process.wait(PATIENCE)

    def _begin(self) -> None:
        """A new store. Complete files stay in force until it has more."""
        shutil.rmtree(self.store, ignore_errors=True)
        self._must("init", "--quiet", "--template=", "--initial-branch", self.followed.remote.branch or "main")
        if self._writing.exists():
            shutil.rmtree(self.tree)
            self._writing.unlink()

    def fetch(self) -> str:
        """Fetch what is new; return the commit that the repository is at."""
        remote = self.followed.remote
        uploads = [f"--upload-pack={remote.upload_pack}"] if remote.upload_pack else []
        said = run_git(
            [
                *(*BOUNDED, "--git-dir", str(self.store), "fetch", "--quiet", "--no-write-fetch-head"),
                *("--no-recurse-submodules", "--no-auto-maintenance", *uploads, "--", remote.url),
                f"+{remote.source}:{FETCHED}",
            ],
            patience=FETCH_PATIENCE,
            environment={name: os.environ[name] for name in PASSED_ON if name in os.environ},
            errors=True,
            stop=self.stop,
        )
        if not said.yes:
            raise Unreachable(_reason(said))
        return self._hash(FETCHED)

    def check(self, commit: str) -> None:
        """Raises Unacceptable for a commit that must not come into force."""
        before, short, path = self.commit, commit[:10], self.followed.path
        if self.followed.forward and before and not self._git("merge-base", "--is-ancestor", before, commit).yes:
            raise Unacceptable(
                f"{short} does not follow {before[:10]}: its history is a different one; try to push a commit that "
                f"follows it (`git merge`), or to start again: stop rorg and remove {self.folder}"
            )
        if self.followed.signers and (why := signed(self.store, commit, self.followed.signers)):
            raise Unacceptable(f"{short} is not signed by any of {self.followed.signers}: {why}")
        if self._git("cat-file", "-t", f"{commit}:{'' if path == '.' else path}").text != "tree":  # not through a link
            raise Unacceptable(f"{short} has no directory {path}; try --path DIR")

    def advance(self, commit: str) -> None:
        """Write the files of a commit and put it into force; on failure restore the previous one."""
        before = self.commit
        try:
            self._write(commit)
        except (Unreachable, OSError):
            if before:
                self._write(before)
            raise

    def _write(self, commit: str) -> None:
        """Once TARGET is set, the next prepare() completes what is begun here."""
        self._must("update-ref", TARGET, commit)
        self._writing.touch()
        known = (self.store / "index").exists()
        self._must("reset", "--hard", "--quiet", commit)
        if not known:  # unknown which files are of another commit
            self._must("clean", "-ffdxq")
        self._writing.unlink()

    def submodules(self) -> list[str]:
        """Directories of submodules in the commit in force; they stay empty."""
        words = ("config", "--blob", f"{TARGET}:.gitmodules", "--get-regexp", r"^submodule\..*\.path$")
        return [line.partition(" ")[2] for line in self._git(*words).text.splitlines()]

    def tidy(self) -> None:
        """Pack what was fetched, once there is much of it."""
        self._git("-c", "gc.autoDetach=false", "gc", "--auto", "--quiet", patience=WRITE_PATIENCE)

    def _must(self, *words: str) -> None:
        said = self._git(*words, patience=WRITE_PATIENCE, errors=True)
        if not said.yes:
            raise Unreachable(_reason(said))

    def _hash(self, name: str) -> str:
        """The hash of a commit; empty if there is none."""
        said = self._git("rev-parse", "--verify", "--quiet", f"{name}^{{commit}}")
        return said.text if said.yes else ""

    def _git(self, *words: str, patience: float = PATIENCE, errors: bool = False) -> Said:
        """Run git in the store without any user's configuration: no filters, no hooks."""
        places = ("--git-dir", str(self.store), "--work-tree", str(self.tree))
        nobody = {"HOME": str(self.folder), "GIT_CONFIG_GLOBAL": "/dev/null"}
        return run_git([*places, *words], None, patience, nobody, errors, self.stop)


def _text(path: Path) -> str:
    with contextlib.suppress(OSError), path.open(errors="replace") as file:
        return file.read(MOST_OUTPUT).strip()
    return ""


def _reason(said: Said) -> str:
    """git's reason for a failure, in one line."""
    lines = [line.strip() for line in said.text.splitlines() if line.strip()]
    told = [line for line in lines if line.startswith(("fatal:", "error:", "ssh:"))] or lines[-1:]
    return without_user("; ".join(told))[:500] or f"git ended with exit code {said.code}"


SSH = ("-c", "gpg.program=false", "-c", "gpg.x509.program=false", "-c", "gpg.minTrustLevel=fully")
"""Accept no signature of another kind."""
PGP = ("-c", "gpg.ssh.program=false", "-c", "gpg.x509.program=false")


def signed(git: Path, commit: str, signers: Path) -> str:
    """Why a commit does not verify; empty if it does. git asks ssh-keygen or gpg, and only the named signers count.
    `git` is the repository's directory. `signers` is a file for ssh-keygen (ALLOWED SIGNERS in its manual: only keys in
    it count), or a GnuPG home: every key in it counts unless it is expired or revoked."""
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
