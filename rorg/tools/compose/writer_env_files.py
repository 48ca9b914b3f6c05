"""Files of variables beside a Compose file: one for each service, and one for variables that several share."""

from __future__ import annotations

from collections.abc import Mapping

Variables = dict[str, str]


def env_files(secrets: Mapping[str, Mapping[str, str]]) -> dict[str, dict[str, Variables]]:
    """Service -> file -> variables. `secrets`: service -> variables with their values. Each variable is in exactly one
    file of a service: that of all services with the same value of it."""
    users: dict[tuple[str, str], list[str]] = {}
    for service, values in sorted(secrets.items()):
        for pair in values.items():
            users.setdefault(pair, []).append(service)
    parts: dict[tuple[str, ...], Variables] = {}
    for (name, value), sharing in users.items():
        parts.setdefault(tuple(sharing), {})[name] = value
    by_service: dict[str, dict[str, Variables]] = {}
    count = 0
    for services, values in sorted(parts.items()):
        file = services[0]
        while len(services) > 1 and file in secrets:
            count += 1
            file = "shared" if count == 1 else f"shared-{count}"
        for service in services:
            by_service.setdefault(service, {})[f"{file}.env"] = values
    return by_service
