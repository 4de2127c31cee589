"""How programs read what `solve-field` and `wcsinfo` print and write, retold from their sources."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

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
