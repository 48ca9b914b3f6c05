"""Certificates for the machines of a robot and for people, by the `openssl` command: an authority of the robot's own,
and a certificate that it signs for each of them."""

from __future__ import annotations

import contextlib
import ipaddress
import os
import secrets
import subprocess
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from rorg.errors import Invalid, Refused
from rorg.store.files import locked, make_directory, write_atomic

AUTHORITY, REVOKED, INDEX = "authority", "revoked", "index.txt"
CURVE = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes")
DAYS = 825
"""The longest that clients of all systems accept."""
YEARS = 3650
"""Days of the authority itself, and of the list of revoked certificates."""
PATIENCE = 60.0
PRIVATE = 0o600


@dataclass(frozen=True, slots=True)
class Authority:
    """A directory with an authority and what it has signed."""

    path: Path

    @property
    def certificate(self) -> Path:
        return self.path / f"{AUTHORITY}.pem"

    @property
    def revoked(self) -> Path:
        return self.path / f"{REVOKED}.pem"

    def files(self, name: str) -> tuple[Path, Path]:
        """The certificate and the key of a name."""
        return self.path / f"{name}.pem", self.path / f"{name}.key"

    def prepare(self) -> bool:
        """Make the authority if there is none; return whether one was made. Raises Invalid."""
        certificate, key = self.files(AUTHORITY)
        if certificate.exists() and key.exists():
            return False
        if key.exists() or certificate.exists():
            raise Invalid(
                f"use {self.path}", "half of the authority is missing", "to put it back, or another directory"
            )
        make_directory(self.path, 0o700)
        usage = ("-addext", "keyUsage=critical,keyCertSign,cRLSign", "-addext", "basicConstraints=critical,CA:TRUE")
        subject = ("-subj", f"/CN=rorg authority {secrets.token_hex(4)}")
        with self._private(key) as made, self._private(certificate) as signed:
            _openssl("req", "-x509", *CURVE, "-keyout", made, "-out", signed, "-days", YEARS, *usage, *subject)
        write_atomic(self.path / INDEX, "")
        write_atomic(self.path / ".gitignore", "*\n")  # no key belongs in a repository
        self._list()
        return True

    def due(self, name: str, hosts: tuple[str, ...] = ()) -> bool:
        """Whether a certificate is missing, is for another address, or has spent two thirds of its time."""
        certificate, key = self.files(name)
        if not (certificate.exists() and key.exists()):
            return True
        left = subprocess.run(
            ["openssl", "x509", "-in", certificate, "-noout", "-checkend", str(DAYS * 86400 // 3)],
            capture_output=True,
            timeout=PATIENCE,
        )
        told = _openssl("x509", "-in", certificate, "-noout", "-ext", "subjectAltName") if hosts else ""
        return left.returncode != 0 or any(host not in told for host in hosts)

    def sign(self, name: str, common_name: str, hosts: tuple[str, ...] = ()) -> None:
        """Make a key and a certificate. With `hosts` it is also that of a server at these names and addresses."""
        certificate, key = self.files(name)
        names = ",".join(f"{'IP' if _is_address(host) else 'DNS'}:{host}" for host in hosts)
        usage = "extendedKeyUsage=clientAuth" + (f",serverAuth\nsubjectAltName={names}" if hosts else "")
        with (
            self._private(key) as made,
            self._private(certificate) as signed,
            tempfile.TemporaryDirectory(prefix="rorg-certificate-") as folder,
        ):
            asked, extensions = Path(folder) / "request.pem", Path(folder) / "extensions"
            extensions.write_text(f"basicConstraints=critical,CA:FALSE\n{usage}\n", encoding="ascii")
            _openssl("req", "-new", *CURVE, "-keyout", made, "-out", asked, "-subj", f"/CN={common_name}")
            authority = ("-CA", self.certificate, "-CAkey", self.files(AUTHORITY)[1])
            serial = ("-set_serial", f"0x{secrets.token_hex(16)}", "-days", DAYS, "-extfile", extensions)
            _openssl("x509", "-req", "-in", asked, "-out", signed, *authority, *serial)

    def revoke(self, name: str) -> None:
        """Put a certificate on the list of revoked ones, and remove it. Raises Invalid if there is none."""
        certificate, key = self.files(name)
        if not certificate.exists() or name == AUTHORITY:
            raise Invalid(f"revoke the certificate of {name}", f"there is no {certificate}", f"`ls {self.path}`")
        self._ca("-revoke", certificate)
        self._list()
        certificate.unlink()
        key.unlink(missing_ok=True)

    def _list(self) -> None:
        with self._private(self.revoked) as made:
            self._ca("-gencrl", "-out", made)

    def _ca(self, *words: object) -> None:
        with tempfile.TemporaryDirectory(prefix="rorg-certificate-") as folder:
            settings = Path(folder) / "ca.cnf"
            told = f"[ca]\ndefault_ca=d\n[d]\ndatabase={self.path.resolve() / INDEX}\ndefault_md=sha256\n"
            settings.write_text(f"{told}default_crl_days={YEARS}\n", encoding="utf-8")
            authority = ("-cert", self.certificate, "-keyfile", self.files(AUTHORITY)[1])
            _openssl("ca", "-config", settings, *authority, *words)

    @contextlib.contextmanager
    def locked(self) -> Iterator[None]:
        """One command at a time changes the directory."""
        make_directory(self.path, 0o700)
        with locked(self.path / ".lock"):
            yield

    @contextlib.contextmanager
    def _private(self, path: Path) -> Iterator[Path]:
        """A new file that takes the place of `path` when the block ends, and that only this user can read."""
        temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, PRIVATE))
        try:
            yield temporary
            os.replace(temporary, path)
        finally:
            temporary.unlink(missing_ok=True)


def _is_address(host: str) -> bool:
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return True


def _openssl(*words: object) -> str:
    """The output of an openssl command. Raises Invalid without openssl, and Refused with its first complaint."""
    try:
        done = subprocess.run(
            ["openssl", *map(str, words)],
            capture_output=True,
            text=True,
            errors="replace",
            timeout=PATIENCE,
            check=True,
        )
    except FileNotFoundError:
        raise Invalid("make certificates", "the command openssl is missing", "`sudo apt install openssl`") from None
    except subprocess.TimeoutExpired:
        raise Refused("make certificates", f"openssl has not ended within {PATIENCE:g} s") from None
    except subprocess.CalledProcessError as error:
        why = next((line for line in error.stderr.splitlines() if "rror" in line), error.stderr.strip()[-200:])
        raise Refused("make certificates", f"openssl: {why}") from error
    return done.stdout
