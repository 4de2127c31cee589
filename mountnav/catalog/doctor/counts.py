"""Stars per frame, all over the sky, counted in a catalog or after the model, and the chance to solve it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mountnav.catalog.packed import PackedStore
from mountnav.catalog.star_counts import density_deg2, galactic
from mountnav.catalog.stars import Catalog
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import gnomonic

Array = NDArray[np.float64]

SOLVED_SHARE = (0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 0.82, 0.95, 0.985, 0.995, 0.999)
"""Share of frames solved with a good hint that hold 0, 1, 2, ... catalog stars within reach of the camera.

A tenth of the stars is taken not to be seen: blended, on a bad column, in a trail. With 5, 6, 7 stars seen
85, 98 and 100 % were solved of 1,180 drawn star lists of 1024 × 1024 pixels, with ten artifacts as bright as
the stars and five times as many fainter sources that are in no catalog (docs/how-to/catalog-doctor.md;
tests/catalog/doctor/test_diagnosis_solves.py draws some again). Of 375 richer fields 374 were solved
(docs/figures/index.md).
"""
SURE_STARS = len(SOLVED_SHARE)
"""With so many stars and more a frame counts as solved."""
WANTED_STARS = 8
"""So many are called enough in advice: 98 % of such frames are solved."""

_LOG_FACTORIALS = np.array([math.lgamma(n + 1.0) for n in range(SURE_STARS)])
"""Logarithms of n!, for Poisson's probabilities of few stars."""


def failing(counts: ArrayLike) -> Array:
    """Probability that a frame with so many catalog stars is not solved.

    Parameters
    ----------
    counts : array_like of int
        Stars in the frame that both catalog and camera reach.

    Returns
    -------
    ndarray
        0 to 1, of the same shape.
    """
    table = 1.0 - np.array((*SOLVED_SHARE, 1.0))
    return np.asarray(table[np.minimum(np.asarray(counts, dtype=np.int64), SURE_STARS)], dtype=np.float64)


def failing_on_mean(means: ArrayLike) -> Array:
    """Probability that a frame is not solved when only the expected number of its stars is known.

    Parameters
    ----------
    means : array_like
        Stars that are expected; the number itself is taken as Poisson's.

    Returns
    -------
    ndarray
        0 to 1, of the same shape.
    """
    mean = np.maximum(np.asarray(means, dtype=np.float64), 1e-12)[..., np.newaxis]
    few = np.arange(SURE_STARS)
    chances = np.exp(few * np.log(mean) - mean - _LOG_FACTORIALS)
    return np.asarray(chances @ (1.0 - np.array(SOLVED_SHARE)))


SAMPLE_FIELDS = 3000
"""Of the reachable sky: a share of 1 % is then known to 0.2 %."""
FIRST = 300
"""So many of them are looked at in full first, spread over all of it; often they are enough."""
OF_A_REGION = 60
"""Frames at most that the figures for galactic pole and plane are means of; chosen by hand. Halved, these
means scatter by 1.4 times as much; they are shown and decide nothing."""
POLE_DEG = 75.0
"""Galactic latitudes beyond this count as the pole."""
PLANE_DEG = 5.0
"""Galactic latitudes within this count as the plane."""
_GOLDEN_DEG = 180.0 * (3.0 - math.sqrt(5.0))
"""The golden angle: fields in steps of it on a spiral cover a sphere evenly, however many they are."""


@dataclass(frozen=True, slots=True)
class SampleFields:
    """Frame centers and how the frames are turned; each array has shape (n,).

    Attributes
    ----------
    ra_deg, dec_deg
        ICRS.
    rotation_deg
        Position angle of the frame's +y axis.
    """

    ra_deg: Array
    dec_deg: Array
    rotation_deg: Array

    def __len__(self) -> int:
        return int(self.ra_deg.size)

    def only(self, chosen: NDArray[np.int64] | NDArray[np.bool_] | slice) -> SampleFields:
        """Some of the fields."""
        return SampleFields(self.ra_deg[chosen], self.dec_deg[chosen], self.rotation_deg[chosen])


@dataclass(frozen=True, slots=True)
class Reach:
    """The band of declinations that a telescope reaches; the sky beyond never rises high enough."""

    low_dec_deg: float = -90.0
    high_dec_deg: float = 90.0

    @property
    def sky_share(self) -> float:
        """Share of the whole sky."""
        return 0.5 * (math.sin(math.radians(self.high_dec_deg)) - math.sin(math.radians(self.low_dec_deg)))


def reach_of(latitude_deg: float, min_altitude_deg: float) -> Reach:
    """What a telescope reaches: declinations whose highest altitude is above the limit.

    Parameters
    ----------
    latitude_deg : float
        Of the site, north positive.
    min_altitude_deg : float
        Nothing is pointed at below this.

    Returns
    -------
    Reach
        Without refraction, which matters by half a degree at the horizon.
    """
    # a limit at the zenith still leaves a sliver, so that there is something to count
    span_deg = max(90.0 - min_altitude_deg, 0.1)
    return Reach(max(latitude_deg - span_deg, -90.0), min(latitude_deg + span_deg, 90.0))


def spread_fields(reach: Reach, count: int = SAMPLE_FIELDS, first: int = FIRST) -> SampleFields:
    """Spread fields evenly over a band of the sky, in a golden spiral.

    Parameters
    ----------
    first : int
        So many of them, spread over all of the band again, come first.

    Returns
    -------
    SampleFields
        The same ones every time.
    """
    low, high = (math.sin(math.radians(one)) for one in (reach.low_dec_deg, reach.high_dec_deg))
    steps: Array = np.arange(count, dtype=np.float64)
    dec_deg = np.degrees(np.arcsin(low + (high - low) * (steps + 0.5) / count))
    order = np.random.default_rng(0).permutation(count)
    # every tenth of the spiral is itself nearly a spiral; the rest in any order
    early = np.linspace(0, count - 1, min(first, count)).astype(np.int64)
    late = order[~np.isin(order, early)]
    places = SampleFields((steps * _GOLDEN_DEG) % 360.0, dec_deg, (steps * 77.7) % 360.0)
    return places.only(np.concatenate((early, late)))


def pole_fields(reach: Reach) -> SampleFields:
    """Fields near the galactic poles that are reached; none where the telescope sees neither."""
    return _of_region(reach, lambda b_deg: np.abs(b_deg) >= POLE_DEG)


def plane_fields(reach: Reach) -> SampleFields:
    """Fields near the galactic plane that are reached."""
    return _of_region(reach, lambda b_deg: np.abs(b_deg) <= PLANE_DEG)


def _of_region(reach: Reach, wanted: Callable[[Array], NDArray[np.bool_]]) -> SampleFields:
    many = spread_fields(Reach(), 6000, 0)
    _, b_deg = galactic(many.ra_deg, many.dec_deg)
    inside = wanted(b_deg) & (many.dec_deg >= reach.low_dec_deg) & (many.dec_deg <= reach.high_dec_deg)
    found = np.flatnonzero(inside)
    return many.only(found[:OF_A_REGION])


RICH = 5 * SURE_STARS
"""Where the poorest of the first frames holds so many stars, the others are not looked at."""
WELL_ABOVE = 3 * SURE_STARS
"""A frame with so many stars to a brighter magnitude is read no deeper."""
SCATTER_DEX = 0.08
"""How far the sky is from the model of the Galaxy from frame to frame: fitted to Tycho-2's own counts."""


@dataclass(frozen=True, slots=True)
class FrameSize:
    """What a frame shows.

    Attributes
    ----------
    width_deg, height_deg : float
        > 0.
    depth_mag : float
        Faintest star that is measured.
    """

    width_deg: float
    height_deg: float
    depth_mag: float

    @property
    def half_diagonal_deg(self) -> float:
        """From the center to a corner."""
        return math.hypot(self.width_deg, self.height_deg) / 2.0

    @property
    def area_deg2(self) -> float:
        """Size."""
        return self.width_deg * self.height_deg

    def __str__(self) -> str:
        return f"{self.width_deg:.3g}° × {self.height_deg:.3g}°"


@dataclass(frozen=True, slots=True)
class Counted:
    """Frames of a catalog over the sky.

    Attributes
    ----------
    looked_at : int
        How many of the places: all, or the first ones if these were rich.
    fails : ndarray, shape (places,)
        Probability that a frame there is not solved, from its own number of stars; 1 where the catalog has
        no sky, 0 where nothing was looked at.
    covered : ndarray of bool, shape (places,)
        Whether the catalog has that part of the sky.
    median, pole, plane : float
        Stars per frame: the median over the covered places, the means near pole and plane. NaN if none is
        reached or covered.
    """

    looked_at: int
    fails: Array
    covered: NDArray[np.bool_]
    median: float
    pole: float
    plane: float


def counted(
    catalog: Catalog,
    frame: FrameSize,
    places: SampleFields,
    pole: SampleFields,
    plane: SampleFields,
    *,
    epoch_yr: float,
) -> Counted:
    """Lay frames over the sky and count the stars of a catalog in each.

    Parameters
    ----------
    catalog : Catalog
        On this machine.
    places, pole, plane : SampleFields
        From `mountnav.catalog.doctor.counts`.
    epoch_yr : float
        Julian year.
    """
    covered = np.array([_covers(catalog, frame, at) for at in _centers(places)], dtype=np.bool_)
    first = np.flatnonzero(covered[:FIRST])
    numbers, bright = _in_frames(catalog, frame, places.only(first), frame.depth_mag, epoch_yr)
    fails = np.where(covered, 0.0, 1.0)
    fails[first] = failing(numbers)
    looked_at = len(places)
    if first.size and numbers.min() >= RICH:
        looked_at = min(FIRST, len(places))
    else:
        rest = FIRST + np.flatnonzero(covered[FIRST:])
        fails[rest] = failing(_at_least(catalog, frame, places.only(rest), bright, epoch_yr))
    return Counted(
        looked_at,
        fails,
        covered,
        float(np.median(numbers)) if first.size else math.nan,
        _mean(catalog, frame, pole, epoch_yr),
        _mean(catalog, frame, plane, epoch_yr),
    )


def modeled(
    faintest_mag: float,
    densest_deg2: float | None,
    frame: FrameSize,
    places: SampleFields,
    pole: SampleFields,
    plane: SampleFields,
) -> Counted:
    """The same for a catalog that isn't here, after the model of the Galaxy.

    Parameters
    ----------
    faintest_mag : float
        How deep it is complete, as a V magnitude.
    densest_deg2 : float or None
        If it was thinned out to so many stars per square degree, the brightest first.

    Returns
    -------
    Counted
        Of a catalog of the whole sky; the model has neither clusters nor dark clouds.
    """
    depth = min(frame.depth_mag, faintest_mag)

    def means(where: SampleFields) -> Array:
        density = density_deg2(where.ra_deg, where.dec_deg, depth)
        if densest_deg2 is not None:
            density = np.minimum(density, densest_deg2)
        return np.asarray(density * frame.area_deg2)

    expected = means(places)
    return Counted(
        len(places),
        failing_near(expected),
        np.ones(len(places), dtype=np.bool_),
        float(np.median(expected)),
        float(np.mean(means(pole))) if len(pole) else math.nan,
        float(np.mean(means(plane))) if len(plane) else math.nan,
    )


def failing_near(means: ArrayLike) -> Array:
    """Probability that a frame is not solved where the model expects so many stars.

    Parameters
    ----------
    means : array_like
        Stars that the model expects in the frame.

    Returns
    -------
    ndarray
        0 to 1, of the same shape. The sky's own unevenness is taken in: a frame's true mean scatters by
        `SCATTER_DEX` about the model's.
    """
    spread = 10.0 ** (math.sqrt(3.0) * SCATTER_DEX)
    mean = np.asarray(means, dtype=np.float64)
    # three points stand for the normal distribution [Gauss and Hermite]
    poor, middle, rich = (failing_on_mean(mean * factor) for factor in (1.0 / spread, 1.0, spread))
    return np.asarray((poor + 4.0 * middle + rich) / 6.0)


def stars_in_frame(
    catalog: Catalog,
    frame: FrameSize,
    center: Icrs,
    rotation_deg: float,
    *,
    epoch_yr: float,
    mag_limit: float | None = None,
) -> Array:
    """Magnitudes of a catalog's stars in one frame.

    Parameters
    ----------
    rotation_deg : float
        Position angle of the frame's +y axis.
    mag_limit : float, optional
        Instead of the frame's depth.

    Returns
    -------
    ndarray, shape (n,)
        Brightest first.
    """
    limit = frame.depth_mag if mag_limit is None else mag_limit
    stars = catalog.cone(center, min(frame.half_diagonal_deg, 89.0), epoch_yr=epoch_yr, mag_limit=limit)
    xi, eta = gnomonic(stars.ra_deg, stars.dec_deg, center.ra_deg, center.dec_deg)
    sin, cos = math.sin(math.radians(rotation_deg)), math.cos(math.radians(rotation_deg))
    # the plane's half sides: tan, so that a lens of 90° is no smaller than it is
    half_width = math.tan(math.radians(min(frame.width_deg, 170.0) / 2.0))
    half_height = math.tan(math.radians(min(frame.height_deg, 170.0) / 2.0))
    inside = (np.abs(xi * cos - eta * sin) <= half_width) & (np.abs(xi * sin + eta * cos) <= half_height)
    return np.asarray(stars.mag[inside])


def _in_frames(
    catalog: Catalog, frame: FrameSize, places: SampleFields, mag_limit: float, epoch_yr: float
) -> tuple[NDArray[np.int64], float]:
    """Stars in each frame; and the magnitude to which nearly all frames hold plenty."""
    numbers = np.zeros(len(places), dtype=np.int64)
    plenty = np.full(len(places), math.inf)
    for row, (center, rotation) in enumerate(zip(_centers(places), places.rotation_deg, strict=True)):
        mags = stars_in_frame(catalog, frame, center, rotation, epoch_yr=epoch_yr, mag_limit=mag_limit)
        numbers[row] = mags.size
        if mags.size >= WELL_ABOVE:
            plenty[row] = mags[WELL_ABOVE - 1]
    # "higher" keeps an infinite magnitude infinite instead of interpolating to NaN
    return numbers, float(np.quantile(plenty, 0.9, method="higher")) if len(places) else math.inf


def _at_least(
    catalog: Catalog, frame: FrameSize, places: SampleFields, bright_mag: float, epoch_yr: float
) -> NDArray[np.int64]:
    """Stars in each frame, counted no further than matters."""
    bright_mag = min(bright_mag, frame.depth_mag)
    numbers, _ = _in_frames(catalog, frame, places, bright_mag, epoch_yr)
    if bright_mag < frame.depth_mag:
        poor = np.flatnonzero(numbers < SURE_STARS)
        numbers[poor], _ = _in_frames(catalog, frame, places.only(poor), frame.depth_mag, epoch_yr)
    return numbers


def _mean(catalog: Catalog, frame: FrameSize, places: SampleFields, epoch_yr: float) -> float:
    here = np.array([_covers(catalog, frame, at) for at in _centers(places)], dtype=np.bool_)
    if not here.any():
        return math.nan
    return float(np.mean(_in_frames(catalog, frame, places.only(here), frame.depth_mag, epoch_yr)[0]))


def _centers(places: SampleFields) -> list[Icrs]:
    return [Icrs(float(ra), float(dec)) for ra, dec in zip(places.ra_deg, places.dec_deg, strict=True)]


def _covers(catalog: Catalog, frame: FrameSize, center: Icrs) -> bool:
    return not isinstance(catalog, PackedStore) or catalog.covers(center, frame.half_diagonal_deg)
