"""A repository of manifests with a history."""

from __future__ import annotations

import subprocess
from pathlib import Path

from rorg.daemon.tree import Tree
from rorg.images.records import Records
from rorg.images.references import References

SERVICE = "apiVersion: rorg/v1\nkind: Service\nmetadata: {{name: {name}}}\nspec: {spec}\n"


class Repository:
    """One with a tree in `manifests/` and a context beside it."""

    def __init__(self, top: Path) -> None:
        self.top, self.tree = top, top / "manifests"
        top.mkdir(parents=True, exist_ok=True)
        self.git("init", "--quiet", "--initial-branch=main")

    def git(self, *words: str) -> str:
        who = ("-c", "user.name=Ada", "-c", "user.email=ada@localhost")
        return subprocess.check_output(["git", *who, *words], cwd=self.top, text=True).strip()

    def write(self, path: str, text: str, mode: int = 0) -> None:
        place = self.top / path
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text(text)
        if mode:
            place.chmod(mode)

    def service(self, name: str, spec: str = "{image: x}") -> None:
        self.write(f"manifests/services/{name}.yaml", SERVICE.format(name=name, spec=spec))

    def commit(self, message: str = "Change") -> str:
        self.git("add", "--all")
        self.git("commit", "--quiet", "--allow-empty", "--message", message)
        return self.git("rev-parse", "HEAD")

    def read(self, engine: str = "docker") -> Tree:
        """The tree as it lies there now."""
        tree = self.unread(engine)
        tree.read_now()
        assert not tree.errors, tree.errors
        return tree

    def unread(self, engine: str = "docker") -> Tree:
        references = References(Records(self.top.parent / "state"), engine == "docker")
        return Tree(self.tree.resolve(), engine=engine, references=references)
