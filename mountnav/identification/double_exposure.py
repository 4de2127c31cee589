"""Does a frame show two skies? Another place's stars among the light that no identified star explains.

A shutter that stayed open over a slew, or a frame exposed twice, holds the stars of two places. A plate fits
either of them, with the same odds. Near by, the same stars are seen twice (`field_motion.second_image`);
farther away they aren't, and only the catalog tells that what is left over is a sky as well.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree
from scipy.special import bdtrc

from mountnav.identification.field_rotation import FEWEST, OTHERS, SEEDS, UnexplainedLight
from mountnav.identification.plate import Plate

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

PER_FRAME = 40
"""So many of the brightest stars per area of the frame are held against the strangers: the brightest dozen
of these are among them even where each place has half of the light. Doubled, chance agrees twice as often and
the look costs four times the time."""
FAR_DIAGONALS = 1.5
"""The other place's stars are looked for so far from the frame's center, in diagonals of the frame: there no
part of the one field is in the other. Doubled, the look costs sixteen times the time."""
GREATEST_TURN_RAD = 0.3
"""Between two places a mount's field turns by no more: a frame of 3° moved by its width at 80° of
declination. Doubled, chance agrees twice as often."""
NEAR_PX = 4.0
"""A stranger so near to a star is that star: patches of light are placed to a pixel, and a tangent plane that
is extended by a wide frame's width is bent by two. Doubled, chance agrees four times as often."""
LEAST_APART = 0.15
"""Of the frame's shorter side: strangers nearer to each other tell no rotation."""
OWN_PLACE_PX, OWN_TURN_RAD = 20.0, 0.02
"""What lies so near to the plate is the plate itself: its faint stars, and pieces of its bright ones."""
CHANCE = 1e-3
"""Another place that chance makes in fewer frames than this is one: only frames with many strangers are
asked, and few stars are bright enough to tell. Ten times as much would refuse one in a hundred of these."""
PAIRS_AT_ONCE = 20_000
"""Ways to lay the strangers on the sky that are tried in one go: 20 MB of memory."""


@dataclass(frozen=True, slots=True)
class SecondField:
    """Another place whose stars a frame shows besides.

    Attributes
    ----------
    offset_px : complex
        How far from where the plate has it a star at the frame's center is seen again.
    turn_rad : float
        By how much the other place is turned to the plate's.
    stars : int
        Strangers that are stars there.
    """

    offset_px: complex
    turn_rad: float
    stars: int


def find_second_field(
    strangers: UnexplainedLight, plate: Plate, ra_deg: Array, dec_deg: Array, shape: tuple[int, int]
) -> SecondField | None:
    """Look for a place of the sky that explains the strangers, seen with the plate's own scale and parity.

    Parameters
    ----------
    strangers : Strangers
    plate : Plate
    ra_deg, dec_deg : ndarray, shape (n,)
        Stars within `FAR_DIAGONALS` of the plate's center, `PER_FRAME` of them for each area of the frame.
    shape : (int, int)
        Of the frame: height, width.

    Returns
    -------
    SecondSky or None
        None where chance would bring as much in more than `CHANCE` of all frames, or where too few strangers
        are left to tell.
    """
    if strangers.x_px.size < FEWEST or ra_deg.size < FEWEST:
        return None
    # in the tangent plane, in pixels: polynomials hold within the frame only
    scale = plate.scale_arcsec_px()
    seen = _complex(plate.tangential(strangers.x_px[:OTHERS], strangers.y_px[:OTHERS])) / scale
    there = _complex(plate.project(ra_deg, dec_deg)) / scale
    there = there[np.isfinite(there)]
    middle = complex(plate.xi[0], plate.eta[0]) / scale
    radius_px = FAR_DIAGONALS * math.hypot(*shape)
    there = there[np.abs(there - middle) < radius_px]
    if there.size < FEWEST:
        return None
    first, second, turn = _ways(seen, there, LEAST_APART * min(shape))
    if first.size == 0:
        return None
    tree = KDTree(np.column_stack((there.real, there.imag)))
    share = min(0.5, there.size * (NEAR_PX / radius_px) ** 2)
    least, best = CHANCE, None
    for some in np.array_split(np.arange(first.size), first.size // PAIRS_AT_ONCE + 1):
        laid = second[some, None] + turn[some, None] * (seen - first[some, None])
        at = second[some] + turn[some] * (middle - first[some])
        asked = (np.abs(laid - middle) < radius_px).sum(axis=1)
        near = tree.query(np.stack((laid.real, laid.imag), axis=-1), distance_upper_bound=NEAR_PX)[0]
        told = np.isfinite(near).sum(axis=1)
        elsewhere = (np.abs(at - middle) > OWN_PLACE_PX) | (np.abs(turn[some] - 1.0) > OWN_TURN_RAD)
        # two of them were laid there
        odds = bdtrc(told - 3.0, np.maximum(asked, told) - 2, share) * first.size
        k = int(np.argmin(np.where(elsewhere & (told > 3), odds, np.inf)))
        if elsewhere[k] and told[k] > 3 and odds[k] < least:
            least = float(odds[k])
            way = complex(turn[some][k])
            again = complex(first[some][k]) + (middle - complex(second[some][k])) / way
            best = SecondField(_in_pixels(plate, again - middle), cmath.phase(way), int(told[k]))
    return best


def _complex(parts: tuple[Array, Array]) -> Complex:
    return np.asarray(parts[0] + 1j * parts[1])


def _in_pixels(plate: Plate, offset: complex) -> complex:
    """An offset in the tangent plane, in pixels of the frame: turned, perhaps mirrored."""
    dx, dy = np.linalg.solve(plate.matrix(), np.array([offset.real, offset.imag]) * plate.scale_arcsec_px())
    return complex(dx, dy)


def _ways(seen: Complex, there: Complex, least_px: float) -> tuple[Complex, Complex, Complex]:
    """Each way to lay two of the brightest strangers upon two stars that are as far apart.

    Returns
    -------
    first, second, turn : ndarray of complex, shape (n,)
        A stranger's place, that of its star, and the rotation from one to the other.
    """
    k, m = np.triu_indices(there.size, 1)
    far = np.abs(there[m] - there[k])
    order = np.argsort(far)
    k, m, far = k[order], m[order], far[order]
    firsts, seconds, turns = [], [], []
    for i, j in zip(*np.triu_indices(min(SEEDS, seen.size), 1), strict=True):
        apart = seen[j] - seen[i]
        length = abs(apart)
        if length < least_px:
            continue
        low, high = np.searchsorted(far, (length - NEAR_PX, length + NEAR_PX))
        for a, b in ((k[low:high], m[low:high]), (m[low:high], k[low:high])):
            turn = (there[b] - there[a]) / apart
            turn /= np.abs(turn)
            some = np.abs(np.angle(turn)) < GREATEST_TURN_RAD
            firsts.append(np.full(int(some.sum()), 0.5 * (seen[i] + seen[j])))
            seconds.append(0.5 * (there[a[some]] + there[b[some]]))
            turns.append(turn[some])
    if not firsts:
        return (np.zeros(0, dtype=complex),) * 3
    return np.concatenate(firsts), np.concatenate(seconds), np.concatenate(turns)
