"""A client certificate that its authority has revoked is worth nothing, from the moment that the list says so."""

from __future__ import annotations

import contextlib
import http.client
import ssl
import subprocess
from pathlib import Path

import pytest
from certificates import certificate
from common import free_port, wait_for
from rorg_process import RorgProcess
from tools import tool

CONFIG = """[ca]
default_ca = here
[here]
database = index
crlnumber = number
default_md = sha256
default_crl_days = 2
"""


def revoke(folder: Path, *names: str) -> None:
    """Writes the list of these, and of those that were revoked before."""
    if not (folder / "index").exists():
        (folder / "index").write_text("")
        (folder / "number").write_text("01\n")
        (folder / "ca.conf").write_text(CONFIG)
    ca = [tool("openssl"), "ca", "-config", "ca.conf", "-keyfile", "authority.key", "-cert", "authority.pem"]
    for name in names:
        subprocess.run([*ca, "-revoke", f"{name}.pem"], cwd=folder, check=True, capture_output=True)
    subprocess.run([*ca, "-gencrl", "-out", "new.pem"], cwd=folder, check=True, capture_output=True)
    (folder / "new.pem").replace(folder / "revoked.pem")


def connection(folder: Path, port: int, who: str) -> http.client.HTTPSConnection:
    context = ssl.create_default_context(cafile=str(folder / "authority.pem"))
    context.load_cert_chain(folder / f"{who}.pem", folder / f"{who}.key")
    return http.client.HTTPSConnection("127.0.0.1", port, context=context, timeout=60)


def status(asked: http.client.HTTPSConnection) -> int:
    """Of a call; 0 if rorg does not talk to this one."""
    try:
        asked.request("GET", "/v1/services")
        answer = asked.getresponse()
        answer.read()
        return answer.status
    except (OSError, http.client.HTTPException):
        return 0


def options(folder: Path, port: int) -> list[str]:
    files = {"cert": "robot.pem", "key": "robot.key", "ca": "authority.pem", "revoked": "revoked.pem"}
    tls = [word for kind, file in files.items() for word in (f"--tls-{kind}", str(folder / file))]
    return ["--listen", f"127.0.0.1:{port}", *tls]


@pytest.mark.slow
def test_a_revoked_certificate_is_refused_at_once_and_its_connections_end(tmp_path):
    for name, authority in (("authority", ""), ("robot", "authority"), ("ada", "authority"), ("bob", "authority")):
        certificate(tmp_path, name, authority)
    revoke(tmp_path)
    port = free_port()
    robot = RorgProcess(tmp_path, {"camera": {}}, *options(tmp_path, port)).start()
    try:
        wait_for(lambda: status(connection(tmp_path, port, "bob")) == 200)
        ada = connection(tmp_path, port, "ada")
        assert status(ada) == 200
        kept = ada.sock
        revoke(tmp_path, "ada")
        wait_for(lambda: status(connection(tmp_path, port, "ada")) == 0)
        assert kept is not None
        kept.settimeout(20)
        with contextlib.suppress(OSError):  # a reset is an end too
            assert kept.recv(1) == b""
        wait_for(lambda: status(connection(tmp_path, port, "bob")) == 200)
        (tmp_path / "revoked.pem").write_text("no list\n")
        wait_for(lambda: "the previous certificates stay in use" in robot.told())
        assert status(connection(tmp_path, port, "ada")) == 0
        assert status(connection(tmp_path, port, "bob")) == 200
    finally:
        robot.close()


def test_rorg_does_not_begin_without_the_list_that_it_is_given(tmp_path):
    for name, authority in (("authority", ""), ("robot", "authority")):
        certificate(tmp_path, name, authority)
    robot = RorgProcess(tmp_path, {"camera": {}}, *options(tmp_path, free_port())).start()
    assert robot.process is not None
    try:
        assert robot.process.wait(60) == 2
        assert "the certificates cannot be read" in robot.told()
    finally:
        robot.closed = True
