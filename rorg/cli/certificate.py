"""rorg certificate"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rorg.cli.kinds import DIRECTORY
from rorg.cli.options import Output, TreeAlone
from rorg.cli.output import print_rows
from rorg.errors import Invalid

if TYPE_CHECKING:
    from rorg.host.certificates import Authority
    from rorg.model.catalog import Catalog

Folder = Annotated[
    Path,
    typer.Option(
        "--into", help="Directory of the authority and its certificates.", metavar="DIR", click_type=DIRECTORY
    ),
]


def command(
    context: TreeAlone,
    *,
    into: Folder = Path("certificates"),
    person: Annotated[
        str, typer.Option(help="Make a certificate for a person, who may then do everything.", metavar="NAME")
    ] = "",
    revoke: Annotated[str, typer.Option(help="Revoke the certificate of this machine or person.", metavar="NAME")] = "",
    output: Output = "table",
) -> None:
    """Make the certificates by which the machines of a robot know each other: an authority, and one for each Machine.
    Run it again to renew them; a certificate is renewed when a third of its time is left.

    Example: rorg certificate manifests
    """
    from rorg.host.certificates import Authority

    if person and revoke:
        raise Invalid("make certificates", "--person and --revoke are mutually exclusive", "one of them")
    authority = Authority(into)
    with authority.locked():
        rows = [_row(authority, "authority", "made")] if authority.prepare() else []
        if revoke:
            authority.revoke(revoke)
            rows.append({"name": revoke, "done": "revoked", "file": str(authority.revoked)})
        elif person:
            _check(person)
            authority.sign(person, person)
            rows.append(_row(authority, person, "made"))
        else:
            rows += _machines(authority, context.catalog())
    print_rows(rows, output, ("name", "done", "file"))


def _machines(authority: Authority, catalog: Catalog) -> list[dict[str, str]]:
    if not catalog.machines:
        raise Invalid(
            "make certificates", "the manifests declare no Machine", "`rorg explain Machine`, or --person NAME"
        )
    rows = []
    for name, machine in catalog.machines.items():
        hosts = (machine.address.rpartition(":")[0].strip("[]"),)
        known = authority.files(name)[0].exists()
        due = authority.due(name, hosts)
        if due:
            authority.sign(name, machine.certificate, hosts)
        rows.append(_row(authority, name, "renewed" if known and due else "made" if due else "unchanged"))
    return rows


def _row(authority: Authority, name: str, done: str) -> dict[str, str]:
    return {"name": name, "done": done, "file": str(authority.files(name)[0])}


def _check(name: str) -> None:
    """Raises Invalid for a name that a file or a certificate cannot have, or that is one of a machine."""
    from rorg.api.permissions import MACHINE

    if not name.replace("-", "").replace("_", "").isalnum() or len(name) > 40 or name.startswith(MACHINE):
        raise Invalid(f"make a certificate for '{name}'", "it is not a name of a person", "letters, digits, - and _")
