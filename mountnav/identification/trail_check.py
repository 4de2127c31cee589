"""A solution held against the light of its own stars: moved to the middle of their trails, or refused."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.stars import Stars
from mountnav.identification.double_exposure import (
    FAR_DIAGONALS,
    PER_FRAME,
    SecondField,
    SecondImage,
    bright_pair,
    find_second_field,
    second_image,
    second_sources,
    unexplained_light,
)
from mountnav.identification.drawn_out_exposure import drawn_out_exposure
from mountnav.identification.faint_exposure import FaintExposure, faint_exposure
from mountnav.identification.field_rotation import Centers, FieldMotion, centers_of_light, field_motion
from mountnav.identification.pairing import Predicted, predicted
from mountnav.identification.plate import Plate
from mountnav.identification.reference import Reference, Selection
from mountnav.identification.selection import star_like
from mountnav.identification.settings import IdentificationSettings
from mountnav.identification.verification import KEPT_SHARE, Identified, is_sound, reach_of
from mountnav.measuring.background import Image
from mountnav.measuring.fast.coarse import Summed
from mountnav.measuring.measurements import Flag, Measurements
from mountnav.measuring.medians import median
from mountnav.measuring.segmentation import LightSegments, segment_light
from mountnav.measuring.star_trail import (
    FEW_STARS,
    REACH_PX,
    StarTrail,
    brighter_image,
    in_bins,
    star_trail,
    tamed,
)
from mountnav.sky.coordinates import Icrs
from mountnav.solution import MOVED_KEY, Reason

__all__ = ["StarsInCone", "TrailCheck", "check_trails", "plate_stays"]

Array = NDArray[np.float64]

StarsInCone = Callable[[Icrs, float, float | None], Stars | None]
"""From a center, a radius in degrees and a magnitude to stars, brightest first; None if they can't be had."""

_SPOILT = int(Flag.SATURATED | Flag.BLEED)
SURE_PX = 0.75
"""A center of light with a larger error, pixels, isn't given: three sigma of it must stay within the 3 px
that a position may be off."""
MOVED_PX = 0.75
"""A center of light nearer to the plate's positions than this is that of an uneven star image, not of a path:
the plate stays with the peaks, as catalogs do, and the difference goes into its error."""
MOVED_SHARE_FWHM, MOVED_MOST_PX = 0.1, 1.5
"""The same for wide images: this share of their width, up to half of the 3 px that a position may be off."""
MOVED_SIGMAS = 4.0
"""A center of light that is farther off, but by fewer of its sigmas than this, isn't known to be elsewhere:
the frame is refused."""
COMPLETE_MAG = 0.75
"""Of sources so much brighter than the faintest star that the catalog has in the frame it has nearly all:
Tycho-2 has 99 % to V = 11.0 and 90 % to 11.5. Halved, deep narrow frames would be refused."""
MANY_PAIRS = 60
"""On so many stars and more a second exposure shows by its own stars. Chosen by hand: the two drawn frames
whose second exposure was overlooked had 21 pairs. Doubled, frames with two bright planets or galaxies are
refused on twice as many stars."""
FAINTER_EXPOSURE_MAG = 1.5
"""Stars so much fainter than the frame's brightest may be brighter than it in the other exposure, if that has
four times the light of this one. Doubled, lamps pass for stars more often."""
BRIGHTEST, STRANGE_AMONG_THEM, SUSPICIOUS_CHANCE = 12, 3, 1e-2
"""So many of the brightest patches that no star explains make a frame suspicious; a second image of its stars
is believed then though chance makes one in this share of such frames. Chosen by hand: of the drawn frame that
was overlooked 4 of the brightest dozen were unexplained, and chance 7e-4. Ten times as much would refuse one
suspicious frame in ten."""
FEWEST_UNEXPLAINED, UNEXPLAINED_BRIGHT_SHARE = 2, 0.5
"""So many sources as bright, and so large a share of the stars that are as bright, aren't planets, variable
stars and satellites any more: of two exposures as bright there are as many as stars."""
SURE_MOVED_PX = 1.0
"""A moved plate whose center isn't known better, all errors together, isn't given: three of them make the
3 px that a position may be off. Doubled, one of 1,000 drawn frames was 3.5 px off."""
TELLING_SIGMAS = 3.0
"""The middle of the light, looked for once more about the moved positions, may lie so many of its errors off.
Three sigma: one honest frame in a hundred (two coordinates) lies farther off."""
MOVED_SHARE = 0.02
"""Error of a move, besides that of its center of light: the share of light that is too faint to be seen."""
GHOST_RATIO = 0.7
"""A mirrored set of the same stars that is brighter than this share of the identified ones may be the stars
themselves: reflections keep a few percent, seldom half."""
HALO_PX = 1.0
"""Error of the middle of a drawn-out image, per coordinate, per share of its light that lies beyond what a
point has and is too faint to be in the center of light: 0.98 px rms of the 13 drawn shaken tubes with more
than 2 % of such light (`benchmarks.trailed`: seeds 60000 to 60211, and shaken ones from 41000 and 62000;
0.2 to 2.8 px per share, both coordinates together). Doubled, the errors of shaken frames would be stated
twice too large."""
CORNER_PX = 3.0
"""Centers of light that leave the plate's positions by more than this toward the corners (and more than an
image is wide) are those of a field that turned or grew: as far as a position may be off."""
LEAST_CORNER_PX, CORNER_SHARE = 1.0, 0.1
"""Below this, or below this share of the offset at the center, the offset is common to all stars, and the
mean path has it: pieces of a gapped trail are cut a little otherwise where it is bright."""
FEWEST_BRIGHT = 3
"""Fewer bright stars than this say nothing of the others."""
BESIDE_PX = 1.5
"""Limit of the brightest stars' distance from the common path. Their light lies within half a pixel of it
where they agree with the others, and 3 to 10 px off where the others are pieces: half of what a position may
be off."""
SCATTERED_PX = 1.75
"""Limit of the brightest stars' distances from the path and the motion of the field, each by itself; the
drawn field that turned under a growing cloud, 5.6 px off, had 1.8. Chosen by hand. At 2.25 none of 100 drawn
frames that are right was refused for it, and that one was overlooked."""
FEW_HALO_SHARE = 0.15
"""A plate on fewer stars than `FEW_STARS` isn't given where so large a share of their light lies beyond what
points have: of a drawn double exposure, 20 px off on 7 stars, it was 0.25. Real frames through poor lenses
have up to 0.6 on 40 stars and more, and 0.02 on fewer. Chosen by hand; doubled, that one is overlooked."""
LONG_RATIO = 0.5
"""Images narrower than this are trails longer than two widths, whose pieces may lie a pixel and more off."""
TOLD_PX, TOLD_SIGMAS = 0.03, 3.0
"""Differences below this, or so many of their sigmas, are those of pixels and noise: undisturbed frames
show 0.00 to 0.02 px."""


@dataclass(frozen=True, slots=True)
class TrailCheck:
    """A solution after the check against the light of its stars: kept, moved or refused.

    Attributes
    ----------
    found : Identified
        The same, or with a plate moved to the middle of the light, or refused.
    measurements : Measurements
        Those its pairs point into: moved alike.
    points : bool
        The plate stayed where it was: it is the stars' own.
    """

    found: Identified
    measurements: Measurements
    path: StarTrail | None
    points: bool


def check_trails(
    found: Identified,
    measurements: Measurements,
    pixels: NDArray[np.generic],
    settings: IdentificationSettings,
    *,
    sky: StarsInCone | None = None,
    summed: Summed | None = None,
) -> TrailCheck:
    """Look where the light of the identified stars fell, and put the plate where its middle is.

    Pieces of trails, or one of two exposures, hold a plate as well as stars do: the odds that so many stars
    are found by chance are as small. Only the light that is left over shows it.

    Parameters
    ----------
    found : Identified
        With a reference.
    pixels : ndarray, shape (height, width)
        Those that were measured.
    sky : callable, optional
        Gives the stars of a cone to a magnitude, at the frame's epoch, of the catalog that the frame was
        identified with: where few were identified, those beyond the frame's edges are used as well.
    summed : Summed, optional
        The frame of whole numbers in bins, if it is at hand.
    """
    reference, stars = found.reference, found.stars
    assert reference is not None
    assert stars is not None
    fwhm_px = _fwhm_px(measurements, reference.pairs.measurement)
    bins = in_bins(pixels, summed)
    frame = _Frame(stars, measurements, pixels, bins, tamed(pixels, bins), fwhm_px, sky)
    ratio, how = brighter_image(pixels, *_expected(reference, stars, measurements), frame.plane)
    if ratio > GHOST_RATIO:
        return TrailCheck(_as_ghosts(found, ratio, how), measurements, None, points=False)
    path = frame.trail(reference)
    if path is None:
        return TrailCheck(found, measurements, None, points=True)
    patches = segment_light(pixels, bins[0])
    field = _field(patches, reference, stars, measurements, drawn_out=path.drawn_out)
    refused = _contradicted(found, reference, path, field, patches, frame)
    if refused is not None:
        return TrailCheck(refused, measurements, path, points=False)
    if plate_stays(path, fwhm_px):
        return TrailCheck(_kept(found, reference, path, field), measurements, path, points=True)
    return _moved_to_light(found, reference, path, field, frame, settings)


@dataclass(frozen=True, slots=True)
class _Frame:
    """The frame whose light is looked at, and what stays the same wherever a plate lies.

    Attributes
    ----------
    stars : Stars
        The list that pairs point into.
    measurements : Measurements
        As they were found, before any move.
    pixels : ndarray, shape (height, width)
        The frame, ADU.
    bins : (Image, Image)
        The pixels in bins (`star_trail.in_bins`).
    plane : (Image, Image)
        The same, cut so that no bright star counts for much (`star_trail.tamed`).
    fwhm_px : float
        Median over the identified sources.
    sky : callable or None
        Gives the stars of a cone.
    """

    stars: Stars
    measurements: Measurements
    pixels: NDArray[np.generic]
    bins: tuple[Image, Image]
    plane: tuple[Image, Image]
    fwhm_px: float
    sky: StarsInCone | None

    def trail(self, reference: Reference, measurements: Measurements | None = None) -> StarTrail | None:
        """Where the light of the pairs' stars fell, by their mean image about the plate's positions."""
        m = self.measurements if measurements is None else measurements
        of_pairs = reference.pairs.measurement
        x, y = _star_pixels(reference, self.stars)
        clear = (m.flags[of_pairs] & _SPOILT) == 0
        if x.size < FEW_STARS and self.sky is not None:
            others = _round_about(reference, self.stars, m, self.sky)
        else:
            others = _expected(reference, self.stars, m)
        return star_trail(
            self.pixels, x, y, m.flux[of_pairs], clear, self.fwhm_px, others=others, plane=self.plane
        )


def _contradicted(
    found: Identified,
    reference: Reference,
    path: StarTrail,
    field: _Field,
    patches: LightSegments,
    frame: _Frame,
) -> Identified | None:
    """The refusal, if the light shows that the plate isn't that of the exposure's middle; else None."""
    why = field.contradicts(path, frame.fwhm_px)
    if why:
        return _as_turned(found, field, why)
    why = _bright_unexplained(patches, reference, frame.stars, frame.measurements, frame.sky)
    if why:
        return _as_unexplained(found, why)
    faint = _faint_exposure(patches, reference, path, frame)
    if faint is not None:
        return _as_faint_exposure(found, faint)
    other = _second_field(patches, reference, frame.stars, frame.measurements, frame.sky)
    if other is not None and not _in_path(path, other, field.half_px):
        return _as_two_fields(found, other)
    if path.halo_share > FEW_HALO_SHARE and len(reference.pairs) < FEW_STARS:
        why = (
            f"{100.0 * path.halo_share:.0f} % of it lies beyond what points have: part of an exposure may be "
            f"elsewhere"
        )
        return _refused(found, path, why)
    if not _center_known(path) or _moved_px(frame.fwhm_px) < path.off_px <= MOVED_SIGMAS * path.sigma_px:
        return _refused(found, path)
    # on many stars what else there is of an exposure is seen, and nebulae about bright ones pull as much
    unsure_px = max(math.sqrt(2.0) * SURE_PX, _moved_px(frame.fwhm_px))
    if path.pull_px > unsure_px and len(reference.pairs) < MANY_PAIRS:
        pull = f"pulls the middle by {path.pull_px:.1f} px"
        return _refused(found, path, f"what is too faint to be followed lies to one side and {pull}")
    return None


def _kept(found: Identified, reference: Reference, path: StarTrail, field: _Field) -> Identified:
    """The solution where it was; its error holds what the light lies beside it."""
    scale = reference.plate.scale_arcsec_px()
    own_px2 = 0.5 * float(np.trace(reference.center_covariance_arcsec2)) / scale**2
    # the plate's own error is a part of how far the light lies beside it: counted once
    variance_px2 = max(0.0, _unfollowed_px2(path) - own_px2)
    variance_px2 += field.variance_px2(0j, drawn_out=path.drawn_out)
    if variance_px2 > 0.0:
        reference = _with_error(reference, variance_px2 * scale**2)
    return replace(found, reference=reference)


def _moved_to_light(
    found: Identified,
    reference: Reference,
    path: StarTrail,
    field: _Field,
    frame: _Frame,
    settings: IdentificationSettings,
) -> TrailCheck:
    """The solution moved to the middle of its stars' light, or refused where that isn't the middle."""
    # pieces of a path that is seen whole lie otherwise than its middle, and are in it
    elsewhere_px2 = field.variance_px2(complex(path.dx_px, path.dy_px), drawn_out=False)
    moved = _moved(reference, frame.stars, frame.measurements, path, elsewhere_px2, settings)
    why = "" if moved is None else _not_its_middle(moved, path, frame)
    if moved is None or why:
        return TrailCheck(_refused(found, path, why), frame.measurements, path, points=False)
    numbers = found.numbers | {
        MOVED_KEY: path.off_px,
        "path_extent_px": path.extent_px,
        "path_sigma_px": path.sigma_px,
    }
    detail = f"{found.detail}, moved by {path.off_px:.1f} px to the middle of the stars' light"
    found = replace(found, reference=moved[0], detail=detail, numbers=numbers)
    return TrailCheck(found, moved[1], path, points=False)


def _unfollowed_px2(path: StarTrail) -> float:
    """Error (squared, per coordinate) of a plate that stays while the center of light lies beside it.

    All sources of a frame are drawn out alike, so this error is common to them: it doesn't show in the
    plate's residuals, and no number of pairs makes it less.
    """
    off2 = 0.5 * path.off_px**2
    if path.uneven:
        # the distance holds the center's own error; what is too faint to be in the center pulls it as well
        return max(off2, path.sigma_px**2) + (HALO_PX * path.halo_share) ** 2
    # round images are those of points: what differs by no more than noise does is none
    return off2 if path.off_px > max(TOLD_PX, TOLD_SIGMAS * path.sigma_px) else 0.0


@dataclass(frozen=True, slots=True)
class _Field:
    """What the patches of light of the whole field show, where `StarTrail` is a mean over the stars.

    Attributes
    ----------
    half_px : float
        From the frame's center to its corners.
    """

    centers: Centers
    motion: FieldMotion | None
    second: SecondImage | None
    half_px: float

    @property
    def corner_px(self) -> float:
        """How far the centers of light leave the plate's positions from the center to a corner."""
        return 0.0 if self.motion is None else abs(self.motion.turn) * self.half_px

    def variance_px2(self, common: complex, *, drawn_out: bool) -> float:
        """Error of the center (squared, per coordinate) where the light lies otherwise here than there.

        A path is the mean over its stars, wherever they are; the plate is held or moved by it all the same.
        """
        if self.motion is None:
            return 0.0
        return 0.5 * self.motion.beside_px(common, drawn_out=drawn_out) ** 2

    def contradicts(self, path: StarTrail, fwhm_px: float) -> str:
        """Why the plate isn't that of the exposure's middle; empty if it may be."""
        second, motion = self.second, self.motion
        if second is not None:
            # of one that is turned the mean over the stars shows nothing, however near it is
            turned = abs(second.turn) * self.half_px > CORNER_PX
            # one that lies at the same offset everywhere is in the path, unless few stars have theirs in the
            # frame and it is drawn out: then each of them is seen where their mean isn't
            there = path.holds(second.center_px.real, second.center_px.imag)
            if turned or (not there and second.pull_px > _moved_px(fwhm_px)):
                how = "turned or at another scale, " if turned else ""
                what = "two exposures in one of a field that turned?" if turned else "two exposures in one?"
                return (
                    f"{second.stars} of the identified stars are seen a second time, {how}"
                    f"{abs(second.center_px):.0f} px away at the frame's center ({what})"
                )
        common = 0j if plate_stays(path, fwhm_px) else complex(path.dx_px, path.dy_px)
        if motion is not None and motion.differs:
            off_px = abs(motion.center_px - common)
            significant = self.corner_px > max(LEAST_CORNER_PX, CORNER_SHARE * abs(motion.center_px))
            if self.corner_px > max(CORNER_PX, fwhm_px) or (significant and off_px > _moved_px(fwhm_px)):
                return (
                    f"the light of {motion.stars} stars lies {off_px:.1f} px beside their places at the "
                    f"frame's center and {self.corner_px:.1f} px more toward its corners: the field turned, "
                    f"or its scale changed, during the exposure"
                )
        if not path.drawn_out:
            return ""
        stars, beside_px, scattered_px = self.centers.beside(common, motion)
        if stars >= FEWEST_BRIGHT and scattered_px > SCATTERED_PX:
            return (
                f"the light of the {stars} brightest stars lies {scattered_px:.1f} px beside their places, "
                f"each in its own direction: the faint ones show only a part of the way that the field turned"
            )
        if stars >= FEWEST_BRIGHT and beside_px > BESIDE_PX:
            return (
                f"the light of the {stars} brightest stars lies {beside_px:.1f} px beside their places: the "
                f"others are pieces of trails, and the trails aren't alike all over the frame"
            )
        if path.far:
            return ""
        if math.sqrt(self.variance_px2(common, drawn_out=not common)) > SURE_PX:
            assert motion is not None
            return (
                f"the light of {motion.stars} stars lies {abs(motion.center_px - common):.1f} px beside "
                f"their places, and otherwise for each of them: the exposure's middle isn't known well enough"
            )
        if motion is not None and motion.center_sigma_px > SURE_PX:
            return (
                f"the images of the stars are drawn out, each in its own way, and the middle of their light "
                f"is only known to {motion.center_sigma_px:.1f} px"
            )
        if stars < FEWEST_BRIGHT and path.axis_ratio < LONG_RATIO:
            return (
                f"the images of the stars are drawn out, and only {stars} of them show by themselves where "
                f"the middle of a trail is"
            )
        return ""


def _field(
    patches: LightSegments, reference: Reference, stars: Stars, measurements: Measurements, *, drawn_out: bool
) -> _Field:
    """Offsets, motion and second image by the patches of light all over the frame, identified or not."""
    width, height = measurements.width_px, measurements.height_px
    center = complex(0.5 * (width - 1), 0.5 * (height - 1))
    there, _, light = _in_frame(reference.plate, stars, measurements)
    centers = centers_of_light(patches, there.x_px, there.y_px, light, center)
    # arcs are whole where their pieces are joined; a point beside its star is a second one where they aren't
    second = None
    for seen in (patches, patches.parts):
        if second is None and seen is not None:
            second = second_image(
                seen, there.x_px, there.y_px, light, center, (height, width), drawn_out=drawn_out
            )
    for seen in (patches, patches.parts):
        if second is None and seen is not None and len(reference.pairs) < MANY_PAIRS:
            second = _suspected(seen, there, light, center, (height, width))
    if second is None and drawn_out:
        second = second_sources(
            measurements.x_px,
            measurements.y_px,
            measurements.flux,
            np.unique(reference.pairs.measurement),
            center,
            (height, width),
        )
    return _Field(centers, field_motion(centers), second, abs(center))


def _suspected(
    patches: LightSegments, there: Predicted, light: Array, center: complex, shape: tuple[int, int]
) -> SecondImage | None:
    """A second image that would pass for chance, were not so many of the brightest patches unexplained."""
    left = unexplained_light(patches, there.x_px, there.y_px, light)
    if left is None:
        return None
    brightest = np.argsort(-np.concatenate((patches.flux[left.known], left.flux)), kind="stable")[:BRIGHTEST]
    if (brightest >= left.known.size).sum() < STRANGE_AMONG_THEM:
        return None
    return second_image(
        patches, there.x_px, there.y_px, light, center, shape, chance=SUSPICIOUS_CHANCE, alike=True
    )


def _in_frame(plate: Plate, stars: Stars, measurements: Measurements) -> tuple[Predicted, Array, Array]:
    """Stars that the plate puts in the frame, their magnitudes, and their light to a common scale."""
    there = predicted(plate, stars, width_px=measurements.width_px, height_px=measurements.height_px)
    mag = stars.mag[there.star]
    return there, mag, 10.0 ** (-0.4 * np.where(np.isfinite(mag), mag, np.inf))


def _second_field(
    patches: LightSegments,
    reference: Reference,
    stars: Stars,
    measurements: Measurements,
    sky: StarsInCone | None,
) -> SecondField | None:
    """Another field whose stars the light shows that isn't the identified stars'."""
    plate, shape = reference.plate, (measurements.height_px, measurements.width_px)
    there, mag, light = _in_frame(plate, stars, measurements)
    mag = np.sort(mag[np.isfinite(mag)])
    if mag.size == 0:
        return None
    around: Stars | None = None
    for seen in (patches, patches.parts):
        left = None if seen is None else unexplained_light(seen, there.x_px, there.y_px, light)
        if left is None or not left.many:
            continue
        if around is None:
            around = _stars_about(plate, stars, shape, float(mag[:PER_FRAME][-1]), sky)
        found = find_second_field(left, plate, around.ra_deg, around.dec_deg, shape)
        if found is not None:
            return found
    return None


def _bright_unexplained(
    patches: LightSegments,
    reference: Reference,
    stars: Stars,
    measurements: Measurements,
    sky: StarsInCone | None,
) -> str:
    """Why the bright light that is no star's forbids a plate on few stars; empty where it doesn't.

    Two exposures in one have as many bright sources that a plate doesn't explain as it explains. Where few
    stars were identified neither their mean image nor another field of the sky shows that: no star's second
    image but two or three lie in the frame.
    """
    if len(reference.pairs) >= MANY_PAIRS:
        return ""
    there, mag, light = _in_frame(reference.plate, stars, measurements)
    left = unexplained_light(patches, there.x_px, there.y_px, light)
    if left is None:
        return ""
    known = np.sort(patches.flux[left.known])[::-1]
    above = int((left.flux > known[0]).sum())
    if above >= FEWEST_UNEXPLAINED:
        faintest_mag = float(mag.min(initial=np.inf, where=np.isfinite(mag))) + FAINTER_EXPOSURE_MAG
        shape = (measurements.height_px, measurements.width_px)
        around = _stars_about(reference.plate, stars, shape, faintest_mag, sky)
        if bright_pair(left, above, reference.plate, around, shape):
            return (
                f"{above} sources brighter than each of the {known.size} brightest identified stars are none "
                f"that the catalog has here, and lie as stars of another place do (two exposures in one?)"
            )
    if len(reference.pairs) >= FEW_STARS:
        return ""
    bright = median(known)
    # as faint as the catalog's faintest stars here sources of light need not be in it
    faintest = float(np.nanmax(mag, initial=-np.inf))
    middle = float(np.nanmedian(stars.mag[reference.pairs.star])) if len(reference.pairs) else np.inf
    if not np.isfinite(middle) or middle > faintest - COMPLETE_MAG:
        return ""
    strange, own = int((left.flux > bright).sum()), int((known >= bright).sum())
    if strange < max(FEWEST_UNEXPLAINED, UNEXPLAINED_BRIGHT_SHARE * own):
        return ""
    return (
        f"{strange} sources brighter than the middle of the {known.size} identified stars are none that the "
        f"catalog has (two exposures in one?)"
    )


def _faint_exposure(
    patches: LightSegments, reference: Reference, path: StarTrail, frame: _Frame
) -> FaintExposure | None:
    """A second exposure whose images are too faint, one by one, outside of the path; None of many stars.

    On many stars the mean image shows it (`StarTrail`).
    """
    if len(reference.pairs) >= MANY_PAIRS:
        return None
    there, _, light = _in_frame(reference.plate, frame.stars, frame.measurements)
    x, y, least_px = there.x_px, there.y_px, _moved_px(frame.fwhm_px)
    left = unexplained_light(patches, x, y, light)
    if left is None:
        return None
    found = faint_exposure(frame.bins, patches, x, y, left, least_pull_px=least_px)
    if found is not None and not path.holds(found.offset_px.real, found.offset_px.imag):
        return found
    found = drawn_out_exposure(frame.bins, patches, x, y, light, frame.fwhm_px, least_pull_px=least_px)
    if found is not None and not path.holds(found.offset_px.real, found.offset_px.imag):
        return found
    return None


def _as_faint_exposure(found: Identified, faint: FaintExposure) -> Identified:
    detail = (
        f"{abs(faint.offset_px):.0f} px from {faint.stars} of the identified stars lies {faint.share:.2f} of "
        f"their light once more (two exposures in one?): the exposure's middle is {faint.pull_px:.0f} px away"
    )
    numbers = found.numbers | {"second_image_ratio": faint.share, "second_sky_px": abs(faint.offset_px)}
    return replace(found, reference=None, reason=Reason.TRAILED, detail=detail, numbers=numbers)


def _as_unexplained(found: Identified, why: str) -> Identified:
    return replace(found, reference=None, reason=Reason.TRAILED, detail=why)


def _stars_about(
    plate: Plate, stars: Stars, shape: tuple[int, int], faintest_mag: float, sky: StarsInCone | None
) -> Stars:
    """The bright stars as far about the frame as another field may lie; else those already read."""
    radius_deg = FAR_DIAGONALS * math.hypot(*shape) * plate.scale_arcsec_px() / 3600.0
    more = None if sky is None else sky(plate.center(), radius_deg, faintest_mag)
    around = stars if more is None else more
    return around.only(around.mag <= faintest_mag)


def _in_path(path: StarTrail, other: SecondField, half_px: float) -> bool:
    """Whether another field is so near, and turned so little, that the mean path has its light."""
    near = path.holds(other.offset_px.real, other.offset_px.imag)
    return near and abs(other.turn_rad) * half_px <= CORNER_PX


def _as_two_fields(found: Identified, other: SecondField) -> Identified:
    away_px = abs(other.offset_px)
    detail = (
        f"{other.stars} sources that the identified stars don't explain are stars of another place, "
        f"{away_px:.0f} px from the frame's center (two exposures in one?)"
    )
    numbers = found.numbers | {"second_sky_px": away_px}
    return replace(found, reference=None, reason=Reason.TRAILED, detail=detail, numbers=numbers)


def _as_turned(found: Identified, field: _Field, why: str) -> Identified:
    numbers = found.numbers | {"corner_px": field.corner_px}
    if field.motion is not None:
        numbers["light_off_px"] = abs(field.motion.center_px)
        numbers["path_sigma_px"] = field.motion.center_sigma_px
    return replace(found, reference=None, reason=Reason.TRAILED, detail=why, numbers=numbers)


def _center_known(path: StarTrail) -> bool:
    """Whether the center of light is known well enough to be given as a position."""
    return not path.cut and path.sigma_px <= SURE_PX


def plate_stays(path: StarTrail, fwhm_px: float = 0.0) -> bool:
    """Whether the light lies where the plate has the stars, or evenly about them as spikes and halos do."""
    return _center_known(path) and path.off_px <= _moved_px(fwhm_px)


def _moved_px(fwhm_px: float) -> float:
    """Distance from which on the plate is moved: wide images are uneven by a tenth of their width."""
    return float(np.clip(MOVED_SHARE_FWHM * fwhm_px, MOVED_PX, MOVED_MOST_PX))


def _star_pixels(reference: Reference, stars: Stars) -> tuple[Array, Array]:
    """Where the plate has the stars of its pairs, pixels."""
    plate, chosen = reference.plate, reference.pairs.star
    return plate.pixels(*plate.project(stars.ra_deg[chosen], stars.dec_deg[chosen]))


def _round_about(
    reference: Reference, stars: Stars, measurements: Measurements, sky: StarsInCone
) -> tuple[Array, Array]:
    """The same with those beyond the frame's edges, whose light elsewhere may fall within."""
    plate = reference.plate
    diagonal_px = math.hypot(measurements.width_px, measurements.height_px)
    radius_deg = (0.5 * diagonal_px + REACH_PX) * plate.scale_arcsec_px() / 3600.0
    faintest = float(np.nanmax(stars.mag[reference.pairs.star], initial=-np.inf))
    around = sky(plate.center(), radius_deg, faintest if np.isfinite(faintest) else None)
    return _expected(reference, stars, measurements, around, REACH_PX)


def _expected(
    reference: Reference,
    stars: Stars,
    measurements: Measurements,
    around: Stars | None = None,
    margin_px: float = 0.0,
) -> tuple[Array, Array]:
    """Where the plate has all stars as bright as the identified ones, brightest first."""
    there = predicted(
        reference.plate,
        stars if around is None else around,
        width_px=measurements.width_px,
        height_px=measurements.height_px,
        margin_px=margin_px,
    )
    if around is not None:
        return there.x_px, there.y_px
    faintest = float(np.nanmax(stars.mag[reference.pairs.star], initial=-np.inf))
    some = ~(stars.mag[there.star] > faintest) if np.isfinite(faintest) else np.ones(len(there), dtype=bool)
    return there.x_px[some], there.y_px[some]


def _as_ghosts(found: Identified, ratio: float, how: str) -> Identified:
    detail = (
        f"a second image of the same stars, {how}, is {ratio:.1f} times as bright as what was identified: "
        f"that may be a reflection in the optics"
    )
    numbers = found.numbers | {"second_image_ratio": ratio}
    return replace(found, reference=None, reason=Reason.TRAILED, detail=detail, numbers=numbers)


def _fwhm_px(measurements: Measurements, chosen: NDArray[np.int64]) -> float:
    fwhm = measurements.fwhm_px[chosen]
    fwhm = fwhm[np.isfinite(fwhm)]
    return median(fwhm) if fwhm.size else 3.0


def _with_error(reference: Reference, variance_arcsec2: float) -> Reference:
    covariance = reference.center_covariance_arcsec2 + variance_arcsec2 * np.eye(2)
    return replace(reference, center_covariance_arcsec2=covariance)


def _moved(
    reference: Reference,
    stars: Stars,
    measurements: Measurements,
    path: StarTrail,
    elsewhere_px2: float,
    settings: IdentificationSettings,
) -> tuple[Reference, Measurements] | None:
    """The plate fitted again, each source moved to the middle of its star's light, with the move's error.

    `elsewhere_px2` is the error (squared, per coordinate) of a move that isn't the same all over the field.
    """
    there = replace(measurements, x_px=measurements.x_px + path.dx_px, y_px=measurements.y_px + path.dy_px)
    plate = _shifted(reference.plate, path.dx_px, path.dy_px)
    selection = Selection(there, star_like(there), stars, settings)
    reach_px = reach_of(reference)
    again = selection.refine(plate, reach_px)
    if again is None or len(again.pairs) < KEPT_SHARE * len(reference.pairs):
        selection = Selection(there, np.unique(reference.pairs.measurement), stars, settings)
        again = selection.refine(plate, reach_px)
    if again is None or not is_sound(again, selection, there, plate, settings, reach_px):
        return None
    scale = again.plate.scale_arcsec_px()
    sigma_px = math.hypot(path.sigma_px, MOVED_SHARE * path.off_px)
    return _with_error(again, (sigma_px**2 + elsewhere_px2) * scale**2), there


def _not_its_middle(moved: tuple[Reference, Measurements], path: StarTrail, frame: _Frame) -> str:
    """Why a moved plate isn't the middle of the path; empty where the light lies evenly about its positions.

    A path of which one piece was not seen from where it was first looked at is looked at from elsewhere now:
    what then has its middle elsewhere is not that path's.
    """
    reference, measurements = moved
    scale = reference.plate.scale_arcsec_px()
    sigma_px = math.sqrt(0.5 * float(np.trace(reference.center_covariance_arcsec2))) / scale
    if sigma_px > SURE_MOVED_PX:
        return f"its middle is only known to {sigma_px:.1f} px"
    again = frame.trail(reference, measurements)
    if again is None or again.cut:
        return "seen from its middle it reaches farther than can be seen"
    sigma_px = min(SURE_PX, max(path.sigma_px, again.sigma_px))
    if again.off_px <= _moved_px(frame.fwhm_px) + TELLING_SIGMAS * sigma_px:
        return ""
    return f"seen from its middle it has another one, {again.off_px:.0f} px away"


def _shifted(plate: Plate, dx_px: float, dy_px: float) -> Plate:
    """The plate that has every star so much farther along, to first order about the center."""
    dxi, deta = plate.matrix() @ np.array([dx_px, dy_px])
    xi, eta = plate.xi.copy(), plate.eta.copy()
    xi[0] -= dxi
    eta[0] -= deta
    return replace(plate, xi=xi, eta=eta)


def _refused(found: Identified, path: StarTrail, why: str = "") -> Identified:
    how_far = "more than can be seen" if path.cut else f"{path.extent_px:.0f} px from where they were found"
    detail = (
        f"the light of {path.stars} identified stars reaches {how_far} (a trail, a shaken tube, two "
        f"exposures in one), and {why or f'its middle is only known to {path.sigma_px:.1f} px'}"
    )
    numbers = found.numbers | {
        "path_extent_px": path.extent_px,
        "path_sigma_px": float(min(path.sigma_px, 1e6)),
    }
    return replace(found, reference=None, reason=Reason.TRAILED, detail=detail, numbers=numbers)
