"""`rorg fleet status` of robots of which many answer something odd: each is one row, and none delays the others."""

from __future__ import annotations

import gzip
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator

import pytest
from computers import Team
from hosts import HTTP, Host, Say, endless, said, with_certificate

SUMMARY = {
    **{"robot": "", "machine": "", "revision": "abc", "standing": "good", "reason": "", "health": {"Healthy": 2}},
    **{"degraded": [], "drift": 0, "engine": "", "down": ""},
}
TIMEOUT, STARTING = 2.0, 15.0
"""Seconds for each robot; seconds for the command besides, on a machine that is busy."""


def ok(body: bytes, *headers: bytes) -> Say:
    head = b"\r\n".join([b"HTTP/1.1 200 OK", b"Content-Length: %d" % len(body), *headers, b"", b""])
    return said(head + body)


def summary(**more: object) -> Say:
    return ok(json.dumps({**SUMMARY, **more}).encode())


def dripped_body() -> Iterator[bytes]:
    yield b"HTTP/1.1 200 OK\r\nContent-Length: 60000\r\n\r\n"
    while True:
        threading.Event().wait(0.2)
        yield b" "


CHUNKED = b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n"
ODD: dict[str, Say] = {
    **HTTP,
    "json-null": ok(b"null"),
    "list": ok(b"[]"),
    "text": ok(b'"fine"'),
    "empty": ok(b""),
    "object": ok(b"{}"),
    "deep": ok(b"[" * 30_000),
    "deep-health": ok(json.dumps(SUMMARY).replace('{"Healthy": 2}', '{"a":' * 5000 + "1" + "}" * 5000).encode()),
    "health-list": summary(health=[1]),
    "health-null": summary(health=None),
    "degraded-numbers": summary(degraded=[1, None]),
    "standing-object": summary(standing={}),
    "engine-list": summary(engine=["down"]),
    "digits": ok(json.dumps(SUMMARY).replace('"drift": 0', '"drift": ' + "9" * 5000).encode()),
    "nan": ok(json.dumps(SUMMARY).replace('"drift": 0', '"drift": NaN').encode()),
    "surrogate": ok(json.dumps(SUMMARY).replace('"abc"', '"\\ud800"').encode()),
    "latin-1": ok(json.dumps(SUMMARY).replace("abc", "gr\u00fcn").encode("unicode_escape").replace(b"\\xfc", b"\xfc")),
    "gzip": ok(gzip.compress(json.dumps(SUMMARY).encode()), b"Content-Encoding: gzip"),
    "redirect": said(b"HTTP/1.1 302 Found\r\nLocation: https://127.0.0.1:1/\r\nContent-Length: 0\r\n\r\n"),
    "redirect-loop": said(b"HTTP/1.1 308 X\r\nLocation: /v1/summary\r\nContent-Length: 0\r\n\r\n"),
    "error-list": said(b"HTTP/1.1 500 X\r\nContent-Length: 2\r\n\r\n[]"),
    "error-deep": said(b"HTTP/1.1 503 X\r\nContent-Length: 30000\r\n\r\n" + b"[" * 30_000),
    "too-short": said(b"HTTP/1.1 200 OK\r\nContent-Length: 9999\r\n\r\n{}"),
    "length-huge": said(b"HTTP/1.1 200 OK\r\nContent-Length: 999999999999\r\n\r\n{}"),
    "length-negative": said(b"HTTP/1.1 200 OK\r\nContent-Length: -1\r\n\r\n{}"),
    "length-text": said(b"HTTP/1.1 200 OK\r\nContent-Length: many\r\n\r\n{}"),
    "chunk-text": said(CHUNKED + b"zz\r\n{}\r\n"),
    "chunk-huge": said(CHUNKED + b"F" * 40 + b"\r\n{}"),
    "chunks": endless(CHUNKED, b"1\r\n \r\n" * 1000),
    "not-http": said(b"SSH-2.0-OpenSSH_9.2\r\n"),
    "status-text": said(b"HTTP/1.1 fine OK\r\n\r\n"),
    "nothing": said(b""),
    "body": endless(b"HTTP/1.1 200 OK\r\n\r\n", b"x" * 65536),
    "dripped-body": dripped_body,
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """With certificates."""
    made = tmp_path_factory.mktemp("fleet")
    Team(made, {"camera": {"image": "host", "command": "true", "machine": "base"}}, ("base",))
    return made


@pytest.mark.slow
def test_each_robot_is_one_row_whatever_it_answers(folder):
    tls = with_certificate(folder / "certificates", "base")
    long = summary(reason="x" * 50_000, health={"\x1b[31m\n": 1})
    hosts = {name: Host(say, tls) for name, say in {**ODD, "good": summary(), "long": long}.items()}
    robots = {name: f"https://127.0.0.1:{host.port}" for name, host in hosts.items()}
    (folder / "robots.yaml").write_text("".join(f"{name}: {at}\n" for name, at in robots.items()))
    authority = str(folder / "certificates/authority.pem")
    environment = {**os.environ, "RORG_CA": authority, "XDG_STATE_HOME": str(folder)}
    command = [sys.executable, "-m", "rorg", "fleet", "status", str(folder / "robots.yaml"), "--timeout", "2s"]
    try:
        for form in ("json", "table"):
            began = time.monotonic()
            done = subprocess.run([*command, "-o", form], env=environment, capture_output=True, text=True, timeout=60)
            assert time.monotonic() - began < TIMEOUT + STARTING
            assert done.returncode == 0, done.stderr
            if form == "table":
                names = [line.split()[0] for line in done.stdout.splitlines()[1:]]
                assert names == list(robots)
                assert max(map(len, done.stdout.splitlines())) < 1000
            else:
                rows = {row["name"]: row for row in json.loads(done.stdout)}
                assert list(rows) == list(robots)
                assert [name for name, row in rows.items() if not row["error"]] == ["good", "long"]
                assert rows["good"]["health"] == {"Healthy": 2}
    finally:
        for host in hosts.values():
            host.close()
