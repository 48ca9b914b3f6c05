"""What rorg needs of an engine for networks, volumes and images; see tests/support/engine_needs.py."""

from __future__ import annotations

import io
import os
import threading

import pytest
from common import BASE_IMAGE, wait_for
from engine_needs import IGNORED, OUT, Bench, Need
from image_trees import Place, images, orders_of

from rorg.core.observed import LABEL_OWNER
from rorg.engines.docker.engine import DockerEngine
from rorg.engines.log_lines import Reading
from rorg.images import buildkit
from rorg.images.docker import DockerBuilder

NO_IMAGES = "no: an image is only a name"


def networks(bench: Bench) -> str:
    """Make networks, and join two of them"""
    engine = bench.engine
    if not isinstance(engine, DockerEngine):
        return IGNORED
    names = [f"needs{os.getpid()}{letter}" for letter in "ab"]
    labels = {LABEL_OWNER: engine.owner, "rorg.io/network": "needs"}
    try:
        for name in names:
            engine.make_object("network", name, {"internal": True}, labels)
        container = bench.made(networks={name: {} for name in names})
        assert set(bench.look(container).networks) == set(names)
        assert engine.inspect(container)
        engine.remove(container)
    finally:
        for name in names:
            engine.remove_object("network", name)
    assert not engine.find_objects(()).found
    return ""


def volumes(bench: Bench) -> str:
    """Keep volumes, also unnamed ones, over a new container"""
    engine = bench.engine
    if not isinstance(engine, DockerEngine):
        return IGNORED
    name = f"needs{os.getpid()}"
    labels = {LABEL_OWNER: engine.owner, "rorg.io/volume": "needs"}
    engine.make_object("volume", name, {}, labels)
    mounted = [f"{name}:/named", "/unnamed"]
    write = "for p in ('/named/a', '/unnamed/a'): open(p, 'a').write('x')\n"
    read = write + "print(*[len(open(p).read()) for p in ('/named/a', '/unnamed/a')])"
    first = bench.started([*OUT, write], volumes=mounted)
    bench.becomes(first, "exited")
    second = bench.made([*OUT, read], first, volumes=mounted)
    engine.remove(first)
    engine.start(second)
    assert bench.output(second) == "2 2\n"
    engine.remove(second, volumes=True)
    engine.remove_object("volume", name)
    assert not engine.find_objects(()).found
    return ""


def object_events(bench: Bench) -> str:
    """Tell at once when a network or volume comes or goes"""
    engine = bench.engine
    if not isinstance(engine, DockerEngine):
        return IGNORED
    reading, heard, name = Reading(), list[int](), f"needs{os.getpid()}e"

    def listen() -> None:
        for _ in engine.object_events(reading):
            heard.append(1)

    threading.Thread(target=listen, daemon=True).start()
    wait_for(lambda: heard, 20)
    labels = {LABEL_OWNER: engine.owner, "rorg.io/volume": "needs"}
    for act in (
        lambda: engine.make_object("volume", name, {}, labels),
        lambda: engine.remove_object("volume", name),
    ):
        count = len(heard)
        act()
        wait_for(lambda count=count: len(heard) > count, 20)
    reading.set()
    return ""


def build(bench: Bench) -> str:
    """Build an image"""
    return built(bench, False)


def build_by_buildkit(bench: Bench) -> str:
    """Build an image by BuildKit"""
    engine = bench.engine
    if isinstance(engine, DockerEngine) and engine.client.release.podman:
        assert not DockerBuilder(engine)._buildkit()
        return "no: its own builder"
    if isinstance(engine, DockerEngine) and not buildkit.find_command():
        pytest.fail("no docker command with BuildKit is installed")
    return built(bench, True)


def built(bench: Bench, better: bool) -> str:
    engine = bench.engine
    if not isinstance(engine, DockerEngine):
        return NO_IMAGES
    place = Place(engine.address, better, bench.folder / "builds")
    try:
        catalog = images(bench.folder, {"needs": f"FROM {BASE_IMAGE}\nRUN echo built > /built\n"})
        order = next(o for o in orders_of(catalog, {BASE_IMAGE}) if o.name == "needs")
        assert [r.outcome for r in place.build([order]).values()] == ["built"], place.heard.all
        assert any("RUN" in text for word, _, text in place.heard.all if word == "step")
        assert place.has(order.reference)
        container = bench.started([*OUT, "print(open('/built').read(), end='')"], image=order.reference)
        assert bench.output(container) == "built\n"
        engine.remove(container)
    finally:
        place.close()
    assert not place.has(order.reference)
    return ""


def tags(bench: Bench) -> str:
    """Tag, save, remove and load an image"""
    engine = bench.engine
    if not isinstance(engine, DockerEngine):
        return NO_IMAGES
    builder, name = DockerBuilder(engine), f"needs-tagged:{os.getpid()}"
    builder.tag(BASE_IMAGE, name)
    assert builder.digest(name)
    with engine.save_images([name]) as blocks:
        archive = io.BytesIO(b"".join(blocks))
    engine.remove_image(name)
    assert engine.missing_images([name]) == {name}
    assert engine.load_images(archive) == 1
    assert not engine.missing_images([name])
    engine.remove_image(name)
    return ""


def disk_usage(bench: Bench) -> str:
    """Tell how much of the disk each image takes"""
    engine = bench.engine
    if not isinstance(engine, DockerEngine):
        return NO_IMAGES
    assert max(int(row["Size"]) for row in engine.images()) > 1 << 20
    return ""


OBJECTS: tuple[Need, ...] = (networks, volumes, object_events, build, build_by_buildkit, tags, disk_usage)
