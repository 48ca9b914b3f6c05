"""Writes workload.yaml: the weights of the evaluation, by a rule that does not look at results.

1. In use, a service takes what its manifest says (`resources`). The sum over all services that can run together is
   3.58 cores and 3.41 GB: the all-on totals that the Rorg paper gives for its robot. The division among the services is
   our assumption; the paper publishes no figure of a single service.
2. The CPU of a running service that nobody uses depends only on the class of its program: a program that works at the
   rate of a sensor or a clock continues (all of it), a program that waits for work idles (a tenth).
3. An idle program, or a paused one, gives back no memory.
4. The start time depends on the class, too. CPU varies by a tenth from run to run, times by a fifth.

`python docs/evaluation/weights.py` writes the file again.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from rorg.manifest.load import load_or_raise

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
FILE = HERE / "workload.yaml"
SPREAD_OF_CPU, SPREAD_OF_TIMES = 0.1, 0.2


@dataclass(frozen=True)
class Class:
    """A class of programs. `idle`: the part of its CPU that an unused program takes; `start`: seconds."""

    about: str
    idle: float
    start: float
    services: tuple[str, ...]


CLASSES = {
    "driver": Class(
        "reads a device or moves one, at the device's rate",
        1.0,
        2.0,
        (
            *("freight_base", "imu_patch", "back_laser", "head_laser", "head_laser_servo", "enable_aux_breaker_1"),
            *("teleop", "usb_cam", "microphone", "estop_server"),
        ),
    ),
    "perception": Class(
        "works on whatever a sensor delivers",
        1.0,
        3.0,
        (
            *("openface_client", "openface_server", "ros_face_recognition_client", "snowboy", "leg_tracker"),
            *("laser_repub", "cartographer", "cartographer_localization", "usbcam_grpc"),
        ),
    ),
    "planner": Class("computes once it has a goal", 0.1, 3.0, ("navigation", "navigation_route", "behavioral")),
    "server": Class(
        "answers when it is asked",
        0.1,
        1.0,
        (
            *("face_db", "human_db", "traffic_control_server", "gcloud_speech_action_server", "ros_speak_text"),
            *("ros_face_train_controller", "text_to_audio_server", "dialogue_report"),
        ),
    ),
    "logger": Class(
        "records by the clock, or what passes by",
        1.0,
        1.0,
        (
            *("cogrob_rosbag", "docker_stats_logger", "psutil_stats_logger", "auto_dock_logging"),
            *("gcloud_speech_logging", "speak_text_logging", "ros_wakeword_logging"),
        ),
    ),
    "ui": Class("is looked at by people", 0.1, 1.0, ("portainer", "ros_trigger_ui")),
    "infrastructure": Class("holds the others together", 1.0, 1.0, ("roscore", "cogrob_robot_state_provider")),
}
"""Every service is in one class."""


def text() -> str:
    """The text of workload.yaml."""
    services = load_or_raise(ROOT / "manifests").services
    classes = {name: kind for kind, one in CLASSES.items() for name in one.services}
    assert sorted(classes) == sorted(n for n, s in services.items() if not s.meta), "each service has one class"
    rule = "\n".join(f"# {line}".rstrip() for line in (__doc__ or "").splitlines())
    lines = [rule, "", "apiVersion: rorg/v1", "kind: Workload", "metadata:", "  name: tour-guide"]
    lines += ["  description: Synthetic weights by class of program; nothing of them was measured.", "spec:"]
    lines += ["  classes:"]
    for kind, one in CLASSES.items():
        start = f"{{mean: {one.start:g}s, deviation: {SPREAD_OF_TIMES * one.start:g}s}}"
        lines.append(f"    {kind}: {{start: {start}}}   # {one.about}; idle it takes {one.idle:g} of its CPU")
    lines.append("  services:")
    for name in sorted(classes):
        cpu, kind = services[name].cpu, classes[name]
        uses = [f"{when}: {_cores(cpu * part)}" for when, part in (("active", 1.0), ("idle", CLASSES[kind].idle))]
        lines.append(f"    {name}: {{class: {kind}, cpu: {{{', '.join(uses)}}}}}")
    return "\n".join(lines) + "\n"


def _cores(mean: float) -> str:
    return f"{{mean: {mean:g}, deviation: {SPREAD_OF_CPU * mean:g}}}"


if __name__ == "__main__":
    FILE.write_text(text(), encoding="utf-8")
