"""Fields of `idle` that an earlier version had: a tree that still says them works as one without them."""

from __future__ import annotations

from dataclasses import replace

import pytest
from robots import write_tree

from rorg.core.desired import desire
from rorg.manifest.load import load

IDLE = {"action": "pause", "linger": "3s"}

NAMED = {"services": ("cam", "Service"), "profiles": ("moving", "Profile"), "policies": ("moving", "Policy")}


def trees(tmp_path, kind: str, value: object):
    """A tree with `prewarm` in one manifest of this kind, and the same tree without it."""
    found = []
    for name, more in (("old", {"prewarm": value}), ("new", {})):
        idle = {"idle": {**IDLE, **more}}
        services = {"lamp": {"driver": {}, "profile": "moving"}, "cam": idle if kind == "services" else {}}
        kinds = {one: {"moving": idle if kind == one else {}} for one in ("profiles", "policies")}
        found.append(write_tree(tmp_path / name, services, **kinds))
    return found


@pytest.mark.parametrize("value", ["auto", "off", 0.05, 7, True, ["nonsense"]], ids=str)
@pytest.mark.parametrize("kind", ["services", "profiles", "policies"])
def test_prewarm_is_accepted_with_a_warning_and_changes_nothing(tmp_path, kind, value):
    old, new = map(load, trees(tmp_path, kind, value))
    assert new.diagnostics == ()
    assert old.catalog is not None
    assert new.catalog is not None
    (warning,) = old.diagnostics
    name, what = NAMED[kind]
    file = tmp_path / f"old/{kind}/{name}.yaml"
    line = next(n for n, text in enumerate(file.read_text().splitlines(), 1) if "prewarm" in text)
    assert str(warning).startswith(f"{file}:{line}:")
    said = f": warning: `prewarm` of the {what} '{name}' has no effect; drop it [prewarm-without-effect]"
    assert str(warning).endswith(said)
    assert "\n" not in str(warning)
    assert old.catalog.fingerprint == new.catalog.fingerprint
    assert desire(old.catalog).digests == desire(new.catalog).digests
    idle = {n: s.idle for n, s in old.catalog.services.items()}
    assert idle == {n: s.idle for n, s in new.catalog.services.items()}
    assert idle["cam"].action == ("stop" if kind == "profiles" else "pause")


def test_prewarm_in_an_overlay_is_accepted_too(tmp_path):
    tree = write_tree(tmp_path, {"cam": {"idle": IDLE}})
    overlay = tree / "robots/nora/services/cam.yaml"
    overlay.parent.mkdir(parents=True)
    overlay.write_text(
        "apiVersion: rorg/v1\nkind: Service\nmetadata: {name: cam}\nspec:\n  idle: {linger: 9s, prewarm: auto}\n"
    )
    loaded = load(tree, robot="nora")
    assert [str(d).partition(" ")[0] for d in loaded.diagnostics] == [f"{overlay}:5:22:"]
    base = load(tree).catalog
    assert base is not None
    assert loaded.catalog is not None
    assert loaded.catalog.services["cam"].idle == replace(base.services["cam"].idle, linger=9.0)
