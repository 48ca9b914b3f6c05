"""Variables in one text (rorg/manifest/template.py). What each gives is what Docker Compose 2.26 gives."""

from __future__ import annotations

from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rorg.manifest.template import MOST_DEPTH, Refused, Variable, escaped, interpolate, parse

SET = {"S": "s1$$x", "E": "", "V": "a${S}"}

GIVES = [
    ("${A:-a}b}", "ab}"),
    ("${A:-{}}", "{}"),
    ("$$$A-", "$-"),
    ("$1 $( $ $-", "$1 $( $ $-"),
    ("${A:-${B:-q}r}", "qr"),
    ("${A:-'x}'}", "'x'}"),
    ("${S:+[$S]} ${S+x} ${E:-em} ${E-un} ${S-$$q}", "[s1$$x] x em  s1$$x"),
    ("$${S} $$S  $s $S.x ${s}", "${S} $S   s1$$x.x "),
    ("${A:-$}", "$"),
    ("${A:-a:?b}", "a:?b"),
    ("${A-:?b}", ":?b"),
    ("${A:-$$x}", "$x"),
    ("${E+yes}${E:+no}", "yes"),
    ("$S$S", "s1$$xs1$$x"),
    ("${A:-a$S}}", "as1$$x}"),
    ("${V}", "a${S}"),
    ("${E?unset}", ""),
    ("${A:-\n  b}", "\n  b"),
    ("no variable at all", "no variable at all"),
]

REFUSED = [
    ("x${A", 1, "no closing brace"),
    ("${}", 0, "no name"),
    ("${1}", 0, "no name"),
    ("${ A}", 0, "no name"),
    ("${a.b}", 0, "'.' after the name"),
    ("${A!x}", 0, "'!' after the name"),
    ("${A:x}", 0, "':' after the name"),
    ("${A:-${B}", 0, "no closing brace"),
    ("${A:-${B!}}", 5, "'!' after the name"),
]

REQUIRED = [
    ("ab ${A:?}", 3, "A", "variable A is empty or not set"),
    ("${A?}", 0, "A", "variable A is not set"),
    ("${A:?need $S}", 0, "A", "variable A is empty or not set: need s1$$x"),
    ("${E:?x}", 0, "E", "variable E is empty or not set: x"),
    ("${S:-${B:?x}}", 5, "B", "variable B is empty or not set: x"),
    ("${S:?${N:?x}}", 5, "N", "variable N is empty or not set: x"),
]


@pytest.mark.parametrize(("text", "value"), GIVES)
def test_what_a_text_gives(text, value):
    assert interpolate(text, SET.get).text == value


@pytest.mark.parametrize(("text", "offset", "why"), REFUSED)
def test_what_is_no_variable(text, offset, why):
    with pytest.raises(Refused) as refused:
        interpolate(text, SET.get)
    assert (refused.value.offset, refused.value.name) == (offset, "")
    assert why in refused.value.message
    assert "$$" in refused.value.remedy


@pytest.mark.parametrize(("text", "offset", "name", "message"), REQUIRED)
def test_what_is_required(text, offset, name, message):
    with pytest.raises(Refused) as refused:
        interpolate(text, SET.get)
    assert (refused.value.offset, refused.value.name, refused.value.message) == (offset, name, message)


def test_which_variables_were_used_and_which_were_not_set():
    found = interpolate("$S ${A} ${B:-$C} ${D-x} $A", SET.get)
    assert found.used == ("S", "A", "B", "C", "D")
    assert found.unset == ("A", "C")


def test_the_pieces_of_a_text():
    assert parse("a$$b ${A:-x$B} $C") == (
        "a$b ",
        Variable("A", 5, 14, True, ":-", ("x", Variable("B", 11, 13, braced=False))),
        " ",
        Variable("C", 15, 17, braced=False),
    )


def test_depth_is_bounded():
    deep = "${A:-" * (MOST_DEPTH + 1) + "}" * (MOST_DEPTH + 1)
    with pytest.raises(Refused):
        interpolate(deep, SET.get)
    assert interpolate("${A:-" * MOST_DEPTH + "x" + "}" * MOST_DEPTH, SET.get).text


@given(st.text(alphabet="$}{AS:-?+ x", max_size=30))
def test_what_is_escaped_stays_as_it_is_and_nothing_else_is_raised(text):
    assert interpolate(escaped(text), SET.get).text == text
    with suppress(Refused):
        interpolate(text, SET.get)
