"""The page of all findings, of the table of codes and of the trees that tests find them in."""

from __future__ import annotations

from pathlib import Path

import yaml

from rorg.manifest.validation.codes import TABLE

CASES = Path(__file__).parents[2] / "tests/cases/findings"
ABOUT = """# Findings

What `rorg validate` says beside mistakes of form. Each has a code, which stays; `rorg diff` and the journal of the
running rorg tell warnings too. An **error** can never work, and the tree is refused: the robot goes on with the last
good one. A **warning** lets it pass.

Where one of these is right, a comment on its line, or before it, lets it pass. It must say why:

```yaml
# part of a Service
spec:
  container:
    privileged: true   # rorg: allow privileged: the vendor's driver opens /dev/mem
```

A comment without a reason, with a code that there is not, or that lets nothing pass is a warning itself. Errors cannot
be let pass.

`rorg validate -o json` gives `code` with each finding, `-o sarif` a file that code hosts show at the lines of a change.
Findings that need a look at this machine (marked so below) are told by `rorg validate --machine`.
"""


def findings() -> str:
    """The page, without the note that it is generated."""
    text = ABOUT
    for family, codes in TABLE.items():
        text += f"\n## {family}\n"
        for name, code in codes.items():
            seen = ", on this machine" if code.machine else ""
            text += f"\n### {name}\n\n**{code.severity}**{seen}: {code.cause} Try {code.remedy}.\n"
            path = CASES / f"{name}.yaml"
            text += _example(yaml.safe_load(path.read_text(encoding="utf-8"))) if path.exists() else ""
    return text


def _example(case: dict[str, dict[str, str]]) -> str:
    """The file in which it is found, and where."""
    file, line, column = str(case["expect"][0]["at"]).rsplit(":", 2)  # type: ignore[index]
    stem = file.removeprefix("services/").removesuffix(".yaml")
    text = case["bad"].get(stem)
    whole = case["bad"].get(file, "")
    head = f"apiVersion: rorg/v1\nkind: Service\nmetadata: {{name: {stem}}}\nspec:\n"
    shown = head + _indented(text) if text is not None else whole
    return f"\nFound at `{file}:{line}:{column}`:\n\n```\n{shown.rstrip()}\n```\n"


def _indented(text: str) -> str:
    return "".join(f"  {line}\n" for line in text.splitlines())
