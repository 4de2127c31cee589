"""The polar axis' error from drift rates and from a model, and which knob to turn which way.

observed = axis + ME (sin h sin δ, cos h) + MA (-cos h sin δ, sin h) in (ξ west, η north) [POINTING §5]; an
axis that turns evenly makes that drift. With ME > 0 the northern end of the axis is too low, with MA > 0 too
far east; in the southern hemisphere it is the other end that stands up, so both turn round.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from mountnav.pointing.drift.values import PolarAlignment, PolarError, Stretch
from mountnav.sky.coordinates import SIDEREAL_DEG_S, Site

RAD_H = math.radians(SIDEREAL_DEG_S * 3600.0)
"""How far the sky turns in an hour, rad."""
_RATE_WIDTH_ARCSEC_H = 30.0
"""Motors that run a little fast or slow: 0.05 % of the sidereal rate."""
# Prior sigma of the sag TF, arcsec. Chosen by hand, the size of ordinary tubes. Doubled, drift tells less
# of the altitude error.
_FLEXURE_WIDTH_ARCSEC = 30.0
# Prior sigma of the axis' errors, arcsec: 10°, so wide that it decides nothing.
_AXIS_WIDTH_ARCSEC = 36000.0
_TOLD_ARCSEC = 1800.0
"""More than this isn't known from drift."""
# Drift and model contradict each other when they differ by more sigmas than this: 3, as usual.
_AGREE_SIGMAS = 3.0
# An error smaller than this, arcmin (3″), isn't worth a turn of a knob. Chosen by hand.
_STILL_ARCMIN = 0.05
# Least cos φ that the azimuth is divided by (2.9° from a pole of the Earth), so that no turn is infinite.
_HIGHEST_COS = 0.05


def from_drift(stretches: Sequence[Stretch], site: Site) -> tuple[PolarError | None, str]:
    """Fit ME and MA to drift rates, less refraction, the motor's rate and flexure free; or None, and why."""
    rows, right = [], []
    latitude = math.radians(site.latitude_deg)
    for one in stretches:
        if one.rates is None:
            continue
        h, d = math.radians(one.ha_deg), math.radians(one.dec_deg)
        hours = max((one.stop - one.start).total_seconds() / 3600.0, 1e-3)
        # periodic error and whatever else scatters tilts a short stretch
        loose = 2.0 * (one.rms_arcsec or 0.0) / hours / math.sqrt(one.looks)
        sag = _flexure_rates(h, d, latitude)
        east = (-RAD_H * math.sin(d) * math.cos(h), -RAD_H * math.sin(d) * math.sin(h), -math.cos(d), -sag[0])
        north = (-RAD_H * math.sin(h), RAD_H * math.cos(h), 0.0, sag[1])
        for columns, rate, sigma in (
            (east, one.rates.east_arcsec_h, one.rates.east_sigma_arcsec_h),
            (north, one.rates.north_arcsec_h, one.rates.north_sigma_arcsec_h),
        ):
            weight = 1.0 / max(math.hypot(sigma, loose), 0.05)
            rows.append([value * weight for value in columns])
            right.append(rate * weight)
    if not rows:
        return None, "no stretch has drift rates"
    widths = np.array([_AXIS_WIDTH_ARCSEC, _AXIS_WIDTH_ARCSEC, _RATE_WIDTH_ARCSEC_H, _FLEXURE_WIDTH_ARCSEC])
    a, y = np.array(rows), np.array(right)
    normal = a.T @ a + np.diag(widths**-2)
    best = np.linalg.solve(normal, a.T @ y)
    covariance = np.linalg.inv(normal)
    free = max(y.size - 4, 1)
    # rates that disagree say so in the sigma
    covariance *= max(1.0, float(np.sum((y - a @ best) ** 2)) / free) if y.size > 4 else 1.0
    # straight lines and first order: good to a hundredth
    first_order = 1.0 + 0.01 * float(np.hypot(best[0], best[1]))
    me_sigma, ma_sigma = (math.hypot(math.sqrt(covariance[at, at]), first_order) for at in (0, 1))
    if max(me_sigma, ma_sigma) > _TOLD_ARCSEC:
        return None, (
            "the drift at these hour angles tells "
            + ("neither error" if min(me_sigma, ma_sigma) > _TOLD_ARCSEC else _half(me_sigma))
            + ": follow stars near the meridian and near hour angle ±6 h"
        )
    return PolarError(float(best[0]), float(best[1]), me_sigma, ma_sigma), ""


def _half(me_sigma: float) -> str:
    return "only the azimuth error" if me_sigma > _TOLD_ARCSEC else "only the altitude error"


def _flexure_rates(h: float, d: float, latitude: float) -> tuple[float, float]:
    """Rates of TF's (ξ, η) for 1″ of flexure, arcsec an hour."""
    return (
        RAD_H * math.cos(latitude) * math.cos(h),
        -RAD_H * math.cos(latitude) * math.sin(h) * math.sin(d),
    )


def from_model(terms: Mapping[str, tuple[float, float]]) -> PolarError | None:
    """Take ME and MA, each (value, sigma) in arcsec, from a model's coefficients; None if it has none."""
    if "ME" not in terms or "MA" not in terms:
        return None
    (me, me_sigma), (ma, ma_sigma) = terms["ME"], terms["MA"]
    return PolarError(me, ma, me_sigma, ma_sigma)


def polar_alignment(drift: PolarError | None, model: PolarError | None, site: Site) -> PolarAlignment | None:
    """Put both together, and say what to turn; None if there is neither."""
    if drift is None and model is None:
        return None
    if drift is None or model is None:
        return _advised(drift, model, None, drift or model, site)
    off = [
        abs(a - b) / math.hypot(sa, sb)
        for a, b, sa, sb in (
            (drift.me_arcsec, model.me_arcsec, drift.me_sigma_arcsec, model.me_sigma_arcsec),
            (drift.ma_arcsec, model.ma_arcsec, drift.ma_sigma_arcsec, model.ma_sigma_arcsec),
        )
    ]
    if max(off) > _AGREE_SIGMAS:
        return _advised(drift, model, False, None, site)
    me, me_sigma = _mean(drift.me_arcsec, drift.me_sigma_arcsec, model.me_arcsec, model.me_sigma_arcsec)
    ma, ma_sigma = _mean(drift.ma_arcsec, drift.ma_sigma_arcsec, model.ma_arcsec, model.ma_sigma_arcsec)
    return _advised(drift, model, True, PolarError(me, ma, me_sigma, ma_sigma), site)


def _mean(a: float, sigma_a: float, b: float, sigma_b: float) -> tuple[float, float]:
    weight_a, weight_b = sigma_a**-2, sigma_b**-2
    return (a * weight_a + b * weight_b) / (weight_a + weight_b), 1.0 / math.sqrt(weight_a + weight_b)


def _advised(
    drift: PolarError | None,
    model: PolarError | None,
    agree: bool | None,
    used: PolarError | None,
    site: Site,
) -> PolarAlignment:
    if used is None:
        assert drift is not None
        assert model is not None
        return PolarAlignment(
            drift,
            model,
            agree,
            None,
            None,
            None,
            None,
            None,
            f"drift (ME {drift.me_arcsec:+.0f} ± {drift.me_sigma_arcsec:.0f}″, MA {drift.ma_arcsec:+.0f} ± "
            f"{drift.ma_sigma_arcsec:.0f}″) and model (ME {model.me_arcsec:+.0f} ± "
            f"{model.me_sigma_arcsec:.0f}″, MA {model.ma_arcsec:+.0f} ± {model.ma_sigma_arcsec:.0f}″) "
            "contradict each other: turn nothing; fit a new model",
        )
    up = math.copysign(1.0, site.latitude_deg)
    # turned about the vertical, the end of the axis moves by the cosine of its altitude only
    cosine = max(math.cos(math.radians(site.latitude_deg)), _HIGHEST_COS)
    higher, higher_sigma = up * used.me_arcsec / 60.0, used.me_sigma_arcsec / 60.0
    east, east_sigma = -up * used.ma_arcsec / 60.0 / cosine, used.ma_sigma_arcsec / 60.0 / cosine
    words = [
        _turn("raise the polar axis", "lower the polar axis", higher, higher_sigma, ""),
        _turn("turn the azimuth knob", "turn the azimuth knob", east, east_sigma, " east| west"),
    ]
    told = [one for one in words if one]
    return PolarAlignment(
        drift,
        model,
        agree,
        used,
        higher,
        east,
        higher_sigma,
        east_sigma,
        ", ".join(told) if told else "leave the polar axis as it is: its error is within what is known of it",
    )


def _turn(positive: str, negative: str, arcmin: float, sigma: float, ways: str) -> str:
    """One knob in words; nothing where the error isn't significant."""
    if abs(arcmin) < max(3.0 * sigma, _STILL_ARCMIN):
        return ""
    east, _, west = ways.partition("|")
    words, way = (positive, east) if arcmin > 0.0 else (negative, west)
    return f"{words} {abs(arcmin):.1f}′ ± {sigma:.1f}′{way}"
