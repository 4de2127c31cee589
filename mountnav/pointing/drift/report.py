"""The drift report of a series or a night: stretches, periodic error, settling, polar axis, in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime

from mountnav.pointing.drift.periodic import periodic_error
from mountnav.pointing.drift.polar import from_drift, from_model, polar_alignment
from mountnav.pointing.drift.stretches import JUMP_ARCSEC, MOVED_ARCSEC, cut, looks_of, settling, stretch_of
from mountnav.pointing.drift.values import DriftReport, PeriodicError, PolarAlignment, Settling, Stretch
from mountnav.pointing.observation import PointingObservation
from mountnav.series.drift import jumps
from mountnav.sky.coordinates import Site

# Stretches that the words list, the longest first; the values have them all. Chosen by hand.
_TOLD_STRETCHES = 6


def drift_report(
    observations: Sequence[PointingObservation],
    *,
    site: Site,
    slew_ends: Sequence[datetime] = (),
    model_terms: Mapping[str, tuple[float, float]] | None = None,
    worm_period_s: float | None = None,
    mount_refracts: bool = False,
    altaz: bool = False,
    moved_arcsec: float = MOVED_ARCSEC,
) -> DriftReport:
    """Report how a mount follows the sky.

    Parameters
    ----------
    observations : sequence of PointingObservation
        Looks with absolute values, in any order.
    slew_ends : sequence of datetime
        When slews arrived; without them no settle time is told.
    model_terms : mapping of str to (value, sigma), optional
        A pointing model's coefficients, arcsec; ME and MA are used.
    worm_period_s : float, optional
        If known, the period found is compared with it.
    mount_refracts : bool
        The mount corrects refraction itself; else what refraction alone makes it drift is taken off.
    altaz : bool
        An alt-azimuth mount: it has no polar axis to be told of.
    moved_arcsec : float
        Readings farther apart belong to two stretches.

    Returns
    -------
    DriftReport
        What can't be told says why.

    Raises
    ------
    BadRequest
        An instant is naive or outside 1972 to 2099.
    """
    parts = [looks_of(one, site, refracts=mount_refracts) for one in cut(observations, moved_arcsec)]
    fitted = [stretch_of(one) for one in parts]
    stretches = tuple(one for one, _ in fitted)
    calm = [one for one in parts if not jumps(one.track(), JUMP_ARCSEC)]
    periodic, periodic_reason = None, "no stretch of looks without a jump"
    if calm:
        longest = max(calm, key=lambda one: one.seconds.size)
        periodic, periodic_reason = periodic_error(longest, worm_period_s=worm_period_s)
    settled, settling_reason = settling(
        [(looks, drift) for looks, (_, drift) in zip(parts, fitted, strict=True)], slew_ends
    )
    drifted, polar_reason, polar = None, "an alt-azimuth mount has no polar axis", None
    if not altaz:
        drifted, polar_reason = from_drift(stretches, site)
        polar = polar_alignment(drifted, from_model(model_terms or {}), site)
    return DriftReport(
        stretches=stretches,
        periodic=periodic,
        periodic_reason=periodic_reason,
        settling=settled,
        settling_reason=settling_reason,
        polar=polar,
        polar_reason=polar_reason,
        words=_words(stretches, periodic, settled, polar),
    )


def _words(
    stretches: tuple[Stretch, ...],
    periodic: PeriodicError | None,
    settled: Settling | None,
    polar: PolarAlignment | None,
) -> str:
    told = [one for one in stretches if one.rates is not None]
    words = []
    for one in sorted(told, key=lambda each: each.start - each.stop)[:_TOLD_STRETCHES]:
        assert one.rates is not None
        minutes = (one.stop - one.start).total_seconds() / 60.0
        words.append(
            f"At hour angle {one.ha_deg / 15.0:+.1f} h, declination {one.dec_deg:+.0f}° it drifts "
            f"{one.rates.east_arcsec_h:+.1f} ± {one.rates.east_sigma_arcsec_h:.1f}″/h east, "
            f"{one.rates.north_arcsec_h:+.1f} ± {one.rates.north_sigma_arcsec_h:.1f}″/h north "
            f"({one.looks} looks in {minutes:.0f} min)."
        )
    if not told:
        words.append("No drift is known: no three looks lie between two moves.")
    hops = sum(len(one.jumps) for one in stretches)
    if hops:
        words.append(f"{hops} jump{'s' if hops > 1 else ''} without a move.")
    if periodic is not None:
        aliases = "".join(f" or {one:.0f}" for one in periodic.aliases_s)
        words.append(
            f"Periodic error: ±{periodic.amplitude_arcsec:.1f} ± {periodic.amplitude_sigma_arcsec:.1f}″ in "
            f"{periodic.period_s:.0f} ± {periodic.period_sigma_s:.0f}{aliases} s"
            + {True: ", the worm's.", False: ", not the worm's period.", None: "."}[periodic.is_worm]
        )
    if settled is not None:
        words.append(_settled_words(settled))
    if polar is not None:
        words.append(f"Polar axis: {polar.advice}.")
    return " ".join(words)


def _settled_words(settled: Settling) -> str:
    if settled.typical_s is not None:
        return f"After a slew it settles in {settled.typical_s:.0f} ± {settled.sigma_s:.0f} s."
    return f"After a slew it settles within {settled.most_s:.0f} s (the first look was at rest already)."
