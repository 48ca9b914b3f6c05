"""Masking of secrets, the only place that decides what people and services may see and what the journal records.

Two rules: masked() goes by the name and form of a declared value, and a Masker replaces the values that manifests
declare secret.
"""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Collection, Iterable, Mapping
from typing import Any
from urllib.parse import quote

from rorg.model.catalog import SHORTEST_SECRET, Catalog, Spec
from rorg.model.health import Health
from rorg.model.image_names import declared
from rorg.model.secret_names import NAME, is_secret_name, secret_texts

MASK = "***"
KEPT = 256
"""Number of secrets of earlier trees that are still masked: old containers and records may quote them."""
_WORD = re.compile(
    rf"created|running|restarting|removing|paused|exited|{'|'.join(Health)}|Synced|"
    r"OutOfSync|create|update|probe|rename|signal|resume|activate|deactivate|inactive|remove|replace|restart|failed|withheld|"
    r"preempted|suspended|skipped|present|imported|pulled|docker|process|developer|Requested|Reconciling|Stalled|Updated|warning|"
    r"always|on-failure"
)
"""Words that programs read in rorg's answers. Masking them would break clients, so they are shown even if a secret has
the same value."""
MARK = re.compile(r"\*{3}\(([0-9a-f]{12})\)")
"""A secret in a container's label: equal secrets have equal marks, and the value cannot be recovered."""
_VALUE = r"(?:\"[^\"]*\"|'[^']*'|[^\s'\"]\S*)"
_SHORT = {
    re.compile(rf"(?:^|(?<=[\s/]))(?:{programs})(?=\s)"): (option, re.compile(rf"(?<=\s){option}"))
    for programs, option in ((r"(?:mysql|mariadb)[\w-]*+|sshpass", "-p"), (r"redis-cli", "-a"), (r"curl", "-u"))
}
"""Programs with a one-letter option that takes a secret, with or without a space. For other programs, `-p` is a
port."""
_WORD_BEGINS = r"(?<![\w.-])"
_RULES = (
    (re.compile(r"(\b(?:bearer|basic)\s+)\S+", re.IGNORECASE), rf"\1{MASK}"),
    (re.compile(r"(://[^\s:/@]*:)[^\s@/]+@"), rf"\1{MASK}@"),
    # NAME=value, NAME:=value (roslaunch), "NAME: value" (a header). A colon without a space is no match: it also
    # separates the paths of a mount.
    (re.compile(rf"({_WORD_BEGINS}{NAME}(?::?=|:\s)\s*){_VALUE}", re.IGNORECASE), rf"\1{MASK}"),
    (re.compile(rf"((?:^|\s)--?{NAME}\s+){_VALUE}", re.IGNORECASE), rf"\1{MASK}"),
)
"""Every pattern takes time linear in the text, because anyone can send long texts."""
_PLAIN = re.compile(r"\d|true|false|yes|no|on|off|", re.IGNORECASE)
"""Values of variables that can be no secret: switches such as PYTHONUNBUFFERED."""
_ONE_VALUE = re.compile(rf"(\s*){_VALUE}")
_NEXT_COMMAND = re.compile(r"[;|&\n]")


def masked(field: str, value: Any) -> Any:
    """Return the value of a declared field as it may be shown. Environment variables are shown by name only, except
    for values too plain to be a secret."""
    if value is None:
        return None
    if is_secret_name(field):
        return MASK
    if field.partition(".")[0] == "environment":
        return value if isinstance(value, str) and _PLAIN.fullmatch(value) else MASK
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, dict):
        return {key: masked(str(key), item) for key, item in value.items()}
    return _list(value) if isinstance(value, list) else value


def _text(text: str) -> str:
    text = MARK.sub(MASK, text)
    for pattern, put in _RULES:
        text = pattern.sub(put, text)
    for program, (_, option) in _SHORT.items():
        text = _without_short(text, program, option)
    return text


def _without_short(text: str, program: re.Pattern[str], option: re.Pattern[str]) -> str:
    """Mask the value after this option of a program, within the same shell command."""
    pieces, position = list[str](), 0
    while program_match := program.search(text, position):
        separator = _NEXT_COMMAND.search(text, program_match.end() + 1)
        end = len(text) if not separator else separator.start() + 3 * (separator[0] == "\n")
        option_match = option.search(text, program_match.end(), end)
        value = _ONE_VALUE.match(text, option_match.end()) if option_match else None
        if option_match is None or value is None:
            rest_begins = option_match.end() if option_match else end
            pieces.append(text[position:rest_begins])
            position = rest_begins
        else:
            pieces += (text[position : option_match.end()], value[1], MASK)
            position = value.end()
    return "".join([*pieces, text[position:]])


def _list(items: list[Any]) -> list[Any]:
    """Mask the item after the name of a secret option."""
    words = [item for item in items if isinstance(item, str)]
    named = [f"{word.rpartition('/')[2]} " for word in words]
    short = tuple(o for p, (o, _) in _SHORT.items() if any((m := p.match(n)) and m.end() == len(n) - 1 for n in named))

    def shown(name: Any, item: Any) -> Any:
        if isinstance(name, str) and name.startswith("-") and (name in short or is_secret_name(name)):
            return MASK
        if isinstance(item, str) and item.startswith(short) and item not in short:
            return item[:2] + MASK
        return masked("", item)

    return [shown(name, item) for name, item in zip([None, *items], items, strict=False)]


# -- by value --------------------------------------------------------------------------------------------------

ASKED = re.compile(
    r"request '[A-Za-z0-9_.:-]{1,64}'|requested by [\w.-]{1,128} \([A-Za-z0-9_.:-]{1,64}\)|"
    r"is lost to [\w.-]{1,128}/[A-Za-z0-9_.:-]{1,64}(?:, [\w.-]{1,128}/[A-Za-z0-9_.:-]{1,64}){0,100}"
)
"""How rorg quotes requests. Their ids were chosen by callers: masking one would tell its caller that it equals a
secret."""
CITED = frozenset(("id", "request", "requested", "requester", "requests", "service", "services"))
"""JSON keys whose values are request ids and names."""


class Masker:
    """Replaces known secret values by ***."""

    def __init__(self) -> None:
        self._known: dict[str, None] = {}
        """Values, most recent last."""
        self._forms: tuple[str, ...] = ()
        """All spellings to look for, longest first."""
        self._parts: dict[str, Masker] = {}
        """Service -> masker with only its secrets; services of earlier trees first, at most KEPT of them."""
        self._names: tuple[str, ...] = ()
        """Names of services that other services manage and that contain a secret. They are shown anyway."""

    def learn(self, catalog: Catalog | None) -> None:
        """Mask the secrets of this tree too. A secret that is part of what rorg itself must say, such as a service name
        or a file name of the tree, cannot be masked."""
        if catalog is None:
            return
        managed = {n for n in catalog.services if any(s.manages(n) for s in catalog.services.values())}
        sayable = "\n".join(_said(catalog, managed))
        to_mask = {s for s in secrets(catalog) if not _WORD.fullmatch(s) and s not in sayable}
        self._look_for(to_mask)
        for name, service_secrets in _own_secrets(catalog).items():
            service_masker = self._parts.pop(name, None) or Masker()
            service_masker._look_for(service_secrets & to_mask)
            self._parts[name] = service_masker
        past = [*self._parts][: -len(catalog.services) or None]
        for name in past[:-KEPT]:
            del self._parts[name]
        self._names = tuple(name for name in managed if any(form in name for form in self._forms))

    def _look_for(self, values: set[str]) -> None:
        if not values <= self._known.keys():
            others = [s for s in self._known if s not in values]
            self._known = dict.fromkeys([*others[-KEPT:], *sorted(values)])
            self._forms = forms(self._known)

    def of(self, service: object, unknown: Masker | None = None) -> Masker:
        """Return the masker for texts of one service. It knows only that service's secrets: otherwise a service could
        print guesses and see which of them are masked. `unknown` is used for services of no known tree."""
        return self._parts.get(service, unknown or self) if isinstance(service, str) else self

    def text(self, text: str) -> str:
        """Return the text as it may be shown."""
        if not any(form in text for form in self._forms):
            return text
        protected = [match[0] for match in ASKED.finditer(text)] + [name for name in self._names if name in text]
        for index, words in enumerate(protected):
            text = text.replace(words, f"\ue000{index}\ue001")
        text = hidden(text, self._forms)
        for index, words in reversed([*enumerate(protected)]):
            text = text.replace(f"\ue000{index}\ue001", words)
        return text

    def value(self, value: Any) -> Any:
        """Return plain JSON as it may be shown; keys of mappings are never masked."""
        if isinstance(value, str):
            return self.text(value)
        if isinstance(value, Mapping) and self._forms:
            return {key: item if _cited(key, item) else self.value(item) for key, item in value.items()}
        return [self.value(item) for item in value] if isinstance(value, list | tuple) and self._forms else value

    def json(self, text: str) -> str:
        """Return JSON text as it may be shown, with its trailing white space. It is parsed only if it contains a
        secret."""
        if not any(form in text for form in self._forms):
            return text
        try:
            return json.dumps(self.value(json.loads(text))) + text[len(text.rstrip()) :]
        except ValueError:
            return self.text(text)

    @property
    def knows(self) -> bool:
        """Whether there is anything to mask."""
        return bool(self._forms)


def _cited(key: Any, item: Any) -> bool:
    """Return whether a value is an id or a name, or a list of them."""
    items = item if isinstance(item, list) else [item]
    return key in CITED and all(isinstance(each, str) for each in items)


def _own_secrets(catalog: Catalog) -> dict[str, set[str]]:
    """Return service -> its secrets, including those of the Images it is built from."""
    secrets_by_service = {}
    for service in catalog.services.values():
        service_secrets = {*secrets_of(service.options, service.secrets)}
        pending, seen_images = [str(service.options.get("image", ""))], set[str]()
        while pending:
            image = catalog.images.get(declared(pending.pop(), catalog.images) or "")
            if image is not None and image.name not in seen_images:
                seen_images.add(image.name)
                pending += image.bases
                service_secrets |= {image.args[name] for name in image.secrets}
        service_secrets |= set(secret_texts("", service.ros.values)) if service.ros else set()
        secrets_by_service[service.name] = service_secrets
    return secrets_by_service


def secrets(catalog: Catalog) -> set[str]:
    """Return all secret values, without those too short to be distinguished from ordinary text."""
    of_images = {image.args[name] for image in catalog.images.values() for name in image.secrets}
    return {value for value in of_images.union(*_own_secrets(catalog).values()) if len(value) >= SHORTEST_SECRET}


def secrets_of(spec: Spec, names: Iterable[str]) -> list[str]:
    """Return the values of these environment variables."""
    environment = spec.get("environment", {})
    return [environment[name] for name in names if environment.get(name)]


def forms(values: Iterable[str]) -> tuple[str, ...]:
    """Return every spelling of these values to look for: plain, and as JSON, YAML, shells and URLs write them; also
    every single line."""
    spellings: set[str] = set()
    for value in values:
        for text in {value, *value.splitlines()}:
            variants = {text, text.strip(), " ".join(text.split()), text.replace("'", "''")}
            spellings |= variants | {
                json.dumps(text)[1:-1],
                json.dumps(text, ensure_ascii=False)[1:-1],
                repr(text)[1:-1],
            }
            spellings |= {shlex.quote(text).strip("'"), quote(text), quote(text, safe="")}
    return tuple(sorted((f for f in spellings if len(f) >= SHORTEST_SECRET), key=lambda f: (-len(f), f)))


def hidden(text: str, values: Iterable[str]) -> str:
    """Return the text with these values masked. Pass longer ones first, or a part of a longer value would remain."""
    for value in values:
        if value in text:
            text = text.replace(value, MASK)
    return text


def _said(catalog: Catalog, managed: Collection[str]) -> Iterable[str]:
    """Return the texts that rorg must be able to say about a tree. Names chosen by managed services are left out, so
    that none of them can expose a secret by declaring it as a name."""
    yield from catalog.services.keys() - set(managed)
    yield from catalog.groups
    yield from catalog.images
    for service in catalog.services.values():
        if service.name in managed:
            continue
        yield from (service.where.file, service.container_name, str(service.options.get("image", "")))
    for image in catalog.images.values():
        yield from (image.where.file, image.context or "", image.reference, *image.bases)
