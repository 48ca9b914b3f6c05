"""Launch files of ROS 2 as manifests: `rorg import roslaunch`. The cases are in tests/cases/launch."""

from __future__ import annotations

import os
import time
from pathlib import Path
from xml.etree import ElementTree

import launch_cases
import pytest

from rorg.manifest.files import Reader
from rorg.manifest.load import load
from rorg.tools.importing.launch_expression import evaluate
from rorg.tools.importing.launch_words import Refusal, split
from rorg.tools.importing.launch_xml import Element, read_launch
from rorg.tools.importing.launch_yaml import guess
from rorg.tools.importing.manifests import write_tree
from rorg.tools.importing.ros2_commands import value_text
from rorg.tools.importing.roslaunch import from_roslaunch

CASES = launch_cases.cases()
PACKAGE = '<package format="3"><name>bot</name><buildtool_depend>ament_cmake</buildtool_depend></package>'


def test_the_cases_are_many_and_each_name_is_used_once():
    assert len(CASES) >= 20
    assert len({case.name for case in CASES}) == len(CASES)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_a_launch_file_becomes_exactly_this(case, tmp_path):
    folder = tmp_path.resolve() / "project"
    folder.mkdir()
    imported = case.imported(folder)
    assert launch_cases.shown(imported, folder) == case.expected
    assert not os.path.exists("/tmp/never-written")
    if not imported.errors:
        write_tree(imported, tmp_path / "manifests")
        loaded = load(tmp_path / "manifests", engine="docker")
        assert not loaded.errors, loaded.errors
        for path in imported.files:
            assert isinstance(read_launch(Path(path), imported.files[path]), Element)


def imported_text(folder: Path, text: str, name: str = "big.launch.xml", **options):
    (folder / "package.xml").write_text(PACKAGE)
    (folder / name).write_text(text)
    return from_roslaunch(folder / name, Reader(folder), {}, "lab", **options)


def launch(*parts: str) -> str:
    return f"<launch>{''.join(parts)}</launch>"


def expression(text: str) -> str:
    return launch(f"<node pkg='a' exec='$(eval &quot;{text}&quot;)'/>")


NODE = "<node pkg='a' exec='b'/>"
SUBSTITUTIONS = "substitutions add more than 1 MiB"
BOUNDED = {
    "exponential values": (
        launch("<let name='x' value='0123456789'/>", "<let name='x' value='$(var x)$(var x)'/>" * 40),
        SUBSTITUTIONS,
    ),
    "a large file": (launch(" " * (1 << 20), NODE), "it has more than 1 MiB"),
    "many elements": (launch("<node pkg='a' exec='b' if='0'/>" * 20_001), "20000 elements"),
    "many programs": (launch(NODE * 501), "more than 500 programs"),
    "deep groups": (launch("<group>" * 200, "</group>" * 200), "nested elements"),
    "a long namespace": (
        launch(f"<push_ros_namespace namespace='{'n' * 100}'/>" * 20, NODE),
        "a name of more than 1000 characters",
    ),
    "settings of all nodes": (
        launch(f"<set_parameter name='a' value='{'v' * 5000}'/>", NODE * 300),
        SUBSTITUTIONS,
    ),
    "variables of included files": (
        launch(f"<let name='a' value='{'v' * 50_000}'/>", "<include file='$(find-pkg-share x)/a.py'/>" * 100),
        SUBSTITUTIONS,
    ),
    "nested substitutions": (launch(f"<node pkg='a' exec='{'$(not ' * 50}1{')' * 50}'/>"), "more than 20 subst"),
    "a long expression": (expression("1" + "+1" * 2000), "2000 characters"),
    "a deep expression": (expression("-" * 1500 + "1"), "not a valid"),
}


@pytest.mark.parametrize("name", BOUNDED)
def test_what_grows_without_limit_is_refused(name, tmp_path):
    text, why = BOUNDED[name]
    imported = imported_text(tmp_path, text, ros=2)
    assert why in str(imported.errors[0])


def test_left_out_are_only_those_elements_that_cannot_be_carried_over(tmp_path):
    text = "<launch><node pkg='a' exec='b'/><node pkg='$(command id)' exec='c'/><arg name='x'/></launch>"
    missing = imported_text(tmp_path, text, skip=True)
    assert [str(error.message) for error in missing.errors] == ["the argument x has no value"]
    assert not missing.manifests
    skipped = imported_text(tmp_path, text.replace("<arg name='x'/>", ""), skip=True)
    assert [made.name for made in skipped.manifests] == ["b-launch"]
    assert "skipped: $(command id)" in skipped.diagnostics[0].message


@pytest.mark.parametrize(
    ("value", "said"), [("'false'", "false"), ("false", "false"), ("2.0", "2.0"), ("'a b'", "a b")]
)
def test_a_parameter_of_all_nodes_has_the_type_that_its_text_looks_like_in_yaml_too(value, said, tmp_path):
    text = f"launch:\n- set_parameter: {{name: x, value: {value}}}\n- node: {{pkg: a, exec: bb}}\n"
    (made,) = imported_text(tmp_path, text, "big.launch.yaml").manifests
    assert made.spec["command"][-1] == f"x:={said}"


def test_names_of_services_are_distinct_and_none_is_taken(tmp_path):
    nodes = "<node pkg='a' exec='bb'/>" * 3 + "<node pkg='a' exec='bb-2'/><node pkg='a' exec='c' name='developer'/>"
    imported = imported_text(tmp_path, f"<launch>{nodes}</launch>")
    assert [made.name for made in imported.manifests] == ["bb", "bb-2", "bb-3", "bb-2-2", "developer-2", "big"]


@pytest.mark.parametrize(
    ("text", "value"),
    [
        *(("1", 1), ("1.50", 1.5), ("-2e-3", "-2e-3"), ("-2.0e-3", -0.002), ("yes", True), ("Off", False)),
        *(("0x10", 16), ("a b", "a b"), ("", ""), ("~", "~"), ("2024-01-01", "2024-01-01"), ("'1'", "1")),
        *(("[1, 2]", [1, 2]), ("[1, 2.5]", [1.0, 2.5]), ("[a, 1]", "[a, 1]"), ("[]", "[]"), ("[[1]]", "[[1]]")),
        *(("a: b", "a: b"), ("{", "{"), ("[a, b]", ["a", "b"]), ("1" * 5000, "1" * 5000), ("!!float x", "!!float x")),
        *(("1:30", 90), ("1:30.5", 90.5), ("0b11", 3), ("010", 8), ("!!bool x", "!!bool x")),
        *((text, text) for text in ("1" + ":1" * 2000, "0x" + "f" * 4000, "[1, 99999999999999999999]")),
    ],
)
def test_a_text_has_the_type_that_ros_2_gives_it(text, value):
    assert guess(text) == value
    assert type(guess(text)) is type(value)


@pytest.mark.parametrize("size", [39_000, 800_000])
@pytest.mark.parametrize("begin", ["1{}", "-1{}.5"], ids=["whole", "fraction"])
def test_a_number_of_hours_minutes_and_seconds_without_end_is_a_text(begin, size, tmp_path):
    """PyYAML takes 27 s for such a number of 781 KB, and Python writes no number of more than 4300 digits."""
    value, node = begin.format(":1" * (size // 2)), "- node: {pkg: a, exec: bb, args: $(var x)}\n"
    began = time.process_time()
    for shown in (value, f"[{value}]"):
        imported_text(tmp_path, f"launch:\n- set_parameter: {{name: x, value: {shown}}}\n{node}", "big.launch.yaml")
    imported_text(tmp_path, f"<launch><set_parameter name='x' value='{value}'/></launch>")
    found = imported_text(tmp_path, f"launch:\n- arg: {{name: x, default: {value}}}\n{node}", "big.launch.yaml")
    assert found.manifests[0].spec["command"][-1] == value
    assert time.process_time() - began < 10.0


@pytest.mark.parametrize("value", ["0x" + "f" * 9000, "0b" + "1" * 9000, "1" * 20, "!!timestamp noon"])
def test_a_number_that_is_out_of_range_and_a_wrong_date_are_texts(value, tmp_path):
    text = f"launch:\n- arg: {{name: x, default: {value}}}\n- node: {{pkg: a, exec: bb, args: $(var x)}}\n"
    (made,) = imported_text(tmp_path, text, "big.launch.yaml").manifests
    assert made.spec["command"][-1] == value.removeprefix("!!timestamp ")


@pytest.mark.parametrize(("tag", "value"), [("!!bool", "x"), ("!!int", ""), ("!!float", "x")])
def test_a_value_that_is_not_of_its_tag_is_a_mistake(tag, value, tmp_path):
    text = f"launch:\n- arg: {{name: x, default: {tag} '{value}'}}\n"
    (error,) = imported_text(tmp_path, text, "big.launch.yaml").errors
    assert error.message == f"not a value of YAML: {value}"


@pytest.mark.parametrize(
    "value",
    ["1", "true", "a b", "", "nan", "-inf", "'", '"', "a: b", "#", "[x]", "\n", "on", 1, 1.0, True, [1.0], ["1", "a"]],
)
def test_a_value_on_the_command_line_is_the_same_value_in_yaml(value):
    assert guess(value_text(value)) == value
    assert type(guess(value_text(value))) is type(value)


@pytest.mark.parametrize(
    ("expression", "value"),
    [
        *(("1 + 2 * 3", "7"), ("'a' + 'b'", "ab"), ("'a' == 'a' and 1 < 2 <= 2", "True"), ("not 'x'", "False")),
        *(("'sim' if 'true' == 'false' else 'real'", "real"), ("'a' in ['a', 'b']", "True"), ("7 % 4", "3")),
        *(("'True'.lower() == 'true'", "True"), ("round(pi, 2)", "3.14"), ("'' or 'x'", "x"), ("-1.5", "-1.5")),
    ],
)
def test_harmless_expressions_are_evaluated(expression, value):
    assert evaluate(expression) == value


@pytest.mark.parametrize(
    "expression",
    [
        *("open('/etc/passwd')", "().__class__", "[x for x in (1,)]", "'%s' % 'a'", "[1] + [2]", "'a' * 9", "2 ** 9"),
        *("f'{1}'", "x", "eval('1')", "'a'.format()", "1 << 9", "", "1; 2", "b'a'", "...", "1j", "int('x')", "'a' < 1"),
        *("'\\ud800'.upper(1)", "(" * 1000, "str(" * 500 + ")" * 500, "len(*'ab')", "int(x=1)"),
    ],
)
def test_other_expressions_are_refused(expression):
    with pytest.raises(Refusal):
        evaluate(expression)


def test_words_split_where_a_shell_splits_them_but_not_within_a_substitution():
    def filled(text):
        return "".join("x y" if not isinstance(piece, str) else piece for piece in text)

    assert split("a  'b c' $(var d)e \"$(var f)\"", filled) == ["a", "b c", "x ye", "x y"]
    assert split("", filled) == []


def test_a_generated_launch_file_says_what_the_launch_file_said(tmp_path):
    (tmp_path / "one").mkdir()
    case = next(case for case in CASES if case.name == "nav2-bringup")
    (text,) = case.imported(tmp_path / "one").files.values()
    again = imported_text(tmp_path, text, "again.launch.xml")
    assert next(iter(again.files.values())).split("\n")[1:] == text.split("\n")[1:]
    assert ElementTree.fromstring(text).tag == "launch"
