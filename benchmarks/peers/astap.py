"""ASTAP's command line, with the embedded catalog as its star database."""

from __future__ import annotations

import contextlib
import math
import shutil
import tempfile
from pathlib import Path

from astropy.io import fits

from benchmarks.peers.astap_stars import write_database
from benchmarks.peers.drawing import TAKEN
from benchmarks.peers.running import Attempt, Found, Job, run
from benchmarks.peers.wcs_files import claimed
from mountnav.catalog.stars import Catalog
from mountnav.units import julian_year

LIMIT_S = 120.0
NUMBERS = ("CRPIX1", "CRPIX2", "CRVAL1", "CRVAL2", "CD1_1", "CD1_2", "CD2_1", "CD2_2")


class Astap:
    """The command.

    Its own databases (Gaia, 500 to 8,000 stars per square degree) are in no package, so it gets the stars
    that mountnav has: 62 per square degree. It counts on a denser one, which makes it weak where a frame
    holds few of them; what it could do with its own is not measured here.

    Parameters
    ----------
    work : Path
        Folder for temporary files; the star database is written there.
    catalog : Catalog
    """

    name = "astap_cli"

    def __init__(self, work: Path, catalog: Catalog) -> None:
        self._work = work
        self._catalog = catalog
        self._stars = work / "astap"
        self._stars.mkdir()
        write_database(catalog, self._stars, epoch_yr=julian_year(TAKEN))

    @staticmethod
    def missing() -> str:
        """Why it can't be run here; empty if it can."""
        return "" if shutil.which("astap_cli") else "astap_cli is not installed (Debian: astap-cli)"

    def can(self, job: Job, *, blind: bool) -> str:
        """It must know the field's height, so it is never quite blind."""
        del blind
        return "" if job.hint.scale_low_arcsec_px and job.hint.scale_high_arcsec_px else "it needs the field"

    def solve(self, job: Job, *, blind: bool) -> Attempt:
        """Solve; hinted within 1.5 times radius or field, blind within 180° with the field told."""
        with tempfile.TemporaryDirectory(dir=self._work) as name:
            base = Path(name) / "found"
            command = ["astap_cli", "-f", str(job.path), "-d", str(self._stars), "-o", str(base)]
            ran = run([*command, *self._options(job, blind=blind)], Path(name), limit_s=LIMIT_S)
            found = _claimed(base.with_suffix(".ini"), job)
        note = "" if found else ("out of time" if ran.late else "did not solve")
        return Attempt(found, ran.cpu_s, ran.wall_s, ran.peak_mb, note)

    def close(self) -> None:
        """Nothing is held."""

    def _options(self, job: Job, *, blind: bool) -> list[str]:
        hint = job.hint
        assert hint.scale_low_arcsec_px is not None
        assert hint.scale_high_arcsec_px is not None
        scale = 0.5 * (hint.scale_low_arcsec_px + hint.scale_high_arcsec_px)
        height_deg, width_deg = job.height_px * scale / 3600, job.width_px * scale / 3600
        options = ["-fov", f"{height_deg:.4f}", "-speed", "slow"]
        # half as many stars as the database has in such a field: with its default of 500 it finds far more
        # in the frame than the database has, and solves less. Where nothing is known of the place: the mean
        stars = 62.0 * height_deg * width_deg
        if hint.center is not None and not blind:
            radius_deg = 0.5 * math.sqrt(height_deg * width_deg)
            near = self._catalog.cone(hint.center, radius_deg, epoch_yr=julian_year(TAKEN))
            stars = len(near) * 4 / math.pi
            options += ["-ra", f"{hint.center.ra_deg / 15:.6f}", "-spd", f"{90 + hint.center.dec_deg:.6f}"]
            # it steps by whole fields: with a smaller radius it tries only the place it is told
            options += ["-r", f"{1.5 * max(hint.radius_deg, height_deg):g}"]
        else:
            options += ["-ra", "0", "-spd", "90", "-r", "180"]
        return [*options, "-s", f"{min(200, max(25, round(0.5 * stars)))}"]


def _claimed(path: Path, job: Job) -> Found | None:
    """What its result file says; None if not solved."""
    if not path.is_file():
        return None
    lines = (line.partition("=") for line in path.read_text("latin-1").splitlines())
    said = {key.strip(): value.strip() for key, _, value in lines}
    if said.get("PLTSOLVD") != "T":
        return None
    header = fits.Header()
    header["NAXIS1"], header["NAXIS2"] = job.width_px, job.height_px
    header["CTYPE1"], header["CTYPE2"] = "RA---TAN", "DEC--TAN"
    for key in NUMBERS:
        with contextlib.suppress(ValueError):
            header[key] = float(said.get(key, ""))
    return claimed(header, job.width_px, job.height_px)
