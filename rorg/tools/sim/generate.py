"""Generates a trace of the tour guide's day from its state machine and a seed.

The states and their order are those of the Rorg paper (ICRA 2019, figure 4), and their services those of TritonBot.
Limits such as 15 s of listening are TritonBot's. The distributions below them, and the battery, are assumptions: no
recording of a real day was published.
"""

from __future__ import annotations

import random
from collections.abc import Mapping
from dataclasses import dataclass

from rorg.errors import Invalid
from rorg.model.trace import Trace, TraceEvent
from rorg.model.units import counted, format_seconds

BEHAVIOUR = "behavioral"
"""The service that goes through these states. The developer requests it."""

_FACES = ("usb_cam", "openface_client", "openface_server", "face_db", "human_db", "ros_face_train_controller")
_WAKEWORD = ("microphone", "snowboy")
_DRIVE = ("navigation_route", "navigation", "cartographer_localization", "laser_repub", "back_laser")
_SPEAK = ("ros_speak_text",)

STATES: Mapping[str, tuple[str, ...]] = {
    "start": (),
    "standby": (*_FACES, *_WAKEWORD),
    "chat": (*_FACES, *_WAKEWORD, "gcloud_speech_action_server", *_SPEAK),
    "tour": (*_DRIVE, "traffic_control_server", "leg_tracker", *_SPEAK),
    "return": (*_DRIVE, "traffic_control_server"),
    "charging": (),
}
"""What the behaviour requests in each state, in addition to services that are always on."""


@dataclass(frozen=True, slots=True)
class Span:
    """A range of seconds with equal probability."""

    least: float
    most: float


START = 30.0
"""Seconds from the developer's request until it looks for visitors."""
PAUSE = 3.0
"""Least seconds of standby: the camera's data about the last visitor is valid for so long."""
SPEAK = Span(2, 5)
LISTEN = Span(3, 15)
"""From the first silence that ends an answer to the longest time that the robot listens."""
GOES_ON = 0.5
"""Probability that a visitor answers once more."""
POINTS = 4
"""Places on a tour."""
GO = Span(15, 60)
"""The way to the next place."""
EXPLAIN = Span(15, 30)
MISSES = 0.05
"""Probability that driving or docking fails."""
TRIES = 3
HOME = Span(30, 90)
"""The way to the place in front of the dock."""
DOCK = Span(20, 60)


@dataclass(frozen=True, slots=True)
class Battery:
    """Fractions of a full battery, and rates per hour. One charge lasts nearly four hours of a busy day."""

    full: float = 0.95
    """Charging ends at this level."""
    low: float = 0.2
    """At this level, the robot drives to its dock."""
    standing: float = 0.16
    driving: float = 0.32
    charging: float = 0.5


Activity = tuple[tuple[str, float], ...]
"""(state, seconds), one after the other, between two periods of standby."""
DRIVING = frozenset(("tour", "return"))


def generate_day(duration: float, greetings: int, tours: int, seed: int, *, name: str = "tour-guide") -> Trace:
    """Exactly this number of greetings and tours within `duration` seconds; the same seed gives the same trace.

    Each tour starts with a greeting; other greetings have no tour. Visitors come at random, and the robot charges when
    its battery is low. Raises Invalid if there are more tours than greetings, or too many for the time."""
    what = f"generate {counted(greetings, 'greeting')} and {counted(tours, 'tour')} in {format_seconds(duration)}"
    if not 0 <= tours <= greetings:
        raise Invalid(what, "each tour starts with a greeting", f"{tours} greetings or more")
    rng = random.Random(seed)
    with_tour = set(rng.sample(range(greetings), tours))
    visits = [_visit(rng, index in with_tour) for index in range(greetings)]
    gaps = [rng.expovariate(1.0) for _ in range(greetings + 1)]
    if _last_visit_ends(visits, gaps, 0.0, seed) > duration:
        least = format_seconds(_last_visit_ends(visits, gaps, 0.0, seed))
        raise Invalid(what, f"they take {least}", "a longer duration, or fewer of them")
    scale = _widest(visits, gaps, duration, seed)
    day = _through(visits, gaps, scale, seed)
    day.stand(duration - day.now)
    begin = TraceEvent(0.0, "developer", "autonomy", (BEHAVIOUR,))
    events = [_entering(at, state) for at, state in day.entered if at < duration]
    text = f"{counted(greetings, 'greeting')} and {counted(tours, 'tour')}, generated with seed {seed}: no recording."
    return Trace(name, duration, (begin, *events), text)


def _entering(at: float, state: str) -> TraceEvent:
    """The state machine decides ten times a second."""
    return TraceEvent(round(at, 1), BEHAVIOUR, BEHAVIOUR, STATES[state], state)


def _visit(rng: random.Random, tour: bool) -> Activity:
    talk = _within(rng, SPEAK) + _within(rng, LISTEN)
    while rng.random() < GOES_ON:
        talk += _within(rng, SPEAK) + _within(rng, LISTEN)
    if not tour:
        return (("chat", talk),)
    shown = sum(_tried(rng, GO) + _within(rng, EXPLAIN) for _ in range(POINTS))
    return (("chat", talk), ("tour", shown), ("return", _home(rng)))


def _within(rng: random.Random, span: Span) -> float:
    return rng.uniform(span.least, span.most)


def _tried(rng: random.Random, span: Span) -> float:
    """Seconds including failed attempts. The last attempt always succeeds."""
    taken = _within(rng, span)
    for _ in range(TRIES - 1):
        if rng.random() >= MISSES:
            break
        taken += _within(rng, span)
    return taken


def _home(rng: random.Random) -> float:
    return _tried(rng, HOME) + _tried(rng, DOCK)


@dataclass
class _Day:
    """Goes through the states in order, and keeps track of time and battery."""

    rng: random.Random
    battery: float
    entered: list[tuple[float, str]]
    now: float = START
    rates: Battery = Battery()

    def enter(self, state: str, seconds: float) -> None:
        self.entered.append((self.now, state))
        self.now += seconds
        rate = self.rates.driving if state in DRIVING else self.rates.standing
        self.battery += seconds / 3600 * (self.rates.charging if state == "charging" else -rate)

    def stand(self, seconds: float) -> None:
        """Spends this time in standby, or at the dock whenever the battery is low."""
        while seconds > 0:
            lasts = min(seconds, max(0.0, self.battery - self.rates.low) / self.rates.standing * 3600)
            if lasts > 0:
                self.enter("standby", lasts)
            seconds -= lasts
            if seconds > 0:
                if self.entered[-1][1] != "return":
                    self.enter("return", _home(self.rng))
                self.enter("charging", (self.rates.full - self.battery) / self.rates.charging * 3600)


def _through(visits: list[Activity], gaps: list[float], scale: float, seed: int) -> _Day:
    """All visits with the gaps between them, up to the end of the last visit."""
    day = _Day(random.Random(f"docks of {seed}"), Battery().full, [(0.0, "start")])
    for gap, visit in zip(gaps, visits, strict=False):
        day.stand(PAUSE + gap * scale)
        for state, seconds in visit:
            day.enter(state, seconds)
    return day


def _last_visit_ends(visits: list[Activity], gaps: list[float], scale: float, seed: int) -> float:
    return _through(visits, gaps, scale, seed).now + gaps[-1] * scale


def _widest(visits: list[Activity], gaps: list[float], duration: float, seed: int) -> float:
    """The largest factor for the gaps that fits into the time. 0 is known to fit."""
    fits, too_wide = 0.0, duration / min(gaps)
    for _ in range(60):
        middle = (fits + too_wide) / 2
        if _last_visit_ends(visits, gaps, middle, seed) <= duration:
            fits = middle
        else:
            too_wide = middle
    return fits
