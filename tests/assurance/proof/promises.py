"""What rorg promises, whatever is killed when: checked over the log of the engine and what clients were told.

Each promise yields its violations as sentences. They read the log from its beginning, so they hold at every moment of
it, and not only at its end.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from proof.engine_link import Entry

from rorg.core.observed import Container

STRANGER = "stranger"
"""Name of a container that is not rorg's, in every world."""
SPARE_CALLS = 6
"""Calls of the engine that a crash may add."""


@dataclass(frozen=True)
class Story:
    """What a run left behind."""

    entries: list[Entry]
    specs: Mapping[str, Mapping[str, Any]]
    """Service -> its last declared spec, also of a service that is no longer declared."""
    gone: frozenset[str] = frozenset()
    """Services whose containers may be removed for good."""
    end: Mapping[str, Any] = field(default_factory=dict)
    """The state in which it came to rest."""
    reference: Story | None = None
    """The same run without a crash."""

    def probed(self, service: str) -> bool:
        return "ready" in self.specs.get(service, {})


def run_of(container: Container) -> tuple[str, str]:
    return container.id, container.started_at


def proven_before(story: Story) -> Iterator[tuple[Entry, Mapping[str, Container], set[tuple[str, str]]]]:
    """Each entry with the containers before it, and the runs that had answered their probe by then."""
    before: Mapping[str, Container] = {}
    proven: set[tuple[str, str]] = set()
    for entry in story.entries:
        yield entry, before, proven
        if entry.verb == "exec" and entry.text == "0" and entry.container in before:
            proven = proven | {run_of(before[entry.container])}
        before = entry.containers or before


def needs_of(spec: Mapping[str, Any]) -> list[str]:
    return [need if isinstance(need, str) else need["service"] for need in spec.get("needs", ())]


def one_container_lives(story: Story) -> Iterator[str]:
    """At most one container of a service is alive."""
    for entry in story.entries:
        alive = Counter(c.service for c in entry.containers.values() if c.alive and c.service)
        yield from (f"{n} containers of {name} live after {entry}" for name, n in alive.items() if n > 1)


def nothing_is_made_twice(story: Story) -> Iterator[str]:
    """No container is made while there is a sound one from the same digest."""
    before: Mapping[str, Container] = {}
    for entry in story.entries:
        if entry.verb == "create":
            made = entry.containers[entry.container]
            twins = [c for c in before.values() if (c.service, c.digest) == (made.service, made.digest)]
            if [c for c in twins if not c.exit_code]:
                yield f"{made.service} was made again from the same digest: {entry}"
        before = entry.containers or before


def nothing_is_tried_more_often(story: Story) -> Iterator[str]:
    """A crash makes no container that would not be made without it: a change that failed is not tried again."""
    if story.reference:
        wanted = made_of(story.reference)
        yield from (
            f"{key[0]} was made {n} times from {key[1]}" for key, n in made_of(story).items() if n > wanted[key]
        )


def made_of(story: Story) -> Counter[tuple[str, str]]:
    """How often containers were made, by service and digest."""
    made = (e.containers[e.container] for e in story.entries if e.verb == "create")
    return Counter((c.service, c.digest) for c in made)


def images_are_built_once(story: Story) -> Iterator[str]:
    """No image is built while the engine has one with its reference."""
    yield from (
        f"an image was built again: {entry}" for entry in story.entries if entry.verb == "build_image" and entry.text
    )


def protected_services_are_not_shed(story: Story) -> Iterator[str]:
    """Nothing that is protected stops."""
    for entry in story.entries:
        if entry.verb == "stop" and story.specs.get(entry.service, {}).get("protected"):
            yield f"{entry.service} is protected, and was stopped: {entry}"


def files_are_whole(story: Story) -> Iterator[str]:
    """The harness compares what commands write with the files before and afterwards, after every kill."""
    yield from (entry.text for entry in story.entries if entry.verb == "half")


def strangers_are_left_alone(story: Story) -> Iterator[str]:
    for entry in story.entries:
        stranger = entry.containers.get(STRANGER)
        if entry.container == STRANGER or (entry.containers and (not stranger or stranger.state != "running")):
            yield f"the container of somebody else was touched: {entry}"


def needs_are_ready_first(story: Story) -> Iterator[str]:
    """Nothing starts before what it needs runs and has answered its probe."""
    for entry, before, proven in proven_before(story):
        if entry.verb not in ("start", "resume") or entry.service not in story.specs:
            continue
        for need in needs_of(story.specs[entry.service]):
            runs = [c for c in before.values() if c.service == need and c.state == "running"]
            if not any(run_of(c) in proven or not story.probed(need) for c in runs):
                yield f"{entry.service} started before {need} was ready: {entry}"


def exclusive_is_exclusive(story: Story) -> Iterator[str]:
    """Services that conflict, or use one resource, never run together. A paused one that is stopped runs until it has
    ended."""
    for entry, before, _ in proven_before(story):
        stopped = before.get(entry.container)
        resumed = {entry.service} if entry.verb == "stop" and stopped and stopped.state == "paused" else set[str]()
        running = sorted(resumed | {c.service for c in entry.containers.values() if c.state == "running"})
        for index, one in enumerate(running):
            spec = story.specs.get(one, {})
            for other in running[index + 1 :]:
                more = story.specs.get(other, {})
                shared = set(spec.get("exclusive", ())) & set(more.get("exclusive", ()))
                if shared or other in spec.get("conflicts", ()) or one in more.get("conflicts", ()):
                    yield f"{one} and {other} ran together after {entry}"


def the_good_one_stays_until_the_next_is_proven(story: Story) -> Iterator[str]:
    for entry, before, proven in proven_before(story):
        removed = before.get(entry.container)
        if entry.verb != "remove" or removed is None or removed.service in story.gone or removed.exit_code:
            continue
        if not (run_of(removed) in proven or (removed.started_at and not story.probed(removed.service))):
            continue
        others = [c for c in before.values() if c.service == removed.service and c.id != removed.id]
        good = [c for c in others if c.alive and (run_of(c) in proven or not story.probed(c.service))]
        if not good:
            yield f"a good container of {removed.service} was removed before its successor was proven: {entry}"


def acknowledged_requests_count(story: Story) -> Iterator[str]:
    """The harness compares the requests file with what was acknowledged, after every kill and at the end."""
    yield from (entry.text for entry in story.entries if entry.verb == "lost")


def it_converges(story: Story) -> Iterator[str]:
    """It comes to rest in time, with few more calls than without a crash; everything asked for runs."""
    yield from (entry.text for entry in story.entries if entry.verb == "late")
    if story.reference:
        calls, most = changes_of(story), 2 * changes_of(story.reference) + SPARE_CALLS
        if calls > most:
            yield f"{calls} calls of the engine; {most} would be enough"


def changes_of(story: Story) -> int:
    return sum(bool(e.containers) and e.verb != "exec" for e in story.entries)


def it_ends_as_without_a_crash(story: Story) -> Iterator[str]:
    if not story.reference or not story.end:
        return
    for key, wanted in story.reference.end.items():
        if story.end.get(key) != wanted:
            yield f"the end differs in {key}: {story.end.get(key)} instead of {wanted}"


PROMISES: tuple[Callable[[Story], Iterator[str]], ...] = (
    acknowledged_requests_count,
    one_container_lives,
    nothing_is_made_twice,
    nothing_is_tried_more_often,
    images_are_built_once,
    protected_services_are_not_shed,
    files_are_whole,
    strangers_are_left_alone,
    needs_are_ready_first,
    exclusive_is_exclusive,
    the_good_one_stays_until_the_next_is_proven,
    it_converges,
    it_ends_as_without_a_crash,
)


def violations(story: Story) -> list[str]:
    """All of them, each with the promise that it breaks."""
    return [f"{promise.__name__}: {text}" for promise in PROMISES for text in promise(story)]
