"""Drawn fields, a host that keeps what is printed, and commands as other programs start them."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cache
from pathlib import Path

import numpy as np
from astropy.io import fits
from numpy.typing import NDArray
from PIL import Image

from api.solver_commands.host import LocalHost
from api.solver_commands.in_process import SolverInProcess
from api.solver_commands.registry import command
from mountnav.catalog.embedded import embedded_catalog
from mountnav.identification.blind.cache import cached_index
from mountnav.simulation.optics import SimulatedOptics
from mountnav.simulation.render import draw_frame
from mountnav.sky.coordinates import Icrs

CENTER = Icrs(83.2, 21.4)
ROTATION_DEG = 33.0
WIDTH_PX, HEIGHT_PX, SCALE_ARCSEC_PX = 800, 600, 10.0
WHEN = datetime(2026, 11, 21, 20, tzinfo=UTC)


@dataclass
class KeepingHost(LocalHost):
    """The files of this process; what is printed is kept."""

    printed: list[str] = field(default_factory=list)
    troubles: list[str] = field(default_factory=list)

    def out(self, text: str) -> None:
        """Keep it."""
        self.printed.append(text)

    def err(self, text: str) -> None:
        """Keep it."""
        self.troubles.append(text)

    @property
    def stdout(self) -> str:
        """All that was printed."""
        return "".join(self.printed)

    @property
    def stderr(self) -> str:
        """All that was printed as trouble."""
        return "".join(self.troubles)


@cache
def solver() -> SolverInProcess:
    """One for all tests of a process; the index of the sky is built if there is none."""
    return SolverInProcess(lambda catalog: cached_index(catalog.indexed))


def call(name: str, *arguments: str | Path) -> tuple[int, str, str]:
    """Run a command here; its exit code, and what it printed."""
    host = KeepingHost()
    code = command(name)([str(argument) for argument in arguments], host, solver())
    return code, host.stdout, host.stderr


@cache
def pixels(
    rotation_deg: float = ROTATION_DEG,
    parity: int = 1,
    center: Icrs = CENTER,
    distortion_px2: float = 0.0,
) -> NDArray[np.uint16]:
    """A drawn field."""
    optics = SimulatedOptics(
        WIDTH_PX,
        HEIGHT_PX,
        SCALE_ARCSEC_PX,
        rotation_deg=rotation_deg,
        parity=parity,
        distortion_px2=distortion_px2,
        faint_stars_deg2=50.0,
        sky_adu_s=10.0,
    )
    drawn = draw_frame(
        center,
        optics,
        embedded_catalog(),
        exposure_s=10.0,
        mid_exposure_utc=WHEN,
        seed=(7, int(rotation_deg)),
    )
    return np.asarray(np.clip(drawn.pixels, 0, 65535), dtype=np.uint16)


def fits_field(path: Path, drawn: np.ndarray, **cards: object) -> Path:
    """Write it as FITS, with a date and no hint but those given."""
    header = fits.Header()
    header["DATE-OBS"], header["EXPTIME"] = "2026-11-21T19:59:55", 10.0
    header.update(cards)
    fits.PrimaryHDU(drawn, header).writeto(path, overwrite=True)
    return path


def png_field(path: Path, drawn: np.ndarray) -> Path:
    """Write it as a stretched picture of 8 bits, the first row on top."""
    low, high = np.percentile(drawn, [5.0, 99.9])
    bright = np.clip((drawn.astype(float) - low) / (high - low), 0.0, 1.0)
    Image.fromarray(np.round(255.0 * np.sqrt(bright)).astype(np.uint8)).save(path)
    return path


def list_field(path: Path, stars: np.ndarray, *, flux: np.ndarray | None = None) -> Path:
    """Write stars (x, y, flux; pixels from 1 on) as Siril does."""
    columns = [
        fits.Column(name=name, format="E", array=values)
        for name, values in (
            ("X", stars[:, 0]),
            ("Y", stars[:, 1]),
            ("FLUX", stars[:, 2] if flux is None else flux),
            ("BACKGROUND", np.zeros(len(stars))),
        )
    ]
    table = fits.BinTableHDU.from_columns(columns)
    table.header["IMAGEW"], table.header["IMAGEH"] = WIDTH_PX, HEIGHT_PX
    fits.HDUList([fits.PrimaryHDU(), table]).writeto(path, overwrite=True)
    return path


def executables(folder: Path, *names: str) -> Path:
    """A folder with commands of these names, each a process of its own, as another program starts them."""
    folder.mkdir(parents=True, exist_ok=True)
    root = Path(__file__).resolve().parents[3]
    for name in names:
        script = folder / name
        script.write_text(
            f"#!{sys.executable}\n"
            "import sys\n"
            f"sys.path.insert(0, {str(root)!r})\n"
            "from tests.api.solver_commands.fields import solver\n"
            "from api.solver_commands.host import LocalHost\n"
            "from api.solver_commands.registry import command\n"
            f"sys.exit(command({name!r})(sys.argv[1:], LocalHost(), solver()))\n"
        )
        script.chmod(0o755)
    return folder


def environment(folder: Path) -> dict[str, str]:
    """That of this process, with the folder's commands first and the tests' index of the sky."""
    path = f"{folder}{os.pathsep}{os.environ.get('PATH', '')}"
    cache_folder = os.environ["MOUNTNAV_CACHE"]
    return {**os.environ, "PATH": path, "MOUNTNAV_CACHE": cache_folder, "OMP_NUM_THREADS": "1"}
