"""Orders, a function for each kind of job; `Client.order` gives them. What is left out is as set."""

from __future__ import annotations

from datetime import datetime
from typing import Any, Literal

from mountnav.client.targets import Target, instant

Order = dict[str, Any]


def _order(kind: str, **fields: Any) -> Order:
    return {"kind": kind, **{name: value for name, value in fields.items() if value is not None}}


At = str | dict[str, float]
"""A named point of the telescope, or a pixel: ``{"x_px": 100.0, "y_px": 200.0}``, from 0."""


def slew(target: Target, *, at: At | None = None) -> Order:
    """Go to a place as the mount believes it; nothing is looked at."""
    return _order("slew", target=target, at=at)


def center(
    target: Target,
    *,
    tolerance_arcsec: float | None = None,
    max_tries: int | None = None,
    timeout_s: float | None = None,
    correct_by: Literal["sync", "offset", "model"] | None = None,
    planned_s: float | None = None,
    at: At | None = None,
    position_angle_deg: float | None = None,
    angle_tolerance_deg: float | None = None,
    either_way: bool | None = None,
) -> Order:
    """Slew, look, correct, and slew again until the target is at the frame's center, or at a point."""
    return _order(
        "center",
        target=target,
        tolerance_arcsec=tolerance_arcsec,
        max_tries=max_tries,
        timeout_s=timeout_s,
        correct_by=correct_by,
        planned_s=planned_s,
        at=at,
        position_angle_deg=position_angle_deg,
        angle_tolerance_deg=angle_tolerance_deg,
        either_way=either_way,
    )


def rotate(
    position_angle_deg: float,
    *,
    angle_tolerance_deg: float | None = None,
    either_way: bool | None = None,
    exposure_s: float | None = None,
    trust_count: bool | None = None,
) -> Order:
    """Turn the field to a position angle where the telescope stands; looks confirm it."""
    return _order(
        "rotate",
        position_angle_deg=position_angle_deg,
        angle_tolerance_deg=angle_tolerance_deg,
        either_way=either_way,
        exposure_s=exposure_s,
        trust_count=trust_count,
    )


def mosaic(
    target: Target,
    *,
    across: int | None = None,
    down: int | None = None,
    overlap: float | None = None,
    width_deg: float | None = None,
    height_deg: float | None = None,
    offsets_arcsec: list[tuple[float, float]] | None = None,
    pattern_angle_deg: float | None = None,
    turn_field: bool | None = None,
    angle_tolerance_deg: float | None = None,
    snake: bool | None = None,
    from_panel: int | None = None,
    until: Literal["next", "dwell"] | None = None,
    frames: int | None = None,
    dwell_s: float | None = None,
    most_s: float | None = None,
    tolerance_arcsec: float | None = None,
    at: At | None = None,
) -> Order:
    """Center each panel of a mosaic, or place of a pattern, and leave it to the camera.

    `Client.next_panel` says that the camera is through with a frame.
    """
    return _order(
        "mosaic",
        target=target,
        across=across,
        down=down,
        overlap=overlap,
        width_deg=width_deg,
        height_deg=height_deg,
        offsets_arcsec=offsets_arcsec,
        pattern_angle_deg=pattern_angle_deg,
        turn_field=turn_field,
        angle_tolerance_deg=angle_tolerance_deg,
        snake=snake,
        from_panel=from_panel,
        until=until,
        frames=frames,
        dwell_s=dwell_s,
        most_s=most_s,
        tolerance_arcsec=tolerance_arcsec,
        at=at,
    )


def spiral_search(
    target: Target,
    *,
    radius_deg: float | None = None,
    step_share: float | None = None,
    field_deg: float | None = None,
    most_looks: int | None = None,
    most_s: float | None = None,
    exposure_s: float | None = None,
) -> Order:
    """Look round a place, step by step, until a frame is solved; then center it."""
    return _order(
        "spiral-search",
        target=target,
        radius_deg=radius_deg,
        step_share=step_share,
        field_deg=field_deg,
        most_looks=most_looks,
        most_s=most_s,
        exposure_s=exposure_s,
    )


def look(*, exposure_s: float | None = None, persistent: bool | None = None, at: At | None = None) -> Order:
    """Expose and solve: where it truly points. Moves and syncs nothing."""
    return _order("look", exposure_s=exposure_s, persistent=persistent, at=at)


def sync() -> Order:
    """Look, and tell the mount where it truly points."""
    return _order("sync")


def sync_to(target: Target) -> Order:
    """Tell the mount that it points at these coordinates; the service believes it within bounds."""
    return _order("sync-to", target=target)


def offset(east_arcsec: float, north_arcsec: float) -> Order:
    """Nudge: slew by so much on the sky."""
    return _order("offset", east_arcsec=east_arcsec, north_arcsec=north_arcsec)


def flip(target: Target, *, planned_s: float | None = None, at: At | None = None) -> Order:
    """Let a German mount change sides, and center the target anew."""
    return _order("flip", target=target, planned_s=planned_s, at=at)


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


def hold(
    *,
    target: Target | None = None,
    for_s: float | None = None,
    every_s: float | None = None,
    exposure_s: float | None = None,
    by: Literal["pulses", "rates", "both"] | None = None,
    looks: Literal["camera", "frames"] | None = None,
    period_s: float | None = None,
    play_arcsec: float | None = None,
) -> Order:
    """Hold still by looks, until its time is over or its job is cancelled; it tracks on in any case."""
    return _order(
        "hold",
        target=target,
        for_s=for_s,
        every_s=every_s,
        exposure_s=exposure_s,
        by=by,
        looks=looks,
        period_s=period_s,
        play_arcsec=play_arcsec,
    )


def dither(
    *,
    pattern: Literal["random", "spiral", "ring"] | None = None,
    bound: float | None = None,
    unit: Literal["arcsec", "px"] | None = None,
    steps: int | None = None,
    seed: int | None = None,
    number: int | None = None,
    settle_within: float | None = None,
    settle_looks: int | None = None,
    timeout_s: float | None = None,
) -> Order:
    """Look elsewhere by a pattern's step; its job succeeds when looks show that it has settled there."""
    return _order(
        "dither",
        pattern=pattern,
        bound=bound,
        unit=unit,
        steps=steps,
        seed=seed,
        number=number,
        settle_within=settle_within,
        settle_looks=settle_looks,
        timeout_s=timeout_s,
    )


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
