"""Sun, Moon, planets and their satellites, as an `Ephemeris`."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

from mountnav.errors import BadRequest
from mountnav.sky.coordinates import Icrs, Site
from mountnav.sky.planets import BODIES, SATELLITES, position_of_body, sigma_of_body_arcsec


@dataclass(frozen=True, slots=True)
class SolarSystemBody:
    """A body of the solar system, by the best source for the instant that is asked for.

    Attributes
    ----------
    body : str
        One of `mountnav.sky.planets.BODIES` or `SATELLITES`.

    Raises
    ------
    BadRequest
        No such body.
    """

    body: str

    def __post_init__(self) -> None:
        """Refuse what is none."""
        if self.body not in BODIES and self.body not in SATELLITES:
            raise BadRequest(f"no body of the solar system is called {self.body!r} here")

    @property
    def name(self) -> str:
        """As people write it."""
        return self.body.capitalize()

    @property
    def begins_utc(self) -> datetime | None:
        """Any time from 1972 to 2099."""
        return None

    @property
    def ends_utc(self) -> datetime | None:
        """Any time from 1972 to 2099."""
        return None

    def icrs(self, utc: datetime, site: Site) -> Icrs:
        """Where it stands: see `mountnav.sky.planets.position_of_body`."""
        return position_of_body(self.body, utc, site)

    def sigma_arcsec(self, utc: datetime) -> float:
        """How well it is known then: hundredths of an arcsecond by DE440, up to 45″ by formulas."""
        return sigma_of_body_arcsec(self.body, utc)
