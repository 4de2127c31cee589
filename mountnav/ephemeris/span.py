"""From when to when an ephemeris holds: nothing is answered outside of it."""

from __future__ import annotations

from datetime import UTC, datetime

from mountnav.errors import BadRequest


def require_within(
    name: str, utc: datetime, begins: datetime | None, ends: datetime | None, why: str = ""
) -> None:
    """Refuse an instant outside of a span.

    Parameters
    ----------
    name : str
        Of the target.
    utc : datetime
        Aware.
    begins, ends : datetime or None
        None: any time.
    why : str
        What makes the span, for the message.

    Raises
    ------
    BadRequest
        It is naive, or outside.
    """
    require_aware(utc)
    if begins is not None and utc < begins:
        raise BadRequest(f"{name} begins at {told(begins)}{why}, and {told(utc)} is before that")
    if ends is not None and utc > ends:
        raise BadRequest(f"{name} ends at {told(ends)}{why}, and {told(utc)} is after that")


def require_aware(utc: datetime) -> None:
    """Refuse an instant that doesn't say its time zone. Raises BadRequest."""
    if utc.utcoffset() is None:
        raise BadRequest(
            f"the instant {utc.isoformat()} doesn't say its time zone",
            advice="give UTC, for example 2026-11-21T22:00:00Z",
        )


def told(utc: datetime) -> str:
    """An instant for messages: UTC to the second."""
    return f"{utc.astimezone(UTC):%Y-%m-%d %H:%M:%S} UTC"
