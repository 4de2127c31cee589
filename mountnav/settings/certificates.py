"""What is asked of a port's certificate files, for all sections that have them."""

from __future__ import annotations

from pathlib import Path

from pydantic_core import PydanticCustomError

__all__ = ["require_certificate_files"]


def require_certificate_files(tls: str, certificate: Path | None, key: Path | None) -> None:
    """Raise `PydanticCustomError` unless both files are named with ``files``, and none otherwise."""
    named = certificate is not None, key is not None
    if (tls == "files") != all(named) or (tls != "files" and any(named)):
        raise PydanticCustomError(
            "certificate_files",
            "tls = {tls} with certificate and certificate_key {named}",
            {
                "tls": repr(tls),
                "named": "named" if all(named) else "not both named",
                "key": "tls",
                "fix": 'tls = "files" with both of them, or tls = "self" or "off" without',
            },
        )
