"""Bodies of the short forms, `POST /v1/telescopes/{id}/slew` and the like: each becomes an order."""

from __future__ import annotations

from typing import Any, Literal, Self

from pydantic import ConfigDict, Field, model_validator

from api.orders.bodies import Body
from api.orders.orders import (
    CenterOrder,
    FirstLightOrder,
    FlipOrder,
    LookOrder,
    OffsetOrder,
    RecoverOrder,
    SlewOrder,
    TrackingOrder,
)
from api.orders.targets import ApparentTarget, IcrsTarget, Target


def _place_or_target(schema: dict[str, Any]) -> None:
    """Say in the schema what `SlewBody` checks: a place, or a target, and no null for either."""
    for name in ("ra_deg", "dec_deg", "target"):
        written = schema["properties"][name]
        kept = next(one for one in written.pop("anyOf") if one.get("type") != "null")
        written.pop("default", None)
        schema["properties"][name] = {**kept, **written}
    schema["oneOf"] = [
        {"required": ["ra_deg", "dec_deg"], "not": {"required": ["target"]}},
        {
            "required": ["target"],
            "not": {"anyOf": [{"required": [name]} for name in ("ra_deg", "dec_deg", "frame")]},
        },
    ]


class SlewBody(Body):
    """Where to go: `ra_deg`, `dec_deg` and perhaps `frame`, or a `target`."""

    model_config = ConfigDict(json_schema_extra=_place_or_target)

    ra_deg: float | None = Field(default=None, ge=0, lt=360)
    dec_deg: float | None = Field(default=None, ge=-90, le=90)
    frame: Literal["icrs", "jnow-apparent"] = Field(
        default="icrs",
        description="jnow-apparent: true equator and equinox of now, geocentric, no refraction",
    )
    target: Target | None = Field(default=None, description="Instead of ra_deg and dec_deg")

    @model_validator(mode="after")
    def _one_place(self) -> Self:
        flat = self.model_fields_set & {"ra_deg", "dec_deg", "frame"}
        for name in ("ra_deg", "dec_deg", "target"):
            if name in self.model_fields_set and getattr(self, name) is None:
                raise ValueError(f"{name} is null: leave it out")
        whole = self.ra_deg is not None and self.dec_deg is not None
        if self.target is None and not whole:
            raise ValueError("ra_deg and dec_deg are needed, or a target")
        if self.target is not None and flat:
            raise ValueError("either ra_deg and dec_deg, or a target: not both")
        return self

    @property
    def place(self) -> Target:
        """The target, however it was written."""
        if self.target is not None:
            return self.target
        assert self.ra_deg is not None
        assert self.dec_deg is not None
        if self.frame == "icrs":
            return IcrsTarget(ra_deg=self.ra_deg, dec_deg=self.dec_deg)
        return ApparentTarget(ra_deg=self.ra_deg, dec_deg=self.dec_deg)

    def order(self) -> SlewOrder | CenterOrder | FlipOrder:
        """As an order."""
        return SlewOrder(target=self.place)


class CenterBody(SlewBody):
    """What to center; bounds not given are the telescope's settings."""

    tolerance_arcsec: float | None = Field(default=None, gt=0, le=3600)
    max_tries: int | None = Field(default=None, ge=1, le=50)
    timeout_s: float | None = Field(default=None, gt=0, le=7200)
    correct_by: Literal["sync", "offset", "model"] | None = None
    planned_s: float | None = Field(
        default=None,
        gt=0,
        le=86_400,
        description="How long it is to be followed: the answer tells which limit comes before that",
    )

    def order(self) -> CenterOrder:
        """As an order."""
        return CenterOrder(
            target=self.place,
            tolerance_arcsec=self.tolerance_arcsec,
            max_tries=self.max_tries,
            timeout_s=self.timeout_s,
            correct_by=self.correct_by,
            planned_s=self.planned_s,
        )


class FlipBody(SlewBody):
    """What to center on the other side of the pier."""

    planned_s: float | None = Field(default=None, gt=0, le=86_400)

    def order(self) -> FlipOrder:
        """As an order."""
        return FlipOrder(target=self.place, planned_s=self.planned_s)


class OffsetBody(Body):
    """How far to nudge, on the sky."""

    east_arcsec: float = Field(ge=-36_000, le=36_000)
    north_arcsec: float = Field(ge=-36_000, le=36_000)

    def order(self) -> OffsetOrder:
        """As an order."""
        return OffsetOrder(east_arcsec=self.east_arcsec, north_arcsec=self.north_arcsec)


class TrackingBody(Body):
    """Whether to follow the sky, and at which rate."""

    on: bool
    rate: Literal["sidereal", "lunar", "solar", "king"] = "sidereal"

    def order(self) -> TrackingOrder:
        """As an order."""
        return TrackingOrder(on=self.on, rate=self.rate)


class LookBody(Body):
    """How to look."""

    exposure_s: float | None = Field(default=None, gt=0, le=600)
    persistent: bool = Field(
        default=False, description="Look: try all that is allowed and moves nothing, waiting included"
    )

    def order(self) -> LookOrder:
        """As an order to look."""
        return LookOrder(exposure_s=self.exposure_s, persistent=self.persistent)

    def recovery(self) -> RecoverOrder:
        """As an order to recover."""
        return RecoverOrder(exposure_s=self.exposure_s)

    def first_light(self) -> FirstLightOrder:
        """As an order for a first light."""
        return FirstLightOrder(exposure_s=self.exposure_s)


__all__ = ["CenterBody", "FlipBody", "LookBody", "OffsetBody", "SlewBody", "TrackingBody"]
