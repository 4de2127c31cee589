"""Calibration of a frame: bias, dark, flat and bad pixels that fit it; misfits are reported."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mountnav.errors import BadRequest
from mountnav.frames import Frame
from mountnav.measuring.calibration.bad_pixels import HOT_SIGMA, BadPixel, heal
from mountnav.measuring.calibration.camera_setup import (
    CameraSetup,
    Kind,
    difference,
    same_filter,
    setup_from_header,
    steps_done,
    unknown_beside_known,
    zero_left_adu,
)
from mountnav.measuring.calibration.masters import Master, read_master
from mountnav.measuring.calibration.raw_files import FloatImage
from mountnav.measuring.saturation import saturation_level

__all__ = ["Calibration", "CalibrationPolicy", "CalibrationReport", "masters_in"]


_FULL_MARGIN = 1.02
"""Saturated pixels are lifted to this many times the highest of the others, so that rounding doesn't mix
them."""
_SAMPLE = 4_000_000
"""Pixels at most by which sky and noise are estimated: bounds the time."""


@dataclass(frozen=True, slots=True)
class FullLevel:
    """From what level a raw pixel is saturated; infinity if none is known."""

    level_adu: float


def full_level(frame: Frame) -> FullLevel:
    """Find from what level on a raw frame's pixels count as saturated.

    Parameters
    ----------
    frame : Frame
        With its pixels untouched.
    """
    image = frame.pixels.astype(np.float32)
    step = max(1, image.size // _SAMPLE)
    sample = image.ravel()[::step]
    sample = sample[np.isfinite(sample)]
    if sample.size == 0:
        return FullLevel(np.inf)
    sky = float(np.median(sample))
    noise = 1.4826 * float(np.median(np.abs(sample - sky)))
    return FullLevel(saturation_level(frame.pixels, image, sky, max(noise, 0.3), frame.saturation_adu))


def keep_full(
    pixels: FloatImage, raw: NDArray[np.generic], full: FullLevel, bad: NDArray[np.bool_] | None = None
) -> float | None:
    """Lift pixels that were saturated above all that were not, in place.

    A flat divides the full well by the response: a saturated pixel at the center would end below an
    unsaturated one in a dark corner, and no single level could tell them apart.

    Parameters
    ----------
    pixels : ndarray of float32, shape (height, width)
        Calibrated.
    raw : ndarray, shape (height, width)
        The same before.
    bad : ndarray of bool, shape (height, width), optional
        Pixels that are not used.

    Returns
    -------
    float or None
        The level from which pixels are saturated now; None if it wasn't known before.
    """
    if not np.isfinite(full.level_adu):
        return None
    saturated = np.asarray(raw, dtype=np.float32) >= full.level_adu
    telling = np.isfinite(pixels) & ~saturated
    if bad is not None:
        saturated &= ~bad
        telling &= ~bad
    highest = float(pixels.max(where=telling, initial=1.0))
    level = _FULL_MARGIN * highest
    if saturated.any():
        # above the level by rounding at most: their height means nothing
        pixels[saturated] = np.float32(level * 1.001)
        return level
    return max(level, float(full.level_adu))


_BAND_ROWS = 128
"""Rows that are worked on together: bounds the memory."""
_LEAST_RESPONSE = 0.05
"""Response below which a pixel is left out instead of being divided: its noise would grow twentyfold."""
_SAME_EXPOSURE = 0.01
"""Relative difference up to which a dark that holds the bias has the frame's exposure."""


@dataclass(frozen=True, slots=True)
class CalibrationPolicy:
    """What may be used that doesn't fit perfectly.

    Attributes
    ----------
    other_filter : bool
        Use a flat of another filter if there is none of the frame's own.
    temperature_warn_c, temperature_refuse_c : float
        A dark taken so far from the frame's temperature is used with a warning, or not at all: dark current
        doubles every 6 to 8 degrees.
    scale_warn : float
        A dark scaled up by more is used with a warning: its noise is scaled too.
    heal_bad_pixels : bool
        Fill lone bad pixels from their neighbors; else all of them become NaN (missing).
    """

    other_filter: bool = False
    temperature_warn_c: float = 3.0
    temperature_refuse_c: float = 10.0
    scale_warn: float = 5.0
    heal_bad_pixels: bool = True


@dataclass(frozen=True, slots=True)
class CalibrationReport:
    """What was done to a frame, and what was not, and why.

    Attributes
    ----------
    bias, dark, flat : str or None
        File names of the masters that were applied.
    dark_factor : float or None
        The dark's exposure went into the frame's so many times.
    healed, missing : int
        Bad pixels that were filled from their neighbors, and that became NaN.
    not_applied : tuple of str
        Each step that was not done, with the reason.
    warnings : tuple of str
        What was done all the same.
    zero_adu : float or None
        Level of a pixel without light in the frame as it is now: 0 once the bias is gone; None: not known.
    """

    bias: str | None = None
    dark: str | None = None
    flat: str | None = None
    dark_factor: float | None = None
    healed: int = 0
    missing: int = 0
    not_applied: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    zero_adu: float | None = None

    @property
    def steps(self) -> str:
        """What was done, in MaxIm's letters: "BDF", "BD", ..."""
        return "".join(
            letter for letter, name in zip("BDF", (self.bias, self.dark, self.flat), strict=True) if name
        )


@dataclass(frozen=True, slots=True)
class _Chosen:
    """Masters that fit a frame; `dark_factor` is what the dark is multiplied with."""

    bias: Master | None
    dark: Master | None
    flat: Master | None
    bad: Master | None
    dark_factor: float
    not_applied: tuple[str, ...]
    warnings: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Calibration:
    """The masters of a folder.

    Attributes
    ----------
    masters : tuple of Master
        In order of their names.
    """

    folder: Path
    masters: tuple[Master, ...]
    policy: CalibrationPolicy = CalibrationPolicy()

    @classmethod
    def load(cls, folder: Path, *, policy: CalibrationPolicy | None = None) -> Calibration:
        """Look through a folder of masters; pixels are read when they are needed.

        Parameters
        ----------
        folder : Path
            As `mountnav calibrate build` makes it; files that are no masters are passed over.

        Raises
        ------
        BadRequest
            No such folder, or no masters in it.
        BadFrame
            A master is damaged.
        """
        if not folder.is_dir():
            raise BadRequest(
                f"{folder} is not a folder", advice="build masters with `mountnav calibrate build`"
            )
        masters = masters_in(folder)
        if not masters:
            raise BadRequest(
                f"{folder} holds no masters", advice="build them with `mountnav calibrate build`"
            )
        return cls(folder, masters, policy or CalibrationPolicy())

    @property
    def bias_adu(self) -> float | None:
        """Level of a raw pixel without light, from the bias; None without one, or if several differ."""
        levels = [
            one.level_adu for one in self.masters if one.kind is Kind.BIAS and one.level_adu is not None
        ]
        return levels[0] if levels and max(levels) - min(levels) < 1.0 else None

    def applied(self, frame: Frame) -> tuple[Frame, CalibrationReport]:
        """Calibrate a frame with the masters that fit it.

        (raw - bias - dark·t) / flat; pixels saturated before are lifted above all others, so that
        `Frame.saturation_adu` of the new frame still parts them. Bad pixels are filled or become NaN.

        Parameters
        ----------
        frame : Frame
            Raw, as ``read_frame(..., raw=True)`` gives it; a mosaic stays a mosaic.

        Returns
        -------
        Frame
            float32 pixels, the same position, time and hint; its header tells what was done (CALSTAT, MNBIAS,
            MNDARK, MNFLAT). The frame itself if nothing fits, or all was done before.

        Raises
        ------
        BadFrame
            A master can't be read.
        """
        facts = setup_from_header(frame.header, frame.width_px, frame.height_px)
        if reason := _spoilt(frame):
            return frame, CalibrationReport(not_applied=(reason,))
        chosen = self._chosen(frame, facts)
        if chosen.bias is chosen.dark is chosen.flat is chosen.bad is None:
            return frame, CalibrationReport(
                not_applied=chosen.not_applied,
                warnings=chosen.warnings,
                zero_adu=zero_left_adu(frame.header),
            )
        full = full_level(frame)
        pixels = _calibrated(frame, chosen)
        bad = _bad_pixels(chosen, frame, pixels)
        saturation = keep_full(pixels, frame.pixels, full, bad)
        missing = np.isnan(pixels) & ~bad if chosen.flat is not None else None
        if not self.policy.heal_bad_pixels:
            pixels[bad] = np.nan
            healed, lost = 0, int(bad.sum())
        else:
            healed, lost = heal(pixels, bad, 2 if frame.mosaic else 1)
        if missing is not None:
            lost += int(missing.sum())
        return self._reported(frame, pixels, saturation, chosen, healed, lost)

    def _reported(
        self,
        frame: Frame,
        pixels: FloatImage,
        saturation_adu: float | None,
        chosen: _Chosen,
        healed: int,
        missing: int,
    ) -> tuple[Frame, CalibrationReport]:
        before = steps_done(frame.header)
        dark = chosen.dark
        zero_gone = "B" in before or chosen.bias is not None or (dark is not None and not dark.zero_free)
        report = CalibrationReport(
            bias=None if chosen.bias is None else chosen.bias.name,
            dark=None if dark is None else dark.name,
            flat=None if chosen.flat is None else chosen.flat.name,
            dark_factor=None if dark is None or not dark.zero_free else chosen.dark_factor,
            healed=healed,
            missing=missing,
            not_applied=chosen.not_applied,
            warnings=chosen.warnings,
            zero_adu=0.0 if zero_gone else None,
        )
        header = dict(frame.header)
        steps = set(before) | set(report.steps) | ({"B"} if zero_gone else set())
        if "PEDESTAL" in header:
            header["PEDESTAL"] = 0  # whatever offset there was is gone
        header["CALSTAT"] = "".join(letter for letter in "BDF" if letter in steps)
        for key, name in (("MNBIAS", report.bias), ("MNDARK", report.dark), ("MNFLAT", report.flat)):
            if name is not None:
                header[key] = name
        if report.dark_factor is not None:
            header["MNDARKT"] = round(report.dark_factor, 4)
        if chosen.bad is not None:
            header["MNHEALED"], header["MNMISSED"] = healed, missing
        gain = next(
            (one.gain_e_adu for one in (chosen.flat, chosen.bias) if one is not None and one.gain_e_adu), None
        )
        if "EGAIN" not in header and gain is not None:
            header["EGAIN"] = round(gain, 4)
        return replace(frame, pixels=pixels, saturation_adu=saturation_adu, header=header), report

    def _chosen(self, frame: Frame, facts: CameraSetup) -> _Chosen:
        done = steps_done(frame.header)
        not_applied: list[str] = []
        warnings: list[str] = []
        fitting = []
        refused: dict[Kind, str] = {}
        for master in self.masters:
            if why := difference(facts, master.facts):
                refused[master.kind] = (
                    f"{master.name}: {why.replace('it has', 'the frame has').replace('its ', 'the frame’s ')}"
                )
            else:
                fitting.append(master)
                if (lacking := unknown_beside_known(facts, master.facts)) is not None:
                    name, value, of_master = lacking
                    whose, silent = (master.name, "the frame") if of_master else ("the frame", master.name)
                    warnings.append(f"{silent} doesn't give its {name}; {whose} says {value}: taken as alike")

        def of(kind: Kind) -> list[Master]:
            some = [one for one in fitting if one.kind is kind]
            if not some:
                not_applied.append(f"{kind}: {refused.get(kind, 'there is no master')}")
            return some

        bias = dark = flat = bad = None
        factor = 1.0
        if "D" in done:
            not_applied.append("dark: the frame says that it was already applied")
        else:
            dark, factor = self._dark(facts, of(Kind.DARK), "B" in done, not_applied, warnings)
        if "B" in done:
            not_applied.append("bias: the frame says that it was already applied")
        elif dark is not None and not dark.zero_free:
            pass  # the dark takes the bias with it
        elif biases := of(Kind.BIAS):
            bias = biases[-1]
        if dark is not None and dark.zero_free and bias is None and "B" not in done:
            not_applied.append("dark: it is free of the bias, and no bias fits")
            dark = None
        if "F" in done:
            not_applied.append("flat: the frame says that it was already applied")
        else:
            flat = self._flat(facts, of(Kind.FLAT), not_applied, warnings)
            if flat is not None and bias is None and dark is None and "B" not in done:
                not_applied.append("flat: the bias must be taken out first, and none fits")
                flat = None
        if "F" not in done:  # a frame finished elsewhere had its pixels mended there, or not at all
            bad = next((one for one in fitting if one.kind is Kind.BAD_PIXELS), None)
        return _Chosen(bias, dark, flat, bad, factor, tuple(not_applied), tuple(warnings))

    def _dark(
        self,
        facts: CameraSetup,
        darks: Sequence[Master],
        bias_is_gone: bool,
        not_applied: list[str],
        warnings: list[str],
    ) -> tuple[Master | None, float]:
        if not darks:
            return None, 1.0
        exposure = facts.exposure_s
        if exposure is None:
            not_applied.append("dark: the frame's exposure isn't known")
            return None, 1.0

        def colder(one: Master) -> float:
            if facts.temperature_c is None or one.facts.temperature_c is None:
                return 0.0
            return abs(one.facts.temperature_c - facts.temperature_c)

        usable = [one for one in darks if colder(one) <= self.policy.temperature_refuse_c]
        if not usable:
            nearest = min(darks, key=colder)
            not_applied.append(
                f"dark: {nearest.name} was taken {colder(nearest):.0f}° away from the frame's temperature"
            )
            return None, 1.0
        usable = [
            one
            for one in usable
            if one.zero_free
            or (
                not bias_is_gone
                and abs((one.facts.exposure_s or 0.0) - exposure) <= _SAME_EXPOSURE * exposure
            )
        ]
        if not usable:
            not_applied.append(
                f"dark: the bias is in it, so it serves only its own exposure, not {exposure:g} s"
            )
            return None, 1.0

        def how_far(one: Master) -> tuple[float, float]:
            dark_s = one.facts.exposure_s or 1.0
            # steps of one degree; then the nearest exposure, a longer one before a shorter one
            ratio = dark_s / max(exposure, 1e-3)
            return round(colder(one)), abs(float(np.log(ratio))) + (0.0 if ratio >= 0.99 else 1.0)

        best = min(usable, key=how_far)
        if colder(best) > self.policy.temperature_warn_c:
            warnings.append(f"{best.name} was taken {colder(best):.1f}° away from the frame's temperature")
        if not best.zero_free:
            return best, 1.0
        times = exposure / (best.facts.exposure_s or 1.0)
        if times > self.policy.scale_warn:
            warnings.append(f"{best.name} is scaled up {times:.1f} times, its noise too")
        return best, exposure

    def _flat(
        self, facts: CameraSetup, flats: Sequence[Master], not_applied: list[str], warnings: list[str]
    ) -> Master | None:
        if not flats:
            return None
        # flats proper before those made of light frames
        ranked = sorted(flats, key=lambda one: one.from_lights)
        own = [one for one in ranked if same_filter(one.facts.filter, facts.filter)]
        if own:
            best = own[0]
        elif self.policy.other_filter:
            best = ranked[0]
            warnings.append(f"{best.name} is of the filter {best.facts.filter}, the frame of {facts.filter}")
        else:
            have = ", ".join(sorted({str(one.facts.filter) for one in ranked}))
            not_applied.append(f"flat: the frame's filter is {facts.filter}, there are flats of {have}")
            return None
        if not best.zero_free:
            warnings.append(f"{best.name} was made without a bias: its response is too even")
        return best


def masters_in(folder: Path) -> tuple[Master, ...]:
    """Return the masters of a folder in order of their names; none if it isn't there."""
    if not folder.is_dir():
        return ()
    found = (read_master(path) for path in sorted(folder.glob("*.fits")) if path.is_file())
    return tuple(one for one in found if one is not None)


def _spoilt(frame: Frame) -> str | None:
    """Tell why a frame's pixels are no longer those that the camera counted, or None."""
    if frame.pixels.ndim != 2:
        return "the frame has color planes"
    if frame.pixels.dtype.kind == "f" and not frame.mosaic:
        bits = frame.header.get("BITPIX")
        planes = frame.header.get("NAXIS3")
        if isinstance(planes, int) and planes > 1:
            return "the frame's colors were already interpolated: raw frames are needed"
        pattern = setup_from_header(frame.header, frame.width_px, frame.height_px).pattern
        if isinstance(bits, int) and bits > 0 and pattern is not None and "MNBIAS" not in frame.header:
            return "the frame's color mosaic was smoothed already: read it with raw=True"
    return None


def _calibrated(frame: Frame, chosen: _Chosen) -> FloatImage:
    bias = None if chosen.bias is None else chosen.bias.pixels()
    dark = None if chosen.dark is None else chosen.dark.pixels()
    flat = None if chosen.flat is None else chosen.flat.pixels()
    left = zero_left_adu(frame.header)
    out: FloatImage = np.empty(frame.pixels.shape, dtype=np.float32)
    for first in range(0, frame.height_px, _BAND_ROWS):
        rows = slice(first, first + _BAND_ROWS)
        band = frame.pixels[rows].astype(np.float32)
        if left:
            band -= np.float32(left)
        if bias is not None:
            band -= bias[rows]
        if dark is not None:
            band -= np.float32(chosen.dark_factor) * dark[rows]
        if flat is not None:
            response = flat[rows].astype(np.float32)
            response[~(response > _LEAST_RESPONSE)] = np.nan
            band /= response
        out[rows] = band
    return out


def _bad_pixels(chosen: _Chosen, frame: Frame, pixels: FloatImage) -> NDArray[np.bool_]:
    """Which pixels are bad in this frame: hot ones only if they get hot in its exposure."""
    if chosen.bad is None:
        return np.zeros(pixels.shape, dtype=bool)
    flags = chosen.bad.flags()
    bad = np.asarray((flags & np.uint8(BadPixel.DEAD | BadPixel.NOISY)) != 0)
    hot = np.asarray((flags & np.uint8(BadPixel.HOT)) != 0)
    if hot.any():
        dark = chosen.dark
        if dark is not None and dark.zero_free and dark.noise_adu is not None:
            y, x = np.nonzero(hot)
            signal = chosen.dark_factor * dark.pixels()[y, x].astype(np.float64)
            usual = chosen.dark_factor * (dark.level_adu or 0.0)
            still = signal - usual < HOT_SIGMA * dark.noise_adu
            # one that is full is useless, whatever the dark says
            still &= ~(frame.pixels[y, x].astype(np.float64) >= (frame.saturation_adu or np.inf))
            hot[y[still], x[still]] = False
        bad |= hot
    return bad
