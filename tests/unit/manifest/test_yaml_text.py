"""Manifests that are written by an import: any value is read back as it was, and a person can read it too."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rorg.manifest.yaml_source import MOST_NUMBER, read_yaml
from rorg.manifest.yaml_text import Inline, Noted, plain, yaml_text
from rorg.tools.importing.manifests import Made

ANY = st.text(st.characters(blacklist_characters="\0", blacklist_categories=["Cs"]), max_size=30)
TEXTS = ANY | st.sampled_from(
    ["", "yes", "on", "null", "~", "1", "0o17", "1e3", ".5", "-", "- a", "a: b", "a #b", "#a", "[", "{}", "*a", "&a",
     "!a", "a:1", "%a", "@a", "`a`", "'", '"', "a\nb", "a\nb\n", "\n", " a\nb", "a \nb", "a\n\n  b\n", "\x85",
     "a\r\nb", "\ufeff", "10s", "512Mi", "12:30", "2024-01-01", "<<", "=", "a\tb", "\ta\nb", "...", "---", "--- a\nb"]
)  # fmt: skip
SCALARS = st.none() | st.booleans() | st.integers(-MOST_NUMBER, MOST_NUMBER) | st.floats(-1e9, 1e9) | TEXTS
KEYS = TEXTS.filter(lambda text: text != "<<")


def values(children: st.SearchStrategy) -> st.SearchStrategy:
    mappings = st.dictionaries(KEYS, children, max_size=4)
    noted = st.builds(Noted, children.filter(lambda item: not isinstance(item, Noted)), TEXTS)
    return st.lists(children, max_size=4) | mappings | mappings.map(Inline) | noted


@pytest.mark.slow
@settings(max_examples=200, deadline=None)
@given(st.dictionaries(KEYS, st.recursive(SCALARS, values, max_leaves=12), min_size=1, max_size=4))
def test_what_is_written_is_read_back(value):
    document, found = read_yaml(yaml_text(value), "x.yaml")
    assert not found
    assert document.value == plain(value)


def test_a_manifest_says_where_it_came_from_and_is_short():
    spec = {
        "image": "lab/nav:1",
        "command": ["sh", "-c", "a\nb\n"],
        "needs": ["base", {"service": "roscore", "restart": True}],
        "ready": Inline({"engine": "healthy", "timeout": "60s"}),
        "restart": Noted("never", "Compose's default"),
        "container": {"environment": {"A": "1", "B": "true"}, "volumes": ["../d:/d:ro"]},
    }
    made = Made("Service", "nav", spec, ("From compose.yaml:3:5,\nservice nav.",))
    assert made.path == "services/nav.yaml"
    assert (
        made.text
        == """\
# yaml-language-server: $schema=../schemas/service.json
# From compose.yaml:3:5, service nav.
apiVersion: rorg/v1
kind: Service
metadata:
  name: nav
spec:
  image: lab/nav:1
  command:
    - sh
    - -c
    - |
      a
      b
  needs: [base, {service: roscore, restart: true}]
  ready: {engine: healthy, timeout: 60s}
  restart: never   # Compose's default
  container:
    environment:
      A: "1"
      B: "true"
    volumes: [../d:/d:ro]
"""
    )
