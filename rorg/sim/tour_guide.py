"""The tour guide's day as a state machine: what each state requests, how long it lasts, what the battery does.

The states and their order are those of the Rorg paper (ICRA 2019, figure 4), their services those of TritonBot. Limits
such as 15 s of listening are TritonBot's; how values spread below them, and the battery, are assumptions: no record of
a real day was published.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

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
