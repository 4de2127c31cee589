"""How programs read what `solve-field` and `wcsinfo` print and write, retold from their sources."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import pytest
from astropy.io import fits
from astropy.wcs import WCS


@dataclass(frozen=True)
class Read:
    """What a program takes for the solution; None where it doesn't read that."""

    ra_deg: float
    dec_deg: float
    scale_arcsec_px: float | None = None
    orientation_deg: float | None = None
    parity: str | None = None


def siril(out: str, wcs_file: Path) -> Read | None:
    """Siril: reads lines until one says that there is no solution, or all; then the plate by wcslib."""
    found = False
    for line in out.split("\n"):
        if line.startswith("Did not solve"):
            break
        found = found or line.startswith("Field center: (RA,Dec)")
    if not found:
        return None
    header = fits.getheader(wcs_file)
    wcs = WCS(header)
    middle = [[0.5 * (header["IMAGEW"] - 1), 0.5 * (header["IMAGEH"] - 1)]]
    ra, dec = wcs.all_pix2world(middle, 0)[0]
    return Read(float(ra), float(dec))


def indi(out: str) -> Read | None:
    """INDI's driver: four patterns on each line; it stops as soon as the first three were found."""
    ra = dec = angle = scale = None
    parity = None
    for line in out.split("\n"):
        if match := re.match(r"Field rotation angle: up is\s*([-+.\deE]+)", line):
            angle = float(match[1])
        if match := re.match(r"Field center: \(RA,Dec\) = \(\s*([-+.\deE]+),\s*([-+.\deE]+)\)", line):
            ra, dec = float(match[1]), float(match[2])
        if match := re.match(r"Field parity:\s*(\S+)", line):
            parity = match[1]
        # everything up to the line's first p must be skipped
        if match := re.match(r"[^p]+pixel scale\s*([-+.\deE]+)", line):
            scale = float(match[1])
        if None not in (ra, dec, angle, scale):
            assert ra is not None
            assert dec is not None
            return Read(ra, dec, scale, angle, parity)
    return None


def stellarsolver(wcsinfo_out: str) -> Read | None:
    """StellarSolver (Ekos) and N.I.N.A.: keys and values of `wcsinfo`."""
    values: dict[str, str] = {}
    for line in wcsinfo_out.split("\n"):
        words = line.split(" ")
        if len(words) == 2:
            values[words[0]] = words[1]
    needed = ("pixscale", "orientation_center", "ra_center", "dec_center", "fieldw", "fieldh", "fieldunits")
    if any(key not in values for key in needed):
        return None
    # its "positive" is the determinant's sign turned round
    parity = "neg" if values["parity"] == "1" else "pos"
    scale = float(values["pixscale"])
    return Read(
        float(values["ra_center"]), float(values["dec_center"]), scale, float(values["orientation"]), parity
    )


def assert_same_wcsinfo(one: dict[str, str], other: dict[str, str]) -> None:
    """Two outputs of `wcsinfo` have the same keys in the same order, and values but for rounding."""
    assert list(one) == list(other)
    for key in one:
        if key.endswith(("_h", "_m", "_d", "_s")):
            continue  # 59.9999999 s may be 0 s of the next minute: compared together below
        if key.endswith(("hms", "dms")):
            assert _units(one[key]) == pytest.approx(_units(other[key]), abs=1.1e-3), key
        elif key == "fieldunits":
            assert one[key] == other[key]
        else:
            close = pytest.approx(float(other[key]), rel=1e-5 if "merc" in key else 1e-9, abs=1e-9)
            assert float(one[key]) == close, key
    for names in (
        ("ra_center_h", "ra_center_m", "ra_center_s"),
        ("dec_center_d", "dec_center_m", "dec_center_s"),
    ):
        texts = [":".join(values[name] for name in names) for values in (one, other)]
        assert _units(texts[0]) == pytest.approx(_units(texts[1]), abs=1e-7), names


def _units(text: str) -> float:
    """Seconds of time or of arc."""
    first, minutes, seconds = (abs(float(word)) for word in text.split(":"))
    return (3600.0 * first + 60.0 * minutes + seconds) * (-1.0 if text.startswith("-") else 1.0)
