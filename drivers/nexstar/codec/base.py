"""The NexStar words: each command's bytes together with the reader of its reply. No wire, no clock.

The same letters serve Celestron's hand controls and Sky-Watcher's SynScan; where the two differ the meaning
stands in `dialect`, the forms of the answers in `replies`.
"""

from __future__ import annotations

from drivers.nexstar.codec import replies
from drivers.nexstar.codec.dialect import Handset, Tracking, Version
from drivers.nexstar.codec.passthrough import (
    Axis,
    Order,
    PassThrough,
    fixed_rate,
    pulse,
    tracking_rate,
    variable_rate,
)
from drivers.nexstar.codec.replies import WirePair, pair_to_text
from drivers.nexstar.codec.site_and_time import (
    WireSite,
    WireTime,
    fine_time_from_bytes,
    site_from_bytes,
    site_to_bytes,
    time_from_bytes,
    time_to_bytes,
)
from drivers.wire.command import Command, Read

GET_PLACE: Command[WirePair] = Command(b"e", "right ascension and declination", replies.pair(False))
GET_PLACE_SHORT: Command[WirePair] = Command(b"E", "right ascension and declination", replies.pair(True))
GET_HORIZON: Command[WirePair] = Command(b"z", "azimuth and altitude", replies.pair(False))
GET_HORIZON_SHORT: Command[WirePair] = Command(b"Z", "azimuth and altitude", replies.pair(True))
SLEWING: Command[bool] = Command(b"L", "goto in progress", replies.letter({b"0": False, b"1": True}))
ALIGNED: Command[bool] = Command(b"J", "alignment complete", replies.small(replies.flag))
PIER_SIDE: Command[str] = Command(b"p", "side of pier", replies.letter({b"E": "E", b"W": "W"}))
VERSION: Command[Version] = Command(b"V", "version", replies.version)
VARIANT: Command[int] = Command(b"v", "kind of hand control", replies.packed(1, replies.number))
MODEL: Command[int] = Command(b"m", "model", replies.packed(1, replies.number))
SYNSCAN_MODEL: Command[int] = Command(b"m", "model", replies.swapped_number)
GET_SITE: Command[WireSite] = Command(b"w", "site", replies.packed(8, site_from_bytes))
GET_TIME: Command[WireTime] = Command(b"h", "time", replies.packed(8, time_from_bytes))
GET_FINE_TIME: Command[WireTime] = Command(b"i", "time", replies.packed(8, fine_time_from_bytes))
_HALT = fixed_rate(Axis.RA, 0).to_bytes() + fixed_rate(Axis.DEC, 0).to_bytes()
"""Both axes at the fixed rate 0, which ends what the keys began [NexStar P]."""


def _unanswered(sent: bytes, meaning: str) -> Command[None]:
    """Something that is sent past all questions: its ``#`` are not waited for, the readers skip them."""
    return Command(sent, meaning, lambda buffer, final: Read(None, 0), True, False)


STOP = _unanswered(b"M" + _HALT, "stop")
"""Goto cancelled and both axes halted in one piece."""
SYNSCAN_STOP = _unanswered(b"MM" + _HALT, "stop")
"""A SynScan wants the stop twice [INDI synscan]."""


def press(axis: Axis, rate: int) -> Command[None]:
    """Press a key at a fixed rate, -9..+9, or let go of it with 0, past all questions [NexStar P]."""
    return _unanswered(fixed_rate(axis, rate).to_bytes(), "key")


def echo(letter: bytes) -> Command[None]:
    """Ask for a letter of `ECHOES` back: shows that the line is in step [NexStar K]."""
    return Command(b"K" + letter, "echo", replies.echoed(letter))


def _order(sent: bytes, meaning: str, repeatable: bool = False) -> Command[None]:
    return Command(sent, meaning, replies.packed(0, replies.done), repeatable)


def slew(ra_deg: float, dec_deg: float, *, short: bool = False) -> Command[None]:
    """Order a goto; a mount that won't answers all the same, and does nothing [NexStar r, R]."""
    return _order((b"R" if short else b"r") + pair_to_text(ra_deg, dec_deg, short=short), "goto")


def slew_horizon(az_deg: float, alt_deg: float, *, short: bool = False) -> Command[None]:
    """Order a goto in azimuth and altitude [NexStar b, B]."""
    return _order((b"B" if short else b"b") + pair_to_text(az_deg, alt_deg, short=short), "goto")


def sync(ra_deg: float, dec_deg: float, *, short: bool = False) -> Command[None]:
    """Tell it where it points [NexStar s, S]."""
    return _order((b"S" if short else b"s") + pair_to_text(ra_deg, dec_deg, short=short), "sync")


def get_tracking(handset: Handset) -> Command[Tracking]:
    """Ask for the tracking mode [NexStar t]."""
    return Command(b"t", "tracking mode", replies.small(replies.tracking(handset)))


def set_tracking(number: int) -> Command[None]:
    """Order a tracking mode by the number this hand control has for it [NexStar T]."""
    return _order(b"T" + bytes([number]), "tracking mode", True)


def set_tracking_rate(rate: int, *, south: bool) -> Command[None]:
    """Order the speed of tracking by one of `passthrough`'s numbers for it [INDI set_track_rate]."""
    return _order(tracking_rate(rate, south=south).to_bytes(), "tracking rate", True)


def set_site(site: WireSite) -> Command[None]:
    """Set the site [NexStar W]."""
    return _order(b"W" + site_to_bytes(site), "site", True)


def set_time(time: WireTime, *, fine: bool = False) -> Command[None]:
    """Set the clock; sent once, since by the second time it would be wrong [NexStar H, I]."""
    return _order((b"I" if fine else b"H") + time_to_bytes(time, fine=fine), "time")


def move(axis: Axis, rate: int) -> Command[None]:
    """Move an axis at a fixed rate, -9..+9; 0 ends it [NexStar P]."""
    return _order(fixed_rate(axis, rate).to_bytes(), "fixed rate", True)


def move_at(axis: Axis, rate_arcsec_s: float) -> Command[None]:
    """Move an axis at any rate; 0 ends it [NexStar P]."""
    return _order(variable_rate(axis, rate_arcsec_s).to_bytes(), "variable rate", True)


def guide(axis: Axis, rate_percent: int, pulse_s: float) -> Command[None]:
    """Guide for a moment [NexStar P]."""
    return _order(pulse(axis, rate_percent, pulse_s).to_bytes(), "guide pulse")


def guiding(axis: Axis) -> Command[bool]:
    """Ask whether a pulse still runs [NexStar P]."""
    return Command(
        PassThrough(axis, Order.PULSING, b"", 1).to_bytes(), "guiding", replies.small(replies.flag)
    )


def guide_rate(axis: Axis) -> Command[float]:
    """Ask for the guide rate, in percents of the sidereal rate [NexStar P]."""
    asked = PassThrough(axis, Order.PULSE_RATE, b"", 1).to_bytes()
    return Command(asked, "guide rate", replies.packed(1, lambda payload: payload[0] * 100.0 / 256.0))


def device_version(device: int) -> Command[Version]:
    """Ask a board for its version; a board that isn't there never answers [NexStar P]."""
    asked = PassThrough(device, Order.VERSION, b"", 2).to_bytes()
    return Command(asked, "version of a board", replies.packed(2, replies.two_bytes))
