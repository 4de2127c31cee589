"""A plate moved over the sky: where a frame's center lies, from pairs with a frame that is solved.

A shift in pixels is exact only on a small, undistorted field. Here the pairs' places on the sky, through the
solved frame's plate, are projected about the new center, and the plate itself is held: exact for projection
and distortion, as long as telescope and camera stay the same and the field doesn't turn.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mountnav.identification.plate import Plate
from mountnav.identification.preliminary import Preliminary, find_shift
from mountnav.identification.shift import Pairing, Sources
from mountnav.identification.wcs import wcs_cards
from mountnav.measuring.measurements import Measurements
from mountnav.series.results import FrameResult, SeriesSettings, Shift
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import gnomonic_inverse
from mountnav.solution import IdentifiedPairs, Solution
from mountnav.units import ARCSEC_PER_RAD

Array = NDArray[np.float64]

MOST_STEPS = 20
"""Steps at most until the center is found; it ends earlier, at `STILL_ARCSEC`."""
STILL_ARCSEC = 1e-5
"""A step shorter than this ends the search for the center. Each is wrong by the field's curvature and by how
north turns on the way."""


def icrs_at_pixels(plate: Plate, x_px: Array, y_px: Array) -> tuple[Array, Array]:
    """Right ascension and declination (degrees, shape (n,)) at pixels, through a plate."""
    xi, eta = plate.tangential(x_px, y_px)
    ra, dec = gnomonic_inverse(
        xi / ARCSEC_PER_RAD, eta / ARCSEC_PER_RAD, plate.tangent.ra_deg, plate.tangent.dec_deg
    )
    return np.asarray(ra), np.asarray(dec)


def pixels_at_icrs(plate: Plate, ra_deg: Array, dec_deg: Array) -> tuple[Array, Array]:
    """Pixels (shape (n,)) of positions, through a plate; NaN for positions behind."""
    xi, eta = plate.project(ra_deg, dec_deg)
    return plate.pixels(xi, eta)


@dataclass(frozen=True, slots=True)
class MovedPlate:
    """A plate moved to where a frame lies.

    Attributes
    ----------
    plate : Plate
        Its tangent point is the frame's center.
    sigma_arcsec : (float, float)
        Standard error of the move, east and north; the solved frame's own error comes on top.
    dx_px, dy_px : float
        Where the frame's center lies in the solved frame, from that frame's center: the exact shift, with the
        sign of [S23 eq. 1, 2].
    rms_arcsec : float
        RMS over pairs of the residual (both coordinates in quadrature).
    residual_x_arcsec, residual_y_arcsec : ndarray, shape (n,)
        Measured minus expected, east and north.
    turn_deg, stretch : float
        Turn (north through east) and change of scale (a share) that the residuals show.
    trend_px : float
        What turn and stretch amount to in the frame's corner.
    trend_sigma : float
        How many standard errors that is.
    """

    plate: Plate
    sigma_arcsec: tuple[float, float]
    dx_px: float
    dy_px: float
    rms_arcsec: float
    residual_x_arcsec: Array
    residual_y_arcsec: Array
    turn_deg: float
    stretch: float
    trend_px: float
    trend_sigma: float

    @property
    def center(self) -> Icrs:
        """The frame's center."""
        return self.plate.tangent

    @property
    def sigma_px(self) -> tuple[float, float]:
        """Standard error of the move along x and y."""
        inverse = np.linalg.inv(self.plate.matrix())
        x, y = np.sqrt(inverse**2 @ np.square(self.sigma_arcsec))
        return float(x), float(y)


def move_plate(
    plate: Plate, ra_deg: Array, dec_deg: Array, x_px: Array, y_px: Array, weight: Array
) -> MovedPlate:
    """Move a plate over the sky so that pairs fall where they were measured.

    Parameters
    ----------
    plate : Plate
        Of the solved frame, tangent at its center.
    ra_deg, dec_deg : ndarray, shape (n,)
        The pairs' places on the sky, n >= 3.
    x_px, y_px : ndarray, shape (n,)
        Where the new frame shows them.
    weight : ndarray, shape (n,)
        Weights of the pairs, px^-2.

    Returns
    -------
    MovedPlate
        With orientation held to the celestial north, as an equatorial mount holds it.
    """
    share = weight / weight.sum()
    seen_xi, seen_eta = plate.tangential(x_px, y_px)
    center = plate.tangent
    for _ in range(MOST_STEPS):
        xi, eta = replace(plate, tangent=center).project(ra_deg, dec_deg)
        east, north = float(share @ (xi - seen_xi)), float(share @ (eta - seen_eta))
        ra, dec = gnomonic_inverse(
            east / ARCSEC_PER_RAD, north / ARCSEC_PER_RAD, center.ra_deg, center.dec_deg
        )
        center = Icrs(float(ra), float(dec))
        if math.hypot(east, north) < STILL_ARCSEC:
            break
    xi, eta = replace(plate, tangent=center).project(ra_deg, dec_deg)
    residual = (seen_xi - xi) + 1j * (seen_eta - eta)
    z = seen_xi + 1j * seen_eta
    about = z - share @ z
    lever = float(share @ np.abs(about) ** 2)
    spread2 = float(share @ np.abs(residual) ** 2)  # both coordinates
    trend = complex(-(share @ (np.conj(about) * residual)) / lever) if lever > 0 else 0j
    rest2 = max(spread2 - abs(trend) ** 2 * lever, 0.0)
    free = max(x_px.size - 2, 1)
    scale = plate.scale_arcsec_px()
    # never better than the stated errors of the measurements
    expected2 = 2.0 * scale**2 * x_px.size / float(weight.sum())
    trend_sigma = math.sqrt(max(rest2, expected2) / free / lever / 2.0) if lever > 0 else math.inf
    corner_arcsec = math.hypot(plate.center_x_px + 0.5, plate.center_y_px + 0.5) * scale
    sums = 1.0 / float(weight.sum())
    count = max(x_px.size - 1, 1)
    sigma = []
    for part in (residual.real, residual.imag):
        chi2 = float(weight @ part**2) / scale**2 / count
        sigma.append(scale * math.sqrt(max(chi2, 1.0) * sums))
    dx, dy = _center_shift(plate, center)
    return MovedPlate(
        plate=replace(plate, tangent=center, xi=_at_rest(plate.xi), eta=_at_rest(plate.eta)),
        sigma_arcsec=(sigma[0], sigma[1]),
        dx_px=dx,
        dy_px=dy,
        rms_arcsec=math.sqrt(spread2),
        residual_x_arcsec=residual.real,
        residual_y_arcsec=residual.imag,
        turn_deg=math.degrees(-trend.imag),
        stretch=trend.real,
        trend_px=abs(trend) * corner_arcsec / scale,
        trend_sigma=abs(trend) / trend_sigma if trend_sigma > 0 else 0.0,
    )


def turn_plate(
    move: MovedPlate, solved: Plate, ra_deg: Array, dec_deg: Array, x_px: Array, y_px: Array, weight: Array
) -> MovedPlate:
    """Turn and stretch the plate by what the residuals show, and move it again.

    Parameters
    ----------
    move : MovedPlate
        From `moved` with the same pairs.
    solved : Plate
        Of the solved frame.
    ra_deg, dec_deg, x_px, y_px, weight : ndarray, shape (n,)
        As in `moved`.

    Returns
    -------
    MovedPlate
        Its turn and stretch are those taken up.
    """
    plate, again, turn_deg, stretch = move.plate, move, 0.0, 0.0
    for _ in range(2):
        turn_deg, stretch = turn_deg + again.turn_deg, stretch + again.stretch
        w = (plate.xi + 1j * plate.eta) * complex(1.0 + again.stretch, -math.radians(again.turn_deg))
        plate = replace(plate, xi=np.asarray(w.real), eta=np.asarray(w.imag))
        again = move_plate(plate, ra_deg, dec_deg, x_px, y_px, weight)
        plate = again.plate
    dx, dy = _center_shift(solved, again.center)
    return replace(again, turn_deg=turn_deg, stretch=stretch, dx_px=dx, dy_px=dy)


def _center_shift(solved: Plate, center: Icrs) -> tuple[float, float]:
    """Where a center lies in the solved frame, from that frame's center, pixels."""
    x, y = pixels_at_icrs(solved, np.array([center.ra_deg]), np.array([center.dec_deg]))
    return float(x[0]) - solved.center_x_px, float(y[0]) - solved.center_y_px


def _at_rest(coefficients: Array) -> Array:
    """Coefficients without the constant term: the tangent point is the center."""
    out = coefficients.copy()
    out[0] = 0.0
    return out


Size = tuple[int, int]

TREND_SIGMAS = 5.0
"""A rotation or growth of the field of more than so many of its errors is significant: an honest fit has one
in 10^6. Chosen by hand."""


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
class MeasuredFrame:
    """A measured frame of a series, without its pixels.

    Attributes
    ----------
    still : bool
        The light of its sources is where they were found: pieces of trails are no positions to follow by.
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
    """A frame placed by its shift from the anchor."""

    preliminary: Preliminary
    shift: Shift
    move: MovedPlate | None
    pairing: Pairing


def follow_frame(anchor: Anchor, look: MeasuredFrame, settings: SeriesSettings) -> Followed | Preliminary:
    """What the shift from the anchor says of a frame; the identification alone where it says nothing."""
    got = find_shift(anchor.sources, look.sources, settings.preliminary)
    pairing = got.pairing
    if pairing is None:
        return got
    move = None
    if anchor.plate is not None:
        sky = anchor.ra_deg[pairing.first], anchor.dec_deg[pairing.first]
        x, y = look.sources.x_px[pairing.second], look.sources.y_px[pairing.second]
        move = move_plate(anchor.plate, *sky, x, y, pairing.weight)
        if field_turns(move, settings):
            move = replace(
                turn_plate(move, anchor.plate, *sky, x, y, pairing.weight),
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


def field_turns(move: MovedPlate, settings: SeriesSettings) -> bool:
    """Whether the field has turned or stretched by more than a shift can follow."""
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


def solution_of_move(anchor: Anchor, found: Followed, look: MeasuredFrame) -> Solution:
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
