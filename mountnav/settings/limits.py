"""`limits` of a telescope: where it may point, and by which way."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from mountnav.pointing.limits import Horizon, Limits
from mountnav.settings.section import Section

_Altitude = Annotated[float, Field(ge=-90, le=90)]
_Cone = Annotated[float, Field(ge=0, lt=90)]
_Turn = Annotated[float, Field(ge=-720, le=720)]
_Rate = Annotated[float, Field(gt=0, le=360)]


class LimitSettings(Section):
    """`limits` of a telescope: where it may point, and by which way. Degrees; see docs/explanation/limits.md.

    Attributes
    ----------
    min_altitude_deg, max_altitude_deg
        Lowest and highest altitude, refraction included.
    way_min_altitude_deg
        Lowest altitude on the way from one place to another, if that may be lower: a German mount near the
        equator passes the pole, which is low there. Left out: as `min_altitude_deg`.
    horizon_file
        Text with azimuth and altitude per line, as Stellarium, N.I.N.A. and KStars use it. A path that isn't
        absolute is taken from the folder in which the service runs.
    horizon_deg
        The same written here: ``[[0, 20], [90, 12.5], [180, 8]]``. One of the two.
    hour_angle_deg
        Hour angles, west positive, at which it may stand and track: ``[-90, 90]``.
    declination_deg
        Declinations that it may look at, on the way too.
    past_meridian_east_deg, past_meridian_west_deg
        German mounts: how far past the meridian the tube may look while it hangs on the east side of the pier
        (the one that looks west), and on the west side. 180: no limit. They count only if the telescope's
        `mount.mounting` is ``german``, or the mount tells its side of the pier.
    first_axis_deg, second_axis_deg
        How far the axes turn: hour angle and declination axis (beyond 90 past the pole), or azimuth and
        altitude.
    sun_cone_deg
        So near to the Sun nothing is slewed, tracked or passed. Left out: 20, or 0 (no such limit) with a
        `solar_filter`.
    sun_cone_from_altitude_deg
        The cone counts from this altitude of the Sun on.
    solar_filter
        A filter for the Sun is in front of the tube, and stays there: only then the Sun is a target.
    moon_cone_deg
        The same for the Moon when it is up. 0: no such limit.
    daylight
        ``refuse``: nothing but parking is done, and tracking ends, while the Sun is above
        `daylight_from_altitude_deg`. ``allow``: the cone is all that keeps it from the Sun.
    daylight_from_altitude_deg
        See there.
    axis_rates_deg_s
        Slew rates of the first and the second axis, if they are known: then fewer ways have to be reckoned
        with.
    ways
        What is assumed of the rates if they aren't known: ``even``: neither axis is more than twice as fast
        as the other; ``any``: nothing, so that everything between start and end has to be allowed.
    margin_deg
        Kept from all limits of the sky on the way and while tracking, for the pointing error.
    slew_takes_s, track_for_s
        How long a slew takes at most, and how long afterwards the target must stay within the limits.
    untrusted_tracking_s
        So long a mount whose position can't be trusted may track before it is stopped.
    """

    min_altitude_deg: _Altitude = 15.0
    max_altitude_deg: _Altitude = 90.0
    way_min_altitude_deg: _Altitude | None = None
    horizon_file: Path | None = None
    horizon_deg: tuple[tuple[float, float], ...] | None = None
    hour_angle_deg: tuple[_Turn, _Turn] | None = None
    declination_deg: tuple[_Altitude, _Altitude] | None = None
    past_meridian_east_deg: float = Field(default=10.0, ge=0, le=180)
    past_meridian_west_deg: float = Field(default=10.0, ge=0, le=180)
    first_axis_deg: tuple[_Turn, _Turn] | None = None
    second_axis_deg: tuple[_Turn, _Turn] | None = None
    sun_cone_deg: _Cone = 20.0
    sun_cone_from_altitude_deg: _Altitude = -6.0
    solar_filter: bool = False
    moon_cone_deg: _Cone = 0.0
    daylight: Literal["allow", "refuse"] = "allow"
    daylight_from_altitude_deg: _Altitude = -6.0
    axis_rates_deg_s: tuple[_Rate, _Rate] | None = None
    ways: Literal["even", "any"] = "even"
    margin_deg: float = Field(default=0.25, ge=0, le=10)
    slew_takes_s: float = Field(default=120.0, ge=0, le=3600)
    track_for_s: float = Field(default=60.0, ge=0, le=86400)
    untrusted_tracking_s: float = Field(default=1800.0, ge=0, le=86400)

    @property
    def limits(self) -> Limits:
        """As the core takes them.

        Raises
        ------
        BadSettings
            The horizon file can't be read, or is none.
        """
        horizon: Horizon | None = None
        if self.horizon_file is not None:
            horizon = Horizon.read(self.horizon_file)
        elif self.horizon_deg is not None:
            horizon = Horizon(self.horizon_deg, "horizon_deg")
        return Limits(
            min_altitude_deg=self.min_altitude_deg,
            max_altitude_deg=self.max_altitude_deg,
            horizon=horizon,
            hour_angle_deg=self.hour_angle_deg,
            declination_deg=self.declination_deg,
            past_meridian_deg=(self.past_meridian_east_deg, self.past_meridian_west_deg),
            first_axis_deg=self.first_axis_deg,
            second_axis_deg=self.second_axis_deg,
            sun_cone_deg=self._cone_deg,
            sun_cone_from_altitude_deg=self.sun_cone_from_altitude_deg,
            solar_filter=self.solar_filter,
            moon_cone_deg=self.moon_cone_deg,
            daylight=self.daylight,
            daylight_from_altitude_deg=self.daylight_from_altitude_deg,
            way_min_altitude_deg=self.way_min_altitude_deg,
            rate_ratio=self._rate_ratio,
            margin_deg=self.margin_deg,
            slew_takes_s=self.slew_takes_s,
            track_for_s=self.track_for_s,
            untrusted_tracking_s=self.untrusted_tracking_s,
        )

    @property
    def _cone_deg(self) -> float:
        return 0.0 if self.solar_filter and "sun_cone_deg" not in self.model_fields_set else self.sun_cone_deg

    @property
    def _rate_ratio(self) -> tuple[float, float] | None:
        if self.axis_rates_deg_s is not None:
            ratio = self.axis_rates_deg_s[1] / self.axis_rates_deg_s[0]
            # how fast they come up to it isn't known
            return ratio / 1.25, ratio * 1.25
        return None if self.ways == "any" else (0.5, 2.0)

    @model_validator(mode="after")
    def _some_sky_is_left(self) -> Self:
        if self.min_altitude_deg >= self.max_altitude_deg:
            raise PydanticCustomError(
                "no_sky",
                "altitudes from {low} to {high} leave no sky",
                {
                    "low": self.min_altitude_deg,
                    "high": self.max_altitude_deg,
                    "key": "max_altitude_deg",
                    "fix": "set max_altitude_deg above min_altitude_deg",
                },
            )
        for key in ("hour_angle_deg", "declination_deg", "first_axis_deg", "second_axis_deg"):
            pair = getattr(self, key)
            if pair is not None and pair[0] >= pair[1]:
                raise PydanticCustomError(
                    "no_range",
                    "{key} = {low} to {high} leaves no range",
                    {"low": pair[0], "high": pair[1], "key": key, "fix": "write the lower one first"},
                )
        return self

    @model_validator(mode="after")
    def _one_horizon(self) -> Self:
        if self.horizon_file is not None and self.horizon_deg is not None:
            raise PydanticCustomError(
                "two_horizons",
                "both horizon_file and horizon_deg are given",
                {"key": "horizon_deg", "fix": "remove one of them"},
            )
        for az_deg, alt_deg in self.horizon_deg or ():
            if not (-360.0 <= az_deg <= 360.0 and -90.0 <= alt_deg <= 90.0):
                raise PydanticCustomError(
                    "no_horizon_point",
                    "azimuth {az}, altitude {alt} is not a point of a horizon",
                    {"az": az_deg, "alt": alt_deg, "key": "horizon_deg", "fix": "azimuth 0 to 360 first"},
                )
        if self.horizon_deg is not None and len(self.horizon_deg) < 2:
            raise PydanticCustomError(
                "short_horizon",
                "one point makes no horizon",
                {"key": "horizon_deg", "fix": "give at least two, or set min_altitude_deg"},
            )
        return self
