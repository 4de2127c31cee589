"""Double exposures: the same stars seen a second time near by, or the stars of another field far away.

A shutter that stayed open over a slew, or a frame exposed twice, holds the stars of two positions. A plate
fits either of them, with the same odds. Near by, the same stars are seen twice (`second_image`,
`second_sources`). Farther away they aren't, and only the catalog shows that the light which the plate's
stars don't explain is that of other stars (`find_second_field`).
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree
from scipy.special import bdtrc

from mountnav.catalog.stars import Stars
from mountnav.identification.field_rotation import FEWEST, STARS
from mountnav.identification.plate import Plate
from mountnav.measuring.medians import median
from mountnav.measuring.segmentation import LightSegments
from mountnav.measuring.star_trail import REACH_PX

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Index = NDArray[np.int64]

SEEDS = 12
"""Number of the brightest stars or unexplained patches, pairs of which propose where the others may lie.
Chosen by hand: time grows with its square."""
OTHERS = 60
"""Number of the brightest patches that no star explains which are used. Chosen by hand: more cost time, and
chance agrees more often."""
UNEXPLAINED = 3.0
"""A patch with more than so many times the light that the catalog gives its stars isn't explained by them.
Colors and variable stars make less. Chosen by hand."""
BRIGHT_SHARE = 0.25
"""Unexplained patches below this share of the identified stars' median light aren't counted as bright: a
second image as faint as that moves the middle by a fifth of the way."""
UNEXPLAINED_SHARE = 0.1
"""Frames of points with a smaller share of unexplained patches among the bright ones aren't searched for a
second image: of one with a third of the light less than half are bright enough, and in a crowd half of these
lie in other stars' patches. Half of all frames reach half of it, which would cost time; doubled, such a
second image
is overlooked."""
IMAGE_GREATEST_TURN = 0.3
"""A second image is rotated (radians) and grown (share) by no more than this: 400 px over a frame of
1,300."""
IMAGE_NEAR_PX = 3.0
"""A patch within this distance of where a star's second image should lie is that image: patches are placed so
well."""
IMAGE_CHANCE = 1e-6
"""A second image is believed if chance makes one in fewer than this share of frames."""
CROWD, CROWD_REACH_PX = 400, 60.0
"""Where no patch shows a second image of drawn-out stars: number of the brightest measured sources that are
searched, and how far (pixels) from the identified ones. Doubled, each costs four times the time."""
RATIO_AGREES = 2.0
"""Second images of stars differ in their share of the first's light by no more than this factor: patches of
light near the threshold lose a part of theirs. Doubled, chance agrees twice as often."""
ALIKE_LIGHT = 0.3
"""The two images of a star have at least this share of each other's light, where any source may be the
second. Chosen by hand."""

PER_FRAME = 40
"""Number of catalog stars, brightest first, per area of the frame that are compared with the unexplained
patches: the brightest dozen of these are among them even where each field has half of the light. Doubled,
chance
agrees twice as often, and the search costs four times the time."""
FAR_DIAGONALS = 1.5
"""How far from the frame's center the other field's stars are searched, in diagonals of the frame: beyond, no
part of the one field is in the other. Doubled, the search costs sixteen times the time."""
FIELD_GREATEST_TURN_RAD = 0.3
"""Between two positions a mount's field turns by no more: a frame of 3° moved by its width at 80° of
declination. Doubled, chance agrees twice as often."""
FIELD_NEAR_PX = 4.0
"""A patch within this distance of a predicted star is that star: patches of light are placed to a pixel, and
a tangent plane that is extended by a wide frame's width is bent by two. Doubled, chance agrees four times as
often."""
LEAST_APART = 0.15
"""Least distance of the two patches or stars that propose a rotation, in shorter sides of the frame."""
OWN_PLACE_PX, OWN_TURN_RAD = 20.0, 0.02
"""A field nearer to the plate than both is the plate itself: its faint stars, and pieces of its bright
ones."""
FIELD_CHANCE = 1e-3
"""Another field is believed if chance makes one in fewer than this share of frames: only frames with many
unexplained patches are searched, and few stars are bright enough to count. Ten times as much would refuse one
in a
hundred of these."""
PAIR_MAG = 0.75
"""Two patches are as bright to each other as two stars, within this, mag: colors and pieces of trails take a
part. Chosen by hand; doubled, lamps pass for stars twice as often."""
MOST_ABOUT = 80
"""Stars about the frame, brightest first, whose pairs are compared: 6,000 pairs. Doubled, four times as many,
and lamps pass for stars as much more often."""
PAIRS_AT_ONCE = 20_000
"""Ways to lay the unexplained patches on the sky that are tried at once: 20 MB of memory."""


@dataclass(frozen=True, slots=True)
class SecondImage:
    """A second set of the same stars in a frame.

    Attributes
    ----------
    center_px : complex
        How far from the first at the frame's center.
    turn : complex
        And how that changes per pixel.
    ratio : float
        Of its light to that of the first.
    stars : int
        That were found in it.
    """

    center_px: complex
    turn: complex
    ratio: float
    stars: int

    @property
    def pull_px(self) -> float:
        """How far the middle of both lies from the first, at the frame's center."""
        return abs(self.center_px) * self.ratio / (1.0 + self.ratio)


@dataclass(frozen=True, slots=True)
class UnexplainedLight:
    """The bright patches of light that no star of a plate explains, brightest first; shape (n,).

    Attributes
    ----------
    known : ndarray of int
        Indices of the brightest patches that the plate's stars do explain.
    many : bool
        So many of them are bright that they may be stars as well as the known ones are.
    """

    x_px: Array
    y_px: Array
    flux: Array
    known: Index
    many: bool


def unexplained_light(
    patches: LightSegments, x_px: Array, y_px: Array, light: Array
) -> UnexplainedLight | None:
    """Part the patches of light into those that a plate's stars explain and the others.

    Parameters
    ----------
    x_px, y_px, light : ndarray, shape (n,)
        Where a plate has all the stars that it knows of, and their light by the catalog.

    Returns
    -------
    UnexplainedLight or None
        None where no patch is explained, so that the light of a star is unknown here.
    """
    at = patches.at(x_px, y_px)
    own = np.bincount(at[at >= 0], light[at >= 0], minlength=patches.x_px.size)
    known = np.flatnonzero(own > 0)
    if known.size == 0:
        return None
    brightest = known[np.argsort(-own[known], kind="stable")][:STARS]
    per_light = median(patches.flux[brightest] / own[brightest])
    # a faint star that happens to lie in a bright patch doesn't explain it
    strange = patches.flux > UNEXPLAINED * per_light * own
    known = known[~strange[known]]
    if known.size == 0:
        return None
    known = known[np.argsort(-patches.flux[known], kind="stable")][:STARS]
    bright = BRIGHT_SHARE * median(patches.flux[known[: STARS // 2]])
    others = np.flatnonzero(strange)
    others = others[np.argsort(-patches.flux[others], kind="stable")][:OTHERS]
    count = int((patches.flux[others] > bright).sum())
    fewest = UNEXPLAINED_SHARE * (count + int((patches.flux[known] > bright).sum()))
    return UnexplainedLight(
        patches.x_px[others], patches.y_px[others], patches.flux[others], known, count >= max(FEWEST, fewest)
    )


def second_image(
    patches: LightSegments,
    x_px: Array,
    y_px: Array,
    light: Array,
    center: complex,
    shape: tuple[int, int],
    *,
    drawn_out: bool = True,
    chance: float = IMAGE_CHANCE,
    alike: bool = False,
) -> SecondImage | None:
    """Look for the same stars once more, elsewhere, and turned or grown: an exposure in two parts.

    Where the second image lies at the same offset everywhere, `star_trail` sees it too.

    Parameters
    ----------
    x_px, y_px : ndarray, shape (n,)
        Where a plate has all the stars that it knows of.
    light : ndarray, shape (n,)
        Theirs by the catalog, to a common scale.
    shape : (int, int)
        Of the frame: height, width.
    drawn_out : bool
        Whether the images are no points: then it is looked for however faint it may be, else only where
        there are bright patches that no star explains.
    chance : float
        It is believed if chance makes one in fewer than this share of frames.
    alike : bool
        All of its images have the same share of their stars' light, by `RATIO_AGREES`.
    """
    found = unexplained_light(patches, x_px, y_px, light)
    if found is None or min(found.known.size, found.x_px.size) < FEWEST:
        return None
    if not (drawn_out or found.many):
        return None
    known = found.known
    first = patches.x_px[known] + 1j * patches.y_px[known] - center
    second = found.x_px + 1j * found.y_px - center
    return _second(
        first, patches.flux[known], second, found.flux, center, shape, believed=chance, alike=alike
    )


def second_sources(
    x_px: Array, y_px: Array, flux: Array, identified: Index, center: complex, shape: tuple[int, int]
) -> SecondImage | None:
    """Look for the second image of a crowd among the measured sources, where patches of light run together.

    Parameters
    ----------
    x_px, y_px, flux : ndarray, shape (n,)
        All that was measured.
    identified : ndarray of int, shape (m,)
        Those that the plate has a star for.
    shape : (int, int)
        Of the frame: height, width.

    Returns
    -------
    SecondImage or None
        Near by alone (`CROWD_REACH_PX`): farther off the images lie in patches of their own.
    """
    lit = identified[np.isfinite(flux[identified]) & (flux[identified] > 0)]
    lit = lit[np.argsort(-flux[lit], kind="stable")][:STARS]
    if lit.size < FEWEST:
        return None
    every = np.flatnonzero(np.isfinite(flux) & (flux > ALIKE_LIGHT * flux[lit].min()))
    every = every[np.argsort(-flux[every], kind="stable")][:CROWD]
    place = x_px + 1j * y_px - center
    return _second(place[lit], flux[lit], place[every], flux[every], center, shape, CROWD_REACH_PX)


def _second(
    first: Complex,
    first_flux: Array,
    second: Complex,
    second_flux: Array,
    center: complex,
    shape: tuple[int, int],
    reach_px: float = REACH_PX,
    *,
    believed: float = IMAGE_CHANCE,
    alike: bool = False,
) -> SecondImage | None:
    """The similarity near to none that puts most of the first upon some of the second."""
    seeds = min(SEEDS, first.size)
    d = second[None, :] - first[:seeds, None]
    ratios = second_flux[None, :] / first_flux[:, None]
    likely = np.ones(d.shape, dtype=bool)
    if reach_px < REACH_PX:
        likely = (ratios[:seeds] > ALIKE_LIGHT) & (ratios[:seeds] < 1.0 / ALIKE_LIGHT)
    i, j = np.nonzero((np.abs(d) < reach_px) & (np.abs(d) > IMAGE_NEAR_PX) & likely)
    p, q = np.triu_indices(i.size, 1)
    apart = first[i[q]] - first[i[p]]
    wide = (i[p] != i[q]) & (j[p] != j[q]) & (np.abs(apart) > LEAST_APART * min(shape))
    if alike:
        wide &= np.abs(np.log(ratios[i[p], j[p]] / ratios[i[q], j[q]])) < math.log(RATIO_AGREES)
    p, q, apart = p[wide], q[wide], apart[wide]
    b = (d[i[q], j[q]] - d[i[p], j[p]]) / apart
    small = np.abs(b) < IMAGE_GREATEST_TURN
    b, p, q = b[small], p[small], q[small]
    if b.size == 0:
        return None
    a = d[i[p], j[p]] - b * first[i[p]]
    best, hits, chance = None, 0, 1.0
    common = np.sqrt(ratios[i[p], j[p]] * ratios[i[q], j[q]])
    share = math.pi * IMAGE_NEAR_PX**2 * second.size / (shape[0] * shape[1])
    # a way that lays three patches or fewer upon others counts for nothing: most are told by a raster
    reach = max(float(np.abs(second.real).max()), float(np.abs(second.imag).max())) + 1.0
    raster = _Raster(second, 0j, reach, IMAGE_NEAR_PX)
    worth = np.zeros(b.size, dtype=bool)
    for part in np.array_split(np.arange(b.size), b.size * first.size // 400_000 + 1):
        there = first + a[part, None] + b[part, None] * first
        worth[part] = raster.may_be_near(there).sum(axis=1) > 3
    some = np.flatnonzero(worth)
    if some.size == 0:
        return None
    for part in np.array_split(some, some.size * first.size * second.size // 4_000_000 + 1):
        there = first + a[part, None] + b[part, None] * first
        # squares: the modulus of so many complex numbers took half of the time of this search
        dx, dy = there.real[:, :, None] - second.real, there.imag[:, :, None] - second.imag
        dx *= dx
        dy *= dy
        dx += dy
        upon = dx < IMAGE_NEAR_PX**2
        if alike:
            upon &= np.abs(np.log(ratios[None] / common[part, None, None])) < math.log(RATIO_AGREES)
        near = upon.any(axis=2)
        at = there + center
        inside = (at.real > 0) & (at.imag > 0) & (at.real < shape[1]) & (at.imag < shape[0])
        hits_here, tested = near.sum(axis=1), inside.sum(axis=1)
        odds = bdtrc(hits_here - 3.0, np.maximum(tested, hits_here) - 2, min(share, 0.5)) * b.size
        k = int(np.argmin(np.where(hits_here > 3, odds, np.inf)))
        if hits_here[k] > 3 and odds[k] < chance:
            best, hits, chance = int(part[k]), int(hits_here[k]), float(odds[k])
    if best is None or chance > believed:
        return None
    there = first + a[best] + b[best] * first
    away = np.abs(there[:, None] - second)
    near_by = away.min(axis=1) < IMAGE_NEAR_PX
    ratio = median(second_flux[away.argmin(axis=1)[near_by]] / first_flux[near_by])
    return SecondImage(complex(a[best]), complex(b[best]), ratio, hits)


RASTER_CELLS = 1000
"""Cells along the raster of the stars of another field: with 500 stars one position in 200 is looked up in
the tree. It changes time and memory, 1 MB, and no result."""


@dataclass(frozen=True, slots=True)
class SecondField:
    """Another field whose stars a frame shows besides its own.

    Attributes
    ----------
    offset_px : complex
        From where the plate has a star at the frame's center to where it is seen again.
    turn_rad : float
        Rotation of the other field against the plate's.
    stars : int
        Unexplained patches that are stars there.
    """

    offset_px: complex
    turn_rad: float
    stars: int


def find_second_field(
    unexplained: UnexplainedLight, plate: Plate, ra_deg: Array, dec_deg: Array, shape: tuple[int, int]
) -> SecondField | None:
    """Look for another field whose stars explain the patches, at the plate's own scale and parity.

    Parameters
    ----------
    ra_deg, dec_deg : ndarray, shape (n,)
        Stars within `FAR_DIAGONALS` of the plate's center, `PER_FRAME` of them for each area of the frame.
    shape : (int, int)
        Of the frame: height, width.

    Returns
    -------
    SecondField or None
        None where chance would bring as much in more than `FIELD_CHANCE` of all frames, or where too few
        patches are left.
    """
    if unexplained.x_px.size < FEWEST or ra_deg.size < FEWEST:
        return None
    # in the tangent plane, in pixels: polynomials hold within the frame only
    scale = plate.scale_arcsec_px()
    seen = _complex(plate.tangential(unexplained.x_px[:OTHERS], unexplained.y_px[:OTHERS])) / scale
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
    sky = _StarsNearBy(there, middle, radius_px)
    share = min(0.5, there.size * (FIELD_NEAR_PX / radius_px) ** 2)
    least, best = FIELD_CHANCE, None
    for ways in np.array_split(np.arange(first.size), first.size // PAIRS_AT_ONCE + 1):
        laid = second[ways, None] + turn[ways, None] * (seen - first[ways, None])
        at = second[ways] + turn[ways] * (middle - first[ways])
        tested = (np.abs(laid - middle) < radius_px).sum(axis=1)
        hits_here = sky.near(laid).sum(axis=1)
        elsewhere = (np.abs(at - middle) > OWN_PLACE_PX) | (np.abs(turn[ways] - 1.0) > OWN_TURN_RAD)
        # two of them were laid there
        odds = bdtrc(hits_here - 3.0, np.maximum(tested, hits_here) - 2, share) * first.size
        k = int(np.argmin(np.where(elsewhere & (hits_here > 3), odds, np.inf)))
        if elsewhere[k] and hits_here[k] > 3 and odds[k] < least:
            least = float(odds[k])
            way = complex(turn[ways][k])
            again = complex(first[ways][k]) + (middle - complex(second[ways][k])) / way
            best = SecondField(_in_pixels(plate, again - middle), cmath.phase(way), int(hits_here[k]))
    return best


def bright_pair(
    unexplained: UnexplainedLight, many: int, plate: Plate, stars: Stars, shape: tuple[int, int]
) -> bool:
    """Whether two of the brightest unexplained patches lie to each other as two stars about the frame do.

    Two patches can prove no other field. But lamps, planets and galaxies seldom lie as two stars do that are
    as bright, and a frame that few stars hold is better refused.

    Parameters
    ----------
    many : int
        How many patches count, the brightest.
    stars : Stars
        Those about the frame that are bright enough.
    """
    many = min(many, SEEDS)
    scale = plate.scale_arcsec_px()
    seen = _complex(plate.tangential(unexplained.x_px[:many], unexplained.y_px[:many])) / scale
    there = _complex(plate.project(stars.ra_deg, stars.dec_deg)) / scale
    sound = np.isfinite(there) & np.isfinite(stars.mag)
    there, mag = there[sound][:MOST_ABOUT], stars.mag[sound][:MOST_ABOUT]
    if min(seen.size, there.size) < 2:
        return False
    instrumental = -2.5 * np.log10(unexplained.flux[:many])
    i, j = np.triu_indices(seen.size, 1)
    k, m = np.nonzero(~np.eye(there.size, dtype=bool))
    apart = (there[m] - there[k])[:, None] - (seen[j] - seen[i])
    bright = (mag[m] - mag[k])[:, None] - (instrumental[j] - instrumental[i])
    elsewhere = np.abs(there[k][:, None] - seen[i]) > OWN_PLACE_PX
    return bool(((np.abs(apart) < FIELD_NEAR_PX) & (np.abs(bright) < PAIR_MAG) & elsewhere).any())


class _Raster:
    """Tells quickly which positions can't be near any of some others: a square of marked cells.

    Parameters
    ----------
    there : ndarray of complex, shape (n,)
        The others, within `radius_px` of `middle`, in each coordinate.
    near_px : float
        What near means.
    """

    def __init__(self, there: Complex, middle: complex, radius_px: float, near_px: float) -> None:
        # a little more than near: what is near is in the same cell or the next one, however it is rounded
        self._cell = max(2.0 * radius_px / RASTER_CELLS, 1.001 * near_px)
        # two cells more all round: stars at the rim mark those beside them, and the outermost stay free
        self._corner = middle - complex(radius_px, radius_px) - 2.0 * self._cell * (1 + 1j)
        self._side = int(2.0 * radius_px / self._cell) + 5
        marked = np.zeros((self._side, self._side), dtype=bool)
        cell = self._cells(there)
        for down in (-1, 0, 1):
            for right in (-1, 0, 1):
                marked.reshape(-1)[cell + down * self._side + right] = True
        self._marked = marked.reshape(-1)

    def _cells(self, place: Complex) -> Index:
        """Index into the flattened raster; what lies beyond is in the outermost cells."""
        at = (place - self._corner) / self._cell
        last = self._side - 1.0
        row = np.clip(at.imag, 0.0, last).astype(np.int64)
        row *= self._side
        row += np.clip(at.real, 0.0, last).astype(np.int64)
        return row

    def may_be_near(self, place: Complex) -> NDArray[np.bool_]:
        """Which positions may be near one; of their shape."""
        return np.asarray(self._marked[self._cells(place)])


class _StarsNearBy:
    """Tells which positions have a star within `FIELD_NEAR_PX`; a raster leaves the many that have none.

    Parameters
    ----------
    there : ndarray of complex, shape (n,)
        Stars within `radius_px` of `middle`.
    """

    def __init__(self, there: Complex, middle: complex, radius_px: float) -> None:
        self._tree = KDTree(np.column_stack((there.real, there.imag)))
        self._raster = _Raster(there, middle, radius_px, FIELD_NEAR_PX)

    def near(self, place: Complex) -> NDArray[np.bool_]:
        """Which positions have one; of their shape."""
        found = self._raster.may_be_near(place)
        some = place[found]
        away = self._tree.query(np.column_stack((some.real, some.imag)), distance_upper_bound=FIELD_NEAR_PX)
        found[found] = np.isfinite(away[0])
        return found


def _complex(parts: tuple[Array, Array]) -> Complex:
    return np.asarray(parts[0] + 1j * parts[1])


def _in_pixels(plate: Plate, offset: complex) -> complex:
    """An offset in the tangent plane, in pixels of the frame: turned, perhaps mirrored."""
    dx, dy = np.linalg.solve(plate.matrix(), np.array([offset.real, offset.imag]) * plate.scale_arcsec_px())
    return complex(dx, dy)


def _ways(seen: Complex, there: Complex, least_px: float) -> tuple[Complex, Complex, Complex]:
    """Each way to lay two of the brightest unexplained patches upon two stars that are as far apart.

    Returns
    -------
    first, second, turn : ndarray of complex, shape (n,)
        A patch's position, that of its star, and the rotation from one to the other.
    """
    ones, others = np.triu_indices(min(SEEDS, seen.size), 1)
    lengths = np.abs(seen[others] - seen[ones])
    wide = lengths >= least_px
    if not wide.any():
        return (np.zeros(0, dtype=complex),) * 3
    k, m = np.triu_indices(there.size, 1)
    x, y = there.real, there.imag
    square = (x[m] - x[k]) ** 2 + (y[m] - y[k]) ** 2
    # most stars are farther apart than any two patches of the frame
    most_px = float(lengths.max()) + 2.0 * FIELD_NEAR_PX
    near = np.flatnonzero(square < most_px**2)
    k, m = k[near], m[near]
    far = np.abs(there[m] - there[k])
    order = np.argsort(far)
    k, m, far = k[order], m[order], far[order]
    span = (there[m] - there[k]) / np.maximum(far, 1e-9)
    between = 0.5 * (there[k] + there[m])
    straight = math.cos(FIELD_GREATEST_TURN_RAD)
    ones, others, lengths = ones[wide], others[wide], lengths[wide]
    low = np.searchsorted(far, lengths - FIELD_NEAR_PX)
    count = np.searchsorted(far, lengths + FIELD_NEAR_PX) - low
    # each pair of patches with each pair of stars as far apart: one row
    patches = np.repeat(np.arange(lengths.size), count)
    pair = np.arange(patches.size) + np.repeat(low - np.cumsum(count) + count, count)
    turn = span[pair] * (np.conj(seen[others] - seen[ones]) / lengths)[patches]
    # both stars the other way round turn it by half a circle more
    as_they_are, swapped = np.flatnonzero(turn.real > straight), np.flatnonzero(turn.real < -straight)
    row = np.concatenate((as_they_are, swapped))
    turns = np.concatenate((turn[as_they_are], -turn[swapped]))
    order = np.argsort(np.concatenate((2 * patches[as_they_are], 2 * patches[swapped] + 1)), kind="stable")
    row, turns = row[order], turns[order]
    return (0.5 * (seen[ones] + seen[others]))[patches[row]], between[pair[row]], turns
