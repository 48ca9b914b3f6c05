"""Secrets: what manifests declare as such, and what comes from files of variables, is shown and recorded nowhere."""

from __future__ import annotations

import json
import os
import subprocess
import urllib.parse
from pathlib import Path

import commands
import pytest
import rorg_client
import yaml
from common import BASE_IMAGE, wait_for
from image_trees import images, orders_of
from robots import WORK, write_tree
from tools import tool

from rorg.core.diff import declared_now, difference
from rorg.core.digest import canonical, declared_fields, digest
from rorg.core.masking import MASK, Masker
from rorg.core.observed import Container
from rorg.engines.make import make_engine
from rorg.manifest.load import load, load_or_raise
from rorg.model.catalog import Catalog, Service
from rorg.store.state_dir import StateDir

WORD = "hunter2-of-the-map"
"""In the environment, the command, and what a probe and an engine say."""
NEXT = "hunter3-of-the-map"
"""That it is changed to."""
ODD = "qu\"ote'd & wörd/$x"
"""In a file of variables: written in another way by everybody who quotes."""
LOST = "lost-hunter-9"
"""In a tree that is refused."""
BUILD = "build-hunter-7"
"""An argument of an image that cannot be built."""
SECRETS = (WORD, NEXT, ODD, LOST, BUILD)


def tree(root, word: str = WORD, **more: dict):
    (root / "services").mkdir(parents=True, exist_ok=True)
    (root / "services/map.env").write_text(f"MAP_KEY={ODD}\n")
    key = {"container": {"environment": {"KEY": word}, "env_file": ["map.env"]}, "secrets": ["KEY"]}
    services = {
        "map": {
            **key,
            "always_on": True,
            "command": [*WORK, word, f"--url=http://{word}@robot/", "--more", f"{ODD};"],
            "ready": {"exec": ["sh", "-c", 'echo "no map for $KEY, $MAP_KEY"; exit 1'], "timeout": "1s"},
        },
        "web": {**key, "always_on": True, "ready": {"http": f"http://127.0.0.1:9/{word}", "timeout": "1s"}},
        "none": {**key, "always_on": True, "container": {**key["container"], "runtime": word}},
        **more,
    }
    return write_tree(root, services)


@pytest.fixture(params=["process", pytest.param("docker", marks=pytest.mark.docker)])
def shell(request, tmp_path, monkeypatch):
    host = request.getfixturevalue("dockerd").host if request.param == "docker" else ""
    if host:
        monkeypatch.setenv("DOCKER_HOST", host)
    found = Shell(tmp_path, request.param, host)
    yield found
    if found.daemon:
        found.daemon.kill()
        found.daemon.wait()
    engine = make_engine(request.param, StateDir(found.state))
    for container in engine.list():
        engine.stop(container.id, "SIGKILL", 5.0)
        engine.remove(container.id)


class Shell:
    """Commands on a robot, and all that they said."""

    def __init__(self, folder, engine: str, host: str) -> None:
        self.folder, self.engine, self.tree, self.state = folder, engine, folder / "tree", folder / "state"
        self.env = {**os.environ, "RORG_STATE_DIR": str(self.state), "RORG_ENGINE": engine, "TERM": "dumb"}
        self.env |= {"DOCKER_HOST": host} if host else {}
        self.said: dict[str, str] = {}
        self.daemon: commands.Forked | None = None

    def __call__(self, *words: str) -> str:
        done = commands.run([*words], self.env, self.folder)
        assert "Traceback" not in done.stderr
        assert "internal error" not in done.stderr
        self.said[f"{len(self.said)} {' '.join(words)}"] = done.stdout + done.stderr
        return done.stdout + done.stderr

    def run(self) -> None:
        log = (self.folder / "rorg.log").open("ab")
        self.daemon = commands.Forked(["run", self.tree], self.env, stdout=log, stderr=log)

    def stop(self) -> None:
        self.daemon.terminate()
        self.daemon.wait(60)
        self.daemon = None

    def api(self) -> rorg_client.Client:
        return rorg_client.Client(str(self.state / "run/rorg.sock"))

    def all_commands(self) -> None:
        self("get", "-o", "wide")
        self("get", "manifests", "-o", "yaml")
        self("describe", "map", "-o", "json")
        self("why", "web")
        self("explain", "services/map", str(self.tree), "-o", "yaml")
        self("diff", "--unified")
        self("diff", "-o", "json")
        self("events", "--tail", "999", "-o", "json")
        self("validate", str(self.tree))
        self("restart", "none", "--yes")

    def all_answers(self) -> None:
        """Every route that reads, of every service and manifest."""
        client = self.api()
        document = client.call("GET", "/v1/openapi.json")
        for path, methods in document["paths"].items():
            if "get" not in methods or path.endswith("/logs") or path == "/v1/wait":
                continue
            for values in ({"name": n, "kind": "Service", "port": "9"} for n in ("map", "web", "none")):
                address = path
                for name, value in values.items():
                    address = address.replace(f"{{{name}}}", value)
                query = "?to=9" if "connections" in path else "?unified=true" if path == "/v1/diff" else ""
                self.said[f"GET {address} {len(self.said)}"] = self.curl(address + query)
        self.said["PUT"] = self.curl("/v1/requests/y", "-X", "PUT", "-d", json.dumps({"services": [WORD]}))

    def curl(self, address: str, *words: str) -> str:
        socket = self.state / "run/rorg.sock"
        line = [tool("curl"), "-s", "-i", "--max-time", "20", "--unix-socket", socket, *words, f"http://x{address}"]
        return subprocess.run(line, capture_output=True, text=True, check=True).stdout

    def all_files(self) -> None:
        """All below the state directory but what rorg must know to go on, which is its owner's alone to read."""
        for path in self.state.rglob("*"):
            if path.name == "log":  # what a service prints is its own
                continue
            if path.name in (".services.last-good.json", "record.json"):
                assert path.stat().st_mode & 0o077 == 0, path
            elif path.is_file():
                self.said[str(path)] = path.read_bytes().decode(errors="replace")
        self.said["log"] = (self.folder / "rorg.log").read_text()

    def check(self) -> None:
        forms = {form for s in SECRETS for form in (s, json.dumps(s)[1:-1], repr(s)[1:-1], urllib.parse.quote(s))}
        found = {f"{where}: {form}" for where, text in self.said.items() for form in forms if form in text}
        assert not found, "\n".join(sorted(found))


@pytest.mark.slow
def test_no_secret_is_in_any_output_answer_or_file(shell):
    tree(shell.tree)
    shell.run()
    wait_for(lambda: "no map for" in shell("describe", "map"))
    wait_for(lambda: f"runtime specified {MASK}" in shell("events", "--tail", "999") or shell.engine == "process")
    shell("suspend", "--for", "10m")
    tree(shell.tree, NEXT)
    wait_for(lambda: "environment.KEY changed" in shell("diff"))
    shell.all_commands()
    shell.all_answers()
    wrong = {"environment": {"KEY": LOST}, "volumes": [f"{LOST}:x:y"]}
    tree(shell.tree, NEXT, lost={"secrets": ["KEY"], "container": wrong})
    wait_for(lambda: "manifests refused" in shell("events", "--tail", "999"))
    shell.all_commands()
    shell.stop()
    tree(shell.tree, NEXT)
    shell.all_commands()
    shell.all_files()
    shell.check()


# -- what is secret --------------------------------------------------------------------------------------------


def test_what_is_secret_is_said_by_names_and_files(tmp_path):
    catalog = load_or_raise(tree(tmp_path))
    assert catalog.services["map"].secrets == ("KEY", "MAP_KEY")
    (tmp_path / "services/map.env").write_text("KEY=overridden-by-the-manifest\n")
    assert load_or_raise(tmp_path).services["map"].secrets == ("KEY",)


def test_a_name_that_hides_nothing_is_an_error_and_a_short_value_is_told(tmp_path):
    write_tree(tmp_path, {"aa": {"secrets": ["KYE"], "container": {"environment": {"KEY": "x"}}}})
    (error,) = load(tmp_path).diagnostics
    assert "'KYE' is neither a variable of 'aa'" in str(error)
    assert "KEY" in error.remedy
    write_tree(tmp_path, {"aa": {"secrets": ["KEY"], "container": {"environment": {"KEY": "x"}}}})
    (warning,) = load(tmp_path).diagnostics
    assert (warning.severity, load(tmp_path).catalog is not None) == ("warning", True)
    assert "too short" in str(warning)


def test_arguments_of_all_images_below_a_service_may_be_secret(tmp_path):
    (tmp_path / "images").mkdir()
    for name, base in (("base", BASE_IMAGE), ("robot", "base")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "Dockerfile").write_text(f"FROM {base}\nARG TOKEN\n")
        spec = {"context": f"../{name}", "args": {"TOKEN": BUILD} if name == "base" else {}}
        manifest = {"apiVersion": "rorg/v1", "kind": "Image", "metadata": {"name": name}, "spec": spec}
        (tmp_path / "images" / f"{name}.yaml").write_text(yaml.safe_dump(manifest))
    catalog = load_or_raise(write_tree(tmp_path, {"aa": {"image": "robot", "secrets": ["TOKEN"]}}))
    assert {name: image.secrets for name, image in catalog.images.items()} == {"base": ("TOKEN",), "robot": ()}


# -- what comes of it ------------------------------------------------------------------------------------------

PLAIN = {"image": "x", "command": ["run", f"--key={WORD}"], "environment": {"KEY": WORD}, "cpus": 1.0}


def container(spec: dict, secrets: tuple[str, ...] = ()) -> Container:
    live = {"cpus": spec["cpus"]}
    return Container(
        "c",
        "map",
        "map",
        "running",
        digest=digest(spec),
        live=live,
        declared=canonical(declared_fields(spec, secrets)),
    )


def test_without_secrets_labels_and_digests_are_as_ever():
    assert canonical(declared_fields(PLAIN)) == (
        '{"command":["run","--key=hunter2-of-the-map"],"cpus":1.0,"environment.KEY":"sha256:044a56306d34","image":"x"}'
    )
    assert digest(PLAIN) == "v1:586bf5535490e4ad1ed0e6398c37fa08"


def test_the_record_of_a_container_has_no_secret_and_tells_a_change_of_one():
    made, other = (
        container(PLAIN, ("KEY",)),
        {**PLAIN, "command": ["run", f"--key={NEXT}"], "environment": {"KEY": NEXT}},
    )
    assert WORD not in made.declared
    found = difference(made, other, digest(other), declared_now(other, ("KEY",)))
    assert set(found.recreate) == {"command", "environment.KEY"}


@pytest.mark.parametrize(("before", "after"), [((), ("KEY",)), (("KEY",), ())])
def test_to_declare_a_secret_makes_no_container_anew(before, after):
    """Not even beside a change that is made in place."""
    other = {**PLAIN, "cpus": 2.0}
    found = difference(container(PLAIN, before), other, digest(other), declared_now(other, after))
    assert (found.recreate, dict(found.live)) == ((), {"cpus": 2.0})


def test_a_masker_hides_values_in_every_writing_but_not_what_rorg_has_to_say():
    def catalog(**values: str) -> Catalog:
        return Catalog({"navigation": Service("navigation", spec={"environment": values}, secrets=tuple(values))})

    masker = Masker()
    masker.learn(catalog(A=ODD, B="naviga", C="running", D="short", E="first line\nsecond line"))
    for text in (ODD, json.dumps(ODD), json.dumps(ODD, ensure_ascii=False), repr(ODD), urllib.parse.quote(ODD)):
        assert MASK in masker.text(f"cannot do it with {text}: why")
        assert "wörd" not in masker.text(text)
        assert "w%C3%B6rd" not in masker.text(text)
    assert masker.text("navigation is running, short") == "navigation is running, short"
    assert masker.text("at second line: x") == f"at {MASK}: x"
    assert masker.json(json.dumps({ODD: [ODD, 7, None]})) == json.dumps({ODD: [MASK, 7, None]})
    masker.learn(catalog(A="another value"))
    assert masker.text(f"{ODD}; another value") == f"{MASK}; {MASK}", "what was secret once still is"


@pytest.mark.slow
def test_a_manifest_is_edited_without_its_secret_being_seen(shell):
    tree(shell.tree)
    shell.run()
    wait_for(lambda: (shell.state / "run/rorg.sock").exists() and shell.api().services())
    client, path = shell.api(), shell.tree / "services/web.yaml"
    base = next(m["digest"] for m in client.manifests() if m["name"] == "web")
    text = client.manifest("Service", "web")
    assert WORD not in text
    assert f"KEY: '{MASK}'" in text or f"KEY: {MASK}" in text
    with pytest.raises(rorg_client.Invalid, match="a secret that is not shown"):
        client.put_manifest("Service", "web", text.replace(f"KEY: {MASK}", f"KEY: x{MASK}"), base, "")
    client.put_manifest("Service", "web", text.replace("timeout: 1s", "timeout: 2s"), base, "")
    written = yaml.safe_load(path.read_text())["spec"]
    assert written["container"]["environment"] == {"KEY": WORD}
    assert written["ready"] == {"http": f"http://127.0.0.1:9/{WORD}", "timeout": "2s"}


@pytest.mark.parametrize("place", ["buildkit", "classic"], indirect=True)
def test_a_build_that_prints_a_secret_leaves_none_in_its_log(place, tmp_path):
    text = (
        f"FROM {BASE_IMAGE}\nARG TOKEN\nARG DISTRO\nRUN python3 -S -c \"print('$DISTRO $TOKEN'); raise SystemExit(7)\""
    )
    args = {"TOKEN": BUILD, "DISTRO": "noetic-of-old"}
    catalog = images(tmp_path, {"bad": text}, bad={"args": args, "secrets": ("TOKEN",)})
    result = place.build(orders_of(catalog, {BASE_IMAGE}))["bad"]
    assert result.outcome == "failed"
    log = Path(result.log).read_text()
    assert f"noetic-of-old {MASK}" in log
    assert BUILD not in log + result.message + result.step + str(place.heard.all)


@pytest.mark.slow
def test_services_of_long_ago_are_forgotten_those_of_now_are_not():
    masker = Masker()
    for number in range(600):
        key = {"environment": {"KEY": f"secret-of-{number:04}"}}
        services = {n: Service(n, spec=key, secrets=("KEY",)) for n in (f"s{number}", "stays")}
        masker.learn(Catalog(services=services))
    assert masker.of("s599") is not masker
    assert masker.of("stays") is not masker
    assert masker.of("s0") is masker, "who is not known hides all"
