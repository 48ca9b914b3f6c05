"""A file may hold several manifests, separated by lines `---`, as kubectl's users write them."""

from __future__ import annotations

from pathlib import Path

import pytest

from rorg.api.manifest_texts import check_name, file_with, manifests_of
from rorg.cli.names import declared
from rorg.errors import Invalid
from rorg.manifest.load import load
from rorg.manifest.yaml_documents import document_texts, read_documents, with_document
from rorg.manifest.yaml_source import MAX_NODES
from rorg.tools.sim.variants import Tree, _with_policy


def service(name: str, more: str = "", kind: str = "Service") -> str:
    return f"apiVersion: rorg/v1\nkind: {kind}\nmetadata: {{name: {name}}}\nspec:\n  image: robot\n{more}"


def tree(root: Path, *documents: str, file: str = "services/robot.yaml") -> Path:
    path = root / file
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("---\n".join(documents), encoding="utf-8")
    return path


def told(root: Path, robot: str = "") -> list[str]:
    return [str(d).replace(f"{root}/", "") for d in load(root, robot=robot).diagnostics]


PROFILE = "apiVersion: rorg/v1\nkind: Profile\nmetadata: {name: base}\nspec:\n  restart: on-failure\n"


def test_all_documents_of_a_file_are_read(tmp_path):
    tree(tmp_path, "# All of it.\n", service("nav", "  profile: base\n  needs: [amcl]\n"), service("amcl"), PROFILE)
    loaded = load(tmp_path)
    assert loaded.diagnostics == ()
    assert set(loaded.catalog.services) == {"developer", "nav", "amcl"}
    assert loaded.catalog.services["nav"].restart == "on-failure"


def test_mistakes_have_the_line_of_the_file_and_one_document_hides_no_other(tmp_path):
    tree(tmp_path, service("aa", "  nedes: []\n"), "spec: [\n", service("bb", "  priority: high\n"), service("cc"))
    assert told(tmp_path) == [
        "services/robot.yaml:6:3: error: unknown key 'nedes'; try 'needs'",
        "services/robot.yaml:9:1: error: not valid YAML: did not find expected node content",
        "services/robot.yaml:15:13: error: spec.priority: input should be a valid integer",
    ]


def test_a_name_that_is_declared_twice_is_an_error(tmp_path):
    tree(tmp_path, service("aa"), service("aa"))
    (found,) = told(tmp_path)
    assert found.startswith("services/robot.yaml:9:18: error: the name 'aa' is taken by a Service at ")
    assert found.endswith("robot.yaml:3:18; try another name")


def test_a_comment_allows_what_its_own_document_has(tmp_path):
    allow = "  # rorg: allow latest-tag: a test\n"
    both = [
        service(name).replace("  image: robot\n", allowed + "  image: robot:latest\n")
        for name, allowed in (("aa", ""), ("bb", allow), ("cc", ""))
    ]
    tree(tmp_path, *both)
    (found,) = [d for d in load(tmp_path).diagnostics if d.code == "latest-tag"]
    assert found.where.line == 5
    assert "1 more like it, the next at" in found.message
    assert ":18:" in found.message


def test_an_overlay_changes_one_document(tmp_path):
    tree(tmp_path, service("aa"), service("bb"))
    tree(tmp_path, service("aa", "  priority: 7\n"), service("bb", "  priority: 8\n"), file="robots/nora/all.yaml")
    found = load(tmp_path, robot="nora").catalog.services
    assert (found["aa"].priority, found["bb"].priority) == (7, 8)


def test_an_overlay_removes_one_document(tmp_path):
    tree(tmp_path, service("aa"), service("bb"))
    text = "apiVersion: rorg/v1\nkind: Service\nmetadata: {name: aa}\nremoved: true\n"
    tree(tmp_path, text, file="robots/nora/all.yaml")
    assert set(load(tmp_path, robot="nora").catalog.services) == {"developer", "bb"}


def test_a_broken_document_causes_no_error_elsewhere(tmp_path):
    tree(tmp_path, "kind: Service\nmetadata:\n  name: nav\nspec: [\n", service("user", "  needs: [nav]\n"))
    assert len(told(tmp_path)) == 1


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ("a: 1\n", 1),
        ("---\na: 1\n", 1),
        ("# only\n---\n# comments\na: 1\n---\n# the end\n", 1),
        ("%YAML 1.2\n---\na: 1\n", 1),
        ("a: 1\n---\nb: 2\n---\n", 2),
        ("a: 1\r\n---\r\nb: 2\r\n", 2),
        ("--- {a: 1}\n--- # second\nb: 2\n", 2),
        ("a: |\n  ---\n  text\n---\nb: 2\n", 2),
        ("a: 1\n---b: 2\n", 1),
        ("", 1),
    ],
)
def test_documents_are_split_at_their_lines(text, count):
    assert "".join(document_texts(text)) == text
    assert len(document_texts(text)) == count
    assert len(read_documents(text, "x.yaml")) == count


def test_limits_hold_for_the_whole_file():
    bomb = "a: &a [" + "x, " * 900 + "]\nb: [" + "*a, " * 120 + "]\n"
    found = read_documents("---\n".join([bomb] * 500), "x.yaml", items=1000)
    assert len(found) < 5
    assert found[-1][2][0].message == f"not valid YAML: more than {MAX_NODES} values"
    ((_, none, (one,)),) = read_documents("a: 1\n---\n" * 1001, "x.yaml", items=1000)
    assert (none, one.message) == (None, "1001 documents, which is more than 1000")


def test_one_document_is_replaced_and_the_others_stay(tmp_path):
    path = tree(tmp_path, "# first\n" + service("aa"), "# second\n" + service("bb"), service("cc"))
    text, kept = path.read_text(), manifests_of(tmp_path)["Service", "bb"]
    assert kept.text.decode() == "---\n# second\n" + service("bb")
    assert file_with(kept, "Service", "bb", service("bb", "  priority: 9")) == text.replace(
        "# second\n" + service("bb"), service("bb", "  priority: 9\n")
    )
    assert file_with(kept, "Service", "bb", None) == text.replace("---\n# second\n" + service("bb"), "")
    assert with_document(service("aa"), ("Service", "aa"), None) is None


def test_a_text_of_several_documents_is_not_written_at_one_name():
    with pytest.raises(Invalid, match="the text has 2 documents; send one at a time"):
        check_name("Service", "aa", service("aa") + "---\n" + service("bb"))


def test_all_names_of_a_file_are_completed(tmp_path):
    tree(tmp_path, service("aa"), service("bb"), PROFILE)
    assert declared(tmp_path, ("service",)) == ["developer", "aa", "bb"]


def test_a_file_of_several_documents_may_have_any_name_and_any_kinds(tmp_path):
    tree(tmp_path, PROFILE, service("aa"), file="services/driving.yaml")
    assert told(tmp_path) == []


def test_secrets_of_each_broken_document_are_known(tmp_path):
    said = "  secrets: [TOKEN]\n  container: {environment: {TOKEN: SECRET}}\n  bogus: 1\n"
    tree(tmp_path, service("aa", said.replace("SECRET", "first-one")), service("bb", said.replace("SECRET", "second")))
    known = {str(s.spec["environment"]["TOKEN"]) for s in load(tmp_path).read.services.values() if s.secrets}
    assert known == {"first-one", "second"}


def test_another_policy_keeps_the_other_documents_of_the_file(tmp_path):
    policy = "apiVersion: rorg/v1\nkind: Policy\nmetadata: {name: policy}\nspec: {idle: {linger: %s}}\n"
    root = tmp_path / "tree"
    tree(root, service("aa"), policy % "1s", service("bb"), file="services/all.yaml")
    other = tmp_path / "other.yaml"
    other.write_text(policy % "9s")
    found = _with_policy(other, Tree(root, "", ""))
    assert {"aa", "bb"} <= found.services.keys()
    assert found.services["aa"].idle.linger == 9
