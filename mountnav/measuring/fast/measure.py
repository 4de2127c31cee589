"""The fast measurement of a frame's brightest sources; precise fits only where asked for."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from mountnav.frames import Frame
from mountnav.measuring.detection import first_of_twins
from mountnav.measuring.fast.candidates import Candidates, locate, saturated_patches, width_px
from mountnav.measuring.fast.coarse import Summed, coarse_peaks
from mountnav.measuring.fast.forced import forced_measurements, quality_of
from mountnav.measuring.fast.moments import (
    Moments,
    Shapes,
    edge_of,
    flags_of,
    nearest_px,
    position_errors,
    typical_of,
    windowed_moments,
)
from mountnav.measuring.fast.psf import SampledPsf, learn_shared_psf
from mountnav.measuring.fast.scene import Scene, survey_frame
from mountnav.measuring.measurements import NO_STAR, TRAILED, Flag, Measurements, SkyQuality
from mountnav.measuring.psf import FWHM_PER_SIGMA, without_pixel_width
from mountnav.measuring.saturation import saturation_level
from mountnav.measuring.settings import MeasuringSettings

Array = NDArray[np.float64]

_DISC_FWHM = 1.25
"""Radius of the discs that are fitted, in FWHM. Doubled, neighbors get into them; halved, the wings don't and
the stated errors of Moffat stars are 10 % too small."""


@dataclass(slots=True)
class FastMeasurement:
    """The brightest sources of a frame, and the means to measure any of its sources precisely.

    Attributes
    ----------
    measurements : Measurements
        Brightest first, rough positions; ``quality`` is None.
    scene : Scene
        The frame, and what was found out about it.
    summed : Summed or None
        The frame in bins, where these are more than a pixel and its pixels are whole numbers of at most 16
        bits.
    """

    measurements: Measurements
    scene: Scene
    settings: MeasuringSettings
    summed: Summed | None = field(default=None, repr=False)
    _learned: tuple[SampledPsf, SkyQuality] | None = field(default=None, repr=False)

    def measured_at(self, x_px: Array, y_px: Array, *, reach_px: float) -> Measurements:
        """Fit the sources found within reach of positions, with the shape that the frame's stars share.

        Parameters
        ----------
        x_px, y_px : ndarray, shape (n,)
            Where sources are expected; positions outside the frame are passed over.
        reach_px : float
            How far from the position a source may be.

        Returns
        -------
        Measurements
            Brightest first, each source once, with ``quality``; possibly none.
        """
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            image, quality = self._learn()
            x, y = np.asarray(x_px, dtype=np.float64), np.asarray(y_px, dtype=np.float64)
            return forced_measurements(
                self.scene, image, quality, x, y, reach_px, self.settings.threshold_sigma
            )

    def _learn(self) -> tuple[SampledPsf, SkyQuality]:
        """The common star and the frame's quality, found out when they are first wanted."""
        if self._learned is None:
            half = int(np.clip(np.ceil(_DISC_FWHM * self.scene.fwhm_px), 4, 12))
            shape, _ = learn_shared_psf(self.scene, self.measurements, half)
            quality = quality_of(self.scene, shape, self.measurements, self.settings, half)
            self._learned = SampledPsf.of(shape, half), quality
        return self._learned


Mask = NDArray[np.bool_]

_CANDIDATES_PER_SOURCE = 3
"""Peaks that are looked at for each source wanted: hot pixels, patches and doubles go. With one, 7 of 224
stars of a crowd are lost; doubled, only time is spent."""
_FEWEST = 5
"""Clear stars below which the frame is left to the full measurement. Doubled or halved, nothing changed on
the frames that were tried."""
_CLEAR_SIGMA = 12.0
"""Height of a clear star over the noise per pixel. Doubled, a tetra3 frame is left to the full measurement;
halved, the width is told by noisier stars and no figure gets better."""
_WIDEST_FWHM_PX = 8.0
"""Wider stars are left to the full measurement, px: bins of 4 px part them. Doubled, a frame of 8 px is
measured; halved, a real frame of 5 px is given up."""
_NARROWEST_FWHM_PX = 1.1
"""Narrower ones too: single pixels can't be distinguished from them. Doubled, frames of 1.5 px and a tetra3
frame are given up; halved, nothing changed on the frames that were tried."""
_MOST_LONE_SHARE = 0.5
"""Share of single pixels among the clear candidates that makes the rest suspect: one minus it, times 0.2,
must be stars. Doubled or halved, nothing changed on the frames that were tried."""
_ROUND_ELLIPTICITY = 0.25
"""Ellipticity up to which a source is round, where the typical one is trailed: streaks among round stars.
Doubled, a frame full of rays is measured; halved, nothing changed."""
_FEWEST_ROUND = 10
"""Round sources that are needed then. Doubled or halved, nothing changed on the frames that were tried."""
_LEAST_ROUND = 0.2
"""And their share of all. Halved, a frame full of rays is measured; doubled, nothing changed."""
_WINDOW_RATIO = 1.25
"""Typical width by moments over that by area beyond which the moments are taken again under a window of their
own width. Without it no figure changed by 3 % but one; always, the error of a painted field grows from 0.176
to 0.185 px."""
_FLOOR_FWHM = 0.01
"""Least error stated of a rough position, in FWHM: asymmetric images move centroids. Doubled, stated errors
of bright painted stars are twice too large; halved, 1.9 times too small for stars of 1.5 px."""
_CAUTIOUS_GAIN = 1.0
"""Largest gain assumed where none is known, electrons per ADU: a smaller one states larger errors. Doubled,
the pull of C00 grows from 0.77 to 0.86."""
_STREAK_ELLIPTICITY = 0.65
"""Ellipticity from which a source is a trail's piece: 1 to 3 axis ratio. Doubled towards 1, half as many are
flagged; at 0.3, 22 of 128 painted stars are."""
_BLEEDING_RATIO = 2.5
"""Extent along the columns over that along the rows from which a patch in a saturated star's column is its
bleed."""
_LOPSIDED_RATIO = 2.0
"""Extent ratio beyond which a saturated star keeps its patch's middle: the moments follow the charge."""
_FULL_HALF_PX = 20
"""Half side of the squares in which saturated stars' centroids are taken, px."""
_FULL_FLOOR_PX = 0.1
"""Least error stated of a saturated star's rough position, px."""
_DEFAULTS = MeasuringSettings()


def measure_fast(
    frame: Frame, *, settings: MeasuringSettings = _DEFAULTS, most: int = 200
) -> FastMeasurement | None:
    """Find a frame's brightest sources at a small part of what `measure` costs.

    The frame is summed in bins of up to 4 × 4 pixels; only round the brightest bins are its own pixels
    looked at. Faint stars, trails and blends are `measure`'s business.

    Parameters
    ----------
    settings : MeasuringSettings, optional
        ``threshold_sigma`` and ``gain_e_adu`` count here as well.
    most : int, optional
        No more star-like sources than so many; what is flagged comes on top, half as many at most.

    Returns
    -------
    FastMeasurement or None
        None for what it takes `measure` to judge: raw mosaics, frames below 64 px, with many missing pixels
        or fewer than five clear stars, and those whose stars are trailed, rings, wider than 8 px or hardly
        wider than a pixel.
    """
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        return _measure_fast(frame, settings, most)


def _measure_fast(frame: Frame, settings: MeasuringSettings, most: int) -> FastMeasurement | None:
    surveyed = survey_frame(frame, settings)
    if surveyed is None:
        return None
    scene, summed = surveyed
    peaks = coarse_peaks(
        summed.plane, scene.sky, scene.bin_px, settings.threshold_sigma, _CANDIDATES_PER_SOURCE * most
    )
    if peaks.flux.size < _FEWEST:
        return None
    found, patches = locate(scene, peaks)
    full = saturation_level(
        frame.pixels, patches.values, scene.sky_adu, scene.noise_adu, frame.saturation_adu
    )
    scene = replace(scene, full_adu=full)
    clear = (found.height > _CLEAR_SIGMA * scene.noise_adu) & (found.top < full)
    stars = clear & ~found.lone
    if np.count_nonzero(stars) < max(_FEWEST, (1.0 - _MOST_LONE_SHARE) * np.count_nonzero(clear) * 0.2):
        return None
    fwhm = width_px(scene, found.x_px[stars], found.y_px[stars])
    if not _NARROWEST_FWHM_PX <= fwhm <= _WIDEST_FWHM_PX:
        return None
    measured = _measured(replace(scene, fwhm_px=fwhm), found, settings, most)
    # sums of 16 bits are exact in single precision, whatever the order
    whole = frame.pixels.dtype.kind in "ui" and frame.pixels.dtype.itemsize <= 2
    if measured is not None and scene.bin_px > 1 and whole:
        measured.summed = summed
    return measured


def _measured(
    scene: Scene, found: Candidates, settings: MeasuringSettings, most: int
) -> FastMeasurement | None:
    """Rough positions and shapes of the candidates, and their flags."""
    moments = _moments(scene, found)
    clean = (found.top < scene.full_adu) & ~found.lone & moments.sound
    clear = found.height / scene.noise_adu
    typical = typical_of(Shapes.of(moments), clean, clear)
    if typical.ellipticity > TRAILED:  # all of them, or a streak's many peaks among round stars
        every = typical.stars
        clean &= Shapes.of(moments).ellipticity < _ROUND_ELLIPTICITY
        typical = typical_of(Shapes.of(moments), clean, clear)
        if typical.stars < max(_FEWEST_ROUND, _LEAST_ROUND * every):
            return None
    if typical.stars < _FEWEST:
        return None
    if not 1.0 / _WINDOW_RATIO < typical.fwhm_px / scene.fwhm_px < _WINDOW_RATIO:
        scene = replace(scene, fwhm_px=typical.fwhm_px)
        moments = _moments(scene, found)
        typical = typical_of(Shapes.of(moments), clean & moments.sound, clear)
    scene = replace(scene, fwhm_px=typical.fwhm_px)
    if not _NARROWEST_FWHM_PX <= scene.fwhm_px <= _WIDEST_FWHM_PX:
        return None
    shapes = Shapes.of(moments)
    full, bleed, hidden = _saturated(scene, found, moments)
    x, y = (
        np.where(moments.sound, moments.x_px, found.x_px),
        np.where(moments.sound, moments.y_px, found.y_px),
    )
    flux = np.where(moments.sound, moments.flux, found.height)
    flux = np.where(full, np.maximum(flux, found.flux), flux)
    noise = scene.noise_at(x, y) * scene.noise_ratio
    gain = scene.gain[0] if scene.gain[1] else min(scene.gain[0], _CAUTIOUS_GAIN)
    floor = np.where(full, _FULL_FLOOR_PX, _FLOOR_FWHM * scene.fwhm_px)
    x_sigma, y_sigma, flux_sigma = position_errors(moments, flux, noise, gain, floor)
    snr = flux / np.maximum(flux_sigma, 1e-12)
    height, width = scene.frame.pixels.shape
    edge = edge_of(x, y, width, height, scene.fwhm_px)
    odd = found.lone | ~moments.sound | scene.sky.restless(*scene.bins(x, y))
    flags = flags_of(shapes, typical, snr, full=full, edge=edge, odd=odd, neighbor_px=nearest_px(x, y))
    flags[bleed] |= Flag.BLEED
    flags[(shapes.ellipticity > _STREAK_ELLIPTICITY) & ~full] |= Flag.TRAIL
    order = np.argsort(-flux, kind="stable")
    order = order[~hidden[order] & (flux[order] > 0.0)]
    order = order[first_of_twins(x[order], y[order], 0.4 * scene.fwhm_px)]
    order = _best(order, flags, most)
    if np.count_nonzero(flags[order] & NO_STAR == 0) < _FEWEST:
        return None
    measurements = Measurements(
        x_px=x[order],
        y_px=y[order],
        x_sigma_px=x_sigma[order],
        y_sigma_px=y_sigma[order],
        flux=flux[order],
        flux_sigma=flux_sigma[order],
        fwhm_px=without_pixel_width(shapes.fwhm_px**2)[order],
        ellipticity=shapes.ellipticity[order],
        flags=flags[order],
        width_px=width,
        height_px=height,
        background_adu=scene.sky_adu,
        noise_adu=scene.noise_adu,
        elongation_deg=shapes.angle_deg[order],
    )
    return FastMeasurement(measurements, scene, settings)


def _moments(scene: Scene, found: Candidates) -> Moments:
    half = int(np.clip(np.ceil(1.5 * scene.fwhm_px) + 1, 4, 16))
    patches = scene.cut(found.x_px, found.y_px, half)
    light = patches.values - patches.ground()[:, None, None]
    sigma = scene.fwhm_px / FWHM_PER_SIGMA
    return windowed_moments(light, patches.left, patches.top, found.x_px, found.y_px, sigma)


def _saturated(scene: Scene, found: Candidates, moments: Moments) -> tuple[Mask, Mask, Mask]:
    """Which sources are saturated, which are bleeding, which lie within another's full patch.

    The positions of the saturated ones are taken again under windows as wide as their patches.
    """
    full = found.top >= scene.full_adu
    bleed, hidden = np.zeros_like(full), np.zeros_like(full)
    patches = saturated_patches(scene, found.x_px, found.y_px, found.top)
    if patches.which.size == 0:
        return full, bleed, hidden
    x, y = patches.x_px, patches.y_px
    reach = patches.radius_px + 0.7 * scene.fwhm_px + 1.0
    seen: list[int] = []
    for i, which in enumerate(patches.which):
        away_x, away_y = np.abs(x[seen] - x[i]), np.abs(y[seen] - y[i])
        if (np.hypot(away_x, away_y) < reach[seen]).any():
            hidden[which] = True
        elif patches.tall[i] > _BLEEDING_RATIO and (away_x < reach[seen]).any():
            bleed[which] = True
        else:
            seen.append(i)
    near = KDTree(np.column_stack([found.x_px, found.y_px]))
    for i in seen:
        for other in near.query_ball_point((x[i], y[i]), reach[i]):
            hidden[other] |= other != patches.which[i]
    some = np.array(seen, dtype=np.intp)
    cut = scene.cut(x[some], y[some], _FULL_HALF_PX)
    light = cut.values - cut.ground()[:, None, None]
    sigma = np.hypot(scene.fwhm_px / FWHM_PER_SIGMA, patches.radius_px[some])
    again = windowed_moments(light, cut.left, cut.top, x[some], y[some], sigma)
    which = patches.which[some]
    moments.put(which, again)
    runs = (patches.tall[some] > _LOPSIDED_RATIO) | (patches.tall[some] < 1.0 / _LOPSIDED_RATIO)
    moments.x_px[which[runs]], moments.y_px[which[runs]] = x[some][runs], y[some][runs]
    return full, bleed, hidden


def _best(order: NDArray[np.intp], flags: NDArray[np.int64], most: int) -> NDArray[np.intp]:
    """The first so many star-like sources, and half as many others at most."""
    star = flags[order] & NO_STAR == 0
    keep = np.where(star, np.cumsum(star) <= most, np.cumsum(~star) <= most // 2)
    return order[keep]
