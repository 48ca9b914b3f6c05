"""A program that brings its own service. In a container, its manifest must say `may_manage: [lab-*]`."""

from __future__ import annotations

import sys

import rorg_client as rorg


def main(name: str, image: str, *command: str) -> None:
    client = rorg.client()
    client.put_service(name, {"image": image, "command": list(command), "idle": {"action": "remove"}})
    try:
        with client.request(name, wait=60):
            print(client.service(name)["state"])
    finally:
        client.remove_service(name)


if __name__ == "__main__":
    main(*sys.argv[1:])
