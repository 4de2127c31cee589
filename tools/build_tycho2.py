"""The recipe of the embedded catalog: Debian's source of Tycho-2 in, tycho2.mnc and tycho2.colors out.

Run from the project's root, after `apt-get source --download-only tycho2` (see tools/README.md)::

    python tools/build_tycho2.py tycho2_2.orig.tar.xz
"""

from __future__ import annotations

import argparse
import hashlib
import sys
import tarfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.packed.companion_colors import write_companion
from mountnav.catalog.packed.error_classes import REFERENCE_YR, classify, error_curve
from mountnav.catalog.packed.packing import CatalogColumns
from mountnav.catalog.space_motion import motion_vectors, places, unit_vectors
from tests.catalog.packed.packing_version_1 import order_of_version_1, pack_version_1

Array = NDArray[np.float64]
Text = NDArray[np.uint8]

SOURCE_SHA256 = "b0d74bd4280e53f7cfc4b37ccb30a1cfbbc30131907dda81c706bbbab5632dfa"
MAIN_FILES = tuple(f"tyc2.dat.{n:02d}" for n in range(20))
SUPPLEMENT_FILE = "suppl_1.dat"
EPOCH_YR = 2000.0
SUPPLEMENT_EPOCH_YR = 1991.25
V_FROM_BT_ALONE_MAG = 0.6
UNKNOWN_MOTION_MAG = (4.5, 5.5, 6.5, 7.5, 8.5, 9.5, 10.5, 11.5, 12.5)
UNKNOWN_MOTION_MAS_YR = (47.0, 38.0, 29.0, 22.5, 17.4, 13.9, 11.6, 10.8, 10.5)
"""How far a star without a proper motion may move, per coordinate: 68.3 % of the Tycho-2 stars of its
magnitude move less (measured on the 2.43 million stars that have one; mean of RA* and Dec)."""


def texts(source: Path) -> tuple[Text, Text]:
    """Read main catalog and supplement 1 as rows of characters."""
    with source.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    if digest != SOURCE_SHA256:
        sys.exit(f"{source}: sha256 is {digest}, expected {SOURCE_SHA256}")
    found: dict[str, bytes] = {}
    with tarfile.open(source, "r:xz") as archive:
        for member in archive:
            name = Path(member.name).name
            content = archive.extractfile(member) if name in (*MAIN_FILES, SUPPLEMENT_FILE) else None
            if content is not None:
                found[name] = content.read()
    main = np.frombuffer(b"".join(found[name] for name in MAIN_FILES), dtype=np.uint8).reshape(-1, 207)
    return main, np.frombuffer(found[SUPPLEMENT_FILE], dtype=np.uint8).reshape(-1, 123)


def column(rows: Text, first: int, last: int) -> Array:
    """Read the numbers in the ReadMe's 1-based columns `first`..`last`; NaN where blank."""
    width = last - first + 1
    fields = np.ascontiguousarray(rows[:, first - 1 : last]).view(f"S{width}").ravel()
    given = np.char.strip(fields) != b""
    values = np.full(fields.size, np.nan)
    values[given] = fields[given].astype(np.float64)
    return values


def v_magnitude(bt: Array, vt: Array) -> Array:
    """Give Johnson V [ReadMe note 7]; VT where BT is missing, BT less a typical color where VT is."""
    v = vt - 0.090 * (bt - vt)
    v = np.where(np.isnan(bt), vt, v)
    return np.where(np.isnan(vt), bt - V_FROM_BT_ALONE_MAG, v)


def b_v_color(bt: Array, vt: Array) -> Array:
    """Give Johnson B-V [ReadMe note 7]; NaN where either magnitude is missing."""
    return 0.850 * (bt - vt)


def main_columns(rows: Text) -> CatalogColumns:
    """Read the main catalog: photocenters merged, stars without a mean position as observed."""
    no_mean = rows[:, 13] == ord("X")
    pair = rows[:, 13] == ord("P")
    ra = np.where(no_mean, column(rows, 153, 164), column(rows, 16, 27))
    dec = np.where(no_mean, column(rows, 166, 177), column(rows, 29, 40))
    mag = v_magnitude(column(rows, 111, 116), column(rows, 124, 129))
    unknown_motion = np.interp(mag, UNKNOWN_MOTION_MAG, UNKNOWN_MOTION_MAS_YR)
    curve = error_curve(
        (
            np.where(no_mean, column(rows, 189, 193), column(rows, 58, 60)),
            np.where(no_mean, column(rows, 195, 199), column(rows, 62, 64)),
        ),
        (
            np.where(no_mean, unknown_motion, column(rows, 66, 69)),
            np.where(no_mean, unknown_motion, column(rows, 71, 74)),
        ),
        (
            np.where(no_mean, 1990.0 + column(rows, 179, 182), column(rows, 76, 82)),
            np.where(no_mean, 1990.0 + column(rows, 184, 187), column(rows, 84, 90)),
        ),
    )
    color = b_v_color(column(rows, 111, 116), column(rows, 124, 129))
    blue, _ = merged_pairs(ra, dec, mag + color, pair)
    mag, keep = merged_pairs(ra, dec, mag, pair)
    return CatalogColumns(
        ra[keep],
        dec[keep],
        column(rows, 42, 48)[keep],
        column(rows, 50, 56)[keep],
        mag[keep],
        curve[keep],
        (blue - mag)[keep],
    )


def merged_pairs(
    ra: Array, dec: Array, mag: Array, pair: NDArray[np.bool_]
) -> tuple[Array, NDArray[np.bool_]]:
    """Give the light of all 'P' lines of one position to the first of them; tell which lines to keep."""
    lines = np.flatnonzero(pair)
    _, first, group = np.unique(
        np.column_stack([ra[lines], dec[lines]]), axis=0, return_index=True, return_inverse=True
    )
    light = np.bincount(group.ravel(), weights=10.0 ** (-0.4 * mag[lines]))
    keep = ~pair
    keep[lines[first]] = True
    together = mag.copy()
    together[lines[first]] = -2.5 * np.log10(light)
    return together, keep


def supplement_columns(rows: Text) -> CatalogColumns:
    """Read supplement 1: Hipparcos stars moved from J1991.25 to J2000, Tycho-1 stars where they were."""
    ra, dec = column(rows, 16, 27), column(rows, 29, 40)
    pm_ra, pm_dec = column(rows, 42, 48), column(rows, 50, 56)
    known = ~np.isnan(pm_ra)
    motion = motion_vectors(ra, dec, np.where(known, pm_ra, 0.0), np.where(known, pm_dec, 0.0))
    moved_ra, moved_dec = places(unit_vectors(ra, dec) + motion * (EPOCH_YR - SUPPLEMENT_EPOCH_YR))
    mag = v_magnitude(column(rows, 84, 89), column(rows, 97, 102))
    # with a letter there, one of the magnitudes is another band's
    color = np.where(rows[:, 81] == ord(" "), b_v_color(column(rows, 84, 89), column(rows, 97, 102)), np.nan)
    unknown_motion = np.interp(mag, UNKNOWN_MOTION_MAG, UNKNOWN_MOTION_MAS_YR)
    epoch = np.full(ra.size, SUPPLEMENT_EPOCH_YR)
    curve = error_curve(
        (column(rows, 58, 62), column(rows, 64, 68)),
        (
            np.where(known, column(rows, 70, 74), unknown_motion),
            np.where(known, column(rows, 76, 80), unknown_motion),
        ),
        (epoch, epoch),
    )
    return CatalogColumns(
        np.where(known, moved_ra, ra), np.where(known, moved_dec, dec), pm_ra, pm_dec, mag, curve, color
    )


def joined(first: CatalogColumns, second: CatalogColumns) -> CatalogColumns:
    """Put both sets of stars into one."""
    return CatalogColumns(
        *(
            np.concatenate([getattr(first, field), getattr(second, field)])
            for field in CatalogColumns.__dataclass_fields__
            if field != "flags"
        )
    )


def report_classes(columns: CatalogColumns) -> None:
    """Print what the error classes cost: each star's sigma by its class against its own."""
    code, classes = classify(columns.error_curve)
    sigma_mas, mean_epoch_yr, sigma_pm_mas_yr = classes.astype(np.float64).T
    for year in (2000.0, 2015.0, 2026.9, 2040.0):
        t = year - REFERENCE_YR
        own = np.sqrt(columns.error_curve @ np.array([1.0, t, t * t]))
        ratio = np.hypot(sigma_mas, (year - mean_epoch_yr) * sigma_pm_mas_yr)[code] / own
        shares = np.percentile(ratio, [0, 1, 16, 50, 84, 99, 100]).round(3)
        print(f"{year}: sigma by class / own sigma, percentiles 0 1 16 50 84 99 100: {shares}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("source", type=Path, help="tycho2_2.orig.tar.xz of Debian's source package tycho2")
    parser.add_argument(
        "--out",
        type=Path,
        default=Path(__file__).resolve().parent.parent / "mountnav" / "catalog" / "data" / "tycho2.mnc",
    )
    arguments = parser.parse_args()
    main_rows, supplement_rows = texts(arguments.source)
    columns = joined(main_columns(main_rows), supplement_columns(supplement_rows))
    header = pack_version_1(columns, arguments.out, name="Tycho-2", band="V", epoch_yr=EPOCH_YR)
    order, _ = order_of_version_1(columns, header.nside)
    assert columns.color_mag is not None
    colors = write_companion(
        arguments.out, header, columns.color_mag[order], color_name="B-V", zero_mag=-1.0, step_mag=0.02
    )
    report_classes(columns)
    print(header)
    for path in (arguments.out, colors):
        written = path.read_bytes()
        print(f"{path.name}: {len(written)} bytes, sha256 {hashlib.sha256(written).hexdigest()}")
    given = columns.color_mag[~np.isnan(columns.color_mag)]
    print(f"B-V: {given.size} known, percentiles 0 0.1 1 50 99 99.9 100:", end=" ")
    print(np.percentile(given, [0, 0.1, 1, 50, 99, 99.9, 100]).round(2))


if __name__ == "__main__":
    main()
