"""LX200 from the mount's side of the wire: commands cut from a stream, replies written; pure.

Angles, dates and times are written and read by `drivers.lx200`, as our driver does [LX200]. What goes wrong
with apps, and how this copes: a `#` or noise before a command is skipped; a degree sign comes as `*`, 0xDF,
Latin-1 or UTF-8; a blank may follow ``:Sr``; Stellarium Mobile asks ``Ka`` (NexStar) first, and takes the
silence for an answer.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta

from drivers.lx200.codec.angles import dec_to_text, ra_to_text

ACK = b"\x06"
LONGEST_COMMAND = 64
"""Longest command, bytes from colon to hash; chosen by hand. What is longer is skipped up to the next
colon. Halved, long site names would be, too."""
SLEWING, AT_REST = b"\x7f#", b"#"
MATCHED = b"Coordinates     matched.        #"
UPDATING = b"1Updating        Planetary Data#" + b" " * 30 + b"#"
_BEGINS = re.compile(rb"[:\x06]")
_HTTP = re.compile(rb"(?:GET|HEAD|POST|PUT|PATCH|DELETE|OPTIONS|TRACE|CONNECT) ")
_MOST_WORDS = 48
"""Readers of replies give up beyond 64 bytes or so."""
_ONE_DIGIT_HOUR = re.compile(rb"[0-9]:")
_A_WHOLE_TURN = re.compile(rb"24:00(?::00(?:\.0+)?|\.0)")
_COMMANDS_IN_A_PART = 32
"""So many are taken in in a turn of the loop, some 0.2 ms; an app sends two or three at once."""
_QUARTER_S = 900.0
"""Offsets of time zones are multiples of this, s: with the zone unknown, times are compared within it."""
_SAME_TIME_S = 60.0
"""An app's clock this near to ours counts as the same, s: some send whole minutes. Doubled, a clock 2 min
off (0.5° of the sky) goes without a word."""


def is_http(heard: bytes) -> bool:
    """Whether what a client says first is a request of a browser.

    Any page that is open on this machine can have its browser send one here, with commands in its body.
    """
    return _HTTP.match(heard) is not None


def cut(buffer: bytes) -> tuple[bytes | None, bytes]:
    """Cut the next command off: ACK, or ``:...#``; None while it isn't whole. Noise between is dropped."""
    at = 0
    while (begins := _BEGINS.search(buffer, at)) is not None:
        at = begins.start()
        if buffer[at : at + 1] == ACK:
            return ACK, buffer[at + 1 :]
        end = buffer.find(b"#", at, at + LONGEST_COMMAND)
        if end >= 0:
            return buffer[at : end + 1], buffer[end + 1 :]
        if len(buffer) - at < LONGEST_COMMAND:
            return None, buffer[at:]
        at += 1
    return None, b""


class Commands:
    """Bytes in, commands out."""

    def __init__(self) -> None:
        self._buffer = b""

    def parts(self, data: bytes) -> Iterator[list[bytes]]:
        """Take bytes, and yield the commands they complete, some at a time: others have a turn in between."""
        self._buffer += data
        found: list[bytes] = []
        while True:
            command, self._buffer = cut(self._buffer)
            if command is None:
                break
            found.append(command)
            if len(found) == _COMMANDS_IN_A_PART:
                yield found
                found = []
        yield found


def plain_angle(argument: bytes) -> bytes:
    """An angle as the codec knows it: without blanks, its degree sign one byte."""
    return argument.replace(b"\xc2\xb0", b"*").replace(b"\xc3\x9f", b"*").strip()


def app_right_ascension(argument: bytes) -> bytes:
    """A right ascension as the codec knows it: apps write ``5:35:17``, and ``24:00:00`` for what rounds up.

    Only that one: ``24:00:01`` is none. From mounts neither is taken: there they are a damaged answer.
    """
    text = plain_angle(argument)
    if _ONE_DIGIT_HOUR.match(text):
        text = b"0" + text
    return b"00" + text[2:] if _A_WHOLE_TURN.fullmatch(text) else text


def app_declination(argument: bytes) -> bytes:
    """A declination as the codec knows it: one without a sign is north, as ``:Sd`` says which angle it is."""
    text = plain_angle(argument)
    return b"+" + text if text[:1].isdigit() else text


def altitude_text(altitude_deg: float, *, short: bool) -> bytes:
    """``sDD*MM'SS`` or ``sDD*MM`` [LX200 :GA#]."""
    return dec_to_text(altitude_deg, short=short).replace(b":", b"'")


def azimuth_text(azimuth_deg: float, *, short: bool) -> bytes:
    """``DDD*MM'SS`` or ``DDD*MM``, from north through east [LX200 :GZ#]."""
    if short:
        minutes = round(azimuth_deg * 60.0) % 21600
        return b"%03d*%02d" % (minutes // 60, minutes % 60)
    seconds = round(azimuth_deg * 3600.0) % 1_296_000
    return b"%03d*%02d'%02d" % (seconds // 3600, seconds // 60 % 60, seconds % 60)


def sidereal_text(lst_deg: float) -> bytes:
    """``HH:MM:SS`` [LX200 :GS#]."""
    return ra_to_text(lst_deg % 360.0)


def zone_text(hours_to_utc: float) -> bytes:
    """``sHH``, or ``sHH.H`` where it is no whole hour: hours to add to local time [LX200 :GG#]."""
    whole = round(hours_to_utc)
    return b"%+03d" % whole if whole == hours_to_utc else b"%+05.1f" % hours_to_utc


def words(said: str) -> bytes:
    """Words as a reply may hold them: ASCII, no ``#``, short."""
    text = re.sub(r"[^\x20-\x7e]+", " ", said.replace("°", " deg").replace("#", " "))
    return " ".join(text.split())[:_MOST_WORDS].strip().encode("ascii")


def is_that_time(told: timedelta, utc: datetime, hours_to_utc: float | None) -> bool:
    """Whether a local time of day is ours; any zone's, where the zone isn't known."""
    utc = utc.astimezone(UTC)
    now_s = 3600.0 * utc.hour + 60.0 * utc.minute + utc.second
    turn_s = _QUARTER_S if hours_to_utc is None else 86_400.0
    off_s = (told.total_seconds() + 3600.0 * (hours_to_utc or 0.0) - now_s) % turn_s
    return min(off_s, turn_s - off_s) <= _SAME_TIME_S


__all__ = [
    "ACK",
    "AT_REST",
    "LONGEST_COMMAND",
    "MATCHED",
    "SLEWING",
    "UPDATING",
    "Commands",
    "altitude_text",
    "app_declination",
    "app_right_ascension",
    "azimuth_text",
    "cut",
    "is_http",
    "is_that_time",
    "plain_angle",
    "sidereal_text",
    "words",
    "zone_text",
]
