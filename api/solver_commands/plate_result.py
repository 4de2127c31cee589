"""What the commands ask the solver, and what they make of its answer: hints, reasons, plates."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import BinaryIO

from api.solver_commands.host import Host
from api.solver_commands.image_facts import ImageFacts, rows_up
from mountnav.errors import BadFrame
from mountnav.frames import Hint
from mountnav.sky.coordinates import Icrs
from mountnav.sky.wcs import is_zpn
from mountnav.sky.wcs_numbers import (
    TOUCHES_ALONE,
    Value,
    WcsNumbers,
    linear_cards,
    touching_cards,
    wcs_numbers,
)
from mountnav.solution import Solution, Verdict

FIELD_ROOM = 1.25
"""Factor by which a stated field may be off when it is searched at first: focal lengths are stated to some
percent, reducers are forgotten. Doubled, a search where the hint says takes several times as long."""
FIELD_TOO_FAR_OFF = 2.0
"""Factor by which a solved field may differ from the stated one at most. Beyond, the order was about another
frame or camera, and the answer is no. Doubled, more of what the original never solves would be solved."""
FIELD_WARNED = 0.05
"""Share by which the field is off before a command says so, as ASTAP does."""
WIDEST_RADIUS_DEG = 30.0
"""Radius about a hint that is searched at most, before the whole sky is; the largest that programs set by
themselves is 30. Doubled, a frame that can't be solved takes longer to give up."""


@dataclass(frozen=True, slots=True)
class Field:
    """The size of a field as a caller states it, by one side.

    Attributes
    ----------
    side_deg : float
        > 0.
    side_px : float
        Pixels along that side.
    source : str
        The option that said so.
    span : float
        The caller gives a range: from the side over this to the side times this.
    """

    side_deg: float
    side_px: float
    source: str
    span: float = 1.0

    @property
    def scale_arcsec_px(self) -> float:
        """Arcseconds a pixel."""
        return 3600.0 * self.side_deg / self.side_px

    def off(self, scale_arcsec_px: float) -> float:
        """Factor between the solved scale and what was stated, >= 1."""
        ratio = scale_arcsec_px / self.scale_arcsec_px
        return max(1.0, max(ratio, 1.0 / ratio) / self.span)


def hint_of(center: Icrs | None, radius_deg: float, field: Field | None, source: str) -> Hint | None:
    """The hint that options make; None if they say nothing.

    Parameters
    ----------
    center : Icrs or None
        None: not given.
    radius_deg : float
        Any; more than `WIDEST_RADIUS_DEG` counts as that, the whole sky comes after it anyway.
    field : Field or None
        None: not given.
    source : str
        The options that said where it is.
    """
    if center is None and field is None:
        return None
    low = high = None
    if field is not None:
        room = FIELD_ROOM * field.span
        low, high = field.scale_arcsec_px / room, field.scale_arcsec_px * room
    return Hint(
        center=center,
        radius_deg=min(radius_deg, WIDEST_RADIUS_DEG),
        scale_low_arcsec_px=low,
        scale_high_arcsec_px=high,
        center_source=source if center is not None else "caller",
        scale_source=field.source if field is not None else "caller",
    )


def opened(host: Host, path: str) -> BinaryIO:
    """Open a file for a command.

    Raises
    ------
    BadFrame
        There is no such file, or it is none.
    """
    try:
        return host.open(path)
    except (OSError, ValueError) as fault:  # a name with a zero byte is a ValueError
        why = getattr(fault, "strerror", None) or str(fault)
        raise BadFrame(f"the file can't be read: {why}", device=path, advice="check its name") from fault


def place(ra_deg: float, dec_deg: float) -> Icrs | None:
    """A place; None if the numbers are none."""
    if not (math.isfinite(ra_deg) and math.isfinite(dec_deg) and abs(dec_deg) <= 90.0):
        return None
    return Icrs(ra_deg % 360.0, dec_deg)


@dataclass(frozen=True, slots=True)
class Plate:
    """A solved frame, or the reason for none.

    Attributes
    ----------
    solution : Solution or None
        None: not solved.
    why : str
        The reason; empty if solved.
    warnings : tuple of str
        Hints that the frame disproves.
    """

    solution: Solution | None
    why: str
    warnings: tuple[str, ...]
    verdict: Verdict


def judged(verdict: Verdict, field: Field | None) -> Plate:
    """Take a verdict for what was asked: a field of quite another size than was stated is no answer.

    Parameters
    ----------
    field : Field or None
        As it was stated.
    """
    warnings = tuple(str(one) for one in verdict.contradictions)
    solution = verdict.solution
    if solution is None:
        reason = verdict.reason.value if verdict.reason is not None else "not solved"
        return Plate(None, f"{reason}: {verdict.detail}" if verdict.detail else reason, warnings, verdict)
    if field is not None and field.off(solution.scale_arcsec_px) > FIELD_TOO_FAR_OFF:
        found_deg = solution.scale_arcsec_px * field.side_px / 3600.0
        why = f"the frame shows a field of {found_deg:.3g} degrees, {field.source} says {field.side_deg:.3g}"
        return Plate(None, why, warnings, verdict)
    if is_zpn(solution.wcs):
        warnings = (*warnings, TOUCHES_ALONE)
    return Plate(solution, "", warnings, verdict)


def solved_cards(solution: Solution, facts: ImageFacts, *, sip: bool) -> dict[str, Value]:
    """The WCS cards of a solution as FITS and ASTAP count rows, from the bottom; TAN unless SIP is wanted."""
    cards: Mapping[str, Value] = touching_cards(solution.wcs) if sip else linear_cards(solution.wcs)
    return rows_up(cards, facts.height_px) if facts.rows_down else dict(cards)


def numbers_of(cards: Mapping[str, Value]) -> WcsNumbers:
    """The numbers of a plate at its center, where its SIP terms vanish."""
    return wcs_numbers(linear_cards(cards))
