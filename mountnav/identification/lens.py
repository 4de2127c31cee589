"""A lens: how far from its axis a star falls, by an odd polynomial of its angle from the axis.

r(θ) = θ + k3·θ³ + k5·θ⁵ + ... holds for every lens that is round: gnomonic (tan θ), equidistant (θ),
equisolid (2 sin θ/2) and stereographic (2 tan θ/2) ones, and those that are bent besides. A polynomial of
pixels on a tangent plane ends where the plane ends; this doesn't. FITS calls it ZPN [Calabretta and Greisen
2002, §5.1.7].
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mountnav.identification.plate import Plate, products
from mountnav.identification.wcs import Cards, wcs_cards
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import gnomonic, gnomonic_inverse
from mountnav.sky.wcs import places_at_pixels
from mountnav.units import ARCSEC_PER_RAD

Array = NDArray[np.float64]

MOST_TERMS = 5
"""Terms beyond the first: up to θ¹¹. With them each of the four projections is met to 0.01 px of 2000 at 75°
from the axis (`tests/identification/test_lens.py`)."""
SIP_DEGREE = 9
"""Highest degree of a SIP polynomial [SIP convention, Shupe et al. 2005]."""
SIP_WORST_PX = 0.1
"""A SIP polynomial that departs from the lens by more than this anywhere in the frame doesn't stand for it;
it is so far off in the very corners only. Bent by 10 % at 40°, a lens needs 0.07 px at degree 9."""
SIP_WIDEST = math.radians(50.0)
"""Farther from the tangent point no SIP polynomial is tried: the plane stretches so that small angles need
many digits."""
GRID = 33
"""Points per side at which SIP and lens are compared, corners included."""
_STEP_PX = 0.5
"""Half of the distance over which derivatives at the frame's center are taken."""


@dataclass(frozen=True, slots=True)
class Lens:
    """A round lens before a flat detector.

    Attributes
    ----------
    axis : Icrs
        Where the optical axis looks.
    axis_x_px, axis_y_px : float
        Where it meets the detector, 0-based.
    matrix : ndarray, shape (2, 2)
        Pixels a radian: (x, y) from (east, north) at the axis.
    terms : ndarray, shape (k,)
        Factors of θ³, θ⁵, ...
    width_px, height_px : int
        Of the frame.
    """

    axis: Icrs
    axis_x_px: float
    axis_y_px: float
    matrix: Array
    terms: Array
    width_px: int
    height_px: int

    def pixels(self, ra_deg: Array, dec_deg: Array) -> tuple[Array, Array]:
        """Where positions fall (0-based, shape (n,)), beyond the frame's edges too."""
        away, east, north = _from_axis(self.axis, ra_deg, dec_deg)
        r = self.radius(away)
        x = self.axis_x_px + r * (self.matrix[0, 0] * east + self.matrix[0, 1] * north)
        y = self.axis_y_px + r * (self.matrix[1, 0] * east + self.matrix[1, 1] * north)
        return x, y

    def radius(self, away_rad: Array) -> Array:
        """r(θ), radians."""
        square = away_rad * away_rad
        r = np.zeros_like(away_rad)
        for term in self.terms[::-1]:
            r = (r + term) * square
        return np.asarray(away_rad * (1.0 + r))

    def rises_to(self, away_rad: float) -> bool:
        """Whether r grows with θ that far: a lens that doesn't shows two places at one pixel."""
        away = np.linspace(0.0, away_rad, 200)
        return bool((np.diff(self.radius(away)) > 0.0).all())

    def corner_rad(self) -> float:
        """Angle from the axis to the farthest corner."""
        x = np.array([-0.5, self.width_px - 0.5])
        y = np.array([-0.5, self.height_px - 0.5])
        return max(self.away_rad(a, b) for a in x for b in y)

    def away_rad(self, x_px: float, y_px: float) -> float:
        """Angle of a pixel from the axis; that of the polynomial's turn, or 180°, where it is beyond."""
        inverse = np.linalg.inv(self.matrix)
        r = float(np.hypot(*(inverse @ np.array([x_px - self.axis_x_px, y_px - self.axis_y_px]))))
        away = np.linspace(0.0, math.pi, 1800)
        reached = self.radius(away)
        beyond = np.flatnonzero((reached >= r) | (np.gradient(reached) <= 0.0))
        return float(away[beyond[0]]) if beyond.size else math.pi

    def zpn_cards(self) -> Cards:
        """FITS cards by which wcslib, and so astropy, has the same lens."""
        inverse = np.degrees(np.linalg.inv(self.matrix))
        cards: Cards = {
            "WCSAXES": 2,
            "CTYPE1": "RA---ZPN",
            "CTYPE2": "DEC--ZPN",
            "CUNIT1": "deg",
            "CUNIT2": "deg",
            "RADESYS": "ICRS",
            "CRPIX1": self.axis_x_px + 1.0,
            "CRPIX2": self.axis_y_px + 1.0,
            "CRVAL1": self.axis.ra_deg,
            "CRVAL2": self.axis.dec_deg,
            "CD1_1": float(inverse[0, 0]),
            "CD1_2": float(inverse[0, 1]),
            "CD2_1": float(inverse[1, 0]),
            "CD2_2": float(inverse[1, 1]),
            "PV2_0": 0.0,
            "PV2_1": 1.0,
            "IMAGEW": self.width_px,
            "IMAGEH": self.height_px,
        }
        for number, term in enumerate(self.terms):
            cards[f"PV2_{2 * number + 2}"] = 0.0
            cards[f"PV2_{2 * number + 3}"] = float(term)
        return cards

    def cards(self) -> Cards:
        """TAN-SIP where that stands for the lens all over the frame, else ZPN."""
        plate = self.sip_plate()
        if plate is None:
            return self.zpn_cards()
        return wcs_cards(plate, width_px=self.width_px, height_px=self.height_px)

    def sip_plate(self) -> Plate | None:
        """A polynomial on the frame's tangent plane that is this lens; None where none is."""
        if self.corner_rad() > SIP_WIDEST:
            return None
        center_x, center_y = (self.width_px - 1) / 2.0, (self.height_px - 1) / 2.0
        tangent = self.place(center_x, center_y)
        # Chebyshev's points: dense at the edges, where polynomials swing
        knots = -np.cos(np.pi * np.arange(GRID) / (GRID - 1))
        u, v = (side.ravel() for side in np.meshgrid(knots, knots))
        x, y = center_x + 0.5 * self.width_px * u, center_y + 0.5 * self.height_px * v
        ra, dec = places_at_pixels(self.zpn_cards(), x, y)
        xi, eta = gnomonic(ra, dec, tangent.ra_deg, tangent.dec_deg)
        unit = 0.5 * max(self.width_px, self.height_px)
        frame = Plate(tangent, center_x, center_y, unit, 1, 1, np.zeros(3), np.zeros(3))
        for degree in range(3, SIP_DEGREE + 1, 2):
            rows = products((x - center_x) / unit, (y - center_y) / unit, degree).T
            found: Array = np.asarray(
                np.linalg.lstsq(rows, np.column_stack((xi, eta)) * ARCSEC_PER_RAD, rcond=None)[0],
                dtype=np.float64,
            )
            # the tangent point is the center exactly: SIP has no constant
            found[0] = 0.0
            xi_rad, eta_rad = (rows @ found / ARCSEC_PER_RAD).T
            back = gnomonic_inverse(xi_rad, eta_rad, tangent.ra_deg, tangent.dec_deg)
            back_x, back_y = self.pixels(*back)
            off = np.hypot(back_x - x, back_y - y)
            if off.max() <= SIP_WORST_PX:
                matrix = found[1:3].T
                parity = -1 if np.linalg.det(matrix) > 0 else 1
                return replace(
                    frame, degree=degree, parity=parity, xi=found[:, 0].copy(), eta=found[:, 1].copy()
                )
        return None

    def place(self, x_px: float, y_px: float) -> Icrs:
        """The position at a pixel."""
        ra, dec = places_at_pixels(self.zpn_cards(), np.array([x_px]), np.array([y_px]))
        return Icrs(float(ra[0]), float(dec[0]))

    def matrix_at(self, x_px: float, y_px: float) -> Array:
        """Derivatives at a pixel, arcsec per pixel: [[dξ/dx, dξ/dy], [dη/dx, dη/dy]]."""
        x = x_px + _STEP_PX * np.array([-1.0, 1.0, 0.0, 0.0])
        y = y_px + _STEP_PX * np.array([0.0, 0.0, -1.0, 1.0])
        here = self.place(x_px, y_px)
        xi, eta = gnomonic(*places_at_pixels(self.zpn_cards(), x, y), here.ra_deg, here.dec_deg)
        return ARCSEC_PER_RAD * np.array([[xi[1] - xi[0], xi[3] - xi[2]], [eta[1] - eta[0], eta[3] - eta[2]]])


def _from_axis(axis: Icrs, ra_deg: Array, dec_deg: Array) -> tuple[Array, Array, Array]:
    """Angle from the axis (radians), and the direction there: parts towards east and north."""
    lon = np.radians(np.asarray(ra_deg, dtype=float) - axis.ra_deg)
    lat = np.radians(np.asarray(dec_deg, dtype=float))
    sin0, cos0 = math.sin(math.radians(axis.dec_deg)), math.cos(math.radians(axis.dec_deg))
    east = np.cos(lat) * np.sin(lon)
    north = cos0 * np.sin(lat) - sin0 * np.cos(lat) * np.cos(lon)
    depth = sin0 * np.sin(lat) + cos0 * np.cos(lat) * np.cos(lon)
    across = np.hypot(east, north)
    length = np.maximum(across, 1e-300)
    return np.arctan2(across, depth), east / length, north / length
