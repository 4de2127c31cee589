"""One frame by its shift from the anchor: who is who, and the anchor's plate moved by that."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mountnav.identification.plate import Plate
from mountnav.identification.preliminary import Preliminary, find_shift
from mountnav.identification.shift import Pairing
from mountnav.identification.sources import Sources
from mountnav.identification.wcs import wcs_cards
from mountnav.measuring.measurements import Measurements
from mountnav.series.results import FrameResult, SeriesSettings, Shift
from mountnav.series.shift import Moved, moved, turned
from mountnav.solution import IdentifiedPairs, Solution

Array = NDArray[np.float64]
Size = tuple[int, int]

TREND_SIGMAS = 5.0


@dataclass(frozen=True, slots=True)
class Anchor:
    """The frame that others are followed from."""

    number: int
    sources: Sources
    plate: Plate | None
    solution: Solution | None
    ra_deg: Array
    dec_deg: Array


@dataclass(frozen=True, slots=True)
class Look:
    """A frame without its pixels.

    Attributes
    ----------
    result : FrameResult
    measurements : Measurements
    sources : Sources
    still : bool
        The light of its sources is where they were found: pieces of trails are no places to follow by.
    """

    result: FrameResult
    measurements: Measurements
    sources: Sources
    still: bool = True

    @property
    def size(self) -> Size:
        """Width and height, in pixels."""
        return self.measurements.width_px, self.measurements.height_px


@dataclass(frozen=True, slots=True)
class Followed:
    """What the shift says of a frame."""

    preliminary: Preliminary
    shift: Shift
    move: Moved | None
    pairing: Pairing


def followed(anchor: Anchor, look: Look, settings: SeriesSettings) -> Followed | Preliminary:
    """What the shift from the anchor says of a frame; the identification alone where it says nothing."""
    got = find_shift(anchor.sources, look.sources, settings.preliminary)
    pairing = got.pairing
    if pairing is None:
        return got
    move = None
    if anchor.plate is not None:
        sky = anchor.ra_deg[pairing.first], anchor.dec_deg[pairing.first]
        x, y = look.sources.x_px[pairing.second], look.sources.y_px[pairing.second]
        move = moved(anchor.plate, *sky, x, y, pairing.weight)
        if turns(move, settings):
            move = replace(
                turned(move, anchor.plate, *sky, x, y, pairing.weight),
                trend_px=move.trend_px,
                trend_sigma=move.trend_sigma,
            )
    sigma = pairing.dx_sigma_px, pairing.dy_sigma_px
    if move is not None and anchor.solution is not None:
        x_sigma, y_sigma = move.sigma_px
        # the anchor's own scale and turn are known so well and no better
        lever = float(np.hypot(move.dx_px, move.dy_px)) * scale_sigma(anchor.solution)
        sigma = float(np.hypot(x_sigma, lever)), float(np.hypot(y_sigma, lever))
    shift = Shift(
        anchor=anchor.number,
        dx_px=move.dx_px if move else pairing.dx_px,
        dy_px=move.dy_px if move else pairing.dy_px,
        dx_sigma_px=sigma[0],
        dy_sigma_px=sigma[1],
        mean_dx_px=pairing.dx_px,
        mean_dy_px=pairing.dy_px,
        pairs=len(pairing),
        strobes=got.strobes,
        acknowledged=got.acknowledged,
        false_probability=got.false_probability,
    )
    return Followed(got, shift, move, pairing)


def turns(move: Moved, settings: SeriesSettings) -> bool:
    """Whether the field has turned or stretched by more than a shift tells."""
    return move.trend_px > settings.trend_px and move.trend_sigma > TREND_SIGMAS


def scale_sigma(solution: Solution) -> float:
    """Relative error of a solution's scale, and of its turn in radians: from its residuals and pairs."""
    pairs = solution.identified
    x, y = pairs.x_px[pairs.used], pairs.y_px[pairs.used]
    if x.size < 2:
        return 0.0
    # RMS distance of the pairs from their middle: what the scale is measured over
    lever_arcsec = float(np.sqrt(np.var(x) + np.var(y))) * solution.scale_arcsec_px
    return solution.rms_arcsec / float(np.sqrt(2.0 * x.size)) / max(lever_arcsec, 1e-9)


def moved_solution(anchor: Anchor, found: Followed, look: Look) -> Solution:
    """The anchor's solution with its plate moved."""
    move, pairing, old = found.move, found.pairing, anchor.solution
    assert move is not None
    assert old is not None
    m = look.measurements
    chosen = look.sources.index[pairing.second]
    scale = move.plate.scale_arcsec_px()
    own_arcsec = scale * float(np.hypot(found.shift.dx_sigma_px, found.shift.dy_sigma_px)) / np.sqrt(2.0)
    covariance = old.center_covariance_arcsec2 + own_arcsec**2 * np.eye(2)
    missing = np.full(chosen.size, np.nan)
    turned_plate = abs(move.plate.rotation_deg() - old.rotation_deg) > 1e-9
    if turned_plate:
        cards = wcs_cards(move.plate, width_px=m.width_px, height_px=m.height_px)
    else:
        cards = {**old.wcs, "CRVAL1": move.center.ra_deg, "CRVAL2": move.center.dec_deg}
    return Solution(
        center=move.center,
        center_sigma_arcsec=float(np.sqrt(0.5 * np.trace(covariance))),
        scale_arcsec_px=scale,
        rotation_deg=move.plate.rotation_deg(),
        parity=move.plate.parity,
        rms_arcsec=move.rms_arcsec,
        pairs=len(pairing),
        rejected=0,
        false_probability=min(1.0, old.false_probability + found.preliminary.false_probability),
        mode="preliminary",
        wcs=cards,
        center_covariance_arcsec2=covariance,
        identified=IdentifiedPairs(
            x_px=look.sources.x_px[pairing.second],
            y_px=look.sources.y_px[pairing.second],
            ra_deg=anchor.ra_deg[pairing.first],
            dec_deg=anchor.dec_deg[pairing.first],
            dx_arcsec=move.residual_x_arcsec,
            dy_arcsec=move.residual_y_arcsec,
            flux=m.flux[chosen],
            flux_sigma=m.flux_sigma[chosen],
            mag=missing,
            centroid_sigma_arcsec=look.sources.sigma_px[pairing.second] * scale,
            catalog_sigma_arcsec=anchor.sources.sigma_px[pairing.first] * scale,
            flags=m.flags[chosen],
            used=np.ones(chosen.size, dtype=bool),
            leverage=np.full(chosen.size, 1.0 / max(chosen.size, 1)),  # only the shift was fit
        ),
        catalog=old.catalog,
    )
