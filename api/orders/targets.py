"""Where to point, as request bodies say it: ICRS with motion, of date, altitude and azimuth, or a name."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator

from mountnav.errors import BadRequest
from mountnav.sky.chain import apparent_to_icrs, observed_to_icrs
from mountnav.sky.coordinates import Air, Apparent, Icrs, Observed, Site
from mountnav.sky.named import object_of_name, position_of_name
from mountnav.sky.proper_motion import moved_to
from mountnav.sky.typed_coordinates import LONGEST_TEXT, read_position

__all__ = [
    "AltAzTarget",
    "ApparentTarget",
    "Body",
    "IcrsTarget",
    "NamedTarget",
    "Tagged",
    "Target",
    "TypedTarget",
    "icrs_of",
]


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
    """A bundled bright object or a planet, by its name; `GET /v1/objects` finds names."""

    kind: Literal["name"] = "name"
    name: str = Field(min_length=1, max_length=80)

    @field_validator("name")
    @classmethod
    def _is_known(cls, name: str) -> str:
        """Refuse it before a job begins."""
        try:
            object_of_name(name)
        except BadRequest as unknown:
            raise ValueError(f"{unknown.what}; {unknown.advice}") from unknown
        return name


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


Target = Annotated[
    IcrsTarget | ApparentTarget | AltAzTarget | NamedTarget | TypedTarget,
    Field(discriminator="kind"),
]


def icrs_of(
    target: IcrsTarget | ApparentTarget | AltAzTarget | NamedTarget | TypedTarget,
    utc: datetime,
    site: Site,
    air: Air,
) -> Icrs:
    """A target as ICRS of this moment.

    Parameters
    ----------
    utc : datetime
        Aware.

    Raises
    ------
    BadRequest
        No such name.
    """
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
        case NamedTarget():
            return position_of_name(target.name, utc, site)
        case TypedTarget():
            return icrs_of(target.read(), utc, site, air)
