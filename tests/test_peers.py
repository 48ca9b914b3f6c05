"""What one machine of a robot makes of what the others tell it (rorg/core/peers.py), and of odd messages."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from rorg.core.desired import desire
from rorg.core.links import Answer, Granted, Link, Remote, Renewal, Report, grant
from rorg.core.ownership import Owned
from rorg.core.peers import heard, peers, seen_from
from rorg.errors import Invalid
from rorg.model.catalog import DEVELOPER, Catalog, Request, Service
from rorg.model.machines import Machine
from rorg.store.machine_file import Known, read, write

SPEC = {"image": "x"}
CATALOG = Catalog(
    services={
        DEVELOPER: Service(DEVELOPER, meta=True),
        "tour": Service("tour", machine="base", needs=("camera",), spec=SPEC),
        "camera": Service("camera", machine="head", spec=SPEC, exclusive={"gpu": 1}, may_request=("tour",)),
    },
    machines={name: Machine(name, f"{name}:1") for name in ("base", "head")},
)
RENEWAL = Renewal("base", "boot", 1, 1, 1, 10.0)
REMOTE = Remote("running", True, True, "Healthy", "Synced", "0123456789ab@2026-01-01T00:00:00Z")


def known(renewal: Renewal, now: float = 1.0):
    return peers(seen_from(CATALOG, "head"), "head", {}, {"base": Granted(renewal, 0.0)}, {}, 1, now)


def test_a_machine_speaks_for_people_and_its_own_services_only():
    said = (Request("a", DEVELOPER, ("camera",)), Request("b", "tour", ("camera",)), Request("c", "camera", ("tour",)))
    renewal = replace(RENEWAL, requests=(*said, Request("d", "nosuch", ("camera",))))
    renewal = replace(renewal, excluded={"tour": "held", "camera": "held", "nosuch": "held"})
    told = known(renewal)
    assert [r.id for r in told.requests] == ["a@base", "b@base"]
    assert told.excluded == {"tour": "held (on base)"}


def test_what_a_silent_machine_wants_counts_for_nothing():
    told = known(replace(RENEWAL, requests=(Request("a", DEVELOPER, ("camera",)),)), now=10.0)
    assert (told.requests, told.silent) == ((), frozenset({"base"}))
    here = desire(seen_from(CATALOG, "head"))
    quiet = heard(here, told.silent)
    assert quiet.catalog.services["tour"].needs == ()
    assert quiet.dependants["camera"] == ()
    assert heard(here, frozenset()) is here


def test_a_service_elsewhere_uses_nothing_here():
    away = seen_from(CATALOG, "base").services["camera"]
    assert (away.spec, away.exclusive, away.calls, away.away) == (None, {}, False, "head")


def test_a_change_of_the_lease_must_be_confirmed_anew():
    link = Link(10.0).sent(RENEWAL, 0.0).answered(Answer(1, (1, 1)), 1)
    assert link.live(8.9)
    assert not link.live(9.0)
    assert not link.lasting(30.0).live(1.0)
    assert link.lasting(10.0) is link


def test_reports_of_an_earlier_rorg_and_older_ones_are_dropped():
    link = Link(10.0).reported(Report(2, 5, (1, 1), {"camera": REMOTE}))
    for late in (Report(1, 9, (1, 1)), Report(2, 4, (1, 1)), Report(2, 5, (1, 1))):
        assert link.reported(late) is link
    assert link.reported(Report(3, 0, (1, 1))).peer == 3


def test_a_renewal_that_is_not_newer_is_refused():
    first = grant(None, replace(RENEWAL, incarnation=2, number=5), 0.0)
    for incarnation, number in ((2, 5), (2, 4), (1, 99)):
        assert grant(first, replace(RENEWAL, incarnation=incarnation, number=number), 1.0) is None
    assert grant(first, replace(RENEWAL, incarnation=3), 1.0) is not None


def test_the_file_of_a_machine_is_read_back_whole(tmp_path):
    renewal = replace(RENEWAL, requests=(Request("a", "tour", ("camera",), ttl=5.0),), asking=(("camera", 1.5),))
    written = Known("head", 7, Owned(frozenset({"camera"}), {"tour": "base"}), {"base": renewal})
    write(tmp_path / "machine.json", written)
    assert read(tmp_path / "machine.json") == written
    assert read(tmp_path / "nosuch" / "machine.json") == Known()


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{}",
        "[]",
        "null",
        '{"here": 1}',
        json.dumps({"here": "a", "incarnation": "x", "owned": [], "last": {}, "leases": {}}),
    ],
)
def test_a_broken_file_of_a_machine_is_an_error_with_its_remedy(tmp_path: Path, text):
    """A machine that does not know what it owns must start nothing."""
    (tmp_path / "machine.json").write_text(text)
    with pytest.raises(Invalid, match=r"machine.json.*remove it"):
        read(tmp_path / "machine.json")
