"""Where to point, as request bodies say it: a place, a name, or something that moves among the stars.

Times in bodies are texts with their time zone, so that a job's request is kept as it came.
"""

from __future__ import annotations

from abc import abstractmethod
from datetime import UTC, datetime
from functools import lru_cache
from typing import Annotated, Any, Literal, Self, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, field_validator, model_validator

from mountnav.ephemeris.any_text import read_elements, read_satellites, read_table
from mountnav.ephemeris.elements import OrbitElements
from mountnav.ephemeris.ephemeris import Ephemeris, StarLike
from mountnav.ephemeris.named import ephemeris_of_name, found_of_name
from mountnav.ephemeris.path import MOST_WAYPOINTS, Path, Waypoint
from mountnav.ephemeris.rates import MOST_RATE_ARCSEC_S, HorizonRatesTarget, SkyRatesTarget
from mountnav.ephemeris.satellite import EarthSatellite, SatelliteElements
from mountnav.ephemeris.small_body import SmallBody
from mountnav.ephemeris.table import Table
from mountnav.errors import BadRequest, LimitKind, OutsideLimits
from mountnav.sky.chain import apparent_to_icrs, observed_to_icrs
from mountnav.sky.coordinates import Air, Apparent, Icrs, Observed, Site
from mountnav.sky.named import NamedObject
from mountnav.sky.proper_motion import moved_to
from mountnav.sky.typed_coordinates import LONGEST_TEXT, read_position

__all__ = [
    "AltAzTarget",
    "ApparentTarget",
    "Body",
    "ElementsTarget",
    "IcrsTarget",
    "Instant",
    "NamedTarget",
    "PathTarget",
    "RatesTarget",
    "SatelliteTarget",
    "TableTarget",
    "Tagged",
    "Target",
    "TypedTarget",
    "ephemeris_of",
    "icrs_of",
    "moves",
    "require_filter",
    "require_place",
]


_Elements = TypeVar("_Elements", OrbitElements, SatelliteElements)


class Body(BaseModel):
    """A request's body: nothing unknown, no text or truth values for numbers, no NaN."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


def _kind_is_required(schema: dict[str, Any]) -> None:
    schema["required"] = ["kind", *(name for name in schema.get("required", ()) if name != "kind")]


class Tagged(Body):
    """One of several kinds of bodies: over the wire it says which."""

    model_config = ConfigDict(json_schema_extra=_kind_is_required)


_RaDeg = Annotated[float, Field(ge=0, lt=360)]
_DecDeg = Annotated[float, Field(ge=-90, le=90)]


class IcrsTarget(Tagged):
    """A place in the ICRS; one that moves is taken to the present by its proper motion and parallax."""

    kind: Literal["icrs"] = "icrs"
    ra_deg: _RaDeg
    dec_deg: _DecDeg
    pm_ra_cosdec_masyr: float = Field(default=0.0, ge=-20_000, le=20_000)
    pm_dec_masyr: float = Field(default=0.0, ge=-20_000, le=20_000)
    parallax_mas: float = Field(default=0.0, ge=0, le=1000)
    epoch_yr: float = Field(
        default=2000.0, ge=1900, le=2100, description="Julian year of the place, for its proper motion"
    )


class ApparentTarget(Tagged):
    """A place on the true equator and equinox of the moment of the order: JNow, geocentric, no refraction."""

    kind: Literal["apparent"] = "apparent"
    ra_deg: _RaDeg
    dec_deg: _DecDeg


class AltAzTarget(Tagged):
    """A direction as seen from the site at the moment of the order; its sky is followed from then on."""

    kind: Literal["altaz"] = "altaz"
    alt_deg: float = Field(ge=-90, le=90, description="Observed: with refraction")
    az_deg: float = Field(ge=0, lt=360, description="North 0°, east 90°")


class NamedTarget(Tagged):
    """A bundled bright object, a body of the solar system, or what was imported, by its name.

    `GET /v1/objects` finds names.
    """

    kind: Literal["name"] = "name"
    name: str = Field(min_length=1, max_length=80)

    @field_validator("name")
    @classmethod
    def _is_known(cls, name: str) -> str:
        """Refuse it before a job begins."""
        try:
            found_of_name(name)
        except BadRequest as unknown:
            raise ValueError(f"{unknown.what}; {unknown.advice}") from unknown
        return name

    @property
    def moves(self) -> bool:
        """Whether it moves among the stars."""
        found = found_of_name(self.name)
        return not isinstance(found, NamedObject) or found.place is None

    @property
    def is_sun(self) -> bool:
        """Whether it is the Sun."""
        found = found_of_name(self.name)
        return isinstance(found, NamedObject) and found.kind == "sun"

    def ephemeris(self, utc: datetime, site: Site) -> Ephemeris:
        """Where it stands when. Raises `BadRequest`."""
        return ephemeris_of_name(self.name, utc, site)


class TypedTarget(Tagged):
    """A position as a person types it, with both coordinates; one alone, or an ambiguous text, is refused."""

    kind: Literal["typed"] = "typed"
    text: str = Field(
        min_length=1,
        max_length=LONGEST_TEXT,
        description="For example 05h34m31.9s +22°00′52″, or 83.633, 22.014 (degrees)",
    )
    frame: Literal["icrs", "jnow-apparent"] = "icrs"

    @field_validator("text")
    @classmethod
    def _is_a_position(cls, text: str) -> str:
        """Refuse it before a job begins."""
        try:
            read_position(text)
        except BadRequest as refused:
            raise ValueError(f"{refused.what} {refused.advice}") from refused
        return text

    def read(self) -> IcrsTarget | ApparentTarget:
        """The same in degrees."""
        place = read_position(self.text)
        kind = IcrsTarget if self.frame == "icrs" else ApparentTarget
        return kind(ra_deg=place.ra_deg, dec_deg=place.dec_deg)


def _instant(text: str) -> str:
    """An instant with its time zone, brought to UTC."""
    try:
        read = datetime.fromisoformat(text)
    except ValueError:
        raise ValueError(f"{text!r} is not a time such as 2026-11-26T22:00:00Z") from None
    if read.utcoffset() is None:
        raise ValueError(f"{text!r} doesn't say its time zone: end it with Z for UTC")
    try:
        return read.astimezone(UTC).isoformat().replace("+00:00", "Z")
    except OverflowError:
        raise ValueError(f"{text!r} is outside the years that are supported") from None


Instant = Annotated[
    str,
    Field(max_length=40, json_schema_extra={"format": "date-time"}),
    AfterValidator(_instant),
]
_Instant = Instant
_Name = Annotated[
    str | None,
    Field(default=None, min_length=1, max_length=80, description="What to call it in messages"),
]
_Sigma = Annotated[float, Field(ge=0, le=36_000, description="How uncertain the giver holds it, one sigma")]
_Rate = Annotated[float | None, Field(ge=-MOST_RATE_ARCSEC_S, le=MOST_RATE_ARCSEC_S)]


class MovingTarget(Tagged):
    """A target that moves among the stars."""

    @abstractmethod
    def ephemeris(self, air: Air) -> Ephemeris:
        """Where it stands when. Raises `BadRequest` if there is no such way."""

    @model_validator(mode="after")
    def _leads_somewhere(self) -> Self:
        """Refuse it before a job begins."""
        try:
            self.ephemeris(_NO_AIR)
        except BadRequest as refused:
            raise ValueError(
                f"{refused.what}; {refused.advice}" if refused.advice else refused.what
            ) from refused
        return self


_NO_AIR = Air()


class RatesTarget(MovingTarget):
    """A place at an instant that moves evenly, until an end.

    Either all four of RA and Dec (ICRS, topocentric, astrometric), or all four of azimuth and altitude
    (observed, with refraction).
    """

    kind: Literal["rates"] = "rates"
    name: _Name = None
    begins_utc: _Instant
    ends_utc: _Instant
    ra_deg: Annotated[float | None, Field(ge=0, lt=360)] = None
    dec_deg: Annotated[float | None, Field(ge=-90, le=90)] = None
    ra_arcsec_s: Annotated[_Rate, Field(description="Of the right ascension itself: not times cos δ")] = None
    dec_arcsec_s: _Rate = None
    az_deg: Annotated[float | None, Field(ge=0, lt=360, description="North 0°, east 90°")] = None
    alt_deg: Annotated[float | None, Field(ge=-90, le=90, description="Observed: with refraction")] = None
    az_arcsec_s: Annotated[
        _Rate, Field(description="Of the azimuth itself: not times cos of the altitude")
    ] = None
    alt_arcsec_s: _Rate = None
    sigma_arcsec: _Sigma = 0.0

    def ephemeris(self, air: Air) -> Ephemeris:
        """As it is followed."""
        among_stars = (self.ra_deg, self.dec_deg, self.ra_arcsec_s, self.dec_arcsec_s)
        over_horizon = (self.az_deg, self.alt_deg, self.az_arcsec_s, self.alt_arcsec_s)
        begins, ends = datetime.fromisoformat(self.begins_utc), datetime.fromisoformat(self.ends_utc)
        match (*among_stars, *over_horizon):
            case (float(ra), float(dec), float(ra_rate), float(dec_rate), None, None, None, None):
                return SkyRatesTarget(
                    Icrs(ra, dec),
                    ra_rate,
                    dec_rate,
                    begins,
                    ends,
                    self.name or "a target by rates",
                    self.sigma_arcsec,
                )
            case (None, None, None, None, float(az), float(alt), float(az_rate), float(alt_rate)):
                return HorizonRatesTarget(
                    az,
                    alt,
                    az_rate,
                    alt_rate,
                    begins,
                    ends,
                    air,
                    self.name or "a target by rates over the horizon",
                    self.sigma_arcsec,
                )
            case _:
                raise BadRequest(
                    "rates need all of ra_deg, dec_deg, ra_arcsec_s and dec_arcsec_s, "
                    "or all of az_deg, alt_deg, az_arcsec_s and alt_arcsec_s, and none of the other four"
                )


class IcrsWaypoint(Body):
    """Where it is among the stars at a time: topocentric, astrometric."""

    utc: _Instant
    ra_deg: _RaDeg
    dec_deg: _DecDeg


class AltAzWaypoint(Body):
    """Where it is over the horizon at a time: observed, with refraction."""

    utc: _Instant
    az_deg: Annotated[float, Field(ge=0, lt=360, description="North 0°, east 90°")]
    alt_deg: Annotated[float, Field(ge=-90, le=90)]


class PathTarget(MovingTarget):
    """A way by waypoints, all of one kind, joined smoothly; it ends at the last."""

    kind: Literal["path"] = "path"
    name: _Name = None
    waypoints: Annotated[
        list[IcrsWaypoint] | list[AltAzWaypoint], Field(min_length=2, max_length=MOST_WAYPOINTS)
    ]
    sigma_arcsec: _Sigma = 0.0

    def ephemeris(self, air: Air) -> Ephemeris:
        """As it is followed."""
        return Path(
            tuple(
                Waypoint(datetime.fromisoformat(one.utc), one.ra_deg, one.dec_deg)
                if isinstance(one, IcrsWaypoint)
                else Waypoint(datetime.fromisoformat(one.utc), one.az_deg, one.alt_deg)
                for one in self.waypoints
            ),
            "icrs" if isinstance(self.waypoints[0], IcrsWaypoint) else "altaz",
            air,
            self.name or "a path by waypoints",
            self.sigma_arcsec,
        )


MOST_ELEMENTS_TEXT = 50_000
"""Letters of one body's elements: SBDB's answer with all its parts has 30,000, an OMM in XML 3,000. Doubled,
a request is larger."""
MOST_TABLE_TEXT = 200_000
"""Letters of an ephemeris table: 1,000 rows of Horizons with many columns. A request may have 256 kB."""


class SatelliteTarget(MovingTarget):
    """An Earth satellite by two-line elements or an OMM; refused when they are too old for the instant."""

    kind: Literal["satellite"] = "satellite"
    elements: str = Field(
        min_length=1,
        max_length=MOST_ELEMENTS_TEXT,
        description="Two lines, with a name's line or without; or an OMM as XML, JSON, KVN or CSV",
    )

    def ephemeris(self, air: Air) -> Ephemeris:
        """As it is followed."""
        return _satellite(self.elements)


class ElementsTarget(MovingTarget):
    """A minor planet or a comet by its orbital elements, integrated with the pull of the planets."""

    kind: Literal["elements"] = "elements"
    elements: str = Field(
        min_length=1,
        max_length=MOST_ELEMENTS_TEXT,
        description="A line of MPCORB.DAT or CometEls.txt, JSON of the MPC, or an answer of JPL's SBDB",
    )

    def ephemeris(self, air: Air) -> Ephemeris:
        """As it is followed."""
        return _small_body(self.elements)


class TableTarget(MovingTarget):
    """A target by an ephemeris table: interpolated, and never beyond its ends."""

    kind: Literal["table"] = "table"
    table: str = Field(
        min_length=1,
        max_length=MOST_TABLE_TEXT,
        description="Observer table of JPL's Horizons (text, CSV or its JSON), page of the MPC's ephemeris "
        "service, or plain CSV",
    )
    made_for: Literal["here", "geocenter"] | None = Field(
        default=None, description="Whom a page of the MPC is for, which gives places by a code alone"
    )

    def ephemeris(self, air: Air) -> Ephemeris:
        """As it is followed."""
        return _table(self.table, self.made_for)


@lru_cache(maxsize=32)
def _satellite(text: str) -> EarthSatellite:
    return EarthSatellite(_the_one(read_satellites(text)))


@lru_cache(maxsize=32)
def _small_body(text: str) -> SmallBody:
    return SmallBody(_the_one(read_elements(text)))


@lru_cache(maxsize=16)
def _table(text: str, made_for: Literal["here", "geocenter"] | None) -> Table:
    return read_table(text, made_for=made_for)


def _the_one(found: tuple[_Elements, ...]) -> _Elements:
    if len(found) > 1:
        names = ", ".join(one.name for one in found[:5])
        raise BadRequest(
            f"these are elements of {len(found)} objects ({names}); exactly one is needed",
            advice="import the file, and order by name: mountnav ephemeris import FILE",
        )
    return found[0]


AnyTarget = (
    IcrsTarget
    | ApparentTarget
    | AltAzTarget
    | NamedTarget
    | TypedTarget
    | RatesTarget
    | PathTarget
    | SatelliteTarget
    | ElementsTarget
    | TableTarget
)
Target = Annotated[AnyTarget, Field(discriminator="kind")]


def ephemeris_of(target: AnyTarget, utc: datetime, site: Site, air: Air) -> Ephemeris:
    """A target as what it is at any time.

    Parameters
    ----------
    utc : datetime
        Aware: the moment of the order, for a direction over the horizon and a place of date.

    Returns
    -------
    Ephemeris
        A `StarLike` for what doesn't move among the stars (`moves` is False).

    Raises
    ------
    BadRequest
        No such name, or no such way.
    """
    match target:
        case MovingTarget():
            return target.ephemeris(air)
        case NamedTarget():
            return target.ephemeris(utc, site)
        case _:
            return StarLike(_fixed(target, utc, site, air))


def moves(target: AnyTarget) -> bool:
    """Whether a target moves among the stars."""
    match target:
        case MovingTarget():
            return True
        case NamedTarget():
            return target.moves
        case _:
            return False


def icrs_of(target: AnyTarget, utc: datetime, site: Site, air: Air) -> Icrs:
    """A target as ICRS of this moment.

    Parameters
    ----------
    utc : datetime
        Aware.

    Raises
    ------
    BadRequest
        No such name; or it has no place at this moment.
    """
    if isinstance(target, MovingTarget | NamedTarget):
        return ephemeris_of(target, utc, site, air).icrs(utc, site)
    return _fixed(target, utc, site, air)


def require_place(target: AnyTarget, utc: datetime, site: Site, air: Air) -> None:
    """Refuse a moving target that is over, or has no place: before a job begins for it.

    One that begins later is looked at when it begins.

    Raises
    ------
    BadRequest
        What is wrong with it, and what to do.
    """
    if not moves(target):
        return
    found = ephemeris_of(target, utc, site, air)
    begins = found.begins_utc
    found.icrs(utc if begins is None else max(utc, begins), site)


def require_filter(target: AnyTarget, *, solar_filter: bool) -> None:
    """Refuse the Sun to a telescope whose settings declare no solar filter.

    Raises
    ------
    OutsideLimits
        The Sun, and there is none.
    """
    if solar_filter or not isinstance(target, NamedTarget) or not target.is_sun:
        return
    raise OutsideLimits(
        "the Sun is not a target for a telescope without a solar filter",
        advice="put the filter on, and say solar_filter = true in the telescope's [telescope.limits]",
        limit=LimitKind.SUN,
    )


def _fixed(
    target: IcrsTarget | ApparentTarget | AltAzTarget | TypedTarget, utc: datetime, site: Site, air: Air
) -> Icrs:
    match target:
        case IcrsTarget():
            here = Icrs(target.ra_deg, target.dec_deg)
            if not (target.pm_ra_cosdec_masyr or target.pm_dec_masyr or target.parallax_mas):
                return here
            return moved_to(
                here,
                utc,
                epoch_yr=target.epoch_yr,
                pm_ra_cosdec_masyr=target.pm_ra_cosdec_masyr,
                pm_dec_masyr=target.pm_dec_masyr,
                parallax_mas=target.parallax_mas,
            )
        case ApparentTarget():
            return apparent_to_icrs(Apparent(target.ra_deg, target.dec_deg, utc))
        case AltAzTarget():
            return observed_to_icrs(
                Observed(az_deg=target.az_deg, alt_deg=target.alt_deg, utc=utc), site, air
            )
        case TypedTarget():
            return _fixed(target.read(), utc, site, air)
