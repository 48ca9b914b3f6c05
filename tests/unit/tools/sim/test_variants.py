"""What else a robot could be told: trees, policies and settings, one by one and swept over."""

from __future__ import annotations

import pytest
from robots import write_tree

from rorg.errors import Invalid
from rorg.manifest.load import load_or_raise
from rorg.model.trace import Trace, TraceEvent
from rorg.model.workload import Workload
from rorg.tools.sim.simulate import simulate
from rorg.tools.sim.variants import Tree, sweep, variant

SERVICES = {
    "base": {"always_on": True, "idle": {"action": "stop", "linger": "3s"}},
    "camera": {"idle": {"linger": "5s"}, "resources": {"cpu": 0.5}},
    "arm": {"resources": {"cpu": 1.0}},
}
POLICY = "apiVersion: rorg/v1\nkind: Policy\nmetadata: {name: other}\nspec: {idle: {action: pause, linger: 7s}}\n"


@pytest.fixture
def tree(tmp_path):
    root = write_tree(tmp_path / "tree", SERVICES, policies={"default": {"idle": {"action": "remove"}}})
    return Tree(root, load_or_raise(root))


def idle(found) -> dict[str, tuple[str, float]]:
    return {name: (s.idle.action, s.idle.linger) for name, s in found.catalog.services.items() if not s.meta}


def test_settings_hold_for_all_that_is_not_always_on(tree):
    found = variant("linger=20s,idle=pause", tree)
    assert found.name == "linger=20s,idle=pause"
    assert idle(found) == {"base": ("stop", 3.0), "camera": ("pause", 20.0), "arm": ("pause", 20.0)}
    kept = variant("busy=min_active=1m", tree)
    assert kept.name == "busy"
    assert idle(kept) == idle(variant(str(tree.root), tree)), "what is not set is as it was"
    assert {n: s.idle.min_active for n, s in kept.catalog.services.items()} == {
        **dict.fromkeys(("developer", "base"), 0.0),
        **dict.fromkeys(("camera", "arm"), 60.0),
    }


def test_a_policy_takes_the_place_of_that_of_the_tree(tree, tmp_path):
    (tmp_path / "soft.yaml").write_text(POLICY)
    found = variant(f"soft={tmp_path / 'soft.yaml'}", tree)
    assert found.name == "soft"
    assert idle(found) == {"base": ("stop", 3.0), "camera": ("pause", 5.0), "arm": ("pause", 7.0)}
    assert idle(variant(str(tmp_path / "soft.yaml"), tree)) == idle(found)


def test_a_directory_is_another_tree(tree, tmp_path):
    other = write_tree(tmp_path / "other", {"arm": {"idle": {"linger": "1h"}}})
    assert idle(variant(f"long={other}", tree)) == {"arm": ("stop", 3600.0)}


def test_a_sweep_has_all_combinations(tree):
    found = sweep(["linger=0s,1m", "idle=pause,stop"], tree)
    assert [v.name for v in found] == [
        *("linger=0s,idle=pause", "linger=0s,idle=stop", "linger=1m,idle=pause", "linger=1m,idle=stop")
    ]
    assert [v.settings for v in found[:1]] == [{"linger": "0s", "idle": "pause"}]
    assert idle(found[3])["arm"] == ("stop", 60.0)


def test_a_longer_linger_costs_cpu_and_spares_waiting(tree):
    """The arm is asked for every ten seconds, for five."""
    asked = [TraceEvent(10.0 * i, "developer", "pick", ("arm",)) for i in range(10)]
    left = [TraceEvent(10.0 * i + 5, "developer", "pick") for i in range(10)]
    trace = Trace("picks", 100.0, tuple(sorted([*asked, *left], key=lambda e: e.at)))
    short, long = (simulate(v.catalog, trace, Workload(), 1) for v in sweep(["linger=0s,20s"], tree))
    assert short.cpu < 0.55 < 0.95 < long.cpu
    assert sum(r.seconds == 0 for r in long.responses) == 9
    assert all(r.seconds > 0 for r in short.responses)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("lingr=2s", "lingr"),
        ("nosuch", "neither a file nor a setting"),
        ("linger=2s,linger=3s", "twice"),
        ("linger=2s,speed=3", "'speed=3' is not a setting"),
        ("linger=soon", "not a duration"),
        ("idle=sleep", "'pause', 'deactivate', 'stop' or 'remove'"),
    ],
)
def test_what_is_no_variant_is_refused(tree, text, why):
    with pytest.raises(Invalid, match=why) as found:
        variant(text, tree)
    assert found.value.remedy


def test_a_file_that_is_no_policy_is_refused(tree, tmp_path):
    (tmp_path / "bad.yaml").write_text(POLICY.replace("7s", "soon"))
    with pytest.raises(Invalid, match=r"bad.yaml:4:\d+"):
        variant(str(tmp_path / "bad.yaml"), tree)
    with pytest.raises(Invalid, match="not a Policy"):
        variant(str(tree.root / "services/arm.yaml"), tree)


@pytest.mark.parametrize(
    ("texts", "why"),
    [
        (["linger"], "not a list of values"),
        (["linger=1s,"], "not a list of values"),
        (["speed=1,2"], "not a list of values"),
        (["linger=1s", "linger=2s"], "twice"),
        (["linger=" + ",".join(f"{i}s" for i in range(101))], "101 variants"),
    ],
)
def test_what_is_no_sweep_is_refused(tree, texts, why):
    with pytest.raises(Invalid, match=why):
        sweep(texts, tree)
