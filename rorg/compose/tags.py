"""What `!reset` and `!override` take away from files before."""

from __future__ import annotations

from rorg.compose.nodes import Node


def without(base: Node, resets: Node) -> Node:
    """What is left of what files before say once `!reset` and `!override` of a later one have taken theirs away."""
    entries = dict(base.mapping)
    for key, value in resets.mapping.items():
        if value.tag and key in entries:
            del entries[key]
        elif key in entries and isinstance(value.value, dict) and isinstance(entries[key].value, dict):
            entries[key] = without(entries[key], value)
    return base.but(entries)


def kept(node: Node) -> Node:
    """Without what is only there to take something away (`!reset`)."""
    if isinstance(node.value, dict):
        return node.but({k: kept(v) for k, v in node.value.items() if v.tag != "reset"})
    if isinstance(node.value, list):
        return node.but([kept(v) for v in node.value if v.tag != "reset"])
    return node
