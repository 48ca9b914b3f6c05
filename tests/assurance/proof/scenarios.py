"""What happens on a robot, each as a short declaration: what is requested, changed, restarted, taken down.

See tree_scenarios.py for manifests in git and for the history, command_scenarios.py for memory pressure, images, and
commands that are killed themselves.
"""

from __future__ import annotations

from proof import (
    command_scenarios,  # noqa: F401 - these add their own
    tree_scenarios,  # noqa: F401
)
from proof.acts import Acts as World
from proof.given import ARM, BASE, NO, SCENARIOS, always, declared, edition, running, scenario, service, settled

scenario("first-apply", declared(base=BASE, arm=ARM, cam=always(needs=["arm"])), running("base", "arm", "cam"))
scenario(
    "request",
    settled(declared(base=service(), cam=service(needs=["base"]))),
    lambda w: w.request("look", "cam"),
    running("base", "cam"),
)
scenario(
    "replaced-request",
    settled(declared(map=service(), cam=service()), lambda w: w.request("look", "cam"), running("cam")),
    lambda w: w.request("look", "map"),
    lambda w: w.until(cam="exited", map="running"),
)
scenario(
    "release",
    settled(
        declared(base=service(), cam=service(needs=["base"])),
        lambda w: w.request("look", "cam"),
        running("cam", "base"),
    ),
    lambda w: w.release("look"),
    lambda w: w.until(cam="exited", base="exited"),
)
scenario(
    "pause",
    settled(
        declared(cam=service(idle={"action": "pause"}), map=service()),
        lambda w: w.request("look", "cam"),
        running("cam"),
    ),
    lambda w: w.release("look"),
    lambda w: w.until(cam="paused"),
    lambda w: w.request("again", "cam", "map"),
    running("cam", "map"),
)


def idle_remove(world: World) -> None:
    world.gone.add("cam")
    world.declare({"cam": service(idle={"action": "remove"})})


scenario(
    "idle-remove",
    settled(idle_remove, lambda w: w.request("look", "cam"), running("cam")),
    lambda w: w.release("look"),
    lambda w: w.until(cam="gone"),
)
scenario(
    "lease",
    settled(declared(cam=service())),
    lambda w: w.request("look", "cam", ttl="300ms"),
    lambda w: w.until(cam="exited"),
)
scenario(
    "replacement",
    settled(declared(base=BASE, arm=ARM), running("base", "arm")),
    declared(base=always(**edition(2)), arm=ARM),
    lambda w: w.changed("base"),
)
scenario(
    "failed-update",
    settled(declared(base=BASE, arm=ARM), running("base", "arm")),
    declared(base=always(**edition(2), ready=NO), arm=ARM),
    lambda w: w.refused("base"),
)
scenario(
    "atomic-update",
    settled(declared(**{n: always(update={"bake": "100ms", "atomic": "nav"}) for n in ("map", "nav")})),
    declared(**{n: always(**edition(2), update={"bake": "100ms", "atomic": "nav"}) for n in ("map", "nav")}),
    lambda w: w.changed("map"),
    lambda w: w.changed("nav"),
)
scenario(
    "live-update",
    settled(declared(base=always(container={"mem_limit": "64Mi"})), running("base")),
    declared(base=always(container={"mem_limit": "96Mi"})),
    lambda w: w.when_alive(lambda: "100663296" in str([c.live for c in w.containers("base")]), "the limit is set"),
)


def renamed(world: World) -> None:
    world.gone.add("cam")
    world.declare({"camera": always(), "base": BASE})


scenario(
    "rename",
    settled(declared(cam=always(), base=BASE), running("cam", "base")),
    renamed,
    lambda w: w.until(camera="running", cam="gone"),
)


def removed(world: World) -> None:
    world.gone.add("cam")
    world.declare({"base": BASE})


scenario(
    "removal",
    settled(declared(cam=always(), base=BASE), running("cam", "base")),
    removed,
    lambda w: w.until(cam="gone"),
)
scenario(
    "withheld-removal",
    settled(
        declared(cam=service(), base=BASE),
        lambda w: w.request("look", "cam"),
        running("cam", "base"),
    ),
    declared(base=BASE),
    lambda w: w.withheld("cam"),
    declared(cam=service(), base=BASE),
    running("cam"),
)
scenario(
    "emptied-tree",
    settled(declared(base=BASE), running("base")),
    lambda w: w.declare({}, policies={"policy": {"resync": "1m"}}),
    lambda w: w.withheld("base"),
    lambda w: w.crash("base"),
    running("base"),
    declared(base=BASE),
)
scenario(
    "spreading-restart",
    settled(
        declared(base=BASE, arm=always(needs=[{"service": "base", "restart": True}])),
        running("base", "arm"),
    ),
    lambda w: w.restart("base", "arm"),
)
scenario(
    "preemption",
    settled(
        declared(low=service(exclusive=["gpu"], priority=20), high=service(exclusive=["gpu"], priority=80)),
        lambda w: w.request("one", "low"),
        running("low"),
    ),
    lambda w: w.request("two", "high"),
    running("high"),
    lambda w: w.release("two"),
    lambda w: w.until(high="exited", low="running"),
)
scenario(
    "hold",
    settled(declared(base=BASE, arm=ARM), running("base", "arm")),
    lambda w: w.call("PUT", "/v1/holds/arm", {"duration": "1h", "force": True}),
    lambda w: w.until(arm="exited"),
    lambda w: w.call("DELETE", "/v1/holds/arm"),
    running("arm"),
)
scenario(
    "crash",
    settled(declared(base=BASE, arm=ARM), running("base", "arm")),
    lambda w: w.crash("arm"),
    running("base", "arm"),
)
scenario(
    "hand-edit",
    settled(declared(map=service(), cam=service()), lambda w: w.request("look", "cam"), running("cam")),
    lambda w: w.edit_requests("look", "map"),
    lambda w: w.until(cam="exited", map="running"),
)


def with_network(world: World) -> None:
    services = {"base": always(container={"networks": ["lan"]})}
    world.declare(services, networks={"lan": {}}, volumes={"maps": {}})


scenario("objects", with_network, running("base"))


scenario(
    "down",
    settled(
        declared(base=BASE, arm=ARM, cam=service()),
        running("base", "arm"),
        lambda w: w.request("look", "cam"),
        running("cam"),
    ),
    lambda w: w.down(),
    ends=True,
)

ALL = SCENARIOS
