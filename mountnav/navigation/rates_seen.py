"""What is wrong with the rates at which a mount tracks a moving target, by what looks show of them.

Pure: rates as they were measured (`rates_measured`) in, a judgement out. All rates are in the mount's own
kind of coordinates, as `OffsetRates` has them: there a mount that keeps its rates moves along a straight line
in right ascension and declination, however near the pole. A tube drifts for other reasons too: a polar axis
beside the pole, refraction, flexure, the worm. What was seen of that before, at the stars' rate, is taken
off, and what may be left of it counts as error: so a named fault is one that no drift explains.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, Literal

from mountnav.devices import STARS_RATES, OffsetRates, PierSide
from mountnav.navigation.rates_measured import (
    TIME_SIGMA_S,
    TRAIL_SHARE,
    OrderedRates,
    RateLook,
    SeenRates,
    TrailSeen,
    rates_of,
)
from mountnav.sky.coordinates import SIDEREAL_ARCSEC_S, SOLAR_TO_SIDEREAL

__all__ = [
    "MOST_PLAY_ARCSEC",
    "LawWord",
    "RateCorrection",
    "RateDoubts",
    "RateFault",
    "RatesJudgement",
    "judge_rates",
]


RIGHT_SIGMAS = 5.5
"""Rates so many sigmas off (two coordinates together) are not those that were ordered: 3 in ten million right
ones are as far off. Halved, one right mount in forty would be called wrong."""
WITHIN_SIGMAS = 4.5
"""A fault that would give rates so near to the measured ones may be it: 4 in 100,000 lie beyond. Doubled,
more faults can't be told apart; halved, a true one is passed over in one case of twelve."""
STEP_ARCSEC_S = 0.004
"""What protocols round rates to, ″/s, in either coordinate: the coarsest, NexStar's and INDI's texts, have
some thousandths. Doubled, only the faults of 0.3 % take longer to be named."""
SCALE_TOLERANCE = 3e-4
"""What gears, quartzes and plates may be wrong by. Chosen by hand: cheap quartzes keep 1e-4. Tenfold, 1.0027
could not be told from 1."""
LAW_TOLERANCE = 4e-3
"""How near a factor must come to 15.04 and to 220, as a share: 15 and 15.04 are one fault, told otherwise.
Doubled, nothing else falls in."""
AXIS_OFF_RAD = math.radians(10.0 / 60.0)
"""How far the mount's axes may be from the sky's: 10′, a polar axis set up by eye. It bends what rates come
to. Doubled, rates near the pole are judged half as sharply."""
UNKNOWN_DRIFT_ARCSEC_S = 0.06
"""Drift where none was seen before, ″/s per coordinate on the sky, one sigma: a polar axis 10′ off gives
0.044, refraction at 20° of altitude 0.02. Doubled, slow comets take twice as long to be judged."""
DRIFT_AGES_ARCSEC_S_H = 0.01
"""How much a drift changes in an hour, ″/s: what the sky's turn makes of that of a polar axis 10′ off.
Doubled, a drift that was seen an hour before says less."""
WORM_ARCSEC, WORM_ARCSEC_S = 12.0, 0.16
"""Amplitude of the error of the right ascension's worm, ″, and the most that it gives in ″/s (12″ in 480 s):
those of usual mounts. Doubled, right ascension's slow rates take twice as long to be judged."""
PLAY_ARCSEC, PLAY_ARCSEC_S = 2.0, 0.02
"""The same of the declination: wind and flexure. Doubled, its slow rates take twice as long to be judged."""
POLE_COS = 0.05
"""Nearer to the pole than this cosine of the declination (2.9°) no fault is named: there the axes' own errors
turn what rates come to by as much as faults do. Halved, a polar axis 10′ off could pass for a fault."""
TELLING_SHARE = 0.5
"""A coordinate whose ordered rate is less than this share of what its errors hide says nothing of a fault."""

MOST_PLAY_ARCSEC = 120.0
"""So far a declination's gear may turn before the tube follows, after it was slewed or turned round, ″: worn
ones have as much. Doubled, rates that are ignored are named after twice the way."""
HARMLESS = 1.5
"""A correction is tried to tell faults apart if under none of them the mount goes faster than so many times
what was ordered. Doubled, the target leaves narrow fields while it is tried."""
GROSS_SHARE = 0.3
"""Rates are called right once every fault that would change them by more than this share is excluded; smaller
ones take longer, and corrections by looks take them off meanwhile. Doubled, cos δ at 50° may go unsaid."""


class RateFault(StrEnum):
    """What a mount makes of rates that it is ordered to keep."""

    IGNORED = "ignored"
    SIGN_RA = "sign-ra"
    SIGN_DEC = "sign-dec"
    SIGNS = "signs"
    FACTOR_15 = "factor-15.04"
    FACTOR_1_15 = "factor-1/15.04"
    FACTOR_SIDEREAL = "factor-1.0027"
    FACTOR_SOLAR = "factor-0.9973"
    FACTOR_220 = "factor-220"
    COS_MISSING = "cos-dec-missing"
    COS_TWICE = "cos-dec-twice"
    SWAPPED = "axes-swapped"
    ONLY_RA = "only-ra"
    ONLY_DEC = "only-dec"
    FORGOTTEN = "forgotten-after-slew"
    LOST_AT_FLIP = "lost-at-flip"
    UNEXPLAINED = "unexplained"


LawWord = Literal[
    "right",
    "none",
    "reversed",
    "x15.04",
    "x15.04 reversed",
    "/15.04",
    "/15.04 reversed",
    "x1.0027",
    "/1.0027",
    "x220",
    "x220 reversed",
    "cos",
    "1/cos",
]
"""What becomes of an ordered rate of one axis."""

_FACTORS: Mapping[LawWord, float] = {
    "right": 1.0,
    "none": 0.0,
    "reversed": -1.0,
    "x15.04": SIDEREAL_ARCSEC_S,
    "x15.04 reversed": -SIDEREAL_ARCSEC_S,
    "/15.04": 1.0 / SIDEREAL_ARCSEC_S,
    "/15.04 reversed": -1.0 / SIDEREAL_ARCSEC_S,
    "x1.0027": SOLAR_TO_SIDEREAL,
    "/1.0027": 1.0 / SOLAR_TO_SIDEREAL,
    "x220": 220.0,
    "x220 reversed": -220.0,
}


def _factor(law: LawWord, dec_deg: float) -> float:
    cosine = max(POLE_COS, math.cos(math.radians(dec_deg)))
    if law == "cos":
        return cosine
    return 1.0 / cosine if law == "1/cos" else _FACTORS[law]


@dataclass(frozen=True, slots=True)
class _Law:
    """A fault, as what it makes of both rates."""

    fault: RateFault | None
    ra: LawWord
    dec: LawWord
    swapped: bool = False

    def rates(self, ordered: OffsetRates, dec_deg: float) -> OffsetRates:
        ra, dec = ordered.ra_arcsec_s, ordered.dec_arcsec_s
        if self.swapped:
            ra, dec = dec, ra
        return OffsetRates(ra * _factor(self.ra, dec_deg), dec * _factor(self.dec, dec_deg))


_F = RateFault
_OF_FACTORS: tuple[tuple[RateFault, LawWord], ...] = (
    (_F.FACTOR_15, "x15.04"),
    (_F.FACTOR_1_15, "/15.04"),
    (_F.FACTOR_SIDEREAL, "x1.0027"),
    (_F.FACTOR_SOLAR, "/1.0027"),
    (_F.FACTOR_220, "x220"),
)
_RIGHT = _Law(None, "right", "right")
_LAWS: tuple[_Law, ...] = (
    _Law(_F.IGNORED, "none", "none"),
    _Law(_F.ONLY_RA, "right", "none"),
    _Law(_F.ONLY_DEC, "none", "right"),
    _Law(_F.SIGN_RA, "reversed", "right"),
    _Law(_F.SIGN_DEC, "right", "reversed"),
    _Law(_F.SIGNS, "reversed", "reversed"),
    *(_Law(fault, law, "right") for fault, law in _OF_FACTORS),
    *(_Law(fault, "right", law) for fault, law in _OF_FACTORS),
    *(_Law(fault, law, law) for fault, law in _OF_FACTORS),
    _Law(_F.FACTOR_15, "x15.04 reversed", "right"),
    _Law(_F.FACTOR_1_15, "/15.04 reversed", "right"),
    _Law(_F.FACTOR_220, "x220 reversed", "right"),
    _Law(_F.COS_MISSING, "1/cos", "right"),
    _Law(_F.COS_TWICE, "cos", "right"),
    _Law(_F.SWAPPED, "right", "right", True),
)
"""All faults that have a name, simplest first."""

_WORDS: Mapping[RateFault, str] = {
    _F.IGNORED: "the mount ignores rates: it tracks at the sidereal rate",
    _F.ONLY_RA: "the mount keeps the rate in right ascension alone",
    _F.ONLY_DEC: "the mount keeps the rate in declination alone",
    _F.SIGN_RA: "the mount takes the rate in right ascension with the other sign",
    _F.SIGN_DEC: "the mount takes the rate in declination with the other sign",
    _F.SIGNS: "the mount takes both rates with the other sign",
    _F.FACTOR_15: "the mount takes arcsec per second for seconds of RA per sidereal second: factor 15.04",
    _F.FACTOR_1_15: "the mount takes seconds of RA per sidereal second for arcsec per second: factor 1/15.04",
    _F.FACTOR_SIDEREAL: "the mount takes seconds for sidereal seconds: factor 1.0027",
    _F.FACTOR_SOLAR: "the mount takes sidereal seconds for seconds: factor 0.9973",
    _F.FACTOR_220: "the mount's rate is about 220 times too fast",
    _F.COS_MISSING: "the mount takes the rate in right ascension for one on the sky: 1/cos δ too fast",
    _F.COS_TWICE: "the mount multiplies the rate in right ascension by cos δ once too often",
    _F.SWAPPED: "the mount gives each axis the rate of the other one",
    _F.FORGOTTEN: "the mount forgets its rates at a slew",
    _F.LOST_AT_FLIP: "the mount loses its rates when it changes sides of the pier",
}


def words_of(fault: RateFault) -> str:
    """A fault in words, as judgements say it."""
    return _WORDS[fault]


_SIDED = frozenset({_F.SIGN_RA, _F.SIGN_DEC, _F.SIGNS})
"""Faults that may be otherwise on the other side of the pier."""
_NO_CURE = frozenset({_F.IGNORED, _F.ONLY_RA, _F.ONLY_DEC, _F.FORGOTTEN, _F.LOST_AT_FLIP, _F.UNEXPLAINED})
"""Faults that no other order would make good; forgotten rates are ordered again after each slew anyway."""
_OF_AXES = {("ra",): " (right ascension)", ("dec",): " (declination)", ("ra", "dec"): ""}


@dataclass(frozen=True, slots=True)
class RateCorrection:
    """What a mount must be sent so that it keeps the rates that are wanted.

    Attributes
    ----------
    fault : RateFault
        What it makes good.
    ra, dec : LawWord
        What the mount makes of each rate.
    swapped : bool
        Whether it gives each axis the rate of the other one.
    side : PierSide
        The side of the pier on which it was seen, and for which alone it holds; unknown: for any.
    """

    fault: RateFault
    ra: LawWord = "right"
    dec: LawWord = "right"
    swapped: bool = False
    side: PierSide = PierSide.UNKNOWN

    def holds(self, side: PierSide) -> bool:
        """Whether it holds for a tube that hangs on that side of the pier."""
        return self.side is PierSide.UNKNOWN or self.side is side

    def sent(self, wanted: OffsetRates, dec_deg: float) -> OffsetRates:
        """What to send for it to keep `wanted` at a declination."""
        ra = wanted.ra_arcsec_s / _factor(self.ra, dec_deg)
        dec = wanted.dec_arcsec_s / _factor(self.dec, dec_deg)
        return OffsetRates(dec, ra) if self.swapped else OffsetRates(ra, dec)

    def kept(self, sent: OffsetRates, dec_deg: float) -> OffsetRates:
        """What it makes of what it is sent."""
        return _Law(self.fault, self.ra, self.dec, self.swapped).rates(sent, dec_deg)

    @property
    def words(self) -> str:
        """For people: what is wrong, and what is done about it."""
        side = "" if self.side is PierSide.UNKNOWN else f", on the {self.side} of the pier"
        return f"{_said(self.fault, self.ra, self.dec)}{side}; rates are sent so that it comes out right"

    def as_dict(self) -> dict[str, Any]:
        """As JSON values."""
        return {
            "fault": str(self.fault),
            "ra": self.ra,
            "dec": self.dec,
            "swapped": self.swapped,
            "side": str(self.side),
        }

    @classmethod
    def of_dict(cls, data: Mapping[str, Any]) -> RateCorrection | None:
        """What `as_dict` gave; None where it can't be read, or is none that could be made good."""
        try:
            fault, side = RateFault(str(data["fault"])), PierSide(str(data["side"]))
            ra, dec, swapped = str(data["ra"]), str(data["dec"]), data["swapped"] is True
        except (KeyError, ValueError):
            return None
        for law in _LAWS:
            if law.fault is not fault or law.swapped is not swapped or fault in _NO_CURE:
                continue
            if (ra, dec) in ((law.ra, law.dec), (law.ra, "right"), ("right", law.dec)):
                words: tuple[LawWord, LawWord] = (
                    law.ra if ra == law.ra else "right",
                    law.dec if dec == law.dec else "right",
                )
                return cls(fault, *words, swapped, side)
        return None


def _said(fault: RateFault, ra: LawWord, dec: LawWord) -> str:
    words = _WORDS[fault]
    if fault in (_F.FACTOR_15, _F.FACTOR_1_15, _F.FACTOR_SIDEREAL, _F.FACTOR_SOLAR, _F.FACTOR_220):
        axes = tuple(name for name, law in (("ra", ra), ("dec", dec)) if law != "right")
        words += _OF_AXES.get(axes, "")
        if "reversed" in ra:
            words += ", and the other sign"
    return words


# -- what was ordered, and what was seen -------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class RateDoubts:
    """How steady a mount is when nothing is ordered; see the constants of this module.

    Attributes
    ----------
    worm_arcsec, worm_arcsec_s : float
        In right ascension, on the sky's equator.
    play_arcsec, play_arcsec_s : float
        In declination.
    step_arcsec_s : float
        To which rates are rounded on the wire.
    axis_off_rad : float
        How far the axes may lie from the sky's.
    """

    worm_arcsec: float = WORM_ARCSEC
    worm_arcsec_s: float = WORM_ARCSEC_S
    play_arcsec: float = PLAY_ARCSEC
    play_arcsec_s: float = PLAY_ARCSEC_S
    time_sigma_s: float = TIME_SIGMA_S
    step_arcsec_s: float = STEP_ARCSEC_S
    axis_off_rad: float = AXIS_OFF_RAD

    def unsteady(self, span_s: float) -> tuple[float, float]:
        """What worm and play may add to rates seen over a span, in right ascension and declination, ″/s."""
        span_s = max(span_s, 1e-3)
        return (
            min(self.worm_arcsec_s, 2.0 * self.worm_arcsec / span_s),
            min(self.play_arcsec_s, 2.0 * self.play_arcsec / span_s),
        )


# -- the judgement -------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class RatesJudgement:
    """What looks say of the rates that a mount keeps.

    Attributes
    ----------
    verdict : {"right", "too-early", "fault", "ambiguous", "unexplained"}
        "too-early": the errors hide whether it keeps them. "ambiguous": it doesn't, and more than one fault
        would explain that.
    measured : SeenRates or None
        None where a trail alone was judged.
    fault : RateFault or None
        Named only where it is the one that explains what was seen; `UNEXPLAINED` where none does.
    could_be : tuple of RateFault
        Those that can't be told apart.
    correction : RateCorrection or None
        What makes the fault good, if an order can.
    words : str
        For people, with the numbers.
    off_sigmas : float
        How many sigmas off the ordered rates.
    trial : RateCorrection or None
        Of faults that can't be told apart: one whose correction would tell, and do no harm if it is another.
    """

    verdict: Literal["right", "too-early", "fault", "ambiguous", "unexplained"]
    measured: SeenRates | None
    words: str
    off_sigmas: float
    fault: RateFault | None = None
    could_be: tuple[RateFault, ...] = ()
    correction: RateCorrection | None = None
    trial: RateCorrection | None = None


@dataclass(frozen=True, slots=True)
class _Evidence:
    """What all hypotheses are held against: rates with their errors, and trails."""

    ordered: OffsetRates
    dec_deg: float
    cosine: float
    seen: SeenRates | None
    drift: OffsetRates
    variance: tuple[float, float]
    trails: tuple[TrailSeen, ...]
    doubts: RateDoubts
    in_play: bool = False

    def sigmas(self, law: _Law) -> float:
        """How far off what was seen is from what a law would give, in sigmas."""
        kept = law.rates(self.ordered, self.dec_deg)
        chi2 = 0.0
        error = self._error(law, kept)
        if self.seen is not None:
            off = (
                self.seen.rates.ra_arcsec_s - self.drift.ra_arcsec_s - kept.ra_arcsec_s,
                self._off_dec(self.seen.rates.dec_arcsec_s - self.drift.dec_arcsec_s, kept.dec_arcsec_s),
            )
            chi2 += sum(
                value**2 / (of_law**2 + variance)
                for value, of_law, variance in zip(off, error, self.variance, strict=True)
            )
        east = (kept.ra_arcsec_s + self.drift.ra_arcsec_s) * self.cosine
        north = kept.dec_arcsec_s + self.drift.dec_arcsec_s
        loose2 = sum((value * size) ** 2 for value, size in zip(error, (self.cosine, 1.0), strict=True))
        worst = 0.0
        for trail in self.trails:
            angle = math.radians(trail.position_angle_deg)
            ways = [
                math.hypot(
                    sign * trail.length_arcsec * math.sin(angle) - east * trail.exposure_s,
                    sign * trail.length_arcsec * math.cos(angle) - north * trail.exposure_s,
                )
                for sign in (1.0, -1.0)
            ]
            loose = sum(self.variance) + loose2
            share = (TRAIL_SHARE * math.hypot(east, north) * trail.exposure_s) ** 2
            worst = max(worst, min(ways) ** 2 / (trail.sigma_arcsec**2 + share + loose * trail.exposure_s**2))
        return math.sqrt(chi2 + worst)

    def _off_dec(self, seen: float, kept: float) -> float:
        """How far off the declination's rate is; while its gear may be in its play it may be any smaller."""
        if self.in_play and seen * kept >= 0.0 and abs(seen) <= abs(kept):
            return 0.0
        return min(seen, seen - kept, key=abs) if self.in_play else seen - kept

    def dec_lags(self) -> bool:
        """Whether the declination was seen to go more slowly than ordered, or not at all: as in its play."""
        if self.seen is None:
            return False
        ordered = self.ordered.dec_arcsec_s
        went = math.copysign(1.0, ordered) * (self.seen.rates.dec_arcsec_s - self.drift.dec_arcsec_s)
        loose = WITHIN_SIGMAS * math.hypot(math.sqrt(self.variance[1]), self._error(_RIGHT, self.ordered)[1])
        return -loose < went < abs(ordered) - loose

    def _error(self, law: _Law, kept: OffsetRates) -> tuple[float, float]:
        """What may be off under a law besides noise: rounding, scale, axes that aren't the sky's."""
        east, north = abs(kept.ra_arcsec_s) * self.cosine, abs(kept.dec_arcsec_s)
        off = self.doubts.axis_off_rad
        tangent = math.sqrt(max(0.0, 1.0 - self.cosine**2)) / self.cosine
        told = any(word.lstrip("x/").startswith(("15.04", "220")) for word in (law.ra, law.dec))
        share = LAW_TOLERANCE if told else SCALE_TOLERANCE
        rounding = (
            abs(_factor(law.ra, self.dec_deg)) * self.doubts.step_arcsec_s,
            abs(_factor(law.dec, self.dec_deg)) * self.doubts.step_arcsec_s,
        )
        in_east = math.hypot(east * (off * tangent + share), north * off / self.cosine)
        in_north = math.hypot(east * off, north * (share + off**2))
        return math.hypot(in_east / self.cosine, rounding[0]), math.hypot(in_north, rounding[1])

    def speed(self, rates: OffsetRates) -> float:
        """On the sky, ″/s."""
        return math.hypot(rates.ra_arcsec_s * self.cosine, rates.dec_arcsec_s)

    def hidden(self) -> tuple[float, float]:
        """Differences of a rate in each coordinate that the errors hide, ″/s."""
        error = self._error(_RIGHT, self.ordered)
        loose = [math.sqrt(variance + own**2) for variance, own in zip(self.variance, error, strict=True)]
        if self.seen is None:
            longest = max((trail.exposure_s for trail in self.trails), default=0.0)
            least = min((trail.sigma_arcsec for trail in self.trails), default=math.inf)
            of_trail = least / longest if longest > 0.0 else math.inf
            loose = [math.hypot(loose[0], of_trail / self.cosine), math.hypot(loose[1], of_trail)]
        ra, dec = (TELLING_SHARE * WITHIN_SIGMAS * one for one in loose)
        return ra, dec

    def told(self) -> tuple[bool, bool]:
        """Which coordinates' rates are fast enough for an ignored one to show."""
        ra, dec = self.hidden()
        return abs(self.ordered.ra_arcsec_s) > ra, abs(self.ordered.dec_arcsec_s) > dec

    def gross(self, law: _Law) -> bool:
        """Whether a law would change the ordered rates by more than a share of them."""
        kept, ordered = law.rates(self.ordered, self.dec_deg), self.ordered
        east = (kept.ra_arcsec_s - ordered.ra_arcsec_s) * self.cosine
        north = kept.dec_arcsec_s - ordered.dec_arcsec_s
        return math.hypot(east, north) > GROSS_SHARE * self.speed(ordered)

    def reduced(self, laws: Sequence[_Law]) -> list[_Law]:
        """Laws without what they say of coordinates in which it makes no difference; each once."""
        hidden, told, found = self.hidden(), self.told(), list[_Law]()
        for law in laws:
            shown = law if law.swapped else self._reduced(law, hidden, told)
            if shown is not None and shown not in found:
                found.append(shown)
        return found

    def _reduced(self, law: _Law, hidden: tuple[float, float], told: tuple[bool, bool]) -> _Law | None:
        kept, ordered = law.rates(self.ordered, self.dec_deg), self.ordered
        shows_ra = abs(kept.ra_arcsec_s - ordered.ra_arcsec_s) > hidden[0]
        shows_dec = abs(kept.dec_arcsec_s - ordered.dec_arcsec_s) > hidden[1]
        if not (shows_ra or shows_dec):
            return None
        shown = replace(law, ra=law.ra if shows_ra else "right", dec=law.dec if shows_dec else "right")
        if {word for word, tells in zip((shown.ra, shown.dec), told, strict=True) if tells} == {"none"}:
            return replace(shown, fault=_F.IGNORED, ra="none", dec="none")
        if shown.fault is _F.SIGNS and not (shows_ra and shows_dec):
            return replace(shown, fault=_F.SIGN_RA if shows_ra else _F.SIGN_DEC)
        return shown


def judge_rates(
    ordered: Sequence[OrderedRates],
    looks: Sequence[RateLook],
    *,
    drift: SeenRates | None = None,
    doubts: RateDoubts | None = None,
    kept_before: bool = False,
    in_play: bool = False,
    since: Literal["begin", "slew", "flip"] = "begin",
) -> RatesJudgement:
    """Judge which rates a mount keeps, and name what is wrong with them where nothing else explains it.

    Parameters
    ----------
    ordered : sequence of OrderedRates
        What the mount was sent, oldest first.
    looks : sequence of RateLook
        Of one posture, with no slew between. One look is judged by its trail alone.
    drift : SeenRates, optional
        What was seen at the stars' rate before.
    doubts : RateDoubts, optional
        How steady this mount is.
    kept_before : bool
        Whether it was seen to keep such rates before what `since` says.
    in_play : bool
        Whether the declination's gear may have turned in its play meanwhile: then the tube stood still in it,
        or went more slowly, and nothing is wrong with that.
    since : {"begin", "slew", "flip"}
        What happened last before these looks, after the rates were sent.
    """
    doubts = doubts or RateDoubts()
    if not looks:
        return RatesJudgement("too-early", None, "no look yet", 0.0)
    seen = rates_of(looks, ordered, time_sigma_s=doubts.time_sigma_s)
    evidence = _evidence(ordered, looks, seen, drift, doubts)
    off = evidence.sigmas(_RIGHT)
    if seen is None and not evidence.trails:
        return RatesJudgement("too-early", None, "one look, and no trail that could be measured", off)
    if evidence.cosine <= POLE_COS:
        words = f"{_measured_words(evidence)}; nearer than 3° to the pole rates aren't judged"
        return RatesJudgement("too-early", seen, words, off)
    told = evidence.told()
    if off <= RIGHT_SIGMAS:
        return _no_fault(evidence, seen, off, told)
    if in_play and evidence.dec_lags():
        return _lagging(replace(evidence, in_play=True), seen, off, looks[-1].side)
    near = [law for law in _LAWS if evidence.sigmas(law) <= WITHIN_SIGMAS]
    return _named(evidence, seen, off, evidence.reduced(near), looks[-1].side, kept_before, since)


def _lagging(evidence: _Evidence, seen: SeenRates | None, off: float, side: PierSide) -> RatesJudgement:
    """Judge right ascension alone, and no fault that no order would make good: play explains the rest."""
    if evidence.sigmas(_RIGHT) > RIGHT_SIGMAS:
        laws = [law for law in _LAWS if law.dec == "right" and not law.swapped]
        near = evidence.reduced([law for law in laws if evidence.sigmas(law) <= WITHIN_SIGMAS])
        if len(near) == 1 and near[0].fault not in _NO_CURE:
            return _named(evidence, seen, off, near, side, False, "begin")
    words = f"{_measured_words(evidence)}: too early, the declination may be in its play"
    return RatesJudgement("too-early", seen, words, off)


def _evidence(
    ordered: Sequence[OrderedRates],
    looks: Sequence[RateLook],
    seen: SeenRates | None,
    drift: SeenRates | None,
    doubts: RateDoubts,
) -> _Evidence:
    dec_deg = looks[-1].place.dec_deg if seen is None else seen.dec_deg
    cosine = max(1e-6, math.cos(math.radians(dec_deg)))
    trails = tuple(look.trail for look in looks if look.trail is not None)
    if seen is None:
        last = [one.rates for one in ordered if one.since_utc <= looks[-1].utc]
        mean = last[-1] if last else STARS_RATES
        span_s = max((trail.exposure_s for trail in trails), default=1.0)
        own, utc = (0.0, 0.0), looks[-1].utc
    else:
        mean, span_s, utc = seen.ordered, seen.span_s, seen.utc
        own = (seen.ra_sigma_arcsec_s**2, seen.dec_sigma_arcsec_s**2)
    worm, play = doubts.unsteady(span_s)
    unsteady = [(worm**2), (play**2)]
    if drift is None:
        before = STARS_RATES
        loose = (UNKNOWN_DRIFT_ARCSEC_S / cosine) ** 2, UNKNOWN_DRIFT_ARCSEC_S**2
    else:
        before = OffsetRates(
            drift.rates.ra_arcsec_s - drift.ordered.ra_arcsec_s,
            drift.rates.dec_arcsec_s - drift.ordered.dec_arcsec_s,
        )
        aged = DRIFT_AGES_ARCSEC_S_H * abs((utc - drift.utc).total_seconds()) / 3600.0
        aged = min(aged, UNKNOWN_DRIFT_ARCSEC_S)
        loose = drift.ra_sigma_arcsec_s**2 + (aged / cosine) ** 2, drift.dec_sigma_arcsec_s**2 + aged**2
        unsteady = [one + two**2 for one, two in zip(unsteady, doubts.unsteady(drift.span_s), strict=True)]
    variance = (own[0] + loose[0] + unsteady[0], own[1] + loose[1] + unsteady[1])
    return _Evidence(mean, dec_deg, cosine, seen, before, variance, trails, doubts)


def _no_fault(
    evidence: _Evidence, seen: SeenRates | None, off: float, told: tuple[bool, bool]
) -> RatesJudgement:
    near = [law for law in evidence.reduced(_LAWS) if evidence.sigmas(law) <= WITHIN_SIGMAS]
    words = _measured_words(evidence)
    if any(told) and off <= WITHIN_SIGMAS and not any(evidence.gross(law) for law in near):
        return RatesJudgement("right", seen, f"{words}: as ordered", off)
    return RatesJudgement("too-early", seen, f"{words}: too early to say whether as ordered", off)


def _named(
    evidence: _Evidence,
    seen: SeenRates | None,
    off: float,
    laws: Sequence[_Law],
    side: PierSide,
    kept_before: bool,
    since: Literal["begin", "slew", "flip"],
) -> RatesJudgement:
    words = _measured_words(evidence)
    if not laws:
        return RatesJudgement(
            "unexplained", seen, f"{words}: unexplained, measured so", off, fault=_F.UNEXPLAINED
        )
    if len(laws) > 1:
        could_be = tuple(dict.fromkeys(law.fault for law in laws if law.fault is not None))
        said = " or ".join(dict.fromkeys(_said(law.fault, law.ra, law.dec) for law in laws if law.fault))
        trial = None if seen is None else _trial(evidence, laws, side)
        words = f"{words}: {said}; can't be told apart yet"
        return RatesJudgement("ambiguous", seen, words, off, None, could_be, None, trial)
    law = laws[0]
    fault = law.fault
    assert fault is not None
    if fault is _F.IGNORED and kept_before:
        fault = {"slew": _F.FORGOTTEN, "flip": _F.LOST_AT_FLIP, "begin": _F.IGNORED}[since]
    correction = None if seen is None else _correction(law, side)
    return RatesJudgement(
        "fault", seen, f"{words}: {_said(fault, law.ra, law.dec)}", off, fault, (fault,), correction
    )


def _correction(law: _Law, side: PierSide) -> RateCorrection | None:
    """What makes a fault good; None of one that no order would."""
    if law.fault is None or law.fault in _NO_CURE:
        return None
    sided = side if law.fault in _SIDED else PierSide.UNKNOWN
    return RateCorrection(law.fault, law.ra, law.dec, law.swapped, sided)


def _trial(evidence: _Evidence, laws: Sequence[_Law], side: PierSide) -> RateCorrection | None:
    """A correction that tells which of some faults it is, and under none leads faster than was ordered."""
    wanted, dec_deg = evidence.ordered, evidence.dec_deg
    hidden, speed = evidence.hidden(), evidence.speed(wanted)
    for law in laws:
        correction = _correction(law, side)
        if correction is None:
            continue
        sent = correction.sent(wanted, dec_deg)
        others = [other.rates(sent, dec_deg) for other in laws if other is not law]
        tells = all(
            abs(kept.ra_arcsec_s - wanted.ra_arcsec_s) > 2.0 * hidden[0]
            or abs(kept.dec_arcsec_s - wanted.dec_arcsec_s) > 2.0 * hidden[1]
            for kept in others
        )
        if tells and all(evidence.speed(kept) <= HARMLESS * speed for kept in others):
            return correction
    return None


def _measured_words(evidence: _Evidence) -> str:
    ordered, seen = evidence.ordered, evidence.seen
    asked = f"ordered {ordered.ra_arcsec_s:+.4g}″/s in RA and {ordered.dec_arcsec_s:+.4g}″/s in Dec"
    if seen is None:
        trail = evidence.trails[-1] if evidence.trails else None
        if trail is None:
            return asked
        return (
            f"{asked}, stars drawn out by {trail.length_arcsec:.1f}″ ± {trail.sigma_arcsec:.1f}″ in "
            f"{trail.exposure_s:g} s"
        )
    text = (
        f"{asked}, seen {seen.rates.ra_arcsec_s:+.4g} ± {seen.ra_sigma_arcsec_s:.2g} and "
        f"{seen.rates.dec_arcsec_s:+.4g} ± {seen.dec_sigma_arcsec_s:.2g}"
    )
    drift = evidence.drift
    if not drift.none:
        text += f" (drift before: {drift.ra_arcsec_s:+.3g} and {drift.dec_arcsec_s:+.3g})"
    return text
