"""The sky over INDI's CCD simulator: our embedded catalog, served by a `gsc` of the tests' own.

The simulator draws what stands where its mount *says* it points. What a telescope truly does is put in by the
`gsc`: it shifts the sky by true minus reported. A sync moves what the mount says and not the tube, so whoever
syncs it must take that off the shift (`SkyUnderSyncs`).
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from mountnav.catalog.embedded import embedded_catalog
from mountnav.devices import Mount, SyncResult
from mountnav.sky.coordinates import Apparent, Icrs
from mountnav.sky.sphere import offset_arcsec

PROGRAM = Path(__file__).with_name("gsc.py")


class GscSky:
    """A `gsc` on a PATH of its own, and its files.

    Parameters
    ----------
    folder : Path
    center : Icrs
        Round this place it knows stars.
    radius_deg : float
    """

    def __init__(self, folder: Path, center: Icrs, radius_deg: float = 4.0) -> None:
        self._folder = folder
        programs = folder / "bin"
        programs.mkdir(parents=True)
        program = programs / "gsc"
        program.write_text(f"#!{sys.executable} -IS\n{PROGRAM.read_text()}")
        program.chmod(0o755)
        stars = embedded_catalog().cone(center, radius_deg, epoch_yr=2026.9, mag_limit=12.5)
        (folder / "stars").write_text(
            "".join(
                f"{ra:.7f} {dec:.7f} {mag:.2f}\n"
                for ra, dec, mag in zip(stars.ra_deg, stars.dec_deg, stars.mag, strict=True)
            )
        )
        self.point(0.0, 0.0)

    def environment(self, path: str) -> dict[str, str]:
        """What the simulator must be run with."""
        return {"PATH": f"{self._folder / 'bin'}:{path}", "GSC_FOLDER": str(self._folder)}

    def point(self, east_arcsec: float, north_arcsec: float) -> None:
        """Set by how much the telescope truly looks beside where it says."""
        self.pointing = (east_arcsec, north_arcsec)
        (self._folder / "pointing").write_text(f"{east_arcsec} {north_arcsec}")

    def looked_at(self) -> list[Icrs]:
        """Where the telescope truly looked at each exposure, as the program noted it."""
        calls = (self._folder / "calls").read_text().splitlines()
        return [Icrs(*map(float, call.split()[2:])) for call in calls]


class SkyUnderSyncs:
    """A mount whose syncs leave the sky where it is."""

    def __init__(self, mount: Mount, sky: GscSky) -> None:
        self._mount = mount
        self._sky = sky
        self.syncs = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._mount, name)

    async def sync(self, place: Apparent | Icrs) -> SyncResult:
        before = (await self._mount.reading()).place
        result = await self._mount.sync(place)
        after = (await self._mount.reading()).place
        shift = offset_arcsec(Icrs(after.ra_deg, after.dec_deg), Icrs(before.ra_deg, before.dec_deg))
        east_arcsec, north_arcsec = self._sky.pointing
        self._sky.point(east_arcsec - shift.east_arcsec, north_arcsec - shift.north_arcsec)
        self.syncs += 1
        return result
