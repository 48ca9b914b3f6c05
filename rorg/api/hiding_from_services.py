"""What is hidden from services. A service that finds its own words masked would know that it has guessed a secret of
another, so it never finds out."""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Mapping
from typing import Any
from urllib.parse import unquote_plus

from rorg.core.masking import MASK, Masker
from rorg.model.catalog import DEVELOPER, SHORTEST_SECRET, Catalog

MOST_SAID = 64 << 10
"""Characters of a call that are looked for in the error that it is answered with."""
_WORD = re.compile(r"[A-Za-z0-9_]+")
_OURS = frozenset(
    _WORD.findall(
        "Service Services accepted access actions already always_on annotations anything apiVersion cannot cap_add "
        "capabilities change command conflicts container developer developers devices driver env_file environment "
        "events except exclusive generation healthcheck history incarnation interlock itself labels limits manage "
        "manages manifest manifests may_act_for may_manage may_request may_restart member metadata method mounts needs "
        "network_mode networks nobody nothing number operation people permission pids_limit plan priority privileged "
        "profile profiles protected reason release released request requested requester requesting requests resources "
        "restart retry rorg running security_opt service services should string suspend tmpfs unknown valid value "
        "variable volumes"
    )
)
"""Words of errors and of manifests, which a call may have too."""


def shown_to_service(value: Any, masker: Masker) -> Any:
    """Plain JSON for a service: what is about one service has the secrets of that one hidden, and the reasons that
    services give for requests are shown as they are."""
    if isinstance(value, list):
        return [shown_to_service(item, masker) for item in value]
    if not isinstance(value, Mapping):
        return masker.value(value)
    near = masker.of(value.get("service"))
    own = value.get("requester", DEVELOPER) != DEVELOPER and not value.get("standing")
    found = {}
    for key, item in value.items():
        if key == "services" and isinstance(item, Mapping):
            found[key] = {name: shown_to_service(below, masker.of(name)) for name, below in item.items()}
        elif isinstance(item, Mapping | list):
            found[key] = near.value({key: item})[key] if _plain(item) else shown_to_service(item, near)
        else:
            found[key] = item if key == "reason" and own else near.value({key: item})[key]
    return found


def _plain(value: Any) -> bool:
    return isinstance(value, list) and not any(isinstance(item, Mapping | list) for item in value)


def error_for_service(error: Mapping[str, Any], said: str, masker: Masker, catalog: Catalog) -> dict[str, Any]:
    """An error for a service that has `said` something: none of its words stand in it, but names that people declared.
    They look like a secret, whether they are one or not."""
    known = _OURS | _names(catalog)
    found = shown_to_service({k: v for k, v in error.items() if k not in ("title", "cause", "remedy")}, masker)
    about = next((n for n, one in (error.get("services") or {}).items() if not one.get("ready")), None)
    texts = {key: unsaid(str(error.get(key, "")), said, known) for key in ("title", "cause", "remedy")}
    return {**error, **found, **{key: masker.of(about).text(text) for key, text in texts.items()}}


def _names(catalog: Catalog) -> set[str]:
    """Words in the names that people declared."""
    managers = [service for service in catalog.services.values() if service.may_manage]
    declared = [name for name in catalog.services if not any(one.manages(name) for one in managers)]
    return {word for name in (*declared, *catalog.groups) for word in _WORD.findall(name)}


def words_of(query: bytes, path: str, body: bytes) -> str:
    """All that a call says."""
    text = body.decode("utf-8", errors="replace")
    try:
        texts = list(_texts(json.loads(text))) if text else []
    except (ValueError, RecursionError):
        texts = [text]
    return "\n".join((path, unquote_plus(query.decode("latin-1")), *texts))[:MOST_SAID]


def _texts(value: Any) -> list[str]:
    if isinstance(value, dict):
        return [text for key, item in value.items() for text in (str(key), *_texts(item))]
    if isinstance(value, list):
        return [text for item in value for text in _texts(item)]
    return [value] if isinstance(value, str) else [str(value)]


def unsaid(text: str, said: str, known: Collection[str]) -> str:
    """The text without what is in `said` too and may be a secret: whatever is long enough, but for words `known`."""
    covered = bytearray(len(text))
    for at in range(len(text) - SHORTEST_SECRET + 1):
        if text[at : at + SHORTEST_SECRET] in said:
            covered[at : at + SHORTEST_SECRET] = b"\x01" * SHORTEST_SECRET
    for word in _WORD.finditer(text):
        if word[0] in known:
            covered[word.start() : word.end()] = bytes(len(word[0]))
    pieces = []
    for run in re.finditer(rb"\x01+|\x00+", bytes(covered)):
        piece = text[run.start() : run.end()]
        pieces.append(MASK if run[0][0] and _WORD.search(piece) else piece)
    return "".join(pieces)
