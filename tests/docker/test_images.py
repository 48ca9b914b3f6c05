"""Images on a real engine: parents first, several at once, a failure stops what stands on it and nothing else."""

from __future__ import annotations

import json
import os
import socket
import stat
import subprocess
import threading
import urllib.request
from pathlib import Path

import pytest
from built_images import BOTH, TAG, files_of
from common import BASE_IMAGE, free_port, wait_for
from forwarder import Forwarder
from image_trees import Heard, Place, images, orders_of
from tools import tool

from rorg.errors import Invalid
from rorg.images import buildkit
from rorg.images.build import build, build_log
from rorg.images.context import context_files
from rorg.images.order import Order
from rorg.images.process import ProcessBuilder
from rorg.images.supply import externals
from rorg.model.image_names import plain

# -- order, failures -----------------------------------------------------------------------------------------------


@BOTH
def test_a_failure_stops_its_descendants_and_nothing_else(place, tmp_path):
    catalog = images(
        tmp_path,
        {
            "bad": f"FROM {BASE_IMAGE}\nLABEL a=b\nCOPY nothing-here /x",
            "child": "FROM bad",
            "grandchild": "FROM child:latest",
            "good": f"FROM {BASE_IMAGE}\nLABEL a=b",
            "leaf": "FROM good\nLABEL c=d",
        },
    )
    results = place.build(orders_of(catalog, {BASE_IMAGE}))
    assert {name: r.outcome for name, r in results.items()} == {
        BASE_IMAGE: "present",
        "bad": "failed",
        "child": "skipped",
        "grandchild": "skipped",
        "good": "built",
        "leaf": "built",
    }
    bad = results["bad"]
    assert "COPY nothing-here /x" in bad.step
    assert "nothing-here" in bad.message
    assert "\n" not in bad.message
    assert results["child"].message == results["grandchild"].message == "bad failed"
    assert bad.message in " ".join(Path(bad.log).read_text().split())
    leaf = place.inspect(f"leaf:{TAG}")
    assert results["leaf"].id == leaf["Id"]
    assert sorted(map(plain, leaf["RepoTags"])) == ["leaf", f"leaf:{TAG}"]
    expected = {"c": "d", "rorg.io/image": "leaf", "rorg.io/identity": "0123456789abcdef", "rorg.io/built-by": "test"}
    assert leaf["Config"]["Labels"].items() >= expected.items()
    assert place.has("bad", "child", f"child:{TAG}", "leaf", f"docker.io/library/good:{TAG}", leaf["Id"]) == {
        "leaf",
        f"docker.io/library/good:{TAG}",
        leaf["Id"],
    }


@BOTH
def test_stages_arguments_and_files_of_other_images(place, tmp_path):
    """Each names its parents in another way, and gets those of the identity, whatever the friendly tags mean."""
    stage = "one" if place.podman else "One"  # Podman tells capital letters from small ones
    taken = f"FROM {BASE_IMAGE} AS two\nCOPY --from=one /data /stage"
    catalog = images(
        tmp_path,
        {
            "source": f"FROM {BASE_IMAGE}\nCOPY data /data",
            "staged": f"FROM source AS {stage}\n{taken}\nFROM nothing/there",
            "chosen": "ARG BASE=nothing/there\nFROM ${BASE}\nLABEL x=y",
            "copied": f"FROM {BASE_IMAGE}\nCOPY --from=source:latest /data /copied",
        },
        staged={"target": "two"},
        chosen={"args": {"BASE": "source"}},
    )
    (tmp_path / "source" / "data").write_text("of the identity")
    results = place.build(orders_of(catalog, {BASE_IMAGE}))
    assert {r.outcome for r in results.values()} == {"present", "built"}, results
    for name, path in (("staged", "stage"), ("chosen", "data"), ("copied", "copied")):
        assert files_of(place, f"{name}:{TAG}")[path][1] == b"of the identity", name


def test_mounts_of_other_images_need_buildkit_or_podman(dockerd, place, tmp_path):
    text = f"FROM {BASE_IMAGE}\nRUN --mount=from=given,target=/given read x < /given/data; echo $x > /found"
    catalog = images(tmp_path, {"given": "FROM scratch\nCOPY data /data", "taker": text})
    (tmp_path / "given" / "data").write_text("of the mount\n")
    results = place.build(orders_of(catalog, {BASE_IMAGE}))
    assert results["taker"].outcome == "built", results
    assert files_of(place, f"taker:{TAG}")["found"][1] == b"of the mount\n"
    if place.podman:
        return
    classic = Place(dockerd.host, False, tmp_path / "classic")
    refused = classic.build(orders_of(catalog, {BASE_IMAGE, f"given:{TAG}"}, names=["taker"]))["taker"]
    assert (refused.outcome, refused.message) == ("failed", "Dockerfile needs BuildKit, which is missing")


# -- contexts ------------------------------------------------------------------------------------------------------


@BOTH
def test_what_a_build_sees_of_its_context(place, tmp_path, monkeypatch):
    """Modes and links too; neither what is ignored, nor git's own, nor the Dockerfile that is made of it."""
    catalog = images(tmp_path, {"parent": f"FROM {BASE_IMAGE}", "seeing": "FROM parent\nCOPY . /seen/"})
    context = tmp_path / "seeing"
    for path, text in {
        "a.txt": "a",
        "tool": "run",
        "sub/.git/inner": "kept",
        ".git/HEAD": "x",
        "build/out": "x",
        "build/keep": "k",
        "Readme.md": "upper",
        "readme.md": "lower",
    }.items():
        (context / path).parent.mkdir(parents=True, exist_ok=True)
        (context / path).write_text(text)
    (context / ".dockerignore").write_text("# all of it\nbuild/*\n!build/keep\nreadme.md\n")
    (context / "tool").chmod(0o751)
    (context / "empty").mkdir()
    (context / "empty").chmod(0o711)
    (context / "link").symlink_to("a.txt")
    (context / "dead").symlink_to("/no/where")
    os.mkfifo(context / "pipe")
    with socket.socket(socket.AF_UNIX) as bound:
        monkeypatch.chdir(context)  # a socket's path is short
        bound.bind("socket")
        results = place.build(orders_of(catalog, {BASE_IMAGE}))
    assert results["seeing"].outcome == "built", results
    found = files_of(place, "seeing")
    seen = {path.removeprefix("seen/"): member for path, member in found.items() if path.startswith("seen/")}
    assert seen.keys() == {
        *("a.txt", "tool", "sub", "sub/.git", "sub/.git/inner", "build", "build/keep", "Readme.md"),
        *("empty", "link", "dead", "Dockerfile", ".dockerignore"),
    }
    assert seen["Dockerfile"][1] == b"FROM parent\nCOPY . /seen/"
    assert [stat.S_IMODE(seen[name][0].mode) for name in ("tool", "empty")] == [0o751, 0o711]
    assert seen["tool"][0].uid == 0
    assert (seen["link"][0].linkname, seen["dead"][0].linkname) == ("a.txt", "/no/where")
    assert int(seen["a.txt"][0].mtime) == int((context / "a.txt").stat().st_mtime)


@pytest.mark.parametrize(
    ("lines", "left_out"),
    [
        (["*"], {"a.txt", "b.md", "sub", "sub/a.txt", "sub/deep", "sub/deep/b.md", ".hidden"}),
        (["*.txt"], {"a.txt"}),
        (["*.TXT"], set()),
        (["/a.txt/"], {"a.txt"}),
        (["**/*.txt"], {"a.txt", "sub/a.txt"}),
        (["sub"], {"sub", "sub/a.txt", "sub/deep", "sub/deep/b.md"}),
        (["./sub/deep"], {"sub/deep", "sub/deep/b.md"}),
        (["**/deep"], {"sub/deep", "sub/deep/b.md"}),
        (["sub/**"], {"sub/a.txt", "sub/deep", "sub/deep/b.md"}),
        (["*", "!sub/deep"], {"a.txt", "b.md", "sub", "sub/a.txt", ".hidden"}),
        (["*", "!**/*.md"], {"a.txt", "sub", "sub/a.txt", "sub/deep", ".hidden"}),
        (["sub", "!sub/a.txt"], {"sub", "sub/deep", "sub/deep/b.md"}),
        (["!sub/a.txt", "sub"], {"sub", "sub/a.txt", "sub/deep", "sub/deep/b.md"}),
        (["[ab].*"], {"a.txt", "b.md"}),
        (["[^a].*"], {"b.md"}),
        (["?.m\\d"], {"b.md"}),
        (["a.tx", "b?md*x", "# sub", "", "\\# sub", "."], set()),
    ],
    ids=lambda value: " ".join(sorted(value) if isinstance(value, set) else value),
)
def test_lines_of_dockerignore_mean_what_docker_says(tmp_path, lines, left_out):
    (tmp_path / "sub/deep").mkdir(parents=True)
    for path in ("a.txt", "b.md", "sub/a.txt", "sub/deep/b.md", ".hidden"):
        (tmp_path / path).touch()
    everything = {path for path, _ in context_files(tmp_path, "Dockerfile")}
    (tmp_path / "Dockerfile.dockerignore").write_text("\n".join(["Dockerfile.dockerignore", *lines]))
    (tmp_path / ".dockerignore").write_text("**")
    seen = [path for path, _ in context_files(tmp_path, "Dockerfile")]
    assert everything - set(seen) == left_out
    assert ".dockerignore" in seen or "*" in lines
    assert seen == sorted(seen, key=lambda path: path.split("/"))


@pytest.mark.parametrize("line", ["!", "[a", "[b-a]"])
def test_a_line_that_docker_refuses_is_an_error_with_its_file(tmp_path, line):
    (tmp_path / ".dockerignore").write_text(f"ok\n{line}\n")
    with pytest.raises(OSError, match=r"dockerignore"):
        list(context_files(tmp_path, "Dockerfile"))


# -- several at once -----------------------------------------------------------------------------------------------


MEET = """import socket
with socket.create_connection(("127.0.0.1", {port}), 120) as met: assert met.recv(1) == b"x"
"""


@BOTH
def test_independent_images_are_built_at_once(place, tmp_path):
    """Each waits until the other one is being built too."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.settimeout(120)
        meet = f"FROM {BASE_IMAGE}\nCOPY meet.py /\nRUN python3 -S /meet.py"
        catalog = images(tmp_path, {"left": meet, "right": f"{meet}\n"})
        for name in catalog.images:
            (tmp_path / name / "meet.py").write_text(MEET.format(port=listener.getsockname()[1]) + f"# {name}")

        def answer() -> None:
            for connection in [listener.accept()[0] for _ in catalog.images]:
                connection.sendall(b"x")
                connection.close()

        answering = threading.Thread(target=answer, daemon=True)
        answering.start()
        results = place.build(orders_of(catalog, {BASE_IMAGE}), jobs=2)
        assert {r.outcome for r in results.values()} == {"present", "built"}, results
        answering.join()


def test_one_job_is_one_after_the_other(tmp_path):
    catalog = images(tmp_path / "images", {name: "FROM scratch" for name in "abcdef"})
    heard, state = Heard(), tmp_path
    orders = orders_of(catalog, set())
    build(orders, lambda: ProcessBuilder(state), jobs=1, clock=lambda: 0.0, listener=heard)
    assert [word for word, *_ in heard.all] == ["began", "ended"] * len(orders)


def test_what_is_there_costs_nothing(tmp_path):
    catalog = images(tmp_path, {"parent": "FROM elsewhere/base:1", "child": "FROM parent"})
    everything = orders_of(catalog, {f"parent:{TAG}", f"child:{TAG}", "elsewhere/base:1"})
    assert [o.reference for o in everything] == [f"child:{TAG}", f"parent:{TAG}"], "not what these stand on"

    def never() -> ProcessBuilder:
        raise AssertionError("nothing is to be done")

    heard = Heard()
    results = build(everything, never, jobs=4, clock=lambda: 0.0, listener=heard)
    assert {r.outcome for r in results} == {"present"}
    assert heard.all == [("ended", o.reference, "present") for o in everything]


@BOTH
def test_what_is_stopped_ends_and_nothing_more_begins(place, tmp_path):
    sleep = f"FROM {BASE_IMAGE}\nRUN python3 -S -c 'import time; time.sleep(600)'"
    catalog = images(tmp_path, {"slow": sleep, "slower": f"{sleep}\nLABEL a=b", "child": "FROM slow"})
    stop = threading.Event()

    def wait_and_stop() -> None:
        wait_for(lambda: any("time.sleep" in text for _, _, text in place.heard.all))
        stop.set()

    threading.Thread(target=wait_and_stop, daemon=True).start()
    results = place.build(orders_of(catalog, {BASE_IMAGE}), jobs=1, stop=stop)
    found = {name: (r.outcome, r.message) for name, r in results.items() if name != BASE_IMAGE}
    assert found.pop("slow") == ("failed", "stopped")
    assert set(found.values()) == {("skipped", "stopped")}
    wait_for(lambda: not place.running(), 60, "the engine to end what it runs")


def test_a_builder_that_is_broken_is_a_failure_like_others(tmp_path):
    class Broken(ProcessBuilder):
        def build(self, order, say):
            if order.name == "bad":
                raise ZeroDivisionError("of a line")
            return super().build(order, say)

    catalog = images(tmp_path / "images", {"bad": "FROM scratch", "child": "FROM bad", "good": "FROM scratch"})
    results = build(orders_of(catalog, set()), lambda: Broken(tmp_path), jobs=2, clock=lambda: 0.0, listener=Heard())
    assert {r.reference.partition(":")[0]: (r.outcome, r.message) for r in results} == {
        "bad": ("failed", "internal error: ZeroDivisionError: of a line"),
        "child": ("skipped", "bad failed"),
        "good": ("built", ""),
    }


def test_images_that_stand_on_each_other_are_refused(tmp_path):
    orders = [Order("a", below=("b",)), Order("b", below=("a",))]
    with pytest.raises(Invalid, match=r"(a -> b -> a|b -> a -> b)"):
        build(orders, lambda: ProcessBuilder(tmp_path), jobs=1, clock=lambda: 0.0, listener=Heard())


# -- logs, secrets -------------------------------------------------------------------------------------------------


@BOTH
def test_values_of_arguments_are_in_no_line_that_is_shown_and_in_no_command_line(place, tmp_path):
    text = f"FROM {BASE_IMAGE}\nARG KEY\nARG PATH_IN\nCOPY data /$PATH_IN/\nRUN echo said-$KEY && exit 3"
    arguments = {"KEY": "s3cret-value", "PATH_IN": "hidden-name"}
    catalog = images(tmp_path, {"secret": text}, secret={"args": arguments})
    (tmp_path / "secret" / "data").write_text("x")
    result = place.build(orders_of(catalog, {BASE_IMAGE}))["secret"]
    assert result.outcome == "failed"
    assert "RUN" in result.step
    told = repr((place.heard.all, result.step, result.message))
    assert "s3cret" not in told
    assert "hidden-name" not in told
    log = Path(result.log)
    assert "said-s3cret-value" in log.read_text()
    assert stat.S_IMODE(log.stat().st_mode) == 0o600
    order = orders_of(catalog, {BASE_IMAGE})[-1]
    line, variables = buildkit.command_line(order, order.image, tmp_path)
    assert "s3cret-value" not in " ".join(line)
    assert variables == arguments


def test_the_last_logs_of_each_image_are_kept(tmp_path):
    catalog = images(tmp_path / "images", {"a": "FROM scratch", "a-b": "FROM scratch"})
    for number in range(7):
        for order in orders_of(catalog, set(), identity=f"{number}" * 64):
            with build_log(tmp_path / "builds", order) as log:
                log("text")
    found = sorted(path.name for path in (tmp_path / "builds").iterdir())
    assert found == [f"{name}-{str(n) * 12}.log" for name in ("a", "a-b") for n in range(2, 7)]


# -- imports and pulls ---------------------------------------------------------------------------------------------


TAR = (
    "import sys, tarfile; tar = tarfile.open(fileobj=sys.stdout.buffer, mode='w|'); tar.add('{}', 'data'); tar.close()"
)


@pytest.mark.smoke
def test_an_import_is_labelled_and_one_that_fails_leaves_nothing(place, tmp_path):
    (tmp_path / "data").write_text("imported")
    script = TAR.format(tmp_path / "data")
    commands = {"whole": ("python3", "-c", script), "broken": ("python3", "-c", f"{script}; sys.exit('disk is full')")}
    catalog = images(
        tmp_path / "images",
        {name: "FROM scratch" for name in commands},
        **{name: {"context": None, "import_command": command} for name, command in commands.items()},
    )
    before = len(place.engine.client.get("/images/json"))
    results = place.build(orders_of(catalog, set()))
    assert {name: r.outcome for name, r in results.items()} == {"whole": "imported", "broken": "failed"}, results
    assert results["broken"].message == "disk is full"
    assert len(place.engine.client.get("/images/json")) == before + 1
    assert place.inspect("whole")["Config"]["Labels"]["rorg.io/identity"] == "0123456789abcdef"
    assert place.inspect(f"whole:{TAG}")["Id"] == results["whole"].id
    assert files_of(place, "whole")["data"][1] == b"imported"


@pytest.fixture
def registry(tmp_path):
    """A registry on the loopback, which the engine takes for a trusted one: (its address, its process)."""
    program = tool("docker-registry")
    address, config = f"127.0.0.1:{free_port()}", tmp_path / "registry.json"
    storage = {"filesystem": {"rootdirectory": str(tmp_path / "registry")}}
    config.write_text(json.dumps({"version": 0.1, "storage": storage, "http": {"addr": address}}))
    process = subprocess.Popen([program, "serve", config], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    wait_for(lambda: answers(address), 60, "the registry")
    yield address, process
    process.kill()
    process.wait()


def answers(address: str) -> bool:
    host, _, port = address.partition(":")
    with socket.socket() as asking:
        return asking.connect_ex((host, int(port))) == 0


def pushed_digest(address: str, repository: str, tag: str) -> str:
    kinds = "application/vnd.docker.distribution.manifest.v2+json, application/vnd.oci.image.manifest.v1+json"
    asked = urllib.request.Request(f"http://{address}/v2/{repository}/manifests/{tag}", headers={"Accept": kinds})
    with urllib.request.urlopen(asked, timeout=20) as answer:
        return answer.headers["Docker-Content-Digest"]


def test_bases_are_pulled_and_without_the_registry_what_is_here_is_enough(place, registry, tmp_path):
    address, process = registry
    base, api = f"{address}/team/base:1", place.engine.api()
    made = place.build(orders_of(images(tmp_path / "base", {"small": "FROM scratch\nLABEL v=1"}), set()))["small"]
    place.builder().tag(made.id, base)
    pushed = [json.loads(line) for line in api.push(base).splitlines()]
    assert not [line for line in pushed if "error" in line]
    api.remove_image(base)
    catalog = images(tmp_path, {"on": f"FROM {base}\nLABEL w=1"})
    results = place.build(orders_of(catalog, set()))
    assert {name: r.outcome for name, r in results.items()} == {base: "pulled", "on": "built"}
    assert results[base].id == pushed_digest(address, "team/base", "1")
    process.kill()
    process.wait()
    results = place.build(orders_of(catalog, {base}, identity="fedcba9876543210", pull=True, cache=False))
    assert (results[base].outcome, results["on"].outcome) == ("present", "built")
    assert "cannot be pulled" in results[base].message
    missing = images(
        tmp_path, {"lost": f"FROM {address}/team/other", "child": "FROM lost", "other": "FROM scratch\nLABEL a=b"}
    )
    found = {name: r.outcome for name, r in place.build(orders_of(missing, set())).items()}
    assert found == {f"{address}/team/other": "failed", "lost": "skipped", "child": "skipped", "other": "built"}
    api.remove_image(base)
    api.close()


@BOTH
def test_the_engine_may_be_on_another_machine(place, dockerd, tmp_path):
    forwarder = Forwarder(dockerd.host)
    try:
        there = Place(forwarder.host, place.buildkit, tmp_path / "builds")
        catalog = images(tmp_path, {"sent": "FROM scratch\nCOPY data /data"})
        (tmp_path / "sent" / "data").write_bytes(os.urandom(3 << 20))
        assert there.build(orders_of(catalog, set()))["sent"].outcome == "built"
        assert files_of(place, "sent")["data"][1] == (tmp_path / "sent" / "data").read_bytes()
        there.close()
    finally:
        forwarder.close()


def test_the_docker_command_is_told_nothing_of_the_users_configuration(monkeypatch):
    monkeypatch.setenv("DOCKER_CONFIG", "/home/somebody/.docker")
    monkeypatch.setenv("DOCKER_CONTEXT", "elsewhere")
    monkeypatch.delenv("DOCKER_TLS_VERIFY", raising=False)
    found = buildkit.environment("http+unix:///run/docker.sock", "/tmp/x")
    assert found == {
        "PATH": os.environ["PATH"],
        "HOME": "/tmp/x",
        "DOCKER_CONFIG": "/tmp/x",
        "DOCKER_HOST": "unix:///run/docker.sock",
        "DOCKER_BUILDKIT": "1",
    }
    monkeypatch.setenv("DOCKER_TLS_VERIFY", "1")
    monkeypatch.setenv("DOCKER_CERT_PATH", "/certificates")
    found = buildkit.environment("tcp://robot:2376", "/tmp/x")
    assert (found["DOCKER_HOST"], found["DOCKER_CERT_PATH"]) == ("tcp://robot:2376", "/certificates")


# -- orders --------------------------------------------------------------------------------------------------------


def test_what_is_there_is_built_again_only_where_it_is_named_and_nothing_kept_may_be_used(tmp_path):
    text = "FROM parent:latest\nCOPY --from=out/tools /a /b"
    catalog = images(tmp_path, {"parent": "FROM out/base:1", "child": text})
    there = {f"parent:{TAG}", f"child:{TAG}", "out/tools"}
    assert [o.there for o in orders_of(catalog, there, names=["child"])] == [True]
    parent, tools, child = orders_of(catalog, there, names=["child"], cache=False, pull=True)
    assert (parent.reference, parent.there, parent.cache) == (f"parent:{TAG}", True, True)
    assert (tools.reference, tools.there, tools.pull) == ("out/tools", True, True)
    assert (child.there, child.cache, child.also) == (False, False, ("child",))
    assert child.below == (f"parent:{TAG}", "out/tools")
    assert child.replacements == {"parent:latest": f"parent:{TAG}"}
    lost, _ = orders_of(catalog, set(), names=["parent"], pull=True)
    assert (lost.reference, lost.image, lost.there, lost.pull) == ("out/base:1", None, False, False)
    assert externals(catalog, ["child", "out/more"]) == {"out/base:1", "out/tools", "out/more"}
