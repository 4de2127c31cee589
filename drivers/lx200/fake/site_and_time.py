"""Site and time of a fake that keeps UT and shows local time: OnStep, and its relatives."""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta

from drivers.lx200.codec.angles import dec_from_text, degrees_to_fine_text, longitude_from_text
from drivers.lx200.codec.site_and_time import hours_to_utc_from_text
from mountnav.simulation.mechanics import Mechanics
from mountnav.sky.coordinates import Site

_DATE_FORMS = {r"\d\d/\d\d/\d\d": "%m/%d/%y", r"\d\d/\d\d/\d{4}": "%m/%d/%Y", r"\d{4}-\d\d-\d\d": "%Y-%m-%d"}


class Settings:
    """The site and the time that are set in the mount; the mechanics keep both.

    Attributes
    ----------
    hours_to_utc : float
        Hours to ADD to local time to get UTC.
    date_set, time_set : bool
        Since it was switched on.
    """

    def __init__(self, mechanics: Mechanics) -> None:
        self._mechanics = mechanics
        self.hours_to_utc = 0.0
        self.date_set = self.time_set = True

    @property
    def ready(self) -> bool:
        """Whether date and time were set since it was switched on."""
        return self.date_set and self.time_set

    @property
    def local(self) -> datetime:
        """Its local time, as if it were UTC."""
        return self._mechanics.believed_utc().astimezone(UTC) - timedelta(hours=self.hours_to_utc)

    def take(self, what: str, text: str) -> None:
        """Carry out `St`, `Sg`, `SG`, `SL` or `SC`.

        Raises
        ------
        ValueError
            If the value makes no sense.
        """
        wire = text.encode("latin-1")
        site = self._mechanics.believed_site
        if what == "St":
            # INDI's driver writes one-digit seconds, as in +49:36:0.00
            latitude = dec_from_text(re.sub(rb":(\d)(?=\.|$)", rb":0\1", wire))
            self._mechanics.set_believed_site(Site(latitude.deg, site.longitude_deg))
        elif what == "Sg":
            self._mechanics.set_believed_site(Site(site.latitude_deg, longitude_from_text(wire)))
        elif what == "SG":
            # the clock goes on in UT: a new zone changes what is shown [ONSTEP :SG#]
            self.hours_to_utc = hours_to_utc_from_text(wire)
        elif what == "SL":
            self._take_time(text)
        elif what == "SC":
            self._take_date(text)
        else:
            raise ValueError(f"{what} is not a setting")

    def _take_time(self, text: str) -> None:
        given = datetime.strptime(text, "%H:%M:%S.%f" if "." in text else "%H:%M:%S")
        self._set_local(datetime.combine(self.local.date(), given.time(), UTC))
        self.time_set = True

    def _take_date(self, text: str) -> None:
        for form, meaning in _DATE_FORMS.items():
            if re.fullmatch(form, text):
                given = datetime.strptime(text, meaning)
                self._set_local(datetime.combine(given.date(), self.local.time(), UTC))
                self.date_set = True
                return
        raise ValueError(f"{text!r} is not a date")

    def _set_local(self, local: datetime) -> None:
        self._mechanics.set_believed_utc(local + timedelta(hours=self.hours_to_utc))

    def tell(self, text: str) -> bytes | None:
        """Answer `Gt`, `Gg` (fine with an `H`), `GC`, `GL`, `GG`; None for anything else."""
        site = self._mechanics.believed_site
        angles = {"Gt": (site.latitude_deg, 2), "Gg": (-site.longitude_deg, 3)}
        if text[:2] in angles and text[2:] in ("", "H"):
            deg, digits = angles[text[:2]]
            if text[2:]:
                return degrees_to_fine_text(deg, 3, digits=digits) + b"#"
            # cut to minutes, as all of them do
            return degrees_to_fine_text(deg, 0, digits=digits).rsplit(b":", 1)[0] + b"#"
        forms = {"GC": "%m/%d/%y#", "GL": "%H:%M:%S#"}
        if text in forms:
            return self.local.strftime(forms[text]).encode()
        if text == "GG":
            minutes = round(abs(self.hours_to_utc) * 60.0)
            return b"%s%02d:%02d#" % (b"-" if self.hours_to_utc < 0 else b"+", minutes // 60, minutes % 60)
        return None
