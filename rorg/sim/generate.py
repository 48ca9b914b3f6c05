"""A trace of the tour guide's day, from its state machine and a seed."""

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
"""What the behaviour requests in each state, beside what is always on."""


@dataclass(frozen=True, slots=True)
class Span:
    """Seconds, of which every value is as likely as any other."""

    least: float
    most: float


START = 30.0
"""Seconds from the developer's request until it looks for visitors."""
PAUSE = 3.0
"""Seconds of standby at the least: what the camera saw of the last visitor is valid for so long."""
SPEAK = Span(2, 5)
LISTEN = Span(3, 15)
"""From the first silence that ends an answer to the longest that is listened to."""
GOES_ON = 0.5
"""How likely a visitor is to answer once more."""
POINTS = 4
"""Places that a tour leads to."""
GO = Span(15, 60)
"""The way to the next place."""
EXPLAIN = Span(15, 30)
MISSES = 0.05
"""How likely a way or a docking is to fail."""
TRIES = 3
HOME = Span(30, 90)
"""The way to the place in front of the dock."""
DOCK = Span(20, 60)


@dataclass(frozen=True, slots=True)
class Battery:
    """Shares of a full battery; rates an hour. One charge lasts nearly four hours of a busy day."""

    full: float = 0.95
    """Charging ends there."""
    low: float = 0.2
    """The robot drives to its dock then."""
    standing: float = 0.16
    driving: float = 0.32
    charging: float = 0.5


Activity = tuple[tuple[str, float], ...]
"""(state, seconds) one after the other, from standby to standby."""
DRIVING = frozenset(("tour", "return"))


def generate_day(duration: float, greetings: int, tours: int, seed: int, *, name: str = "tour-guide") -> Trace:
    """Exactly so many greetings and tours in so many seconds, the same for the same seed. Each tour begins with a
    greeting; the others end without one. Visitors come at random; the robot charges when its battery is low.

    Raises Invalid where so much does not fit, or tours are more than greetings."""
    what = f"generate {counted(greetings, 'greeting')} and {counted(tours, 'tour')} in {format_seconds(duration)}"
    if not 0 <= tours <= greetings:
        raise Invalid(what, "each tour begins with a greeting", f"{tours} greetings or more")
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
    """The state machine looks ten times a second what is to be done."""
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
    """Seconds with the tries that fail; the last one counts in any case."""
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
    """Goes through the states one after the other, and keeps account of time and battery."""

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
        """So long in standby, and at the dock meanwhile whenever the battery is low."""
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
    """All visits, with these gaps in between, up to the end of the last one."""
    day = _Day(random.Random(f"docks of {seed}"), Battery().full, [(0.0, "start")])
    for gap, visit in zip(gaps, visits, strict=False):
        day.stand(PAUSE + gap * scale)
        for state, seconds in visit:
            day.enter(state, seconds)
    return day


def _last_visit_ends(visits: list[Activity], gaps: list[float], scale: float, seed: int) -> float:
    return _through(visits, gaps, scale, seed).now + gaps[-1] * scale


def _widest(visits: list[Activity], gaps: list[float], duration: float, seed: int) -> float:
    """What to multiply gaps with, to fill the time. 0 is known to fit."""
    fits, too_wide = 0.0, duration / min(gaps)
    for _ in range(60):
        middle = (fits + too_wide) / 2
        if _last_visit_ends(visits, gaps, middle, seed) <= duration:
            fits = middle
        else:
            too_wide = middle
    return fits
