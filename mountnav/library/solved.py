"""Solving in one call, and what a solved frame is in astropy's types."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.catalog_set import CatalogSet
from mountnav.catalog.stars import Catalog
from mountnav.errors import BadRequest, SolveFailed
from mountnav.extras import extra
from mountnav.frames import Frame, Hint
from mountnav.library.images import Image, read
from mountnav.sky.coordinates import Icrs
from mountnav.solution import Solution, Verdict

if TYPE_CHECKING:
    from astropy.coordinates import SkyCoord
    from astropy.table import Table
    from astropy.wcs import WCS
    from matplotlib.axes import Axes

    from mountnav.identification.blind.index import BlindIndex
    from mountnav.measuring.measurements import SkyQuality
    from mountnav.solving.settings import SolveSettings

_BAR_STEPS = 30
"""Width of the bar that shows how far the index of the sky is built, characters."""
SCALE_SHARE = 0.05
"""A scale that is given as one number may be off by this share: what focal lengths on tubes are off by."""
ARROW_SHARE = 0.05
"""In `SolvedFrame.plot` the median residual is drawn as long as this share of the frame's width."""


def solve(
    image: Image,
    *,
    center: SkyCoord | Icrs | None = None,
    radius_deg: float = 1.0,
    scale_arcsec_px: float | tuple[float, float] | None = None,
    catalog: Catalog | None = None,
    blind: bool = True,
    settings: SolveSettings | None = None,
) -> SolvedFrame:
    """Find out where an image was taken.

    Parameters
    ----------
    image : path, ndarray, HDU, HDUList, CCDData or Frame
        See `mountnav.read`. Hints in its header are used and never trusted.
    center : SkyCoord or Icrs, optional
        Where the image's middle is believed to be; goes before the header's.
    radius_deg : float
        How far off `center` may be.
    scale_arcsec_px : float or (float, float), optional
        The scale, within 5 %, or between two bounds.
    catalog : Catalog, optional
        Instead of the embedded Tycho-2.
    blind : bool
        Search the whole sky where no hint leads to a solution. The index for it is built on first need, which
        takes half a minute once per machine.
    settings : SolveSettings, optional
        How hard it is tried and what is believed; default: as the service does it.

    Returns
    -------
    SolvedFrame
        The frame with its solution.

    Raises
    ------
    SolveFailed
        The image was not identified; `reason` and the message say why. Nothing is ever guessed.
    BadFrame
        There is no image in what was given.
    BadRequest
        A hint that makes no sense.
    """
    from mountnav.catalog.embedded import embedded_catalog
    from mountnav.identification.blind.cache import installed_index
    from mountnav.solving.settings import SolveSettings
    from mountnav.solving.solve import solve as solve_frame

    frame = read(image)
    hint = _hint(center, radius_deg, scale_arcsec_px)
    embedded = embedded_catalog()
    stars: Catalog = CatalogSet(embedded) if catalog is None else catalog
    wanted = settings or SolveSettings()
    if not blind:
        wanted = replace(wanted, blind="never")
    elif wanted.index is None and wanted.blind != "never":
        wanted = replace(wanted, index=installed_index(embedded))
    verdict = solve_frame(frame, stars, hint=hint, settings=wanted)
    # once per machine: it is built only where no hint led to a solution
    if not verdict.solved and wanted.blind != "never" and wanted.index is None:
        verdict = solve_frame(frame, stars, hint=hint, settings=replace(wanted, index=_index_of_the_sky()))
    if verdict.solution is None:
        assert verdict.reason is not None
        raise SolveFailed(
            f"{frame.source} was not solved: {verdict.reason.value}; {verdict.detail}",
            device=frame.source,
            advice="give `center` and `scale_arcsec_px` if you know them",
            reason=verdict.reason.value,
        )
    return SolvedFrame(frame, verdict, verdict.solution)


def _hint(
    center: SkyCoord | Icrs | None, radius_deg: float, scale: float | tuple[float, float] | None
) -> Hint | None:
    if center is None and scale is None:
        return None
    at: Icrs | None
    if center is None or isinstance(center, Icrs):
        at = center
    else:
        icrs = center.icrs
        at = Icrs(float(icrs.ra.deg), float(icrs.dec.deg))
    if not radius_deg > 0:
        raise BadRequest(f"radius_deg is {radius_deg}", advice="give a positive number of degrees")
    if scale is None:
        return Hint(at, radius_deg)
    low, high = scale if isinstance(scale, tuple) else (scale / (1 + SCALE_SHARE), scale * (1 + SCALE_SHARE))
    if not 0 < low <= high:
        raise BadRequest(f"scale_arcsec_px is {scale}", advice="give arcseconds per pixel, or (low, high)")
    return Hint(at, radius_deg, low, high)


def _index_of_the_sky() -> BlindIndex:
    """The index for searching the whole sky, built if need be, with a bar on stderr."""
    from mountnav.catalog.embedded import embedded_catalog
    from mountnav.identification.blind.cache import cached_index

    shown = -1

    def progress(share: float) -> None:
        nonlocal shown
        if round(100 * share) == shown:
            return
        shown = round(100 * share)
        done = round(share * _BAR_STEPS)
        bar = "#" * done + "." * (_BAR_STEPS - done)
        print(f"\rbuilding the index of the sky, once: [{bar}] {share:4.0%}", end="", file=sys.stderr)

    index = cached_index(embedded_catalog(), progress=progress)
    if shown >= 0:
        print(file=sys.stderr)
    return index


@dataclass(frozen=True)
class SolvedFrame:
    """A solved image.

    Attributes
    ----------
    frame : Frame
        What was solved.
    verdict : Verdict
        Everything the solver says: times, notes, hints that turned out wrong.
    solution : Solution
        Position, scale, rotation, parity and odds.
    """

    frame: Frame = field(repr=False)
    verdict: Verdict = field(repr=False)
    solution: Solution = field(repr=False)

    @property
    def center(self) -> SkyCoord:
        """Position of the image's geometric center, ICRS."""
        return _sky_coord(self.solution.center)

    @property
    def center_sigma_arcsec(self) -> float:
        """One-sigma error of `center` per coordinate."""
        return self.solution.center_sigma_arcsec

    @property
    def wcs(self) -> WCS:
        """TAN, TAN-SIP or ZPN, as astropy has it; pixels count from 0 in its methods."""
        from astropy.io.fits import Header
        from astropy.wcs import WCS

        header = Header()
        for key, value in self.solution.wcs.items():
            header[key] = value
        return WCS(header, relax=True)

    @property
    def scale_arcsec_px(self) -> float:
        """At the center."""
        return self.solution.scale_arcsec_px

    @property
    def rotation_deg(self) -> float:
        """Position angle of the image's +y axis, east of north."""
        return self.solution.rotation_deg

    @property
    def parity(self) -> int:
        """+1: the sky as seen; -1: mirrored."""
        return self.solution.parity

    @property
    def false_probability(self) -> float:
        """Chance that a wrong place would have looked as good."""
        return self.solution.false_probability

    @property
    def quality(self) -> SkyQuality | None:
        """FWHM, sky, limiting magnitude, zero point; None if nothing was measured for it."""
        return self.verdict.quality

    @property
    def stars(self) -> Table:
        """The identified stars: pixels, ICRS positions, residuals, flux and magnitude; one row a star."""
        from astropy import units as u
        from astropy.table import Table

        pairs = self.solution.identified
        table = Table(
            {
                "x": pairs.x_px * u.pix,
                "y": pairs.y_px * u.pix,
                "ra": pairs.ra_deg * u.deg,
                "dec": pairs.dec_deg * u.deg,
                "residual_east": pairs.dx_arcsec * u.arcsec,
                "residual_north": pairs.dy_arcsec * u.arcsec,
                "flux": pairs.flux * u.adu,
                "flux_sigma": pairs.flux_sigma * u.adu,
                "mag": pairs.mag * u.mag,
                "used": pairs.used,
            }
        )
        table.meta.update(catalog=self.solution.catalog, band=pairs.band)
        return table

    def position_of(self, x: float, y: float) -> SkyCoord:
        """The position at a pixel (0-based), ICRS."""
        return _sky_coord(self.solution.icrs_at(x, y))

    def pixel_of(self, position: SkyCoord) -> tuple[float, float]:
        """The pixel (0-based) of a position; NaN where it isn't in front of the camera."""
        x, y = self.wcs.world_to_pixel(position)
        return float(x), float(y)

    def plot(self, axes: Axes | None = None) -> Axes:
        """Draw the image with its identified stars and their residuals.

        Parameters
        ----------
        axes : matplotlib Axes, optional
            Where; a figure of its own by default.

        Returns
        -------
        Axes
            The axes that were drawn in.
        """
        with extra("plots", "plots"):
            import matplotlib.pyplot as plt

        if axes is None:
            _, axes = plt.subplots(figsize=(7, 7 * self.frame.height_px / self.frame.width_px))
        pixels = np.asarray(self.frame.pixels, dtype=float)
        finite = pixels[np.isfinite(pixels)]
        low, high = np.percentile(finite, [5.0, 99.7]) if finite.size else (0.0, 1.0)
        axes.imshow(pixels, origin="lower", cmap="gray", vmin=low, vmax=max(high, low + 1e-9))
        pairs = self.solution.identified
        used = pairs.used
        axes.scatter(pairs.x_px[used], pairs.y_px[used], s=60, facecolors="none", edgecolors="C0", lw=0.8)
        axes.scatter(pairs.x_px[~used], pairs.y_px[~used], s=40, marker="x", c="C3", lw=0.8)
        dx, dy = self._residuals_px()
        length = np.hypot(dx, dy)
        if used.any() and np.median(length[used]) > 0:
            factor = ARROW_SHARE * self.frame.width_px / float(np.median(length[used]))
            axes.quiver(
                pairs.x_px, pairs.y_px, factor * dx, factor * dy,
                angles="xy", scale_units="xy", scale=1.0, color="C1", width=0.003,
            )  # fmt: skip
        axes.set_title(f"{self.frame.source}\n{self._told()}", fontsize=8)
        axes.set_xlabel(f"x (px); arrows: residuals, median {np.median(length[used]):.2f} px")
        axes.set_ylabel("y (px)")
        return axes

    def _residuals_px(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Residuals of the pairs along x and y: measured minus catalog."""
        pairs = self.solution.identified
        angle = np.radians(self.solution.rotation_deg)
        east, north = pairs.dx_arcsec / self.scale_arcsec_px, pairs.dy_arcsec / self.scale_arcsec_px
        up = north * np.cos(angle) + east * np.sin(angle)
        # seen with north up, east is to the left of an image with parity +1
        right = -self.parity * (east * np.cos(angle) - north * np.sin(angle))
        return np.asarray(right), np.asarray(up)

    def _told(self) -> str:
        return (
            f"{self.center.to_string('hmsdms', precision=1)}, {self.scale_arcsec_px:.3f}″/px, "
            f"{self.rotation_deg:.2f}°, {self.solution.pairs} stars, rms {self.solution.rms_arcsec:.2f}″, "
            f"odds of a mistake {self.false_probability:.0e}"
        )

    def __repr__(self) -> str:
        return f"<SolvedFrame {self.frame.source}: {self._told()}>"

    def _repr_html_(self) -> str:
        from html import escape

        rows: dict[str, Any] = {
            "center": f"{self.center.to_string('hmsdms', precision=1)} ± {self.center_sigma_arcsec:.2f}″",
            "scale": f"{self.scale_arcsec_px:.4f} ″/px",
            "rotation": f"{self.rotation_deg:.3f}° east of north, "
            + ("as seen" if self.parity > 0 else "mirrored"),
            "stars": f"{self.solution.pairs} identified, rms {self.solution.rms_arcsec:.2f}″",
            "odds of a mistake": f"{self.false_probability:.0e}",
        }
        cells = "".join(
            f"<tr><th>{escape(key)}</th><td>{escape(str(value))}</td></tr>" for key, value in rows.items()
        )
        return f"<table><caption>{escape(self.frame.source)}</caption>{cells}</table>"


def _sky_coord(position: Icrs) -> SkyCoord:
    from astropy import units as u
    from astropy.coordinates import SkyCoord

    return SkyCoord(position.ra_deg * u.deg, position.dec_deg * u.deg, frame="icrs")
