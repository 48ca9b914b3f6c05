"""What happens under memory pressure and to images, and commands that are killed themselves."""

from __future__ import annotations

from typing import Any

import yaml
from common import BASE_IMAGE
from proof.acts import Acts as World
from proof.given import BASE, always, declared, running, scenario, service, settled
from proof.tree_scenarios import later_request, second_commit

GIB = 1 << 30
PRESSURE = {"policy": {"pressure": {"step": "100ms", "calm": "300ms", "high": 0.9, "low": 0.8}}}
DOCKERFILE = "FROM {base}\nLABEL edition={edition}\n"
COMPOSE = """\
services:
  nav: {image: x, command: [sleep, "1"], secrets: [token]}
  lidar: {image: y, build: {dockerfile_inline: "FROM z"}}
secrets: {token: {environment: HOME}}
"""


# -- shedding ------------------------------------------------------------------------------------------------------


def crowd(world: World) -> None:
    world.loaded = True
    world.engine.sim.needs.update({name: (0.0, GIB) for name in ("high", "low")})
    high, low = service(priority=90, protected=True), service(priority=20)
    world.declare({"high": high, "low": low}, policies=PRESSURE)


scenario(
    "shedding",
    settled(crowd, lambda w: w.request("all", "high", "low"), running("high", "low")),
    lambda w: w.load(6 * GIB),
    lambda w: w.until(high="running", low="exited"),
    lambda w: w.load(1 * GIB),
    running("high", "low"),
)


# -- images --------------------------------------------------------------------------------------------------------


def write_image(world: World, edition: int) -> None:
    folder = world.tree / "images/cam"
    folder.mkdir(parents=True, exist_ok=True)
    spec = {"context": "./cam"}
    manifest = {"apiVersion": "rorg/v1", "kind": "Image", "metadata": {"name": "cam"}, "spec": spec}
    (folder.parent / "cam.yaml").write_text(yaml.safe_dump(manifest))
    (folder / "Dockerfile").write_text(DOCKERFILE.format(base=BASE_IMAGE, edition=edition))


def with_image(world: World) -> None:
    if not world.images:
        world.images = True
        world.engine.images.build_image(BASE_IMAGE, {}, "")
    write_image(world, 1)
    policies = {"robot": {"images": {"keep": 1}}}
    world.declare({"base": BASE, "cam": always(image="cam", needs=["base"])}, policies=policies)


def next_image(world: World) -> None:
    write_image(world, 2)
    world.when_alive(world._served, "the API")
    world.reread()


def has_edition(number: int):
    """Wait until its only container is made from this edition of the image."""

    def look(world: World) -> bool:
        image = next((world.engine.images.find(world.engine.made_from[c.id]) for c in world.containers("cam")), None)
        alive = [c.state for c in world.containers("cam")] == ["running"]
        return alive and image is not None and f"edition={number}" in image.text

    return lambda world: world.when_alive(lambda: look(world), f"cam is not of edition {number}")


def given_image(world: World) -> None:
    """The service is added by the first step."""
    world.images = True
    world.engine.images.build_image(BASE_IMAGE, {}, "")
    world.declare({"base": BASE})


scenario("image-build", settled(given_image, running("base")), with_image, running("base", "cam"))
scenario("image-update", settled(with_image, running("cam")), next_image, has_edition(2))


def two_editions(world: World) -> None:
    settled(with_image, running("cam"), next_image, has_edition(2))(world)


scenario(
    "prune",
    two_editions,
    lambda w: w.killed_command("image", "prune", "--yes", "--engine", "docker"),
    command=True,
)
scenario(
    "image-save",
    two_editions,
    lambda w: w.out.mkdir(exist_ok=True),
    lambda w: w.killed_command("image", "save", str(w.out / "images.tar"), "cam", "--engine", "docker"),
    command=True,
)


# -- commands that write files ---------------------------------------------------------------------------------------


def with_password(text: str) -> dict[str, Any]:
    """Its secret is exported into a file of its own."""
    return always(secrets=["PASSWORD"], container={"environment": {"PASSWORD": text}})


def with_export(world: World) -> None:
    """A tree that was exported when it was another one."""
    world.out.mkdir(exist_ok=True)
    settled(declared(base=with_password("one")), running("base"))(world)
    export(world)
    world.declare({"base": with_password("two"), "cam": service()})


def export(world: World) -> None:
    world.killed_command("export", "compose", str(world.tree), "--output", str(world.out / "compose.yaml"), "--force")


def with_project(world: World) -> None:
    (world.out / "project").mkdir(parents=True)
    (world.out / "project/compose.yaml").write_text(COMPOSE)
    settled(declared(base=BASE), running("base"))(world)


def take_over(world: World, *more: str) -> None:
    files = [str(world.out / "project/compose.yaml"), "--output", str(world.out / "manifests")]
    world.killed_command("import", "compose", *files, *more)


def imported(world: World) -> None:
    """As somebody does it who looks whether the first attempt has succeeded."""
    if not (world.out / "manifests").exists():
        take_over(world)


def with_manifests(world: World) -> None:
    with_project(world)
    take_over(world)
    (world.out / "project/compose.yaml").write_text(COMPOSE.replace("image: x", "image: changed"))


scenario("export", with_export, export, command=True)
scenario("import", with_project, imported, command=True)
scenario("import-over", with_manifests, lambda w: take_over(w, "--force"), command=True)


# -- commands that go back -------------------------------------------------------------------------------------------


def roll_back(world: World) -> None:
    world.killed_command("rollback", "1", "--yes")


def restore(world: World) -> None:
    world.doubtful["look"] = [None]
    world.killed_command("restore", "--at", "1", "--yes")
    world.asked["look"] = world.doubtful.pop("look")[0]


scenario("rollback-killed", second_commit, roll_back, lambda w: w.changed("base"), command=True)
scenario(
    "restore-killed",
    later_request,
    restore,
    lambda w: w.changed("base"),
    lambda w: w.until(cam="exited"),
    command=True,
)
