"""The format of .env and env_file (rorg/manifest/dotenv.py). What each gives is what Docker Compose 2.26 gives."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rorg.manifest.dotenv import read_dotenv, values_of

SET = {"K": "kk$A", "AK": "ak"}

GIVES = [
    ("A=1\n", {"A": "1"}),
    ("  B = two words  \n", {"B": "two words"}),
    ("export C=3\nexport\tD = x", {"C": "3", "D": "x"}),
    ("export=1\nexportA=2", {"export": "1", "exportA": "2"}),
    ('D: yaml\nA : "b"', {"D": "yaml", "A": "b"}),
    (r"""E='single $A # no \n \' \\ \" esc'""", {"E": r"""single $A # no \n ' \\ \" esc"""}),
    (
        r'''F="double $K # yes \n \" \t \$A $$A \x \' \\ \a \0101 \101 \\n"''',
        {"F": "double kk$A # yes \n \" \t $A $A \\x \\' \\ \x07 A \\101 \\n"},
    ),
    ("G=un # comment\nH=un#nc\nS=#x\nT= #x\nU=  x  # y #z", {"G": "un", "H": "un#nc", "S": "#x", "T": "#x", "U": "x"}),
    ('I="multi\n # line"\nZ=1', {"I": "multi\n # line", "Z": "1"}),
    ("J=\nK2 = \nL=2", {"J": "", "K2": "", "L": "2"}),
    ("L=${A:-x} ${Q:-d} $K", {"L": "x d kk$A"}),
    (r"M=$$A \$A \n", {"M": "$A \\ \\n"}),
    ('O="a" # trailing\nZ=1', {"O": "a", "Z": "1"}),
    ("P=a\"b\"c\nW=a=b\nQ=it's\nR=x'y # z'", {"P": 'a"b"c', "W": "a=b", "Q": "it's", "R": "x'y"}),
    ("x.y=1\nx-y=2\nX[0]=3\n1A=4\nÉ=é", {"x.y": "1", "x-y": "2", "X[0]": "3", "1A": "4", "É": "é"}),
    ("A=1\nA=2\nB=$A", {"A": "2", "B": "2"}),
    ("X=$A\nA=1", {"X": "", "A": "1"}),
    ("K\nNOPE\nexport AK\n", {"K": "kk$A", "AK": "ak"}),
    ("K=file", {"K": "file"}),
    ("K=file\nB=$K", {"K": "file", "B": "kk$A"}),
    ("A=1\r\nB=2\r\n", {"A": "1", "B": "2"}),
    ("\ufeffA=1", {"A": "1"}),
    ('A="a\\\nb"', {"A": "a\\\nb"}),
    ('A="$K"\nB=\'$K\'\nC="\\$K"', {"A": "kk$A", "B": "$K", "C": "$K"}),
    ('A="${K}" B=2', {"A": "kk$A", "B": "2"}),
    ('A={"a": 1}\nB=[1, 2] # x', {"A": '{"a": 1}', "B": "[1, 2]"}),
    ("A=$\nB=$(x)\nC=`x`", {"A": "$", "B": "$(x)", "C": "`x`"}),
    ("# only\n\n", {}),
]

WRONG = [
    ("A@=1", 1, 2, "'@' in the name"),
    ("ok=1\na b=1", 2, 1, "a blank in the name 'a b'"),
    ("K # c\nB=1", 1, 3, "'#' in the name"),
    ("=x", 1, 1, "no name"),
    ("A='x", 1, 3, "not closed"),
    ('B=1\n  A="x\ny', 2, 5, "not closed"),
    ("A=1\nB=${C", 2, 3, "no closing brace"),
    ("A=${R:?needed}", 1, 3, "variable R is empty or not set: needed"),
]


@pytest.mark.parametrize(("text", "values"), GIVES)
def test_what_a_file_gives(text, values):
    entries, mistakes = read_dotenv(text, SET.get)
    assert not mistakes
    assert values_of(entries) == values


@pytest.mark.parametrize(("text", "line", "column", "message"), WRONG)
def test_what_cannot_be_read(text, line, column, message):
    _, (mistake,) = read_dotenv(text, SET.get)
    assert (mistake.line, mistake.column) == (line, column)
    assert message in mistake.message
    assert mistake.remedy


def test_all_mistakes_at_once_and_what_is_right_beside_them():
    entries, mistakes = read_dotenv("A@=1\nB=2\nC=${\nD=4\n", SET.get)
    assert [m.line for m in mistakes] == [1, 3]
    assert values_of(entries) == {"B": "2", "D": "4"}


def test_places_bare_names_and_variables_that_are_not_set():
    entries, _ = read_dotenv("A=1\n  export B = $X\nK\nNOPE", SET.get)
    assert [(e.name, e.line, e.column, e.bare, e.unset) for e in entries] == [
        ("A", 1, 1, False, ()),
        ("B", 2, 10, False, ("X",)),
        ("K", 3, 1, True, ()),
        ("NOPE", 4, 1, True, ()),
    ]
    assert entries[3].value is None


@given(st.text(alphabet="AB=\n'\"\\ #$:{}x", max_size=40))
def test_whatever_stands_there_is_read_or_refused(text):
    entries, mistakes = read_dotenv(text, SET.get)
    assert all(m.line <= text.count("\n") + 1 and m.column > 0 for m in mistakes)
    assert all(e.name for e in entries)
