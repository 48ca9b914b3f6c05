"""What happens on a robot, each as a short function.

Missing: shedding (the sim engine uses nothing of this machine, so there is no load to shed), retention (which waits for
a thousand changes), image builds and prunes (they need an engine with images), `rorg restore` and rollback by the
command (here the commit that they make is made by git).
"""

from __future__ import annotations

from typing import Any

from acts import Acts as World
from cases import Scenario, Step

PROBE = {"exec": ["sh", "-c", "true"], "interval": "100ms", "timeout": "2s"}
NO = {"exec": ["sh", "-c", "false"], "interval": "100ms", "timeout": "200ms"}
SCENARIOS: dict[str, Scenario] = {}


def service(**spec: Any) -> dict[str, Any]:
    """A service with a probe, whose changes are proven soon."""
    return {"ready": PROBE, "update": {"bake": "100ms"}, **spec}


def always(**spec: Any) -> dict[str, Any]:
    return service(always_on=True, **spec)


def edition(number: int) -> dict[str, Any]:
    """Options that make another container."""
    return {"container": {"environment": {"EDITION": str(number)}}}


def declared(**services: dict[str, Any]) -> Step:
    return lambda world: world.declare(services)


def running(*names: str) -> Step:
    return lambda world: world.until(**dict.fromkeys(names, "running"))


def settled(*first: Step) -> Step:
    """A world in which rorg has run until nothing was left to do."""

    def given(world: World) -> None:
        declare, *rest = first
        declare(world)
        world.start()
        for step in rest:
            step(world)
        world.rest()

    return given


def scenario(name: str, given: Step, *steps: Step, ends: bool = False) -> None:
    SCENARIOS[name] = Scenario(name, given, steps, ends)


BASE, ARM = always(), always(needs=["base"])

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


def in_git(world: World) -> None:
    world.declare({"base": BASE, "cam": service()})
    for words in (["init", "-q"], ["add", "-A"], ["commit", "-qm", "all"]):
        world.git(*words)


scenario(
    "manifest-put",
    settled(in_git),
    lambda w: w.put_manifest("base", "always_on: true", "container: {environment: {EDITION: two}}\n  always_on: true"),
    lambda w: w.changed("base"),
)
scenario("manifest-delete", settled(in_git), lambda w: w.delete_manifest("cam"))


def second_commit(world: World) -> None:
    in_git(world)
    world.start()
    world.until(base="running")
    world.rest()
    world.declare({"base": always(**edition(2)), "cam": service()})
    world.git("commit", "-qam", "second")
    world.when_alive(lambda: len(world.containers("base")) == 2, "a successor")
    world.when_alive(lambda: len(world.containers("base")) == 1, "only the successor")
    world.rest()


scenario("rollback", second_commit, lambda w: w.git_back(), lambda w: w.changed("base"))


def followed(world: World) -> None:
    world.declare({"base": BASE})
    world.tree.rename(world.upstream)
    for words in (["init", "-q"], ["add", "-A"], ["commit", "-qm", "all"]):
        world.git(*words, folder=world.upstream)
    world.tree.mkdir()
    world.options = ("--git", str(world.upstream), "--poll", "1m")
    world.start()
    world.until(base="running")
    world.rest()


scenario(
    "git-fetch",
    followed,
    lambda w: w.commit_upstream(
        "base", "always_on: true", "always_on: true\n  container: {environment: {EDITION: two}}"
    ),
    lambda w: w.changed("base"),
)
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
