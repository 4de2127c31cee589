"""Orders, a function for each kind of job; `Client.order` gives them. What is left out is as set.

Made from the orders of the service by `python -m tools.client_orders`: change them in
`api/orders/vocabulary.py`.
"""

from __future__ import annotations

from datetime import datetime
from typing import Any, Literal

from mountnav.client.targets import Target, instant

Order = dict[str, Any]


def _order(kind: str, fields: dict[str, Any]) -> Order:
    """An order of what a caller gave: what is None was left out."""
    given = {name: value for name, value in fields.items() if value is not None}
    return {"kind": kind} | {
        name: instant(value) if isinstance(value, datetime) else value for name, value in given.items()
    }


At = str | dict[str, float]
"""A named point of the telescope, or a pixel: ``{"x_px": 100.0, "y_px": 200.0}``, from 0."""


def slew(target: Target, *, at: At | None = None) -> Order:
    """Go to a place as the mount believes it; nothing is looked at.

    Parameters
    ----------
    at : At, optional
        To which point of the camera the target is brought: a name of `[[telescope.point]]`, or a pixel;
        left out: the frame's middle.
    """
    return _order("slew", locals())


def center(
    target: Target,
    *,
    angle_tolerance_deg: float | None = None,
    either_way: bool | None = None,
    tolerance_arcsec: float | None = None,
    max_tries: int | None = None,
    timeout_s: float | None = None,
    correct_by: Literal["sync", "offset", "model"] | None = None,
    planned_s: float | None = None,
    at: At | None = None,
    position_angle_deg: float | None = None,
) -> Order:
    """Slew, look, correct, and slew again until the target is at the frame's center, or at a point.

    Parameters
    ----------
    either_way : bool, optional
        It may stand on its head as well.
    planned_s : float, optional
        How long it is to be followed: the answer tells which limit comes before that.
    at : At, optional
        To which point of the camera the target is brought: a name of `[[telescope.point]]`, or a pixel;
        left out: the frame's middle.
    position_angle_deg : float, optional
        Position angle of the image's +y, north through east; of a named point its own direction. A
        rotator turns it there, and looks confirm it.
    """
    return _order("center", locals())


def look(*, exposure_s: float | None = None, persistent: bool | None = None, at: At | None = None) -> Order:
    """Expose and solve: where it truly points. Moves and syncs nothing.

    Parameters
    ----------
    persistent : bool, optional
        Of a look: try all that is allowed and moves nothing, waiting included.
    at : At, optional
        Of a look: tell where this point looks, too.
    """
    return _order("look", locals())


def sync() -> Order:
    """Look, and tell the mount where it truly points."""
    return _order("sync", locals())


def sync_to(target: Target) -> Order:
    """Tell the mount that it points at these coordinates: a planetarium's sync, believed within bounds."""
    return _order("sync-to", locals())


def offset(east_arcsec: float, north_arcsec: float) -> Order:
    """Nudge: slew by so much on the sky, east and north positive."""
    return _order("offset", locals())


def flip(target: Target, *, planned_s: float | None = None, at: At | None = None) -> Order:
    """Let a German mount change sides, and center the target again.

    Parameters
    ----------
    planned_s : float, optional
        How long it is to be followed: the answer tells which limit comes before that.
    at : At, optional
        To which point of the camera the target is brought: a name of `[[telescope.point]]`, or a pixel;
        left out: the frame's middle.
    """
    return _order("flip", locals())


def follow(
    target: Target,
    *,
    duration_s: float | None = None,
    until_utc: datetime | str | None = None,
    tolerance_arcsec: float | None = None,
    exposure_s: float | None = None,
    look_every_s: float | None = None,
    at: At | None = None,
) -> Order:
    """Center a target that moves among the stars, and track it until an end; looks confirm its rates.

    It ends earlier where its ephemeris ends or a limit is ahead. However it ends, the mount has no rates of
    its own afterwards.

    Parameters
    ----------
    duration_s : float, optional
        For so long from now on; or until_utc.
    until_utc : datetime or str, optional
        Until then, at most a day ahead; or duration_s.
    exposure_s : float, optional
        Of the looks.
    look_every_s : float, optional
        Between two looks while all is well; left out: a minute.
    at : At, optional
        To which point it is brought, by what solves have taught.
    """
    return _order("follow", locals())


def forget_rates() -> Order:
    """Forget what looks have taught of how the mount keeps rates: they are sent as they are again."""
    return _order("forget-rates", locals())


def park() -> Order:
    """Go to the park position and stay."""
    return _order("park", locals())


def unpark() -> Order:
    """Be ready to move again."""
    return _order("unpark", locals())


def set_park() -> Order:
    """Take the present place for the park position."""
    return _order("set-park", locals())


def home() -> Order:
    """Go home, or find it by its sensors."""
    return _order("home", locals())


def tracking(on: bool, *, rate: Literal["sidereal", "lunar", "solar", "king"] | None = None) -> Order:
    """Follow the sky, or rest."""
    return _order("tracking", locals())


def guide(direction: Literal["n", "s", "e", "w"], duration_s: float) -> Order:
    """Move at the guide rate for a moment."""
    return _order("guide", locals())


def offset_rates(ra_arcsec_s: float, dec_arcsec_s: float, *, for_s: float | None = None) -> Order:
    """Track at rates beside the sidereal one, up to an end: it goes back to a star's by itself then.

    The job ends when the mount has taken them; the rates go on. A further order changes or prolongs them, 0
    and 0 end them; so do a stop, a slew and a park.

    Parameters
    ----------
    ra_arcsec_s : float
        Change of the right ascension, arcseconds per second of the clock, not times cos(dec); positive to
        the east. In the mount's own coordinates.
    dec_arcsec_s : float
        Change of the declination, arcseconds per second; positive to the north.
    for_s : float, optional
        They end by themselves after so many seconds; limits are checked up to then.
    """
    return _order("offset-rates", locals())


def trust() -> Order:
    """An operator's word that the mount's position is right: give it after a look.

    Needs the role configure.
    """
    return _order("trust", locals())


def set_site_time() -> Order:
    """Set the mount's site and clock to this service's. Moves nothing; its position may count no more."""
    return _order("set-site-time", locals())


def accept_site_time() -> Order:
    """Accept that mount and settings contradict each other on site or time, until that changes.

    Needs the role configure.
    """
    return _order("accept-site-time", locals())


def recover(*, exposure_s: float | None = None) -> Order:
    """Tell a lost mount where it points: two looks anywhere in the sky that agree, then a sync."""
    return _order("recover", locals())


def first_light(*, exposure_s: float | None = None) -> Order:
    """Tell a telescope set up by eye where it points, and learn its camera: looks and small moves."""
    return _order("first-light", locals())


def rotate(
    position_angle_deg: float,
    *,
    angle_tolerance_deg: float | None = None,
    either_way: bool | None = None,
    exposure_s: float | None = None,
    trust_count: bool | None = None,
) -> Order:
    """Turn the field to a position angle where the telescope stands; looks confirm it.

    Parameters
    ----------
    position_angle_deg : float
        Position angle of the image's +y, north through east; of a named point its own direction. A
        rotator turns it there, and looks confirm it.
    either_way : bool, optional
        It may stand on its head as well.
    trust_count : bool, optional
        An operator's word that the rotator's cables lie as its count says. Needs configure.
    """
    return _order("rotate", locals())


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
    """Look round the target, step by step, until a frame is solved, and center it; else go back.

    Parameters
    ----------
    step_share : float, optional
        Of the field's shorter side.
    field_deg : float, optional
        That side; left out: by what is known of the camera.
    """
    return _order("spiral-search", locals())


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

    Parameters
    ----------
    path : str, optional
        In one of the folders that frames may be taken from (`[telescope.night]` folder, allowed_folders).
        Left out: a frame is exposed.
    exposure_s : float, optional
        Without a path.
    ra_deg : float, optional
        Believed ICRS center, with a path.
    dec_deg : float, optional
        With ra_deg.
    radius_deg : float, optional
        How wrong that may be.
    scale_low_arcsec_px : float, optional
        With a path.
    scale_high_arcsec_px : float, optional
        With a path.
    blind : {"after", "only", "never"}, optional
        With a path: search the whole sky; else as the settings have it.
    budget_s : float, optional
        With a path.
    """
    return _order("solve", locals())


def series(
    *,
    target: Target | None = None,
    looks: int | None = None,
    every_s: float | None = None,
    exposure_s: float | None = None,
) -> Order:
    """Look again and again while it tracks: how the field drifts, with errors.

    Parameters
    ----------
    target : dict, optional
        Slewed to first; left out: where it stands.
    every_s : float, optional
        From the beginning of a look to that of the next, at least.
    """
    return _order("series", locals())


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
    """Hold still by looks: drift, periodic error and flexure are corrected by guide pulses or rates.

    Parameters
    ----------
    target : dict, optional
        Where the center should be; left out: where the first look finds it.
    for_s : float, optional
        How long; left out: until it is cancelled or stopped.
    every_s : float, optional
        From look to look, at least.
    by : {"pulses", "rates", "both"}, optional
        Left out: pulses where the mount takes them, else rates.
    looks : {"camera", "frames"}, optional
        The telescope's own, or the frames that are sent to it.
    period_s : float, optional
        Of the worm, if known; else it is found.
    play_arcsec : float, optional
        Backlash in declination, if known; else it is learned.
    """
    return _order("hold", locals())


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
    """Look elsewhere by a pattern's step; done when looks show that it has settled. Also while it holds.

    Parameters
    ----------
    bound : float, optional
        No step is farther from where it began.
    unit : {"arcsec", "px"}, optional
        Of bound and settle_within.
    steps : int, optional
        Of a turn of the ring, or of a spiral.
    seed : int, optional
        The same steps for the same seed.
    number : int, optional
        Which step, 0 where it began; left out: the next one.
    settle_looks : int, optional
        So many in a row must be within that.
    """
    return _order("dither", locals())


def model_run(
    *,
    points: int | None = None,
    spread: Literal["spiral", "random"] | None = None,
    seed: int | None = None,
    exposure_s: float | None = None,
    put_in_force: bool | None = None,
) -> Order:
    """Look at points over the allowed sky, one after the other; make a pointing model, and judge it.

    Parameters
    ----------
    points : int, optional
        About so many, and those of the last check besides.
    seed : int, optional
        The same plan for the same seed.
    put_in_force : bool, optional
        Write it to `[telescope.model]` file and aim by it, if it is accepted. Needs configure.
    """
    return _order("model-run", locals())


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
    """Center each panel of a mosaic round the target, one after the other, and leave it to the camera.

    Parameters
    ----------
    across : int, optional
        Panels in a row; with `down`.
    overlap : float, optional
        Of neighbors, as a share of the field.
    width_deg : float, optional
        Of the field; left out: the look camera's, by solves.
    offsets_arcsec : list[tuple[float, float]], optional
        Instead of across and down: places beside the target, each to the right and upwards.
    pattern_angle_deg : float, optional
        Position angle of the pattern's upward direction.
    turn_field : bool, optional
        Turn each image to its panel's angle; needs a rotator.
    snake : bool, optional
        Every other row backwards.
    from_panel : int, optional
        What was done before isn't done again.
    until : {"next", "dwell"}, optional
        next: each panel is kept until `POST /v1/jobs/{id}/next`; dwell: for dwell_s.
    frames : int, optional
        So many `next` for each panel.
    most_s : float, optional
        A camera program silent for so long has died.
    at : At, optional
        To which point of the camera the target is brought: a name of `[[telescope.point]]`, or a pixel;
        left out: the frame's middle.
    """
    return _order("mosaic", locals())


def move_axis(
    axis: Literal["primary", "secondary"],
    rate_deg_s: float,
    *,
    for_s: float | None = None,
    job_id: str | None = None,
) -> Order:
    """Move an axis on at a speed while somebody holds it; it ends by itself if no further order comes.

    A further one of the same caller prolongs the motion, or changes its speed, in the same job; 0 ends it.

    Parameters
    ----------
    axis : {"primary", "secondary"}
        primary: right ascension, or azimuth; secondary: declination, or altitude.
    rate_deg_s : float
        Degrees per second, on top of tracking. Positive: to greater right ascension (azimuth), to greater
        declination (altitude); 0 ends it. Speeds that the mount hasn't are refused.
    for_s : float, optional
        It ends by itself after so many seconds, if no further order prolongs it.
    job_id : str, optional
        Goes into this job alone, the one that the first order of a motion began: refused once that has
        ended, so that an order that comes late moves nothing.
    """
    return _order("move-axis", locals())
