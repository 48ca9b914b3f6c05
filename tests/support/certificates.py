"""Certificates for tests of TLS."""

from __future__ import annotations

import subprocess

from tools import tool


def certificate(folder, name: str, authority: str = "") -> None:
    """NAME.pem and NAME.key, signed by the authority, or by itself."""

    def openssl(*args: str) -> None:
        subprocess.run([tool("openssl"), *args], cwd=folder, check=True, capture_output=True)

    kind, out = ("-new", f"{name}.csr") if authority else ("-x509", f"{name}.pem")
    openssl(
        "req",
        kind,
        "-newkey",
        "rsa:2048",
        "-nodes",
        "-keyout",
        f"{name}.key",
        "-out",
        out,
        "-subj",
        f"/CN={name}",
        "-days",
        "2",
    )
    if authority:
        (folder / "names").write_text("subjectAltName=IP:127.0.0.1\n")
        openssl(
            "x509",
            "-req",
            "-in",
            f"{name}.csr",
            "-CA",
            f"{authority}.pem",
            "-CAkey",
            f"{authority}.key",
            "-out",
            f"{name}.pem",
            "-days",
            "2",
            "-CAcreateserial",
            "-extfile",
            "names",
        )
