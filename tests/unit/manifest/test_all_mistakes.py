"""One run of `rorg validate` reports mistakes of every kind: those of form in one part of a manifest withhold neither
those in other parts nor those between manifests, and no mistake causes another one that is not there."""

from __future__ import annotations

from pathlib import Path

import pytest

from rorg.manifest.load import load


def tree(root: Path, **services: str) -> Path:
    """A tree of services by name; `kind_name` is a manifest of another kind."""
    for name, spec in services.items():
        kind, _, rest = name.partition("_") if "_" in name else ("Service", "", name)
        folder = {"Policy": "policies"}.get(kind, f"{kind.lower()}s")
        path = root / folder / f"{rest}.yaml"
        path.parent.mkdir(exist_ok=True)
        head = f"apiVersion: rorg/v1\nkind: {kind}\nmetadata: {{name: {rest}}}\n"
        path.write_text(spec if spec.startswith("!") else f"{head}spec:\n{spec}", encoding="utf-8")
    return root


def told(root: Path) -> list[str]:
    return [f"{Path(d.where.file).stem}: {d.message}" for d in load(root).errors]


def test_every_kind_of_mistake_at_once(tmp_path):
    found = told(
        tree(
            tmp_path,
            keys="  image: robot\n  ports: ['80:80']\n  needs: [nobody]\n",
            types="  image: robot\n  priority: high\n  may_request: [nobody]\n",
            options="  image: robot\n  always_on: maybe\n  container: {network_mode: host, networks: [x]}\n",
            one="  image: robot\n  needs: [two]\n  bogus: 1\n",
            two="  image: robot\n  needs: [one]\n",
            meta="  type: meta\n  image: robot\n  bogus: 1\n  needs: [nobody]\n",
            both="  image: robot\n  needs: [left, right]\n",
            left="  image: robot\n  conflicts: [right]\n",
            right="  image: robot\n",
            profile="  image: robot\n  restart: sometimes\n  profile: nobody\n",
            unparsed="! [",
        )
    )
    assert found == [
        "both: 'both' needs both 'left' and 'right', which conflict",
        "keys: unknown key 'ports'",
        "keys: needs unknown service 'nobody'",
        "meta: spec: a meta service has no container: drop image",
        "meta: unknown key 'bogus'",
        "meta: needs unknown service 'nobody'",
        "one: services need each other: one -> two -> one",
        "one: unknown key 'bogus'",
        "options: spec.always_on: input should be a valid boolean",
        "options: networks and network_mode: host exclude each other",
        "profile: spec.restart: input should be 'always', 'on-failure' or 'never'",
        "profile: unknown profile 'nobody'",
        "types: spec.priority: input should be a valid integer",
        "types: unknown service 'nobody'",
        "unparsed: not valid YAML: did not find expected node content",
    ]


@pytest.mark.parametrize(
    "services",
    [
        {"nav": "! [", "user": "  image: robot\n  needs: [nav]\n  may_restart: [nav]\n"},
        {"Profile_base": "! [", "user": "  image: robot\n  profile: base\n  unset_environment: [A]\n  secrets: [B]\n"},
        {"Profile_base": "  bogus: 1\n", "user": "  image: robot\n  profile: base\n  unset_environment: [A]\n"},
        {
            "Profile_base": "! [",
            "Profile_top": "  extends: [base]\n",
            "user": "  image: robot\n  profile: top\n  secrets: [B]\n",
        },
        {"Policy_policy": "! [", "user": "  image: robot\n  exclusive: {gpu: 2}\n"},
        {"Policy_policy": "  resources: {gpu: two}\n", "user": "  image: robot\n  exclusive: {gpu: 2}\n"},
        {"Network_default": "! [", "user": "  image: robot\n  container: {networks: {default: {aliases: [a]}}}\n"},
        {"Image_base": "! [", "user": "  image: base\n  secrets: [TOKEN]\n"},
        {"user": "  image: robot\n  container: {mem_limt: 1Gi, memswap_limit: 2Gi}\n"},
        {"user": "  image: robot\n  ready: {completed: true}\n  restart: once\n"},
        {"user": "  imag: robot\n"},
        {"user": "  image: robot\n  ready: {tpc: 80}\n"},
        {"user": "  image: robot\n  needs: [[x]]\n"},
        {
            "shm": "  image: robot\n  container: {ipc: 3}\n",
            "user": "  image: robot\n  container: {ipc: 'service:shm'}\n",
        },
    ],
    ids=lambda services: "-".join(services),
)
def test_a_mistake_causes_no_other(tmp_path, services):
    (found,) = told(tree(tmp_path, **services))
    assert found.partition(":")[0] == next(iter(services)).rpartition("_")[2]


def test_a_broken_item_of_a_list_hides_no_mistake_of_the_others(tmp_path):
    loaded = load(
        tree(
            tmp_path,
            user="  image: robot\n  needs:\n  - [x]\n  - nobody\n  - {service: other, bogus: 1}\n  - nothing\n"
            "  may_request: [other, {}, somebody]\n",
            probed="  image: robot\n  ready: {all: [{tcp: 80, bogus: 1}, {tcp: x}, {http: 'ftp://a'}]}\n",
            other="  image: robot\n  conflicts: [3, anybody]\n",
        )
    )
    found = [f"{Path(d.where.file).stem}:{d.where.line}:{d.where.column}: {d.message}" for d in loaded.errors]
    assert found == [
        "other:6:15: spec.conflicts.0: '3' is a number, not a text",
        "other:6:18: conflicts unknown service 'anybody'",
        "probed:6:27: unknown key 'bogus'",
        "probed:6:44: spec.ready.all.1.tcp: must be PORT or HOST:PORT, with a port from 1 to 65535",
        "probed:6:55: spec.ready.all.2.http: must be a URL that begins with http://",
        "user:7:5: spec.needs.0: must be a mapping",
        "user:8:5: needs unknown service 'nobody'",
        "user:9:22: unknown key 'bogus'",
        "user:10:5: needs unknown service 'nothing'",
        "user:11:24: spec.may_request.1: it is a mapping, not a text",
        "user:11:28: unknown service 'somebody'",
    ]


def test_what_is_left_of_a_broken_manifest_never_runs(tmp_path):
    loaded = load(tree(tmp_path, nav="  image: robot\n  bogus: 1\n", good="  image: robot\n"))
    assert loaded.catalog is None
    assert "nav" not in loaded.read.services
    assert "good" in loaded.read.services


def test_secrets_of_a_broken_manifest_are_known(tmp_path):
    said = "  image: robot\n  bogus: 1\n  secrets: [TOKEN]\n  container: {environment: {TOKEN: very-secret}}\n"
    loaded = load(tree(tmp_path, nav=said))
    assert any("very-secret" in str(s.spec) and s.secrets == ("TOKEN",) for s in loaded.read.services.values())


def test_a_value_that_yaml_cannot_give_is_not_checked_further(tmp_path):
    assert told(tree(tmp_path, nav='  image: robot\n  mounts: ["./a\\0b:/x"]\n', good="  image: robot\n")) == [
        "nav: a NUL character, which ends a text for the engine and for programs"
    ]
