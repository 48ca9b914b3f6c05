"""Container options from outside: what `rorg validate` lets pass, the engine takes, and makes of it what Compose would.
The spellings are in cases/options.txt."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from option_spellings import SPELLINGS, Shell


def test_enough_spellings():
    assert len(SPELLINGS) >= 300
    assert len({s.text for s in SPELLINGS}) == len(SPELLINGS)


def batched(items: list, size: int) -> list[list]:
    return [items[at : at + size] for at in range(0, len(items), size)]


def test_what_the_engine_would_not_take_is_refused_at_its_place(tmp_path):
    refused, places = [s for s in SPELLINGS if s.expected is None], {}
    for number, some in enumerate(batched(refused, 100)):  # one run lists 200 mistakes at most
        shell = Shell(tmp_path / str(number))
        for spelling in some:
            shell.service(spelling.name, spelling.text)
        for diagnostic in json.loads(shell("validate", str(shell.tree), "-o", "json", code=2).stdout):
            place = diagnostic["line"], diagnostic["column"]
            places.setdefault(Path(diagnostic["file"]).stem, []).append(place)
    wrong = {s.text: (s.place, places.get(s.name)) for s in refused if places.get(s.name) != [s.place]}
    assert wrong == {}


def seen(inspected: dict, path: str, tree: Path):
    """What the engine says at a path of the table."""
    if path == "M":
        return sorted(_mount(m, tree) for m in inspected["Mounts"])
    if path == "N":
        return sorted(inspected["NetworkSettings"]["Networks"])
    full = {"H": "HostConfig", "C": "Config"}.get(path.partition(".")[0], path.partition(".")[0])
    value = inspected[full]
    for key in path.split(".")[1:]:
        value = value.get(key)
    return value


def _mount(mount: dict, tree: Path) -> str:
    source = re.sub("^[0-9a-f]{64}$", "UNNAMED", mount.get("Name") or mount.get("Source", ""))
    for folder, short in ((tree / "services", "."), (tree, "..")):
        source = source.replace(f"{folder.resolve()}/", f"{short}/")
    spread = mount["Propagation"] if mount["Propagation"] not in ("", "rprivate") else ""
    words = (mount["Type"], source, mount["Destination"], "rw" if mount["RW"] else "ro", spread)
    return " ".join(word for word in words if word)


def same(found: object, expected: object) -> bool:
    """As expected; fields that only the engine fills in do not count."""
    if isinstance(expected, dict) and isinstance(found, dict):
        return all(same(found.get(k), v) for k, v in expected.items())
    if isinstance(expected, list) and isinstance(found, list):
        return len(found) == len([e for e in expected if e != "PATH=*"]) and all(map(same, found, expected))
    return found == expected or (not found and not expected)


@pytest.mark.docker
def test_what_is_accepted_is_what_compose_makes(dockerd, tmp_path):
    import docker

    shell = Shell(tmp_path, dockerd.host)
    accepted = [s for s in SPELLINGS if s.expected is not None]
    (shell.tree / "services/maps").mkdir()
    (shell.tree / "maps").mkdir()
    (shell.tree / "services/seccomp.json").write_text('{"defaultAction": "SCMP_ACT_ALLOW"}')
    for spelling in accepted:
        shell.service(spelling.name, spelling.text)
    api = docker.APIClient(dockerd.host, version="auto")
    try:
        shell("apply", str(shell.tree), "--yes", "--timeout", "60")
        rows = api.containers(all=True, filters={"label": ["rorg.io/service"]})
        made = {row["Labels"]["rorg.io/service"]: api.inspect_container(row["Id"]) for row in rows}
        told = [(s, p, seen(made[s.name], p, shell.tree)) for s in accepted for p in s.expected]
        assert [(s.text, p, found) for s, p, found in told if not same(found, s.expected[p])] == []
        # Nothing that is read back differs from what was written: else it would be updated, or replaced, for ever.
        shell("diff", str(shell.tree))
    finally:
        for row in api.containers(all=True, filters={"label": ["rorg.io/service"]}):
            api.remove_container(row["Id"], v=True, force=True)
