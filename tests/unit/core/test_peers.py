"""What one machine of a robot makes of what the others tell it (rorg/core/peers.py), and of odd messages."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from rorg.core.desired import desire
from rorg.core.links import MOST_UNANSWERED, Answer, Granted, Link, Remote, Renewal, Report, grant
from rorg.core.ownership import Owned
from rorg.core.peers import Peers, heard, peers, seen_from, stand_ins
from rorg.core.received import MOST_CHARACTERS, MOST_ITEMS, is_within_bounds
from rorg.errors import Invalid
from rorg.model.catalog import DEVELOPER, Catalog, Request, Service
from rorg.model.machines import Machine
from rorg.model.objects import EngineObject
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
    return peers(seen_from(CATALOG, "head"), "head", {}, {"base": Granted(renewal, 0.0)}, {}, now)


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
    link = Link(10.0, own=1).sent(RENEWAL, 0.0).answered(Answer(1, (1, 1)))
    assert link.live(8.9)
    assert not link.live(9.0)
    assert not link.lasting(30.0).live(1.0)
    assert link.lasting(10.0) is link


def test_reports_of_an_earlier_rorg_and_older_ones_are_dropped():
    link = Link(10.0, own=1).reported(Report(2, 5, (1, 1), {"camera": REMOTE}))
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
    "value",
    [
        2**63,
        -(2**63),
        math.inf,
        math.nan,
        "x" * (MOST_CHARACTERS + 1),
        (1,) * (MOST_ITEMS + 1),
        {"a": ("b", 2**63)},
        replace(RENEWAL, requests=(Request("a", "tour", ("camera",), ttl=math.inf),)),
    ],
)
def test_a_value_out_of_bounds_is_refused(value):
    assert not is_within_bounds(value)


def test_usual_values_are_within_bounds():
    assert is_within_bounds(replace(RENEWAL, asking=(("camera", 1.5),), number=2**63 - 1, excluded={"tour": "held"}))
    assert is_within_bounds(Report(1, -(2**62), (1, 1), {"tour": REMOTE, "camera": None}))


def test_what_is_out_of_bounds_on_the_disk_is_left_out(tmp_path):
    """An earlier version has written it. The other machines say again what they know."""
    bad = replace(RENEWAL, number=2**70)
    owned = Owned(frozenset({"camera"}), {"tour": "base"})
    path = tmp_path / "machine.json"
    write(path, Known("head", 10**4299, owned, {"base": bad, "arm": RENEWAL}, {"base": 10**4299, "arm": 3}))
    assert read(path) == Known("head", 0, owned, {"arm": RENEWAL}, {"arm": 3})


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


# -- the sender's side of a lease ------------------------------------------------------------------------------


LOOK = Request("look", DEVELOPER, ("camera",))


def renewal(number: int, since: int, *requests: Request, **more: Any) -> Renewal:
    return Renewal("base", "boot", 1, number, since, 10.0, requests, **more)


def answer(number: int, incarnation: int = 5, own: int = 1, report: Report | None = None) -> Answer:
    return Answer(incarnation, (own, number), report=report)


def test_a_renewal_is_due_three_times_per_lease_and_after_each_change():
    first = Link(12.0, own=1)
    assert (first.next_at, first.number) == (0.0, 0)
    assert first.due(0.0, first.content)
    sent = first.sent(renewal(1, 1), 100.0)
    assert (sent.next_at, sent.due(103.9, sent.content), sent.due(104.0, sent.content)) == (104.0, False, True)
    assert sent.due(100.0, renewal(2, 2, LOOK).content)


def test_a_renewal_names_the_first_one_that_said_the_same():
    new = Link(12.0, own=1)
    assert new.since_of(new.content) == 1, "nothing was said yet"
    sent = new.sent(renewal(1, 1, LOOK), 100.0)
    assert (sent.since_of(renewal(1, 1, LOOK).content), sent.since_of(new.content)) == (1, 2)
    again = sent.sent(renewal(2, 1, LOOK), 104.0)
    assert (again.number, again.since, again.said_at, again.sent_at, again.wants_since) == (2, 1, 100.0, 104.0, 1)
    asks = again.sent(renewal(3, 3, LOOK, asking=(("camera", 1.0),)), 105.0)
    assert (asks.since, asks.said_at, asks.wants_since) == (3, 105.0, 1), "it wants the same"
    other = asks.sent(renewal(4, 4), 106.0)
    assert (other.since, other.wants, other.wants_since) == (4, ((), {}), 4)
    assert new.sent(renewal(1, 1), 100.0).wants_since == 1


def test_only_so_many_renewals_without_an_answer_are_remembered():
    link = Link(12.0, own=1)
    for number in range(1, MOST_UNANSWERED + 3):
        link = link.sent(renewal(number, 1), float(number))
    assert list(link.unanswered) == list(range(3, MOST_UNANSWERED + 3))
    assert link.answered(answer(2)).confirmed_at is None


def test_an_answer_extends_the_lease_from_when_its_renewal_was_sent():
    link = Link(10.0, own=1).sent(renewal(1, 1), 100.0).sent(renewal(2, 1), 103.0).sent(renewal(3, 1), 106.0)
    assert (link.lost_at, link.live(100.0)) == (None, False)
    second = link.answered(answer(2))
    assert (second.confirmed_at, second.lost_at, second.peer) == (103.0, 112.0, 5)
    assert second.unanswered == {3: 106.0}
    assert second.answered(answer(3)).confirmed_at == 106.0
    assert second.answered(answer(1)) == second, "it comes late"
    late = replace(second, unanswered={**second.unanswered, 1: 100.0})
    assert late.answered(answer(1)).confirmed_at == 103.0


@pytest.mark.parametrize("more", [{"incarnation": 4}, {"own": 0}])
def test_an_answer_of_or_to_an_earlier_rorg_counts_for_nothing(more):
    link = replace(Link(10.0, own=1).sent(renewal(1, 1), 100.0), peer=5)
    assert link.answered(answer(1, **more)) is link


def test_a_machine_that_knows_a_later_rorg_is_told_a_higher_number_and_has_confirmed_nothing():
    link = Link(10.0, own=1).sent(renewal(1, 1), 100.0)
    assert link.answered(answer(1, own=7)) == replace(link, own=8)


def test_the_report_of_a_restarted_rorg_replaces_that_of_the_previous_one():
    report = Report(5, 1, (1, 1), {"camera": REMOTE})
    link = Link(10.0, own=1).sent(renewal(1, 1), 100.0).answered(answer(1, report=report))
    assert (link.report, link.known(108.9), link.known(109.0)) == (report, report, None)
    next_link = link.sent(renewal(2, 1), 101.0)
    assert next_link.answered(answer(2)).report == report
    assert next_link.answered(answer(2, 6)).report is None
    assert next_link.answered(answer(9, report=Report(5, 2, (1, 2)))).report.version == 2
    assert replace(link, report=None).reported(Report(4, 9, (1, 1))).report is None


def test_what_the_other_machine_has_heard_is_in_its_report():
    link = Link(10.0).reported(Report(5, 1, (2, 7)))
    heard = [replace(link, own=own).heard(number) for own, number in ((2, 7), (2, 8), (1, 9), (3, 1))]
    assert heard == [True, False, True, False]
    assert not Link(10.0, own=1).heard(0)
    assert REMOTE.alive
    assert not replace(REMOTE, incarnation="").alive


# -- what is known of the others -------------------------------------------------------------------------------


REPORT = Report(5, 1, (1, 1), {"tour": REMOTE, "camera": replace(REMOTE, incarnation="")})
CONFIRMED = Link(10.0, own=1).sent(renewal(1, 1), 50.0).answered(answer(1, report=REPORT))
"""Of the machine `base`, as `head` has it."""


def seen(link: Link | None = CONFIRMED, now: float = 51.0, granted: dict | None = None) -> Peers:
    links = {} if link is None else {"base": link}
    return peers(seen_from(CATALOG, "head"), "head", links, granted or {}, {}, now)


def test_a_report_says_how_the_services_of_its_machine_are():
    told = seen()
    assert (told.remotes, told.unknown, told.disputed) == ({"tour": REMOTE}, {}, {})
    assert (told.pending, told.said_at, told.deadline) == (frozenset(), {"base": 50.0}, 59.0)
    twice = replace(REPORT, services={**REPORT.services, "camera": REMOTE})
    assert seen(replace(CONFIRMED, report=twice)).disputed == {"camera": "base"}
    more = CONFIRMED.sent(renewal(2, 2, LOOK), 51.0)
    assert (seen(more).pending, seen(more).said_at) == ({"base"}, {})
    asks = CONFIRMED.sent(renewal(2, 2, asking=(("tour", 1.0),)), 51.0)
    assert (seen(asks).pending, seen(asks).said_at) == (frozenset(), {})


@pytest.mark.parametrize(
    ("link", "now", "why"),
    [
        (None, 51.0, "is on base, which has not answered yet"),
        (Link(10.0, own=1), 51.0, "is on base, which has not answered yet"),
        (CONFIRMED, 59.0, "is on base, which does not answer (lease of 10 s)"),
        (replace(CONFIRMED, report=replace(REPORT, services={})), 51.0, "is not in the manifests of base"),
    ],
)
def test_of_a_machine_that_does_not_answer_nothing_is_known(link, now, why):
    told = seen(link, now)
    assert (told.unknown, told.remotes) == ({"tour": why}, {})
    assert told.trouble(seen_from(CATALOG, "head").services["tour"]) == why


@pytest.mark.parametrize(("now", "deadline"), [(51.0, 55.0), (55.0, 59.0), (59.0, None)])
def test_the_next_lease_to_end_is_known(now, deadline):
    assert seen(now=now, granted={"base": Granted(RENEWAL, 45.0)}).deadline == deadline


def test_a_lease_of_an_unknown_machine_counts_for_nothing():
    asked = replace(RENEWAL, machine="gone", requests=(LOOK,))
    told = seen(granted={"gone": Granted(asked, 50.0), "base": Granted(replace(RENEWAL, requests=(LOOK,)), 50.0)})
    assert ([r.id for r in told.requests], told.silent) == (["look@base"], frozenset())


@pytest.mark.parametrize(
    ("remote", "trouble"),
    [
        (REMOTE, ""),
        (replace(REMOTE, ready=False, reason="refused"), "is not ready: refused"),
        (replace(REMOTE, ready=False), "is not ready: not wanted"),
        (replace(REMOTE, wanted=False), "is not ready: not wanted"),
        (None, "is on base, which has not answered yet"),
    ],
)
def test_a_service_elsewhere_can_be_relied_on_if_it_is_ready_and_wanted(remote, trouble):
    tour = seen_from(CATALOG, "head").services["tour"]
    told = Peers("head", remotes={"tour": remote} if remote else {})
    assert told.trouble(tour) == told.unready(tour) == trouble
    pending = replace(told, pending=frozenset({"base"}))
    assert (pending.trouble(tour), pending.unready(tour)) == (trouble, "is on base, which is taking up a change")


def test_what_has_changed_of_the_others_is_found():
    told = Peers("head", remotes={"tour": REMOTE}, unknown={"map": "silent"}, unowned={"camera": "base has it"})
    assert told.changed(told) == told.changed(replace(told)) == set()
    for change, names in (
        ({"remotes": {}}, {"tour"}),
        ({"remotes": {"tour": replace(REMOTE, ready=False)}}, {"tour"}),
        ({"unknown": {"map": "lost"}}, {"map"}),
        ({"unknown": {}}, {"map"}),
        ({"pending": frozenset({"base"})}, {"tour", "map"}),
        ({"unowned": {}}, {"camera"}),
    ):
        assert told.changed(replace(told, **change)) == replace(told, **change).changed(told) == names


def test_times_of_the_others_move_with_the_clock():
    told = Peers("head", said_at={"base": 5.0}, deadline=7.0)
    assert told.shifted(10.0) == Peers("head", said_at={"base": 15.0}, deadline=17.0)
    assert Peers().shifted(10.0) == Peers()


def test_networks_and_volumes_that_only_other_machines_use_are_left_out():
    networks = {name: EngineObject("network", name, name) for name in ("ros", "lan", "spare")}
    volumes = {name: EngineObject("volume", name, name) for name in ("maps", "logs", "old")}
    there = {"image": "x", "networks": {"ros": {}, "lan": {}}, "volumes": ["maps:/maps", "logs:/logs"]}
    here = {"image": "x", "networks": {"lan": {}}, "volumes": ["logs:/logs"]}
    services = {
        "tour": Service("tour", machine="base", spec=there),
        "camera": Service("camera", machine="head", spec=here),
        "tools": Service("tools", meta=True),
    }
    catalog = Catalog(services, networks=networks, volumes=volumes)
    found = seen_from(catalog, "head")
    assert (set(found.networks), set(found.volumes)) == ({"lan", "spare"}, {"logs", "old"})
    assert set(seen_from(catalog, "base").networks) == set(networks)
    alone = replace(catalog, services={"camera": services["camera"]})
    assert seen_from(alone, "head") is alone


def test_a_silent_machine_wants_nothing_and_the_others_as_before():
    services = {**CATALOG.services, "map": Service("map", machine="arm", needs=("camera",), always_on=True)}
    standing = tuple(Request("s", by, ("camera",), standing=True) for by in ("tour", "map"))
    machines = {**CATALOG.machines, "arm": Machine("arm", "arm:1")}
    here = desire(seen_from(replace(CATALOG, services=services, machines=machines, requests=standing), "head"))
    quiet = heard(here, frozenset({"arm"}))
    kept = quiet.catalog.services
    assert (kept["map"].needs, kept["map"].always_on, kept["tour"].needs) == ((), False, ("camera",))
    assert quiet.catalog.requests == standing[:1]
    assert quiet.dependants["camera"] == ("tour",)
    assert heard(here, frozenset({"nosuch"})) is here


def test_containers_elsewhere_have_a_stand_in():
    states = {name: replace(REMOTE, state=name) for name in ("running", "none", "unknown", "exited")}
    found = stand_ins(states)
    assert set(found) == {"running", "exited"}
    assert found["running"].incarnation == REMOTE.incarnation
    assert (found["exited"].service, found["exited"].state) == ("exited", "exited")
