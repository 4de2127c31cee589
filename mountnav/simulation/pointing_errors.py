"""How wrong a simulated telescope points: numbers only; what they do to a direction is in `geometry`."""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass, fields
from pathlib import Path

from mountnav.errors import BadSettings
from mountnav.files import read_text
from mountnav.parsing import toml_of


@dataclass(frozen=True, slots=True)
class PointingErrors:
    """The errors of an equatorial mount, in the sense *observed = axis reading + Σ c_k f_k* [POINTING §5].

    Attributes
    ----------
    ih_arcsec, id_arcsec : float
        Zero points of the hour angle and of the declination axis.
    ch_arcsec : float
        Collimation: the tube is not square to the declination axis.
    np_arcsec : float
        The two axes are not square to each other.
    me_arcsec, ma_arcsec : float
        The polar axis is wrong in elevation, in azimuth.
    tf_arcsec : float
        Tube flexure, in proportion to the sine of the zenith distance.
    backlash_arcsec : float
        Play of each gear, >= 0. None shows after an approach towards the west or the north; after one towards
        the east or the south the tube trails by the whole of it, until the motor has run back through it.
    periodic_amplitude_arcsec : float
        Half the swing of the worm's periodic error in hour angle, >= 0.
    periodic_period_s : float
        One turn of the worm when tracking, > 0.

    Raises
    ------
    BadSettings
        When a value is not a finite number or is out of its range.
    """

    ih_arcsec: float = 0.0
    id_arcsec: float = 0.0
    ch_arcsec: float = 0.0
    np_arcsec: float = 0.0
    me_arcsec: float = 0.0
    ma_arcsec: float = 0.0
    tf_arcsec: float = 0.0
    backlash_arcsec: float = 0.0
    periodic_amplitude_arcsec: float = 0.0
    periodic_period_s: float = 480.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
                raise BadSettings(
                    f"pointing error {field.name} = {value!r} is not a number", advice=f"allowed: {allowed()}"
                )
        for name in ("backlash_arcsec", "periodic_amplitude_arcsec"):
            if getattr(self, name) < 0:
                raise BadSettings(f"pointing error {name} = {getattr(self, name)} is negative", advice=">= 0")
        if self.periodic_period_s <= 0:
            raise BadSettings(
                f"pointing error periodic_period_s = {self.periodic_period_s} is not a period", advice="> 0"
            )

    @classmethod
    def from_toml(cls, path: Path | str) -> PointingErrors:
        """Read the errors from a TOML file whose top-level keys are the attributes' names.

        Parameters
        ----------
        path : Path or str
            The file; what it leaves out keeps its default.

        Raises
        ------
        BadSettings
            When the file can't be read, is no TOML, or holds an unknown name or a bad value.
        """
        try:
            values = toml_of(read_text(Path(path)))
        except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as cause:
            raise BadSettings(f"can't read the pointing errors in {path}: {cause}") from cause
        names = {field.name for field in fields(cls)}
        unknown = sorted(set(values) - names)
        if unknown:
            raise BadSettings(
                f"unknown pointing error {', '.join(unknown)} in {path}", advice=f"allowed: {allowed()}"
            )
        try:
            return cls(**values)
        except BadSettings as cause:
            raise BadSettings(f"{path}: {cause.what}", advice=cause.advice) from cause


def allowed() -> str:
    """List the names an errors file may use, for messages."""
    return ", ".join(field.name for field in fields(PointingErrors))
