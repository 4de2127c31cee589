"""FITS tables as astrometry.net writes them: stars in pixels, stars on the sky, and pairs of both."""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from mountnav.solution import Solution

__all__ = ["correspondences", "index_stars", "match_table", "sky_places", "sources_table"]

Array = NDArray[np.float64]
Cards = Mapping[str, str | int | float]
Column = tuple[str, str, str, "NDArray[np.generic]"]

SAME_SOURCE_PX = 2.0
"""So near to a source of the list an identified one must lie to be the same, pixels: centroids are taken
again after stars are identified, and move by some tenths. Chosen by hand; doubled, close pairs
are mixed up."""
LEAST_PROBABILITY = 1e-300
"""Chances of being wrong are cut here for their logarithm; a float ends at 1e-308."""
_CORNERS = 5
"""Stars of the largest pattern in a `.match` table."""
_TEXT_LENGTH = 31
"""Letters of FIELDNAME in a `.match` table."""


def _table(columns: Sequence[Column], primary: Cards, cards: Cards) -> bytes:
    """A FITS file with one table; columns are name, format, unit, values."""
    from astropy.io import fits

    hdu = fits.BinTableHDU.from_columns(
        [
            fits.Column(name=name, format=form, unit=unit or None, array=values)
            for name, form, unit, values in columns
        ]
    )
    hdu.header.update(dict(cards))
    first = fits.PrimaryHDU()
    first.header.update(dict(primary))
    file = io.BytesIO()
    fits.HDUList([first, hdu]).writeto(file)
    return file.getvalue()


def sources_table(
    x_px: NDArray[np.generic],
    y_px: NDArray[np.generic],
    flux: NDArray[np.generic],
    background: float | NDArray[np.generic],
    *,
    width_px: int,
    height_px: int,
    primary: Cards | None = None,
) -> bytes:
    """Make a table of sources (`.axy`, `.xy`, `.xyls`).

    Parameters
    ----------
    x_px, y_px : ndarray, shape (n,)
        0-based; written from 1 on.
    flux : ndarray, shape (n,)
        ADU.
    background : float or ndarray, shape (n,)
        ADU.
    width_px, height_px : int
        Of the frame.
    primary : mapping, optional
        Cards for the primary header.
    """
    size: Cards = {"IMAGEW": width_px, "IMAGEH": height_px}
    columns: list[Column] = [
        ("X", "E", "pix", np.asarray(x_px, np.float64) + 1.0),
        ("Y", "E", "pix", np.asarray(y_px, np.float64) + 1.0),
        ("FLUX", "E", "unknown", np.asarray(flux)),
        ("BACKGROUND", "E", "unknown", np.broadcast_to(np.asarray(background, np.float32), np.shape(x_px))),
    ]
    return _table(columns, {**size, **(primary or {})}, {"EXTNAME": "SOURCES", "SRCEXT": 1, **size})


def sky_places(solution: Solution) -> bytes:
    """Make a table of where the stars in the fit lie on the sky, at the frame's epoch (`.rdls`)."""
    pairs, used = solution.identified, solution.identified.used
    columns: list[Column] = [
        ("RA", "D", "deg", pairs.ra_deg[used]),
        ("DEC", "D", "deg", pairs.dec_deg[used]),
        ("MAG", "E", "mag", pairs.mag[used]),
    ]
    return _table(columns, {"AN_FILE": "RDLS"}, {})


def index_stars(solution: Solution, cards: Cards) -> bytes:
    """Make a table of where the plate puts the same stars, pixels from 1 on (`-indx.xyls`)."""
    x, y = _projected(solution, cards)
    columns: list[Column] = [("X", "D", "pix", x + 1.0), ("Y", "D", "pix", y + 1.0)]
    size = {name: cards[name] for name in ("IMAGEW", "IMAGEH")}
    return _table(columns, {"AN_FILE": "XYLS", **size}, size)


def _projected(solution: Solution, cards: Cards) -> tuple[Array, Array]:
    from mountnav.identification.wcs import plate_from_cards

    plate = plate_from_cards(cards, width_px=int(cards["IMAGEW"]), height_px=int(cards["IMAGEH"]))
    used = solution.identified.used
    xi, eta = plate.project(solution.identified.ra_deg[used], solution.identified.dec_deg[used])
    return plate.pixels(xi, eta)


def correspondences(
    solution: Solution,
    cards: Cards,
    seen_px: NDArray[np.generic],
    background: float,
) -> bytes:
    """Make a table of pairs of source and star (`.corr`).

    Parameters
    ----------
    cards : mapping
        Of the WCS that is written: TAN or TAN-SIP, CRPIX in the frame's center.
    seen_px : ndarray, shape (n, 2)
        The sources of the `.axy` table, 0-based: `field_id` counts them from 0, -1 for one that isn't there.
    """
    from mountnav.sky.wcs import places_at_pixels

    pairs, used = solution.identified, solution.identified.used
    x, y = pairs.x_px[used], pairs.y_px[used]
    ra, dec = places_at_pixels(cards, x, y)
    index_x, index_y = _projected(solution, cards)
    columns: list[Column] = [
        ("field_x", "D", "pixels", x + 1.0),
        ("field_y", "D", "pixels", y + 1.0),
        ("field_ra", "D", "degrees", ra),
        ("field_dec", "D", "degrees", dec),
        ("index_x", "D", "pixels", index_x + 1.0),
        ("index_y", "D", "pixels", index_y + 1.0),
        ("index_ra", "D", "degrees", pairs.ra_deg[used]),
        ("index_dec", "D", "degrees", pairs.dec_deg[used]),
        ("index_id", "J", "none", np.arange(x.size)),
        ("field_id", "J", "none", _rows_of(x, y, seen_px)),
        ("match_weight", "D", "none", np.ones(x.size)),
        ("FLUX", "E", "unknown", pairs.flux[used]),
        ("BACKGROUND", "E", "unknown", np.full(x.size, background)),
    ]
    return _table(columns, {}, {})


def _rows_of(x: Array, y: Array, seen_px: NDArray[np.generic]) -> NDArray[np.int64]:
    """Which sources these are, by their places; -1 for none."""
    seen = np.asarray(seen_px, np.float64).reshape(-1, 2)
    rows = np.full(x.size, -1)
    if not seen.size:
        return rows
    for number, (one_x, one_y) in enumerate(zip(x, y, strict=True)):
        distance = np.hypot(seen[:, 0] - one_x, seen[:, 1] - one_y)
        nearest = int(distance.argmin())
        if distance[nearest] < SAME_SOURCE_PX:
            rows[number] = nearest
    return rows


def match_table(solution: Solution, cards: Cards, sources: int, cpu_s: float) -> bytes:
    """Make a `.match` table: what it says of the plate; what it says of a pattern of stars is zero.

    Parameters
    ----------
    cards : mapping
        Of the WCS that is written.
    sources : int
        How many were measured.
    cpu_s : float
        Time that identifying took.
    """
    width, height = int(cards["IMAGEW"]), int(cards["IMAGEH"])
    ra, dec = math.radians(solution.center.ra_deg), math.radians(solution.center.dec_deg)
    center = [math.cos(dec) * math.cos(ra), math.cos(dec) * math.sin(ra), math.sin(dec)]
    radius_deg = 0.5 * math.hypot(width, height) * solution.scale_arcsec_px / 3600.0
    log_odds = -math.log(max(solution.false_probability, LEAST_PROBABILITY))

    def whole(name: str, form: str, value: int) -> Column:
        return name, form, "", np.array([value])

    def many(name: str, form: str, values: Sequence[float]) -> Column:
        return name, f"{len(values)}{form}", "", np.array([values])

    columns: list[Column] = [
        whole("QUAD", "J", 0),
        whole("DIMQUADS", "B", 0),
        many("STARS", "J", [0] * _CORNERS),
        many("FIELDOBJS", "J", [0] * _CORNERS),
        many("IDS", "K", [0] * _CORNERS),
        ("CODEERR", "E", "", np.zeros(1)),
        many("QUADPDI", "D", [0.0] * 2 * _CORNERS),
        many("QUADPIX", "D", [0.0] * 2 * _CORNERS),
        many("QUADXYZ", "D", [0.0] * 3 * _CORNERS),
        many("CENTERXYZ", "D", center),
        ("RADIUS", "D", "DEG", np.array([radius_deg])),
        whole("NMATCH", "J", solution.pairs),
        whole("NDISTRACT", "J", max(0, sources - solution.pairs)),
        whole("NCONFLICT", "J", 0),
        whole("NFIELD", "J", sources),
        whole("NINDEX", "J", solution.pairs),
        whole("NAGREE", "J", 0),
        many("CRVAL", "D", [float(cards[f"CRVAL{i}"]) for i in (1, 2)]),
        many("CRPIX", "D", [float(cards[f"CRPIX{i}"]) for i in (1, 2)]),
        many("CD", "D", [float(cards[f"CD{i}_{j}"]) for i in (1, 2) for j in (1, 2)]),
        ("WCS_VALID", "L", "", np.array([True])),
        whole("FIELDNUM", "J", 1),
        whole("FIELDID", "J", 0),
        whole("INDEXID", "I", 0),
        whole("HEALPIX", "I", -1),
        whole("HPNSIDE", "I", 0),
        ("FIELDNAME", f"{_TEXT_LENGTH}A", "", np.array([""])),
        # in this table: whether the sky is mirrored
        ("PARITY", "L", "", np.array([solution.parity < 0])),
        whole("QTRIED", "J", 0),
        whole("QMATCHED", "J", 0),
        whole("QSCALEOK", "J", 0),
        whole("QPEERS", "I", 0),
        whole("NVERIFIED", "J", 0),
        ("TIMEUSED", "E", "s", np.array([cpu_s])),
        ("LOGODDS", "E", "", np.array([log_odds])),
        ("WORSTLOGODDS", "E", "", np.array([log_odds])),
    ]
    return _table(columns, {"AN_FILE": "MATCH"}, {})
