"""A solver that is told the truth and makes of it what a real one makes of a frame: numbers and refusals.

It takes frames without pixels (`truth_frame`) and answers as `mountnav.solving.solve.solve` does, in a
moment, so that a night costs seconds. What is left to chance hangs on the script's seed and the frame's
number alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime

import numpy as np

from mountnav.clock import Clock
from mountnav.frames import Frame, Hint
from mountnav.measuring.measurements import SkyQuality, StarImages
from mountnav.simulation.seeded_random import uniform
from mountnav.simulation.sky_script import SkyScript
from mountnav.simulation.truth_frame import FrameTruth, truth_of
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import displaced, separation_arcsec, turn_deg
from mountnav.solution import IdentifiedPairs, Reason, Solution, Times, Verdict
from mountnav.solving.contradictions import contradictions_with
from mountnav.solving.settings import SolveSettings

# Trails, pixels, from which on images count as trailed, and from which on nothing is found. Chosen by hand.
_TRAILED_PX, _LOST_IN_TRAILS_PX = 6.0, 60.0
_WIDTH_PX, _ELLIPTICITY = 1.19, 0.1
"""Of a star that isn't trailed: one sigma of its width, and what optics and seeing make of it."""
# Matched stars of the usual exposure at an ordinary place. Chosen by hand.
_USUAL_PAIRS = 45.0
# Seconds that a blind search takes longer. Chosen by hand.
_BLIND_S = 6.0


@dataclass(frozen=True, slots=True)
class SeenThrough:
    """The camera as the solver finds it.

    Attributes
    ----------
    scale_arcsec_px : float
        The true one, whatever the settings say.
    sigma_px : float
        One-sigma error per coordinate of a solved center, in pixels.
    usual_exposure_s : float
        Below it stars get few.
    distortion_px2 : float
        What appears at r pixels from the middle belongs at r · (1 - distortion_px2 · r²); the solver finds
        that.
    """

    width_px: int = 3000
    height_px: int = 2000
    scale_arcsec_px: float = 2.0
    parity: int = 1
    sigma_px: float = 0.1
    usual_exposure_s: float = 5.0
    distortion_px2: float = 0.0


class SkySeen:
    """A `mountnav.navigation.equipment.Solve` for frames that carry their truth.

    Parameters
    ----------
    script : SkyScript
        Clouds, poor fields, wrong solutions.
    clock : Clock
        In whose time a solve takes its time.
    began_utc : datetime, optional
        When the script began; now if None.
    whole_sky : bool
        Whether there is an index to search the whole sky by.

    Attributes
    ----------
    false_frames : set of int
        Numbers of the frames that were answered wrongly so far.
    reasons : list of Reason or None
        Of each answer; None: solved.
    solved_dec_deg : list of float
        True declinations of the frames that were solved rightly.
    """

    def __init__(
        self,
        script: SkyScript,
        clock: Clock,
        through: SeenThrough | None = None,
        *,
        began_utc: datetime | None = None,
        whole_sky: bool = True,
    ) -> None:
        self.script = script
        self.through = through or SeenThrough()
        self.false_frames: set[int] = set()
        self.reasons: list[Reason | None] = []
        self.solved_dec_deg: list[float] = []
        self._clock = clock
        self._began_utc = began_utc or clock.utc()
        self._whole_sky = whole_sky

    async def __call__(self, frame: Frame, hint: Hint, settings: SolveSettings) -> Verdict:
        """Answer with a verdict, after the time that it takes."""
        verdict = self.verdict(frame, hint, settings)
        await self._clock.sleep(verdict.times.total_s)
        self.reasons.append(verdict.reason)
        truth = truth_of(frame)
        if verdict.solution is not None and truth.number not in self.false_frames:
            self.solved_dec_deg.append(truth.center.dec_deg)
        return verdict

    def verdict(self, frame: Frame, hint: Hint, settings: SolveSettings) -> Verdict:
        """What is made of a frame, at once.

        Raises
        ------
        BadFrame
            When it carries no truth.
        """
        truth = truth_of(frame)
        chance = np.random.default_rng([self.script.seed % 2**32, truth.number])
        spent_s = self.script.solve_s * float(chance.uniform(0.7, 1.6))
        if chance.random() < self.script.slow_share:
            return _unsolved(Reason.TIMED_OUT, "out of time", 80, settings.budget_s)
        thin = 1.0
        cloud = self.script.cloud_at(self._minutes(frame))
        if cloud is not None:
            thin = 0.4 if cloud.thin else 0.0
            if not cloud.thin or chance.random() < 0.3:
                return _unsolved(
                    Reason.CLOUD_OR_DEFOCUS, "3 stars measured, the catalog promises 210", 3, spent_s
                )
        stars = self._stars(truth, frame.exposure_s or 1.0) * thin
        trail_px = truth.trail_arcsec / self.through.scale_arcsec_px
        if stars < 8.0 or trail_px > _LOST_IN_TRAILS_PX:
            what = "the stars are trailed" if trail_px > _LOST_IN_TRAILS_PX else "too few stars"
            images = StarImages.TRAILED if trail_px > _LOST_IN_TRAILS_PX else StarImages.WELL_SAMPLED
            return _unsolved(Reason.TOO_FEW_MEASUREMENTS, what, int(stars), spent_s, images)
        far_deg = 0.0
        if hint.center is not None:
            far_deg = separation_arcsec(hint.center, truth.center) / 3600.0
        blind = hint.center is None or far_deg > hint.radius_deg
        if settings.blind == "only":
            blind = True
        if chance.random() < self.script.false_share:
            self.false_frames.add(truth.number)
            return self._false(truth, hint, chance, spent_s)
        if blind and (settings.blind == "never" or not self._whole_sky):
            return _unsolved(Reason.NO_MATCH, f"nothing within {hint.radius_deg:g}°", int(stars), spent_s)
        return self._solved(truth, hint, chance, spent_s + _BLIND_S * blind, stars, trail_px, blind)

    def poor_at(self, place: Icrs) -> bool:
        """Whether a place is too poor in stars for the usual exposure; for the judge."""
        return self._richness(place) < 1.0

    # -- inside ----------------------------------------------------------------------------------

    def _minutes(self, frame: Frame) -> float:
        utc = frame.mid_exposure_utc or self._clock.utc()
        return (utc - self._began_utc).total_seconds() / 60.0

    def _stars(self, truth: FrameTruth, exposure_s: float) -> float:
        """Stars measured: by the exposure, and by how rich the place is."""
        longer = exposure_s / self.through.usual_exposure_s
        return 2.0 * _USUAL_PAIRS * self._richness(truth.center) * longer

    def _richness(self, place: Icrs) -> float:
        """Stars of a place over the usual, always the same there."""
        row = math.floor(place.dec_deg)
        cell = row * 1000 + math.floor(place.ra_deg * math.cos(math.radians(row + 0.5)))
        bits = np.array([cell % 2**63], dtype=np.uint64)
        share = float(uniform(bits, self.script.seed)[0])
        if share >= self.script.poor_share:
            return 1.0
        return 0.02 if share < self.script.poor_share / 3.0 else 0.06

    def _solved(
        self,
        truth: FrameTruth,
        hint: Hint,
        chance: np.random.Generator,
        spent_s: float,
        stars: float,
        trail_px: float,
        blind: bool,
    ) -> Verdict:
        through = self.through
        satellite = bool(self.script.satellite_every) and truth.number % self.script.satellite_every == 0
        pairs = max(6, int(min(0.5 * stars, 4.0 * _USUAL_PAIRS) * chance.uniform(0.85, 1.15)))
        sigma = through.sigma_px * through.scale_arcsec_px * math.sqrt(_USUAL_PAIRS / pairs)
        if trail_px > _TRAILED_PX:
            sigma += 0.1 * truth.trail_arcsec
        east, north = chance.normal(0.0, sigma, 2)
        solution = self._solution(
            displaced(truth.center, float(east), float(north)),
            sigma,
            through.scale_arcsec_px * float(1.0 + chance.normal(0.0, 2e-5)),
            truth.rotation_deg + float(chance.normal(0.0, 0.01)),
            through.parity,
            pairs,
            chance,
            10.0 ** -min(60.0, 1.5 * pairs),
            "blind/linear" if blind else "full/linear",
            rejected=4 if satellite else 1,
        )
        notes = ("a satellite's trail crosses the frame",) if satellite else ()
        images = StarImages.TRAILED if trail_px > _TRAILED_PX else StarImages.WELL_SAMPLED
        return Verdict(
            solution,
            None,
            "",
            int(stars),
            Times(0.05, 0.5 * spent_s, 0.5 * spent_s, spent_s),
            {"blind": 1.0} if blind else {},
            contradictions_with(hint, solution.center, solution.scale_arcsec_px),
            _quality(int(stars), images, trail_px, _in_image_deg(truth, through.parity)),
            notes,
        )

    def _false(self, truth: FrameTruth, hint: Hint, chance: np.random.Generator, spent_s: float) -> Verdict:
        """A wrong place that looks as good: any rotation, any scale that the hint allows, few pairs."""
        anywhere = chance.random() < 1.0 / 3.0
        if anywhere:
            z, turn = chance.uniform(-1.0, 1.0), chance.uniform(0.0, 360.0)
            center = Icrs(turn_deg(float(turn)), math.degrees(math.asin(float(z))))
        else:
            near = hint.center or truth.center
            reach_arcsec = min(hint.radius_deg, 3.0) * 3600.0
            way, angle = chance.uniform(0.05, 1.0) * reach_arcsec, chance.uniform(0.0, math.tau)
            center = displaced(near, float(way * math.sin(angle)), float(way * math.cos(angle)))
        low = hint.scale_low_arcsec_px or 0.8 * self.through.scale_arcsec_px
        high = hint.scale_high_arcsec_px or 1.2 * self.through.scale_arcsec_px
        solution = self._solution(
            center,
            self.through.sigma_px * self.through.scale_arcsec_px * 2.0,
            float(chance.uniform(low, high)),
            float(chance.uniform(0.0, 360.0)),
            int(chance.choice([-1, 1])),
            int(chance.integers(6, 12)),
            chance,
            10.0 ** -float(chance.uniform(9.0, 12.0)),
            "blind/linear" if anywhere else "full/linear",
            rejected=3,
        )
        return Verdict(
            solution,
            None,
            "",
            40,
            Times(0.05, 0.5 * spent_s, 0.5 * spent_s, spent_s),
            contradictions=contradictions_with(hint, center, solution.scale_arcsec_px),
            quality=_quality(40, StarImages.WELL_SAMPLED),
        )

    def _solution(
        self,
        center: Icrs,
        sigma_arcsec: float,
        scale_arcsec_px: float,
        rotation_deg: float,
        parity: int,
        pairs: int,
        chance: np.random.Generator,
        false_probability: float,
        mode: str,
        *,
        rejected: int,
    ) -> Solution:
        rms = 0.3 * self.through.scale_arcsec_px
        return Solution(
            center=center,
            center_sigma_arcsec=sigma_arcsec,
            scale_arcsec_px=scale_arcsec_px,
            rotation_deg=turn_deg(rotation_deg),
            parity=parity,
            rms_arcsec=rms,
            pairs=pairs,
            rejected=rejected,
            false_probability=false_probability,
            mode=mode,
            wcs=self._cards(center, scale_arcsec_px, rotation_deg, parity),
            center_covariance_arcsec2=np.eye(2) * sigma_arcsec**2,
            identified=self._pairs(center, pairs, rms, chance),
            catalog="simulated sky",
        )

    def _cards(
        self, center: Icrs, scale_arcsec_px: float, rotation_deg: float, parity: int
    ) -> dict[str, str | int | float]:
        scale_deg, turn = scale_arcsec_px / 3600.0, math.radians(rotation_deg)
        bend = self.through.distortion_px2
        cubic = dict.fromkeys(("A_3_0", "A_1_2", "B_2_1", "B_0_3"), -bend)
        sip = {"A_ORDER": 3, "B_ORDER": 3, **cubic} if bend else {}
        # +y looks along the position angle; +x, as the sky is seen, a right angle to the west of it
        return {
            "WCSAXES": 2,
            "CTYPE1": "RA---TAN-SIP" if sip else "RA---TAN",
            "CTYPE2": "DEC--TAN-SIP" if sip else "DEC--TAN",
            "CUNIT1": "deg",
            "CUNIT2": "deg",
            "RADESYS": "ICRS",
            "CRPIX1": (self.through.width_px + 1) / 2.0,
            "CRPIX2": (self.through.height_px + 1) / 2.0,
            "CRVAL1": center.ra_deg,
            "CRVAL2": center.dec_deg,
            "CD1_1": -parity * scale_deg * math.cos(turn),
            "CD1_2": scale_deg * math.sin(turn),
            "CD2_1": parity * scale_deg * math.sin(turn),
            "CD2_2": scale_deg * math.cos(turn),
            "IMAGEW": self.through.width_px,
            "IMAGEH": self.through.height_px,
            **sip,
        }

    def _pairs(self, center: Icrs, pairs: int, rms: float, chance: np.random.Generator) -> IdentifiedPairs:
        shape = pairs
        deviations = chance.normal(0.0, rms / math.sqrt(2.0), (2, shape))
        return IdentifiedPairs(
            x_px=chance.uniform(0.0, self.through.width_px, shape),
            y_px=chance.uniform(0.0, self.through.height_px, shape),
            ra_deg=np.full(shape, center.ra_deg),
            dec_deg=np.full(shape, center.dec_deg),
            dx_arcsec=deviations[0],
            dy_arcsec=deviations[1],
            flux=np.full(shape, 1e4),
            flux_sigma=np.full(shape, 100.0),
            mag=np.full(shape, 10.0),
            centroid_sigma_arcsec=np.full(shape, rms),
            catalog_sigma_arcsec=np.full(shape, 0.05),
            flags=np.zeros(shape, dtype=np.int64),
            used=np.ones(shape, dtype=np.bool_),
            leverage=np.full(shape, 3.0 / shape),
        )


def _in_image_deg(truth: FrameTruth, parity: int) -> float:
    """Direction of a trail in the image, from +x towards +y, in [-90, 90)."""
    turned = math.radians(truth.trail_angle_deg - truth.rotation_deg)
    angle_deg = math.degrees(math.atan2(math.cos(turned), -parity * math.sin(turned)))
    return (angle_deg + 90.0) % 180.0 - 90.0


def _quality(
    stars: int, images: StarImages, trail_px: float = 0.0, trail_angle_deg: float = 0.0
) -> SkyQuality:
    # a trail of length L adds L² / 12 to the variance along it
    wide = math.sqrt(_WIDTH_PX**2 / (1.0 - _ELLIPTICITY) + trail_px**2 / 12.0)
    narrow = _WIDTH_PX * math.sqrt(1.0 - _ELLIPTICITY)
    return SkyQuality(
        stars=stars,
        images=images if stars else StarImages.NONE,
        fwhm_px=2.3548 * math.sqrt(wide * narrow) if stars else None,
        ellipticity=1.0 - narrow / wide if stars else None,
        elongation_deg=trail_angle_deg if stars else None,
        sky_adu=400.0,
        noise_adu=8.0,
        sky_gradient=0.5,
        limiting_flux_adu=120.0,
        saturated_share=0.0,
    )


def _unsolved(
    reason: Reason,
    detail: str,
    measured: int,
    spent_s: float,
    images: StarImages = StarImages.WELL_SAMPLED,
) -> Verdict:
    return Verdict(
        None,
        reason,
        detail,
        measured,
        Times(total_s=spent_s),
        {"measured": float(measured)},
        quality=_quality(measured, images),
    )
