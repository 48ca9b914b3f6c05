"""Makes the page of all findings, from the table of codes and the example trees of the tests."""

from __future__ import annotations

from pathlib import Path

import yaml

from rorg.manifest.validation.codes import TABLE

CASES = Path(__file__).parents[2] / "tests/cases/findings"
ABOUT = """# Findings

Findings are mistakes that `rorg validate` reports although each manifest is well formed. Each has a stable code.
`rorg diff` and the journal of the running rorg show warnings too.

- An **error** can never work. rorg refuses the tree, and the robot continues with the last good one.
- A **warning** does not stop the tree from coming into force.
- A **hint** changes little. Only `rorg validate --hints` shows it.

If you mean what a warning complains about, allow it with a comment on its line, or on the line before. The comment
must say why:

```yaml
# part of a Service
spec:
  container:
    privileged: true   # rorg: allow privileged: the vendor's driver opens /dev/mem
```

A comment without a reason, with an unknown code, or that allows nothing is itself a warning. Errors cannot be
allowed.

`rorg validate -o json` gives the `code` of each finding; `-o sarif` writes a file that code hosts show beside the lines
of a change. `rorg validate --machine` also reports findings about this machine, which are marked below.
"""


def findings() -> str:
    """The page, without the note that it is generated."""
    text = ABOUT
    for family, codes in TABLE.items():
        text += f"\n## {family}\n"
        for name, code in codes.items():
            seen = ", on this machine" if code.machine else ", once per robot" if code.once else ""
            text += f"\n### {name}\n\n**{code.severity}**{seen}: {code.cause} {code.advice}.\n"
            path = CASES / f"{name}.yaml"
            text += _example(yaml.safe_load(path.read_text(encoding="utf-8"))) if path.exists() else ""
    return text


def _example(case: dict[str, dict[str, str]]) -> str:
    """The example file, and the place of the finding in it."""
    file, line, column = str(case["expect"][0]["at"]).rsplit(":", 2)  # type: ignore[index]
    stem = file.removeprefix("services/").removesuffix(".yaml")
    text = case["bad"].get(stem)
    whole = case["bad"].get(file, "")
    head = f"apiVersion: rorg/v1\nkind: Service\nmetadata: {{name: {stem}}}\nspec:\n"
    shown = head + _indented(text) if text is not None else whole
    return f"\nFound at `{file}:{line}:{column}`:\n\n```\n{shown.rstrip()}\n```\n"


def _indented(text: str) -> str:
    return "".join(f"  {line}\n" for line in text.splitlines())
