"""Projects of which something cannot be carried over."""

from __future__ import annotations

from pathlib import Path

from rorg.tools.importing.systemd import from_systemd

UNSUPPORTED = """\
name: bot
services:
  nav:
    image: lab/nav
    post_start: [{command: a}]
    isolation: hyperv
    labels: {rorg.io/x: y}
    volumes: [{type: npipe, source: a, target: /a}, '/a:b', {type: bind, source: /c, target: /d, bind: {recursive: enabled}}]
    configs: [far]
    networks: [lan]
    depends_on: [developer, _x]
  developer: {image: a}
  _x: {image: b}
  far: {image: lab/far, build: 'https://example.org/far.git'}
networks: {lan: {enable_ipv4: false}}
configs: {far: {external: true}}
"""  # noqa: E501


def of_units(skip: bool = False, **texts: str):
    return from_systemd({Path(n.replace("__", "@") + ".service"): t for n, t in texts.items()}, "", Path("m"), skip)
