"""What the API accepts can be read back as it was: whatever it says, and however much of it there is."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rorg.api.inputs import PutRequest, read, request_of
from rorg.errors import Invalid
from rorg.model.catalog import Hold, Request
from rorg.model.diagnostics import Where
from rorg.model.units import SHORTEST_LEASE, stamp
from rorg.store.requests_document import RequestsDocument
from rorg.store.requests_limits import MOST_REQUESTS, OF_ALL, OF_ONE, no_room
from rorg.store.requests_parser import parse, render

RUN = "f" * 64 + "/2026-01-31T12:00:00.123456Z"
NAMES = st.from_regex(r"[a-z0-9][a-z0-9_.-]{0,61}[a-z0-9]", fullmatch=True)
IDS = st.from_regex(r"[A-Za-z0-9][A-Za-z0-9_.:-]{0,63}", fullmatch=True)
NUMBERS = st.from_regex(r"[0-9]{1,6}(\.[0-9]{1,10})?", fullmatch=True)
DURATIONS = st.lists(st.builds(str.__add__, NUMBERS, st.sampled_from(["ms", "s", "m", "h", "d"])), max_size=2)
BODIES = st.fixed_dictionaries(
    {"services": st.lists(NAMES | st.text(max_size=70), max_size=4)},
    optional={
        "reason": st.text(max_size=60) | st.text("\0\x1b\x85\u2028\u202e\ufeff\ud800: #\"'\\\n\t", max_size=20),
        "priority": st.integers(-1, 101) | st.booleans(),
        "ttl": st.none() | DURATIONS.map("".join) | st.text(max_size=21),
    },
)


def read_back(document: RequestsDocument) -> RequestsDocument:
    again, diagnostics = parse(render(document), "requests.yaml")
    assert again is not None, diagnostics
    assert not diagnostics
    return replace(again, requests=tuple(replace(r, where=Where("")) for r in again.requests))


@pytest.mark.slow
@given(IDS, NAMES, BODIES, st.none() | st.just(RUN))
def test_a_request_is_read_back_as_it_was_accepted(id, requester, body, run):
    try:
        request = replace(request_of(id, requester, read(PutRequest, body), stamp(0)), incarnation=run)
    except Invalid:
        return
    assert request.ttl is None or request.ttl >= SHORTEST_LEASE
    document = RequestsDocument((request,), {}, {requester: Hold(1e9, body.get("reason", ""))})
    assert read_back(document) == document


@pytest.mark.parametrize("ttl", ["0.0001ms", "0." + "0" * 13 + "1ms", "0s", "0.0ms", "99ms"])
def test_a_lease_that_nobody_can_renew_is_refused_and_never_becomes_none(ttl):
    with pytest.raises(Invalid, match=r"ttl.*try"):
        request_of("x", "developer", PutRequest(services=["a"], ttl=ttl))
    document, diagnostics = parse(f"requests:\n- {{id: x, services: [a], ttl: {ttl}}}\n", "requests.yaml")
    assert document is None
    assert "requests.yaml:2:" in str(diagnostics[0])


def as_much_as_possible(requesters: list[str], services: tuple[str, ...], reason: str) -> RequestsDocument:
    """Each of them puts requests until none is accepted any more."""
    document = RequestsDocument()
    for requester in requesters:
        run = None if requester == "developer" else RUN
        for number in range(MOST_REQUESTS + 1):
            request = Request(f"{number:064}", requester, services, reason, run, priority=50, ttl=0.1, renewed=stamp(0))
            if no_room(document, request):
                break
            document = replace(document, requests=(*document.requests, request))
    return document


SERVICES = [f"service-{n}" for n in range(8)]
LARGE = {
    "long names": (tuple(f"{n:062}" for n in range(300)), ""),
    "short names": (tuple(f"{n:02x}" for n in range(256)), ""),
    "one name": (("ab",), ""),
    "long reasons": (("ab",), "x" * 500),
    "reasons to be escaped": (("ab",), "\x01" * 500),
    "reasons in other scripts": (("ab",), "\U0001f916" * 500),
    "reasons that look like YAML": (("ab",), ("a: [#' " * 80)[:500]),
}


@pytest.mark.slow
@pytest.mark.parametrize(("services", "reason"), LARGE.values(), ids=LARGE)
def test_at_every_limit_the_file_is_read_back_whole(services, reason):
    document = as_much_as_possible(SERVICES, services, reason)
    assert document.requests
    one = Request("mine", "developer", services, reason)
    assert not no_room(document, one), "services leave room for people"
    document = as_much_as_possible(["developer", *SERVICES], services, reason).put(one)
    text = render(document)
    assert len(text.encode()) < 2 * OF_ALL
    assert read_back(document) == document


def test_one_service_takes_no_room_from_the_others():
    document = as_much_as_possible(["greedy"], LARGE["long names"][0], "")
    assert 0 < len(render(document)) < 2 * OF_ONE
    assert "greedy would have more than 32 KiB" in no_room(document, Request("more", "greedy", ("x" * 62,) * 300))
    assert not no_room(document, Request("mine", "modest", LARGE["long names"][0], "x" * 500, RUN))


def test_the_same_request_can_be_put_again_at_every_limit():
    document = as_much_as_possible(["developer", *"abcdefgh"], LARGE["long names"][0], "")
    assert not [r for r in document.requests if no_room(document, r)]
