"""What commands do in one way: JSON, files that can't be used, a service that doesn't answer."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from mountnav.errors import BadRequest, DeviceMissing


def finite_or_none(value: float | None) -> float | None:
    """A number as JSON can hold it: None for NaN and infinities."""
    return float(value) if value is not None and math.isfinite(value) else None


def print_json(
    value: object, *, indent: int | None = None, ascii_only: bool = True, compact: bool = False
) -> None:
    """Print JSON and a line end on the standard output.

    Parameters
    ----------
    value : object
        Of plain values. A NaN or an infinity becomes null: JSON has neither.
    indent : int, optional
        All on one line without it.
    ascii_only : bool
        Write other characters as escapes; else as they are.
    compact : bool
        Leave out the spaces between the parts.
    """
    text = json.dumps(
        json_ready(value),
        indent=indent,
        ensure_ascii=ascii_only,
        separators=(",", ":") if compact else None,
        allow_nan=False,
    )
    sys.stdout.write(text + "\n")


def json_ready(value: Any) -> Any:
    """Plain values as JSON can hold them: null for NaN and infinities, at any depth."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: json_ready(element) for key, element in value.items()}
    if isinstance(value, list | tuple):
        return [json_ready(element) for element in value]
    return value


def reason_of(error: OSError) -> str:
    """What the system says of a file, without its name."""
    return error.strerror or str(error)


def unreadable(error: OSError) -> str:
    """Why a frame wasn't read: one of several that are worked on, so it ends nothing."""
    return f"the file can't be read: {reason_of(error)}"


@contextmanager
def refusing_os_errors(what: str, *, advice: str | None = None) -> Iterator[None]:
    """Turn an `OSError` into a `BadRequest` that says `what` and the reason."""
    try:
        yield
    except OSError as error:
        raise BadRequest(f"{what}: {reason_of(error)}", advice=advice) from error


@contextmanager
def answering(service: str) -> Iterator[None]:
    """Calls to a running service. Raises `DeviceMissing` where none answers."""
    import httpx

    try:
        yield
    except httpx.HTTPError as error:
        raise DeviceMissing(
            f"no mountnav service answers: {error}", device=service, advice="start it, or give --service"
        ) from error
