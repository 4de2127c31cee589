"""Where to point, as it is typed on a command line: a name, a position, a direction, or what moves.

A text is a position if it can be read as one, and a name else: the service knows the names.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from api.cli.output import refusing_os_errors
from mountnav.errors import BadRequest

if TYPE_CHECKING:
    from mountnav.client.targets import Target

LARGEST_FILE_BYTES = 1 << 20
"""Largest file that is read for a target, bytes: of a file of many bodies one is cut out, and the service
bounds what is sent. Doubled, a wrong file takes twice as long to be refused."""

RATES_HOURS = 12.0
"""How long a target by rates is one, hours: a night. Doubled, a straight line is taken for a way of a day."""


@dataclass(frozen=True, kw_only=True)
class MovingTargetOptions:
    """The options that name a target that moves."""

    target: Annotated[
        str | None,
        typer.Argument(
            metavar="[TARGET]", help="A name, or a position with both coordinates.", show_default=False
        ),
    ] = None
    tle: Annotated[
        Path | None, typer.Option("--tle", help="A satellite: a file of its two lines, or three.")
    ] = None
    elements: Annotated[
        Path | None, typer.Option("--elements", help="A comet or minor planet: a file of its elements.")
    ] = None
    table: Annotated[
        Path | None, typer.Option("--table", help="A table of places by time: Horizons, MPES, or CSV.")
    ] = None
    rates: Annotated[
        str | None,
        typer.Option(
            "--rates",
            metavar="RA,DEC",
            help="With a position: how it moves from now on, arcsec per second; RA not times cos(dec).",
        ),
    ] = None

    def chosen(self) -> Target:
        """The one target that was typed.

        Raises
        ------
        BadRequest
            None, more than one, or one that can't be read.
        """
        given = self._given()
        if len(given) > 1 or (given and self.rates is not None):
            also = ["--rates"] if self.rates else []
            raise BadRequest(f"more than one target: {', '.join(given + also)}", advice="name one")
        return self._read()

    def _given(self) -> list[str]:
        """The options that name a target by themselves, as far as they were given."""
        named = {"--tle": self.tle, "--elements": self.elements, "--table": self.table}
        return [name for name, path in named.items() if path is not None]

    def _read(self) -> Target:
        from mountnav.client import targets

        text, rates = self.target, self.rates
        if self.tle is not None:
            return targets.satellite(_cut(_text_of(self.tle), text, lines_after=2))
        if self.elements is not None:
            return targets.elements(_cut(_text_of(self.elements), text))
        if self.table is not None:
            _no_text(text, "--table")
            return targets.table(_text_of(self.table))
        if text is None or not text.strip():
            raise BadRequest(
                "no target was named", advice="a name, a position, --altaz, --tle, --elements or --table"
            )
        if rates is not None:
            ra_arcsec_s, dec_arcsec_s = _two_numbers("--rates", rates)
            place = _position(text)
            if place is None:
                raise BadRequest("--rates need a position, not a name", advice='"05h34m31.9s +22d00m52s"')
            now = datetime.now(UTC)
            ends = now + timedelta(hours=RATES_HOURS)
            return targets.rates(*place, ra_arcsec_s, dec_arcsec_s, begins_utc=now, ends_utc=ends)
        return targets.typed(text) if _position(text) is not None else targets.named(text.strip())


@dataclass(frozen=True, kw_only=True)
class TargetOptions(MovingTargetOptions):
    """The options that name a target."""

    altaz: Annotated[
        str | None,
        typer.Option("--altaz", metavar="ALT,AZ", help="A direction: altitude and azimuth, degrees."),
    ] = None

    def _given(self) -> list[str]:
        return super()._given() + (["--altaz"] if self.altaz is not None else [])

    def _read(self) -> Target:
        if self.altaz is None:
            return super()._read()
        from mountnav.client import targets

        _no_text(self.target, "--altaz")
        alt_deg, az_deg = _two_numbers("--altaz", self.altaz)
        return targets.altaz(alt_deg, az_deg)


def _no_text(text: str | None, option: str) -> None:
    if text is not None:
        raise BadRequest(f"both {text!r} and {option} were given", advice="name one target")


def _position(text: str) -> tuple[float, float] | None:
    """A position in degrees; None if it is none. Raises `BadRequest` for one that is ambiguous."""
    from mountnav.sky.typed_coordinates import TypedPosition, read_target

    read = read_target(text)
    return (read.ra_deg, read.dec_deg) if isinstance(read, TypedPosition) else None


def _two_numbers(option: str, text: str) -> tuple[float, float]:
    parts: Sequence[str] = text.replace(",", " ").split()
    try:
        first, second = (float(part) for part in parts)
    except ValueError:
        raise BadRequest(f"{option} takes two numbers, not {text!r}", advice=f"{option} 0.5,-0.25") from None
    return first, second


def _cut(text: str, name: str | None, *, lines_after: int = 0) -> str:
    """What of a file of many bodies is of the one that is named; all of it if none is.

    Raises
    ------
    BadRequest
        None, or more than one line names it.
    """
    if name is None or text.lstrip()[:1] in ("{", "["):
        return text
    lines = text.splitlines()
    found = [number for number, line in enumerate(lines) if name.lower() in line.lower()]
    if len(found) != 1:
        raise BadRequest(
            f"{len(found) or 'no'} lines of that file name {name!r}", advice="name it as one line alone does"
        )
    at = found[0]
    return "\n".join(lines[at : at + lines_after + 1])


def _text_of(path: Path) -> str:
    """A file as text. Raises `BadRequest`."""
    with refusing_os_errors(f"{path} can't be read"), path.open("rb") as file:
        data: Any = file.read(LARGEST_FILE_BYTES + 1)
    if len(data) > LARGEST_FILE_BYTES:
        raise BadRequest(f"{path} is larger than {LARGEST_FILE_BYTES >> 20} MB", advice="cut it to the night")
    try:
        text: str = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    return text
