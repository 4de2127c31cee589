"""Findings in words: what was seen, with its numbers, what it most probably is, and what to do."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mountnav.devices import Epoch
from mountnav.pointing.doctor.evidence import Fit, zeros_of
from mountnav.pointing.doctor.facts import Facts, wrapped
from mountnav.pointing.doctor.findings import CERTAIN, Finding, Illness, Measured, Mounting
from mountnav.pointing.doctor.hypotheses import Shape, Turn, ZeroPoint
from mountnav.pointing.doctor.priors import NAMED, SUSPICION
from mountnav.pointing.doctor.sky_checks import SideCheck
from mountnav.sky.coordinates import SIDEREAL_DEG_S, SOLAR_TO_SIDEREAL, Site

_NAMES: dict[Epoch, str] = {"apparent": "JNow (of date)", "icrs": "J2000"}
_AXES = {"IH": "hour angle", "ID": "declination"}
_ADVICE = {
    Illness.CLOCK: "set the mount's clock, time zone and daylight saving switch, then sync",
    Illness.LONGITUDE_SIGN: "set the mount's longitude (many count it west positive), then sync",
    Illness.NOT_ALIGNED: "sync on a solved frame; look again",
}


@dataclass(frozen=True, slots=True)
class Case:
    """What telling needs to know of the patient."""

    facts: Facts
    site: Site
    believed: Epoch
    sides: SideCheck
    mounting: Mounting | None


def log_odds(log_for: float, log_against: float) -> float:
    """Odds of two weights, `CERTAIN` at most."""
    return math.exp(min(log_for - log_against, math.log(CERTAIN)))


def shape_finding(
    case: Case, fit: Fit, best: Shape, share: float, healthy: float, rivals: tuple[Illness, ...]
) -> Finding:
    """Tell what the pattern of offsets means.

    Parameters
    ----------
    best : Shape
        Of the illness that is most probable.
    share, healthy : float
        Its probability, and that of nothing being wrong.
    rivals : tuple of Illness
        What else it may be.
    """
    odds = log_odds(math.log(max(1.0 - healthy, 1e-300)), math.log(max(healthy, 1e-300)))
    rivals = rivals if share < NAMED else ()
    facts = case.facts
    assert best.illness is not None
    what = best.illness
    ids: tuple[str, ...] = ()
    match what:
        case Illness.EPOCH:
            numbers, words, advice = _epoch(case, fit)
        case Illness.SLIPPED:
            return _slipped(case, best, share, odds, rivals)
        case Illness.WRONG_LOOK:
            ids = (facts.look_ids[best.at],)
            numbers, words, advice = _wrong_look(facts, best.at)
        case Illness.CLOCK | Illness.LONGITUDE_SIGN:
            numbers, words, advice = _altaz_turn(case, best)
            rivals = tuple({Illness.CLOCK, Illness.LONGITUDE_SIGN} - {what})
        case Illness.HEMISPHERE:
            numbers = {"latitude": Measured(case.site.latitude_deg, None, "deg")}
            words = "both axes count the other way: the mount believes that it is in the other hemisphere."
            advice = f"set the mount's latitude to {case.site.latitude_deg:+.2f}° (mind the sign), then sync"
        case _:
            numbers = _scatter(facts)
            words = f"offsets of {numbers['largest']} follow no rule that is known here."
            advice = "don't sync or move by these looks; look again, and check clutches, camera and solver"
    return Finding(what, share, odds, numbers, words, advice, rivals, ids)


def _altaz_turn(case: Case, best: Shape) -> tuple[dict[str, Measured], str, str]:
    assert best.illness is not None
    degrees = best.at * 15.0 * SOLAR_TO_SIDEREAL if best.at else -2.0 * case.site.longitude_deg
    seconds = Measured(degrees / SIDEREAL_DEG_S, None, "s")
    longitude = Measured(wrapped_half(case.site.longitude_deg + degrees), None, "deg")
    words = (
        f"the sky is turned about the pole by {degrees:+.2f}°: the mount's clock is {_ahead(seconds)}"
        + (f", {_hours(best.at)}" if best.at else "")
        + f" or it believes that it is at longitude {longitude}"
        + ("." if best.at else ", the sign of its longitude is wrong.")
    )
    return {"clock": seconds, "longitude": longitude}, words, _ADVICE[best.illness]


def _epoch(case: Case, fit: Fit) -> tuple[dict[str, Measured], str, str]:
    facts = case.facts
    lon, lat = wrapped(facts.other_lon - facts.read_lon), facts.other_lat - facts.read_lat
    free = zeros_of(facts).with_columns(lon, np.where(case.sides.beyond, -lat, lat), 3.0, "scale")
    scale, sigma = fit.fitted(facts.read_lon, facts.read_lat, free).zero("scale")
    size = float(np.median(np.hypot(lon * np.cos(facts.lat), lat)))
    numbers = {
        "scale": Measured(scale, sigma, "of the difference between JNow and J2000"),
        "difference": Measured(math.degrees(size) * 60.0, None, "arcmin"),
    }
    truly = _NAMES["icrs" if case.believed == "apparent" else "apparent"]
    words = (
        f"the readings carry {scale:.2f} ± {sigma:.2f} times the difference between JNow and J2000 (here "
        f"{math.degrees(size) * 60.0:.1f}′): the mount speaks {truly}, believed is {_NAMES[case.believed]}."
    )
    return numbers, words, f"set the mount's epoch to {truly}, here or in the mount, not in both; then sync"


def _slipped(case: Case, best: Shape, share: float, odds: float, rivals: tuple[Illness, ...]) -> Finding:
    assert best.fitted is not None
    facts = case.facts
    size, sigma = (math.degrees(one) for one in best.fitted.zero("slip"))
    ids = (facts.look_ids[best.at - 1], facts.look_ids[best.at])
    minutes = (facts.utc_s[best.at] - facts.utc_s[best.at - 1]) / 60.0
    when = f"within the {minutes:.0f} minutes before {_which(facts, best.at)}, without a sync,"
    numbers = {"slip": Measured(size * 60.0, sigma * 60.0, "arcmin")}
    hour = 15.0 * SOLAR_TO_SIDEREAL
    hours = round(size / hour)
    if best.axis == "IH" and hours and abs(size - hours * hour) < max(3.0 * sigma, 0.1):
        seconds = Measured(size / (SIDEREAL_DEG_S), sigma / SIDEREAL_DEG_S, "s")
        return Finding(
            Illness.CLOCK,
            share,
            odds,
            {"clock": seconds, **numbers},
            f"{when} the mount's clock was put {_ahead(seconds)}: {_hours(hours)}.",
            _ADVICE[Illness.CLOCK],
            (Illness.SLIPPED, *rivals),
            ids,
        )
    axis = _AXES[best.axis]
    words = (
        f"{when} the {axis} axis slipped by {size * 60.0:+.1f} ± {sigma * 60.0:.1f}′ (tube against reading)."
    )
    return Finding(
        Illness.SLIPPED,
        share,
        odds,
        numbers,
        words,
        f"check the {axis} clutch, belt and balance, and the motor for lost steps; then sync",
        rivals,
        ids,
    )


def _which(facts: Facts, at: int) -> str:
    """Name a look by its number among all; syncs carry their look's id and are no looks."""
    ids = list(dict.fromkeys(facts.look_ids))
    number, count = (ids.index(facts.look_ids[at]), len(ids)) if all(ids) else (at, len(facts))
    return f"look {number + 1} of {count}"


def _offsets(facts: Facts) -> tuple[np.ndarray, np.ndarray]:
    lon = wrapped(facts.lon - facts.read_lon)
    return wrapped(lon - np.median(lon)) * np.cos(facts.lat), facts.lat - facts.read_lat


def _wrong_look(facts: Facts, at: int) -> tuple[dict[str, Measured], str, str]:
    east, north = _offsets(facts)
    away = math.degrees(math.hypot(east[at] - np.median(east), north[at] - np.median(north)))
    words = f"{_which(facts, at)} lies {away:.2f}° from where the others put it: a false solution?"
    return {"away": Measured(away, None, "deg")}, words, "don't use it; look again at the same place"


def _scatter(facts: Facts) -> dict[str, Measured]:
    east, north = _offsets(facts)
    largest = math.degrees(float(np.max(np.hypot(east - np.median(east), north - np.median(north)))))
    return {"largest": Measured(largest, None, "deg")}


def turn_finding(case: Case, weighed: Sequence[Turn], points: Sequence[ZeroPoint]) -> list[Finding]:
    """Tell what the zero points mean; nothing where they are ordinary."""
    logs = np.array([one.log_weight for one in weighed])
    shares = np.exp(logs - np.logaddexp.reduce(logs))
    healthy = float(shares[0])
    if healthy >= SUSPICION:
        return []
    ill = float(np.logaddexp.reduce(logs[1:]))
    odds = log_odds(ill, float(logs[0]))
    by: dict[Illness, float] = {}
    for one, share in zip(weighed[1:], shares[1:], strict=True):
        assert one.illness is not None
        # a clock that is wrong by any time and a wrong longitude are the same turn
        name = Illness.CLOCK if one.illness is Illness.LONGITUDE else one.illness
        by[name] = by.get(name, 0.0) + float(share)
    what = max(by, key=lambda one: by[one])
    rivals = [one for one, share in by.items() if one is not what and share > 0.02]
    names = (what, Illness.LONGITUDE) if what is Illness.CLOCK else (what,)
    best = max(
        (one for one in weighed[1:] if one.illness in names),
        key=lambda one: one.log_weight,
    )
    at = min(best.segments or tuple(points), key=lambda one: one.ih_sigma_deg)
    turn = Measured(at.ih_deg, at.ih_sigma_deg, "deg")
    dec = Measured(at.id_deg, at.id_sigma_deg, "deg")
    numbers = {"hour_angle_zero": turn, "declination_zero": dec}
    if what is Illness.NOT_ALIGNED:
        words = (
            f"zero points are off by {turn} in hour angle, {dec} in declination: the mount was never synced."
        )
        return [Finding(what, by[what], odds, numbers, words, _ADVICE[what], tuple(rivals))]
    seconds = Measured(at.ih_deg / SIDEREAL_DEG_S, at.ih_sigma_deg / SIDEREAL_DEG_S, "s")
    longitude = Measured(wrapped_half(case.site.longitude_deg + at.ih_deg), at.ih_sigma_deg, "deg")
    numbers |= {"clock": seconds, "longitude": longitude}
    if what is Illness.LONGITUDE_SIGN:
        words = (
            f"hour angles are off by {turn}, minus twice the longitude ({case.site.longitude_deg:+.2f}°)"
            f": the mount believes that it is at {longitude}, the sign of its "
            "longitude is wrong (or its clock "
            f"is {_ahead(seconds)})."
        )
        rivals += [one for one in (Illness.CLOCK,) if one not in rivals]
    else:
        hours = f": {_hours(best.hours)}" if best.illness is Illness.CLOCK else ""
        words = (
            f"hour angles are off by {turn} and declinations are not: the mount's clock is "
            f"{_ahead(seconds)}{hours}, or it believes that it is at longitude {longitude}; "
            "looks can't tell which."
        )
        rivals += [one for one in (Illness.LONGITUDE,) if one not in rivals]
    return [Finding(what, by[what], odds, numbers, words, _ADVICE[what], tuple(rivals))]


def wrapped_half(angle_deg: float) -> float:
    """Into (-180, 180]."""
    return 180.0 - (180.0 - angle_deg) % 360.0


def _ahead(seconds: Measured) -> str:
    size = Measured(abs(seconds.value), seconds.sigma, seconds.unit)
    return f"{size} {'ahead' if seconds.value > 0 else 'behind'}"


def _hours(hours: int) -> str:
    return "daylight saving time?" if abs(hours) == 1 else f"a time zone? ({hours:+d} h)"


def side_finding(case: Case) -> Finding | None:
    """Tell what is wrong with the reported sides; None where nothing is."""
    check = case.sides
    if check.probability_turned > SUSPICION:
        assert check.jump_deg is not None
        jump = Measured(check.jump_deg, check.jump_sigma_deg, "deg")
        return Finding(
            Illness.CAMERA_TURNED,
            check.probability_turned,
            CERTAIN,
            {"turn": jump},
            f"the camera was turned by {jump} between looks: image angles say nothing about sides until "
            "they are learned again.",
            "nothing, if you turned it; else tighten it",
        )
    if check.probability_wrong < SUSPICION:
        return None
    against = max(1.0 - check.probability_wrong, 1e-12)
    ids = tuple(case.facts.look_ids[one] for one in check.looks)
    advice = "limits and flips rest on it: stop, look which side the tube is on, then home or unpark again"
    if check.swapped:
        words = "the sides are reported the wrong way round: the tube is east where the mount says west."
        return Finding(Illness.PIER_SIDE, 1.0 - against, 1.0 / against, {}, words, advice, (), ids)
    assert check.jump_deg is not None
    jump = Measured(check.jump_deg, check.jump_sigma_deg, "deg")
    told = (
        "the mount reported another side and the image did not turn"
        if check.unchanged_flip
        else "the image turned upside down and the mount reported no other side"
    )
    return Finding(
        Illness.PIER_SIDE,
        check.probability_wrong,
        # no healthy mount turns an image, or fails to at a flip
        CERTAIN,
        {"turn": jump},
        f"{told} (turned by {jump} against what the sides say, in {len(ids)} of {len(case.facts)} looks).",
        advice,
        (Illness.CAMERA_TURNED,) if check.probability_wrong < NAMED else (),
        ids,
    )
