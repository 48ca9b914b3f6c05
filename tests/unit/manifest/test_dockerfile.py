"""What a Dockerfile uses: cases written by hand (tests/cases/dockerfiles), and made-up and broken ones.

The cases say what Docker does. A use is written as "FROM reference"; a case without stages has one without a name.
"""

from __future__ import annotations

import pytest
import yaml
from common import ROOT
from hypothesis import given
from hypothesis import strategies as st

from rorg.manifest.dockerfile import Dockerfile, DockerfileError, Use, read, rewritten

CASES = [
    case
    for path in sorted((ROOT / "tests/cases/dockerfiles").glob("*.yaml"))
    for case in yaml.safe_load(path.read_text("utf-8"))
]
GOOD, BAD = [c for c in CASES if "error" not in c], [c for c in CASES if "error" in c]


def asked(case: dict) -> tuple[str, dict[str, str]]:
    return case["text"], case.get("args", {})


def options(case: dict) -> dict[str, str]:
    return {key: case[key] for key in ("target", "platform") if key in case}


def written(uses: tuple[Use, ...]) -> list[str]:
    return [f"{use.by} {use.reference}" for use in uses]


def named(case: dict) -> str:
    return case["name"].replace(" ", "-")


def test_there_are_many_cases_each_with_a_name_of_its_own():
    assert len(CASES) >= 100
    assert len({case["name"] for case in CASES}) == len(CASES)


@pytest.mark.parametrize("case", GOOD, ids=named)
def test_what_it_uses(case):
    text, args = asked(case)
    found = read(text, args, **options(case))
    assert written(found.uses) == case["uses"]
    assert list(found.stages) == case.get("stages", [""])
    assert found.buildkit == case.get("buildkit", False)
    for use in found.uses:
        start, end = use.places
        assert text[:start].count("\n") + 1 == use.line
        assert text[start:end].strip() == text[start:end] != ""


@pytest.mark.parametrize("case", BAD, ids=named)
def test_what_docker_refuses(case):
    text, args = asked(case)
    with pytest.raises(DockerfileError) as error:
        read(text, args, **options(case))
    assert error.value.line == case["error"]
    assert case.get("message", "") in str(error.value)


@pytest.mark.parametrize("case", GOOD, ids=named)
def test_other_references(case):
    """Each use in turn, and all of them: the rest of the file is what it was."""
    text, args = asked(case)
    assert rewritten(text, args, {}, **options(case)) == text
    before = read(text, args, **options(case))
    others = {use.reference: f"lab/other:{number}-123" for number, use in enumerate(before.uses)}
    changed = rewritten(text, args, others, **options(case))
    after = read(changed, args, **options(case))
    assert written(after.uses) == [f"{use.by} {others[use.reference]}" for use in before.uses]
    assert after.stages == before.stages
    for use, other in zip(before.uses, after.uses, strict=True):
        text = text.replace(text[slice(*use.places)], "", 1) if len(before.uses) == 1 else text
        changed = changed.replace(others[use.reference], "", 1) if len(before.uses) == 1 else changed
        assert other.reference == others[use.reference]
    if len(before.uses) == 1:
        assert text == changed


def test_only_the_word_itself_is_changed():
    text = (
        "ARG B=zbase  # kept\r\n"
        "FROM --platform=linux/amd64   ${B:-x}  AS  run \r\n"
        "RUN --mount=type=bind,from=zbase,source=/a,target=/a  echo zbase from=zbase\r\n"
        "COPY --chown=1 --from='zbase' zbase zbase\r\n"
    )
    assert rewritten(text, {}, {"zbase": "zbase:0123"}) == (
        "ARG B=zbase  # kept\r\n"
        "FROM --platform=linux/amd64   zbase:0123  AS  run \r\n"
        "RUN --mount=type=bind,from=zbase:0123,source=/a,target=/a  echo zbase from=zbase\r\n"
        "COPY --chown=1 --from='zbase:0123' zbase zbase\r\n"
    )


def test_the_machine_may_be_another_one():
    text = "FROM a:$BUILDARCH-$TARGETARCH\n"
    assert written(read(text, {}, machine="linux/arm64").uses) == ["FROM a:arm64-arm64"]
    assert written(read(text, {}, platform="linux/arm/v7", machine="linux/x86_64").uses) == ["FROM a:amd64-arm"]


def test_variables_within_each_other_have_a_limit():
    with pytest.raises(DockerfileError, match="more than"):
        read("FROM " + "${A:-" * 5000 + "a" + "}" * 5000, {})


PARTS = st.sampled_from(
    ["FROM ", "from", " AS x", "COPY --from=", "RUN --mount=", "type=bind,from=", "ARG ", "X=", "${X:-", "$X", "}", "x"]
    + [
        "<<EOF",
        "<<-",
        "EOF",
        "\n",
        "\r\n",
        "\\\n",
        "\\",
        "'",
        '"',
        "`",
        "# escape=`\n",
        " ",
        "\t",
        "0",
        "ONBUILD ",
        "lab/a:1",
    ]
    + ["#", "\ufeff", "\x0b", "\u2028", "${X#", "${X//", "/", "*", "?", "--", "-", "=", ",", "scratch", "\0", "é"]
)
TEXTS = st.one_of(st.text(), st.lists(PARTS, max_size=40).map("".join))


@st.composite
def mutated(draw: st.DrawFn) -> str:
    """A case from which something is taken out and into which something else is put."""
    text = draw(st.sampled_from(CASES))["text"]
    for _ in range(draw(st.integers(1, 3))):
        start = draw(st.integers(0, len(text)))
        end = draw(st.integers(start, min(len(text), start + 8)))
        text = text[:start] + draw(st.one_of(PARTS, st.just(""))) + text[end:]
    return text


@given(st.one_of(TEXTS, mutated()), st.dictionaries(st.sampled_from(["X", "A", ""]), TEXTS, max_size=2))
def test_whatever_it_says_it_is_read_or_refused(text, args):
    try:
        found = read(text, args)
    except DockerfileError as refused:
        line = refused.line
    else:
        line = 1
        assert_it_can_be_rewritten(text, args, found)
    assert 1 <= line <= text.count("\n") + 1


def assert_it_can_be_rewritten(text: str, args: dict[str, str], found: Dockerfile) -> None:
    assert rewritten(text, args, {}) == text
    others = {use.reference: f"other/image:{number}" for number, use in enumerate(found.uses)}
    after = read(rewritten(text, args, others), args)
    assert written(after.uses) == [f"{use.by} {others[use.reference]}" for use in found.uses]
    assert after.stages == found.stages
