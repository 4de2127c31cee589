"""What a drift report holds: values with sigmas, words and plain dicts; no mathematics."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime


@dataclass(frozen=True, slots=True)
class Jump:
    """The tube jumped between two looks without a move: seen minus believed, drift taken off."""

    utc: datetime
    east_arcsec: float
    north_arcsec: float
    sigma_arcsec: float

    def as_dict(self) -> dict[str, object]:
        """Plain values."""
        return {
            "utc": self.utc.isoformat(),
            "east_arcsec": self.east_arcsec,
            "north_arcsec": self.north_arcsec,
            "sigma_arcsec": self.sigma_arcsec,
        }


@dataclass(frozen=True, slots=True)
class Rates:
    """Drift on the sky: how fast the tube leaves the place the mount reads, east and north positive."""

    east_arcsec_h: float
    north_arcsec_h: float
    east_sigma_arcsec_h: float
    north_sigma_arcsec_h: float

    def as_dict(self) -> dict[str, object]:
        """Plain values."""
        return {
            "east_arcsec_h": self.east_arcsec_h,
            "north_arcsec_h": self.north_arcsec_h,
            "east_sigma_arcsec_h": self.east_sigma_arcsec_h,
            "north_sigma_arcsec_h": self.north_sigma_arcsec_h,
        }


@dataclass(frozen=True, slots=True)
class Stretch:
    """Looks between two moves or syncs.

    Attributes
    ----------
    start, stop : datetime
        First and last look.
    ha_deg, dec_deg : float
        Hour angle and declination, in the middle.
    rates : Rates or None
        None for fewer than three looks without a jump between them, or looks of one instant.
    refraction : Rates or None
        What refraction alone makes a tube drift that follows the stars evenly; None without air.
    rms_arcsec : float or None
        Scatter about the line.
    reason : str
        Why there are no rates.
    """

    start: datetime
    stop: datetime
    looks: int
    ha_deg: float
    dec_deg: float
    rates: Rates | None
    refraction: Rates | None
    rms_arcsec: float | None
    jumps: tuple[Jump, ...] = ()
    reason: str = ""

    def as_dict(self) -> dict[str, object]:
        """Plain values."""
        return {
            "start": self.start.isoformat(),
            "stop": self.stop.isoformat(),
            "looks": self.looks,
            "ha_deg": self.ha_deg,
            "dec_deg": self.dec_deg,
            "rates": self.rates.as_dict() if self.rates else None,
            "refraction": self.refraction.as_dict() if self.refraction else None,
            "rms_arcsec": self.rms_arcsec,
            "jumps": [one.as_dict() for one in self.jumps],
            "reason": self.reason or None,
        }


@dataclass(frozen=True, slots=True)
class PeriodicError:
    """A swing of the hour angle axis.

    Attributes
    ----------
    amplitude_arcsec, amplitude_sigma_arcsec : float
        Half the swing, of the axis (on the sky it is smaller by cos δ).
    false_alarm : float
        Probability that noise makes as high a peak anywhere in the range.
    aliases_s : tuple of float
        Periods that these instants can't tell from it.
    is_worm : bool or None
        Whether the period is that of the worm, where it is known.
    """

    period_s: float
    period_sigma_s: float
    amplitude_arcsec: float
    amplitude_sigma_arcsec: float
    false_alarm: float
    aliases_s: tuple[float, ...] = ()
    is_worm: bool | None = None

    def as_dict(self) -> dict[str, object]:
        """Plain values."""
        return {
            "period_s": self.period_s,
            "period_sigma_s": self.period_sigma_s,
            "amplitude_arcsec": self.amplitude_arcsec,
            "amplitude_sigma_arcsec": self.amplitude_sigma_arcsec,
            "false_alarm": self.false_alarm,
            "aliases_s": list(self.aliases_s),
            "is_worm": self.is_worm,
        }


@dataclass(frozen=True, slots=True)
class Settling:
    """How long the tube takes to come to rest after a slew.

    Attributes
    ----------
    least_s, most_s : float or None
        It takes longer than the one and no longer than the other; None: no look tells.
    typical_s, sigma_s : float or None
        Median over the slews that are limited from both sides, and its error.
    slews : int
        Slews that told something.
    """

    least_s: float | None
    most_s: float | None
    typical_s: float | None
    sigma_s: float | None
    slews: int

    def as_dict(self) -> dict[str, object]:
        """Plain values."""
        return {
            "least_s": self.least_s,
            "most_s": self.most_s,
            "typical_s": self.typical_s,
            "sigma_s": self.sigma_s,
            "slews": self.slews,
        }


@dataclass(frozen=True, slots=True)
class PolarError:
    """The polar axis' error as ME and MA [POINTING §5], arcsec, with sigmas."""

    me_arcsec: float
    ma_arcsec: float
    me_sigma_arcsec: float
    ma_sigma_arcsec: float

    def as_dict(self) -> dict[str, object]:
        """Plain values."""
        return {
            "me_arcsec": self.me_arcsec,
            "ma_arcsec": self.ma_arcsec,
            "me_sigma_arcsec": self.me_sigma_arcsec,
            "ma_sigma_arcsec": self.ma_sigma_arcsec,
        }


@dataclass(frozen=True, slots=True)
class PolarAlignment:
    """Error of the polar axis, from where it is known, and what to turn.

    Attributes
    ----------
    from_drift, from_model : PolarError or None
        None: not known from there.
    agree : bool or None
        Whether the two agree within 3 sigma; None where there is only one.
    used : PolarError or None
        Both combined if they agree, or the only one; None if they don't.
    raise_arcmin, east_arcmin : float or None
        What to do to the upper end of the axis: raise it, turn it east (an angle about the vertical).
    raise_sigma_arcmin, east_sigma_arcmin : float or None
        One sigma; None: not known.
    advice : str
        In words.
    """

    from_drift: PolarError | None
    from_model: PolarError | None
    agree: bool | None
    used: PolarError | None
    raise_arcmin: float | None
    east_arcmin: float | None
    raise_sigma_arcmin: float | None
    east_sigma_arcmin: float | None
    advice: str

    def as_dict(self) -> dict[str, object]:
        """Plain values."""
        return {
            "from_drift": self.from_drift.as_dict() if self.from_drift else None,
            "from_model": self.from_model.as_dict() if self.from_model else None,
            "agree": self.agree,
            "used": self.used.as_dict() if self.used else None,
            "raise_arcmin": self.raise_arcmin,
            "east_arcmin": self.east_arcmin,
            "raise_sigma_arcmin": self.raise_sigma_arcmin,
            "east_sigma_arcmin": self.east_sigma_arcmin,
            "advice": self.advice,
        }


@dataclass(frozen=True, slots=True)
class DriftReport:
    """How a mount follows the sky: drift, periodic error, settling, polar axis; what isn't known says why.

    Attributes
    ----------
    periodic, settling, polar : value or None
        None: not known.
    periodic_reason, settling_reason, polar_reason : str
        Why one isn't known.
    words : str
        The whole in a few sentences.
    """

    stretches: tuple[Stretch, ...]
    periodic: PeriodicError | None
    periodic_reason: str
    settling: Settling | None
    settling_reason: str
    polar: PolarAlignment | None
    polar_reason: str
    words: str

    def as_dict(self) -> dict[str, object]:
        """Plain values, for JSON."""
        return {
            "words": self.words,
            "stretches": [one.as_dict() for one in self.stretches],
            "periodic": self.periodic.as_dict() if self.periodic else None,
            "periodic_reason": self.periodic_reason or None,
            "settling": self.settling.as_dict() if self.settling else None,
            "settling_reason": self.settling_reason or None,
            "polar": self.polar.as_dict() if self.polar else None,
            "polar_reason": self.polar_reason or None,
        }
