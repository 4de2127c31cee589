"""A certificate that the service makes for itself: one way for its own port and for the nova API's.

Key and certificate lie in the folder of the service's state, for their owner alone; the certificate also in a
file without the key, to be installed where it is to be trusted.
"""

from __future__ import annotations

import ipaddress
import os
import socket
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING

from mountnav.errors import BadSettings
from mountnav.files import FILE_MODE, FOLDER_MODE, replace_bytes

if TYPE_CHECKING:
    from cryptography.x509 import GeneralName

__all__ = ["own_certificate"]

_VALID_DAYS = 800
"""How long a certificate is valid, days: below the 825 that Apple's systems take at most."""
_RENEWED_DAYS = 30
"""One that ends within so many days is made again, also while the service runs. Doubled, a month earlier."""
_SLOW_CLOCK_DAYS = 1
"""It is valid from so many days before its making, for clients whose clocks are behind."""


def own_certificate(folder: Path, host: str, name: str = "nova") -> tuple[Path, str]:
    """The service's own certificate, made if there is none that is good any more.

    Parameters
    ----------
    folder : Path
        Of the service's state.
    host : str
        Where it listens; named in the certificate, besides localhost and this machine's name.
    name : str
        Whose it is: of the files, ``NAME-tls.pem`` and ``NAME-tls.crt``, and in the certificate.

    Returns
    -------
    Path
        Of a PEM file with key and certificate, mode 0600.
    str
        SHA-256 fingerprint of the certificate, as browsers show it.

    Raises
    ------
    BadSettings
        The package `cryptography` is missing, or the files can't be written.
    """
    try:
        from cryptography import x509
        from cryptography.hazmat.primitives import hashes, serialization
        from cryptography.hazmat.primitives.asymmetric import ec
        from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID
    except ImportError as missing:
        raise BadSettings(
            "a certificate of its own needs the package cryptography",
            device=name,
            advice='install mountnav[tls], or name a certificate of yours with tls = "files"',
        ) from missing
    path, public_path = folder / f"{name}-tls.pem", folder / f"{name}-tls.crt"
    now = datetime.now(UTC)
    names = _names(host)
    try:
        known = x509.load_pem_x509_certificate(path.read_bytes())
        told = known.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        there = {str(one.value) for one in told}
        if known.not_valid_after_utc > now + timedelta(days=_RENEWED_DAYS) and there >= set(names):
            path.chmod(FILE_MODE)
            return path, _fingerprint(known.fingerprint(hashes.SHA256()))
    except (OSError, ValueError, x509.ExtensionNotFound):
        pass  # none yet, or none that can be used: it is made again
    key = ec.generate_private_key(ec.SECP256R1())
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, f"mountnav {name}")])
    made = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(subject)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - timedelta(days=_SLOW_CLOCK_DAYS))
        .not_valid_after(now + timedelta(days=_VALID_DAYS))
        .add_extension(x509.SubjectAlternativeName([_general_name(name) for name in names]), critical=False)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH]), critical=False)
        .sign(key, hashes.SHA256())
    )
    public = made.public_bytes(serialization.Encoding.PEM)
    secret = key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=FOLDER_MODE)
        # closed to others before the secret is in it
        os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, FILE_MODE))
        path.chmod(FILE_MODE)
        replace_bytes(path, secret + public)
        replace_bytes(public_path, public)
    except OSError as fault:
        raise BadSettings(
            f"the certificate can't be written: {fault.strerror}",
            device=str(path),
            advice="run this as the user that runs the service",
        ) from fault
    return path, _fingerprint(made.fingerprint(hashes.SHA256()))


def _names(host: str) -> list[str]:
    """Names and addresses under which the service may be reached."""
    names = ["localhost", "127.0.0.1", "::1", socket.gethostname() or "localhost", host]
    return list(dict.fromkeys(name for name in names if name not in ("0.0.0.0", "::") and name.isascii()))


def _general_name(name: str) -> GeneralName:
    from cryptography import x509

    try:
        return x509.IPAddress(ipaddress.ip_address(name))
    except ValueError:
        return x509.DNSName(name)


def _fingerprint(digest: bytes) -> str:
    return digest.hex(":").upper()
