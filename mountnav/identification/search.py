"""Star lists in, a verified reference or a typed refusal out: hypotheses, plate, odds, in that order."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from mountnav.catalog.stars import Catalog
from mountnav.frames import Hint
from mountnav.identification.anchors import SearchedPart
from mountnav.identification.budget import Budget
from mountnav.identification.full import Hypothesis, OutOfTime, Points, Search, hypotheses
from mountnav.identification.refusal import Refusal, refusal
from mountnav.identification.rounds import INDEX_LEAST_DEG, Round, plan
from mountnav.identification.search_area import WIDEST_FRAME_DEG
from mountnav.identification.selection import Index, all_finite, star_like
from mountnav.identification.settings import IdentificationSettings
from mountnav.identification.verification import Identified, verified
from mountnav.measuring.measurements import Measurements
from mountnav.sky.coordinates import Icrs
from mountnav.solution import Contradiction, Reason

if TYPE_CHECKING:
    from mountnav.identification.blind.index import BlindIndex

FEW_CLEAN = 8
"""With fewer star-like sources than this the index is asked with the flagged ones at once. Chosen by hand:
with more, stars are found sooner without them."""
SOURCES_ASKED = 300
"""The index is asked with no more than so many of the brightest sources (`blind.search.MOST_POINTS`): where
none of them is flagged, asking again brings nothing new."""
NEAR_FIELDS = 3.0
"""A hinted radius of up to so many fields is searched tile by tile before the whole sky is."""

ENOUGH_WORK = 16_000_000
"""Work of triangles, in catalog triangles, that a search may take beside an index of the sky: 1.2 CPU s on
the machine of docs/speed.md. Doubled, a hopeless frame costs a second more; halved, frames below 0.6° are
lost that a hint misses by several fields."""
LATER_LEAST = 300_000
"""But each round has so much work, the nearest tiles: an area so wide that its first round takes all of the
above is still looked at deeper in its middle."""
SHARE_OF_LATER = 2.0
"""A later round may take so many times its fair share of what is left: most take less, and leave it to those
after them. Chosen by hand."""

_CALLER = Hint().scale_source


@dataclass(frozen=True, slots=True)
class Reach:
    """How far a search goes.

    Attributes
    ----------
    index : BlindIndex or None
        Also what a hint says is looked up in it first.
    blind : {"after", "only", "never"}
        Whether the whole sky is searched after the hint failed, at once without asking any hint, or not.
    thorough : bool
        Also what may be if the hint is wrong, and the costly rounds; else only what the hint says at first,
        and the whole sky.
    tried : int
        Hypotheses of an earlier search for the same frame: each was one more chance to be fooled.
    rough : bool
        A plate to find stars by is enough.
    indexed : Catalog or None
        The catalog that the index was made of, if frames are identified with another one: what the index
        proposes is judged by its own stars.
    sky_searched : bool
        An earlier search for the same frame went over the whole sky by the index.
    """

    index: BlindIndex | None = None
    blind: Literal["after", "only", "never"] = "after"
    thorough: bool = True
    tried: int = 0
    rough: bool = False
    indexed: Catalog | None = None
    sky_searched: bool = False


def identify(
    measurements: Measurements,
    catalog: Catalog,
    hint: Hint,
    *,
    epoch_yr: float,
    settings: IdentificationSettings | None = None,
    budget_s: float = 30.0,
    reach: Reach | None = None,
) -> Identified:
    """Find out which stars the measurements are.

    Parameters
    ----------
    hint : Hint
        What it says is tried first, then its alternatives, then the whole sky if there is an index, then
        what may be if the hint is wrong: other scales, places farther out.
    epoch_yr : float
        Julian year of the frame.
    budget_s : float
        Processor time allowed; `budget.wall_limit_s` is the wall time that may take.
    reach : Reach, optional
        How far the search goes; without it, as far as is possible without an index.

    Returns
    -------
    Identified
        With a reference whose false-positive probability is below the limit, or with a reason.
    """
    settings, reach = settings or IdentificationSettings(), reach or Reach()
    index = reach.index
    believed = [_reconciled(reading) for reading in (hint, *hint.alternatives)]
    placed = [] if reach.blind == "only" else [reading for reading in believed if reading.center is not None]
    search = Search(Budget.of(budget_s), hypotheses=reach.tried)
    late: float | None = None
    nowhere = without_place(hint, reach)
    if nowhere is not None:
        return _refused(nowhere, 1.0, (), search)
    clean, every = star_like(measurements), all_finite(measurements)
    try:
        if every.size >= settings.min_pairs:
            flagged = clean.size < every.size
            # with so few clean ones the index was asked with all of them already
            again = clean.size >= FEW_CLEAN and not np.array_equal(
                clean[:SOURCES_ASKED], every[:SOURCES_ASKED]
            )
            for step in _steps(
                believed, placed, index, measurements, settings, reach, flagged=flagged, again=again
            ):
                usable = every if step.flagged or (step.turn is None and clean.size < FEW_CLEAN) else clean
                stars_of = catalog if step.turn is not None or reach.indexed is None else reach.indexed
                found = _attempt(
                    step, measurements, usable, stars_of, index, epoch_yr, settings, search, rough=reach.rough
                )
                if found is not None:
                    return found
    except OutOfTime:
        late = budget_s
    empty = _empty_bounds(hint)
    if empty and late is None:
        return _refused(
            Refusal(
                Reason.HINT_CONTRADICTS,
                f"{empty[0]}; and with the scale unknown nothing matches",
                {
                    "scale_low_arcsec_px": hint.scale_low_arcsec_px or 0.0,
                    "scale_high_arcsec_px": hint.scale_high_arcsec_px or 0.0,
                    "measured": float(len(measurements)),
                },
            ),
            search.best_probability,
            empty,
            search,
        )
    likeliest = placed[0] if placed else replace(believed[0], center=None)
    why = refusal(measurements, catalog, likeliest, search, settings, epoch_yr=epoch_yr, out_of_time_s=late)
    return _refused(why, search.best_probability, empty, search)


@dataclass(frozen=True, slots=True)
class _Step:
    """One thing to try: a round about a center, or (without a round) a look into the index."""

    turn: Round | None
    center: Icrs | None
    radius_deg: float = 180.0
    scales: tuple[float, float] | None = None
    first_only: bool = False
    all_sources: bool = False
    rounds_left: int = 0
    """Of a round that is bounded: how many there are with it and after it; 0: it has all it wants."""

    @property
    def flagged(self) -> bool:
        """Whether sources that look like no stars take part too."""
        return self.all_sources or (self.turn is not None and self.turn.flagged)


def _steps(
    believed: list[Hint],
    placed: list[Hint],
    index: BlindIndex | None,
    measurements: Measurements,
    settings: IdentificationSettings,
    reach: Reach,
    *,
    flagged: bool,
    again: bool,
) -> Iterator[_Step]:
    """What is tried in turn: what the hints say, the whole sky, then what may be if the hints are wrong.

    Last comes the whole sky with the flagged sources too (`again`): what is tried before it has the same odds
    as without it.
    """
    shorter_px = min(measurements.width_px, measurements.height_px)
    only = reach.blind == "only"
    # where the index has next to no stars it is searched last
    narrow = reach.indexed is not None and too_narrow_for_index(placed, shorter_px)
    near = narrow or all(_is_near(reading, shorter_px) for reading in placed)
    sky = index is not None and reach.blind != "never" and (reach.thorough or not narrow)
    # the paper's own way is by triangles
    indexed = (sky or reach.sky_searched) and settings.v_min_ident is None
    plans = [
        (reading, plan(reading, shorter_px, settings, flagged=flagged, indexed=indexed)) for reading in placed
    ]

    def part(number: int) -> Iterator[_Step]:
        for one, parts in plans:
            for turn in parts[number]:
                yield _Step(turn, one.center)

    # and where the hint says
    if index is not None and not only and settings.v_min_ident is None:
        yield from _index_steps(placed, first_only=near)
    if near:
        yield from part(0)
    if sky:
        # a header is no hint here; a caller who says a scale means it
        yield from _whole_sky([one for one in believed if not only or one.scale_source == _CALLER])
    if not near and (reach.thorough or not sky):
        yield from part(0)
    if reach.thorough:
        later = [*part(1), *part(2)]
        for number, step in enumerate(later):
            yield replace(step, rounds_left=len(later) - number) if indexed else step
    if sky and again and not reach.rough:
        yield from _whole_sky([] if only else believed, all_sources=True)


def _index_steps(placed: list[Hint], *, first_only: bool) -> Iterator[_Step]:
    """Where the hints say, looked up in the index: some milliseconds, where triangles cost ten times that.

    Where triangles follow, the later rounds of the index are left to the look over the whole sky.
    """
    steps = [
        _Step(None, reading.center, reading.radius_deg, _scales(reading), first_only) for reading in placed
    ]
    yield from dict.fromkeys(steps)


def _whole_sky(believed: list[Hint], *, all_sources: bool = False) -> Iterator[_Step]:
    """Steps of the whole sky: first at the scales that are believed, then at any."""
    scales = [*(_scales(reading) for reading in believed), None]
    yield from dict.fromkeys(_Step(None, None, scales=one, all_sources=all_sources) for one in scales)


def _scales(hint: Hint) -> tuple[float, float] | None:
    low, high = hint.scale_low_arcsec_px, hint.scale_high_arcsec_px
    return None if low is None and high is None else (low or 0.0, high or math.inf)


def too_narrow_for_index(believed: list[Hint], shorter_px: int) -> bool:
    """Whether, by all that is believed, the frame is narrower than what the index is made for.

    Parameters
    ----------
    shorter_px : int
        The frame's shorter side.
    """
    highs = [reading.scale_high_arcsec_px for reading in believed]
    known = [high for high in highs if high is not None]
    return bool(highs) and len(known) == len(highs) and shorter_px * max(known) / 3600.0 < INDEX_LEAST_DEG


def _is_near(hint: Hint, shorter_px: int) -> bool:
    """Whether the hinted area is so small that its tiles are searched before the whole sky is."""
    low, high = hint.scale_low_arcsec_px, hint.scale_high_arcsec_px
    if hint.center is None or low is None or high is None:
        return False
    return hint.radius_deg <= NEAR_FIELDS * shorter_px * math.sqrt(low * high) / 3600.0


def without_place(hint: Hint, reach: Reach) -> Refusal | None:
    """Refuse, before anything is measured or searched, what has neither a position nor an index to find one.

    Returns
    -------
    Refusal or None
        None when a search makes sense.
    """
    placed = reach.blind != "only" and any(
        reading.center is not None for reading in (hint, *hint.alternatives)
    )
    if placed or (reach.index is not None and reach.blind != "never"):
        return None
    why = "and blind search is switched off" if reach.blind == "never" else "and there is no index of the sky"
    return Refusal(Reason.NO_HINT, f"neither the header nor the caller says where it was taken, {why}", {})


def _refused(
    why: Refusal, probability: float, disproved: tuple[Contradiction, ...], search: Search
) -> Identified:
    numbers = why.numbers | {"hypotheses": float(search.hypotheses)}
    return Identified(
        None, None, why.reason, why.detail, probability, numbers, disproved, tried=search.hypotheses
    )


def _empty_bounds(hint: Hint) -> tuple[Contradiction, ...]:
    """The contradiction, if no scale lies between the bounds."""
    low, high = hint.scale_low_arcsec_px, hint.scale_high_arcsec_px
    if low is None or high is None or 0 < low <= high:
        return ()
    return (
        Contradiction(
            "scale", hint.scale_source, f"at least {low:g} ″/px", f"at most {high:g} ″/px is said too"
        ),
    )


def _reconciled(hint: Hint) -> Hint:
    """The hint without bounds that rule each other out: the scale is unknown then."""
    if not _empty_bounds(hint):
        return hint
    return replace(hint, scale_low_arcsec_px=None, scale_high_arcsec_px=None)


def _end_of_round(step: _Step, search: Search) -> float:
    """Up to what work a round may go: of what is left, later ones have a share."""
    if step.rounds_left == 0:
        return math.inf
    left = max(0.0, ENOUGH_WORK - search.work)
    return search.work + max(LATER_LEAST, min(left, SHARE_OF_LATER * left / step.rounds_left))


def _attempt(
    step: _Step,
    measurements: Measurements,
    usable: Index,
    catalog: Catalog,
    index: BlindIndex | None,
    epoch_yr: float,
    settings: IdentificationSettings,
    search: Search,
    *,
    rough: bool,
) -> Identified | None:
    """Try one step."""
    width, height = measurements.width_px, measurements.height_px
    if usable.size < settings.min_pairs:
        return None
    points = Points(measurements.x_px[usable], measurements.y_px[usable], width, height)
    turn = step.turn
    proposals: Iterator[Hypothesis] = iter(())
    if turn is not None and step.center is not None:
        if math.hypot(width, height) * turn.scales[0] / 3600 > WIDEST_FRAME_DEG:
            return None
        search.anchors.searched(SearchedPart(step.center, turn.outer_deg, turn.scales, usable.size))
        search.round_ends = _end_of_round(step, search)
        proposals = hypotheses(
            points, turn, catalog, step.center, epoch_yr=epoch_yr, settings=settings, search=search
        )
    elif index is not None:
        from mountnav.identification.blind.search import blind_hypotheses

        search.whole_sky = search.whole_sky or step.center is None
        if (
            step.center is not None
            and step.scales is not None
            and 0 < step.scales[0] < step.scales[1] < math.inf
        ):
            search.anchors.searched(SearchedPart(step.center, step.radius_deg, step.scales, usable.size))
        proposals = blind_hypotheses(
            points,
            index,
            catalog,
            scales=step.scales,
            center=step.center,
            radius_deg=step.radius_deg,
            epoch_yr=epoch_yr,
            settings=settings,
            search=search,
            first_only=step.first_only,
        )
    for hypothesis in proposals:
        found = verified(hypothesis, measurements, usable, catalog, epoch_yr, settings, search, rough=rough)
        if found is not None:
            return replace(found, blind=turn is None and step.center is None)
    return None
