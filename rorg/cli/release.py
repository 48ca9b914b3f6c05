"""rorg release"""

from __future__ import annotations

from typing import Annotated

from rorg.cli.options import Argument, Option, StateDirectory
from rorg.cli.output import echo


def command(
    id: Annotated[str, Argument(help="Id of the request.")],
    requester: Annotated[str, Option(names=("--as",), help="Its requester, where several use the same id.")] = "",
    state_dir: StateDirectory = None,
) -> None:
    """Give a request up. Releasing what is already released is fine."""
    from rorg.cli.context import Context
    from rorg.cli.output import note
    from rorg.errors import Invalid

    released: list[str] = []
    client = Context(state_dir, None).client()
    if client:
        found = [
            r["requester"]
            for r in client.requests()
            if r["id"] == id and not r["standing"] and requester in ("", r["requester"])
        ]
        if len(found) > 1:
            raise Invalid(
                f"release '{id}'", f"{' and '.join(sorted(found))} have a request of that id", "--as REQUESTER"
            )
        for name in found:
            client.release(id, name)
            echo(f"request '{id}' of {name} released")
        if not found:
            note(f"there is no request '{id}'; nothing to release")
        return

    from rorg.store.requests_document import RequestsDocument
    from rorg.store.requests_file import RequestsFile
    from rorg.store.state_dir import StateDir, default_state_dir

    def edit(document: RequestsDocument) -> RequestsDocument:
        keys = {r.key for r in document.requests if r.id == id and requester in ("", r.requester)}
        if len(keys) > 1:
            raise Invalid(
                f"release '{id}'",
                f"{' and '.join(sorted(k[0] for k in keys))} have a request of that id",
                "--as REQUESTER",
            )
        released[:] = [k[0] for k in keys]
        return document.without(keys)

    RequestsFile(StateDir(state_dir or default_state_dir()).prepare().requests).change(edit)
    if released:
        echo(f"request '{id}' of {released[0]} released")
    else:
        note(f"there is no request '{id}'; nothing to release")
