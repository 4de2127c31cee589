"""Orders, a function for each kind of job; `Client.order` gives them. What is left out is as set."""

from __future__ import annotations

from datetime import datetime
from typing import Any, Literal

from mountnav.client.targets import Target, instant

Order = dict[str, Any]


def _order(kind: str, **fields: Any) -> Order:
    return {"kind": kind, **{name: value for name, value in fields.items() if value is not None}}


def slew(target: Target) -> Order:
    """Go to a place as the mount believes it; nothing is looked at."""
    return _order("slew", target=target)


def center(
    target: Target,
    *,
    tolerance_arcsec: float | None = None,
    max_tries: int | None = None,
    timeout_s: float | None = None,
    correct_by: Literal["sync", "offset", "model"] | None = None,
    planned_s: float | None = None,
) -> Order:
    """Slew, look, correct, and slew again until the target is at the frame's center."""
    return _order(
        "center",
        target=target,
        tolerance_arcsec=tolerance_arcsec,
        max_tries=max_tries,
        timeout_s=timeout_s,
        correct_by=correct_by,
        planned_s=planned_s,
    )


def look(*, exposure_s: float | None = None, persistent: bool | None = None) -> Order:
    """Expose and solve: where it truly points. Moves and syncs nothing."""
    return _order("look", exposure_s=exposure_s, persistent=persistent)


def sync() -> Order:
    """Look, and tell the mount where it truly points."""
    return _order("sync")


def sync_to(target: Target) -> Order:
    """Tell the mount that it points at these coordinates; the service believes it within bounds."""
    return _order("sync-to", target=target)


def offset(east_arcsec: float, north_arcsec: float) -> Order:
    """Nudge: slew by so much on the sky."""
    return _order("offset", east_arcsec=east_arcsec, north_arcsec=north_arcsec)


def flip(target: Target, *, planned_s: float | None = None) -> Order:
    """Let a German mount change sides, and center the target anew."""
    return _order("flip", target=target, planned_s=planned_s)


def follow(
    target: Target,
    *,
    duration_s: float | None = None,
    until_utc: datetime | str | None = None,
    tolerance_arcsec: float | None = None,
    exposure_s: float | None = None,
    look_every_s: float | None = None,
) -> Order:
    """Center a target that moves among the stars, and track it until an end; looks confirm its rates.

    Parameters
    ----------
    target : dict
        Of any kind.
    duration_s : float, optional
        For so long from now on; or `until_utc`.
    until_utc : datetime or str, optional
        Until then (aware, or ISO 8601 with a time zone); or `duration_s`.
    tolerance_arcsec : float, optional
    exposure_s : float, optional
        Of the looks.
    look_every_s : float, optional
        Between two looks while all is well; a minute if left out.
    """
    return _order(
        "follow",
        target=target,
        duration_s=duration_s,
        until_utc=None if until_utc is None else instant(until_utc),
        tolerance_arcsec=tolerance_arcsec,
        exposure_s=exposure_s,
        look_every_s=look_every_s,
    )


def forget_rates() -> Order:
    """Forget what looks have taught of how the mount keeps rates."""
    return _order("forget-rates")


def park() -> Order:
    """Go to the park position and stay."""
    return _order("park")


def unpark() -> Order:
    """Be ready to move again."""
    return _order("unpark")


def set_park() -> Order:
    """Take the present place for the park position."""
    return _order("set-park")


def home() -> Order:
    """Go home, or find it by its sensors."""
    return _order("home")


def tracking(on: bool, *, rate: Literal["sidereal", "lunar", "solar", "king"] | None = None) -> Order:
    """Follow the sky, or rest."""
    return _order("tracking", on=on, rate=rate)


def guide(direction: Literal["n", "s", "e", "w"], duration_s: float) -> Order:
    """Move at the guide rate for a moment."""
    return _order("guide", direction=direction, duration_s=duration_s)


def offset_rates(ra_arcsec_s: float, dec_arcsec_s: float, *, for_s: float | None = None) -> Order:
    """Track at rates beside the sidereal one, up to an end; 0 and 0 end them.

    Parameters
    ----------
    ra_arcsec_s, dec_arcsec_s : float
        In the mount's own coordinates, ″ per second of the clock; right ascension not times cos δ, positive
        to the east.
    for_s : float, optional
        They end by themselves after so long; 15 minutes if left out.
    """
    return _order("offset-rates", ra_arcsec_s=ra_arcsec_s, dec_arcsec_s=dec_arcsec_s, for_s=for_s)


def move_axis(
    axis: Literal["primary", "secondary"],
    rate_deg_s: float,
    *,
    for_s: float | None = None,
    job_id: str | None = None,
) -> Order:
    """Move an axis on while it is held; `Client.move_axis` gives it, and never sends it a second time.

    Parameters
    ----------
    axis : {"primary", "secondary"}
        Right ascension or azimuth; declination or altitude.
    rate_deg_s : float
        On top of tracking; positive to greater right ascension (azimuth) or declination (altitude); 0 ends
        it.
    for_s : float, optional
        It ends by itself after so long, if no further order prolongs it; a second if left out, ten at most.
    job_id : str, optional
        Of the job that the first order began: refused once that has ended.
    """
    return _order("move-axis", axis=axis, rate_deg_s=rate_deg_s, for_s=for_s, job_id=job_id)


def trust() -> Order:
    """An operator's word that the mount's position is right. Needs the role configure."""
    return _order("trust")


def set_site_time() -> Order:
    """Set the mount's site and clock to the service's."""
    return _order("set-site-time")


def accept_site_time() -> Order:
    """Accept that mount and settings differ on site or time, until that changes. Needs configure."""
    return _order("accept-site-time")


def recover(*, exposure_s: float | None = None) -> Order:
    """Tell a lost mount where it points: two looks that agree, then a sync. Never moves."""
    return _order("recover", exposure_s=exposure_s)


def first_light(*, exposure_s: float | None = None) -> Order:
    """Tell a telescope set up by eye where it points, and learn its camera: looks, small moves, a sync."""
    return _order("first-light", exposure_s=exposure_s)


def solve(
    *,
    path: str | None = None,
    exposure_s: float | None = None,
    ra_deg: float | None = None,
    dec_deg: float | None = None,
    radius_deg: float | None = None,
    scale_low_arcsec_px: float | None = None,
    scale_high_arcsec_px: float | None = None,
    blind: Literal["after", "only", "never"] | None = None,
    budget_s: float | None = None,
) -> Order:
    """Solve a frame that lies on the service's machine; or expose one and solve it. Moves nothing.

    All but `exposure_s` is for a file, and refused without its `path`.
    """
    return _order(
        "solve",
        path=path,
        exposure_s=exposure_s,
        ra_deg=ra_deg,
        dec_deg=dec_deg,
        radius_deg=radius_deg,
        scale_low_arcsec_px=scale_low_arcsec_px,
        scale_high_arcsec_px=scale_high_arcsec_px,
        blind=blind,
        budget_s=budget_s,
    )


def series(
    *,
    target: Target | None = None,
    looks: int | None = None,
    every_s: float | None = None,
    exposure_s: float | None = None,
) -> Order:
    """Look again and again while it tracks: how the field drifts."""
    return _order("series", target=target, looks=looks, every_s=every_s, exposure_s=exposure_s)


def model_run(
    *,
    points: int | None = None,
    spread: Literal["spiral", "random"] | None = None,
    seed: int | None = None,
    exposure_s: float | None = None,
    put_in_force: bool | None = None,
) -> Order:
    """Look at points over the allowed sky, make a pointing model of them, and judge it."""
    return _order(
        "model-run",
        points=points,
        spread=spread,
        seed=seed,
        exposure_s=exposure_s,
        put_in_force=put_in_force,
    )
