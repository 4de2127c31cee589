"""Clock and site in LX200's words: an app is told ours; what it tells is compared, never taken."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime, time, timedelta

from api.planetarium import lx200_words
from api.planetarium.lx200_machine import Machine
from drivers.lx200.angles import dec_from_text, dec_to_text, longitude_from_text, longitude_to_text
from drivers.lx200.site_and_time import date_from_text, hours_to_utc_from_text, time_from_text
from mountnav import __version__
from mountnav.sky.chain import sidereal_time_deg
from mountnav.sky.coordinates import Site, utc_now

_SAME_PLACE_DEG = 0.1
_BUILT = {"VD": b"Jan 01 2026", "VT": b"00:00:00"}
"""Some clients wait for a date of the firmware: a form of words, as no firmware is here."""


class Here:
    """What is the same wherever the mount points.

    Parameters
    ----------
    site : Site
    machine : Machine
        Of the app: it has a zone of its own.
    """

    def __init__(self, site: Site, machine: Machine) -> None:
        self._site = site
        self._machine = machine

    def answers(self) -> dict[str, Callable[[], bytes]]:
        """What ``:G…`` is answered, by its letters, without the ``#``."""
        site = self._site
        return {
            "S": lambda: lx200_words.sidereal_text(sidereal_time_deg(utc_now(), site)),
            "L": lambda: self._local().strftime("%H:%M:%S").encode(),
            "a": lambda: self._local().strftime("%I:%M:%S").encode(),
            "C": lambda: self._local().strftime("%m/%d/%y").encode(),
            "G": lambda: lx200_words.zone_text(self._hours_to_utc()),
            "c": lambda: b"24",
            "t": lambda: dec_to_text(site.latitude_deg, short=True),
            "g": lambda: longitude_to_text(site.longitude_deg),
            "T": lambda: b"60.1",
            "M": lambda: b"mountnav",
            "VP": lambda: b"mountnav",
            "VN": lambda: __version__.encode(),
            "VF": lambda: b"mountnav|" + __version__.encode(),
            "VD": lambda: _BUILT["VD"],
            "VT": lambda: _BUILT["VT"],
        }

    def compare(self, what: str, wire: bytes) -> bytes:
        """``1`` if what an app says of site and time is so, else ``0``.

        Raises
        ------
        Unreadable, ValueError
            It makes no sense.
        """
        if what == "C":
            return lx200_words.UPDATING if self._is_today(date_from_text(wire)) else b"0"
        return b"1" if self._is_so(what, wire) else b"0"

    def _is_so(self, what: str, wire: bytes) -> bool:
        if what == "t":
            return (
                abs(dec_from_text(lx200_words.plain_angle(wire)).deg - self._site.latitude_deg)
                < _SAME_PLACE_DEG
            )
        if what == "g":
            off_deg = longitude_from_text(lx200_words.plain_angle(wire)) - self._site.longitude_deg
            return abs((off_deg + 180.0) % 360.0 - 180.0) < _SAME_PLACE_DEG
        if what == "G":
            # the app's own zone, in which it is answered from now on: nothing of the mount's
            self._machine.hours_to_utc = hours_to_utc_from_text(wire)
            return True
        if what == "L":
            at: time = time_from_text(wire)
            told = timedelta(hours=at.hour, minutes=at.minute, seconds=at.second)
            return lx200_words.is_that_time(told, utc_now(), self._machine.hours_to_utc)
        return False

    def _is_today(self, told: object) -> bool:
        """Whether a local date is ours; a day more or less where the zone wasn't told."""
        slack = timedelta(0) if self._machine.hours_to_utc is not None else timedelta(hours=14)
        local = self._local()
        return told in ((local - slack).date(), local.date(), (local + slack).date())

    def _hours_to_utc(self) -> float:
        if self._machine.hours_to_utc is not None:
            return self._machine.hours_to_utc
        offset = utc_now().astimezone().utcoffset() or timedelta(0)
        return -offset.total_seconds() / 3600.0

    def _local(self) -> datetime:
        return utc_now() - timedelta(hours=self._hours_to_utc())


__all__ = ["Here"]
