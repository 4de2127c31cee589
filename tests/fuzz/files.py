"""Targets that read files from elsewhere: star catalogs of all kinds, packed ones, journals, BLOBs.

Each seed is a good file; the bytes are put where the reader looks for them, under the name it expects.
"""

from __future__ import annotations

import asyncio
import base64
import contextlib
import gzip
import io
import shutil
import tempfile
import zlib
from collections.abc import Callable
from datetime import UTC, datetime
from functools import cache
from pathlib import Path

import numpy as np
from astropy.table import Table

from drivers.indi.codec.exposure import BrokenBlob, content
from drivers.indi.codec.messages import Blob
from mountnav.catalog.packed import PackedStore
from mountnav.catalog.packed.packing import CatalogColumns, pack
from mountnav.catalog.readers import open_reader
from mountnav.errors import MountnavError
from mountnav.journal.database import database_url
from mountnav.journal.reading import JournalReader
from mountnav.journal.sql_journal import open_journal
from mountnav.journal.upkeep import check
from mountnav.pointing.model.model import PointingModel
from mountnav.pointing.observation import PointingObservation, write_observations
from mountnav.sky.coordinates import Icrs
from tests.catalog.readers import astap_files, siril_files, ucac4_zones, usno_b1_files
from tests.journal.samples import look_of, note_of, slew_of

INDEX_FILES = Path(__file__).parents[1] / "catalog" / "readers" / "index_files"


@cache
def folder() -> Path:
    """A place for files, for this process."""
    return Path(tempfile.mkdtemp(prefix="mountnav-fuzz-"))


def _emptied(name: str) -> Path:
    path = folder() / name
    shutil.rmtree(path, ignore_errors=True)
    path.mkdir()
    return path


def _said(told: Exception) -> None:
    assert str(told), "an error without a word"


def catalog(kind: str, name: str) -> Callable[[bytes], None]:
    """A reader of a catalog, given a folder that holds one file of that name."""

    def run(data: bytes) -> None:
        path = _emptied(kind) / name
        path.write_bytes(data)
        try:
            reader = open_reader(kind, path if kind == "gaia" else path.parent)
            for part in reader.parts():
                for _ in reader.read(part):
                    pass
        except MountnavError as told:
            _said(told)

    return run


def _one_file(write: Callable[[Path], object]) -> bytes:
    made = _emptied("seeds")
    write(made)
    (path,) = [path for path in made.iterdir() if path.is_file()]
    return path.read_bytes()


def ucac4_zone() -> bytes:
    """The smallest zone, whole: the reader knows how many stars each has."""
    return _one_file(lambda path: ucac4_zones.write_zones(path, (ucac4_zones.SMALL[0],)))


def usno_zone() -> bytes:
    """Two stars of zone 10."""
    stars = [usno_b1_files.record({"ra": ra, "spd": 370_000}) for ra in (1000, 2000)]
    return _one_file(lambda path: usno_b1_files.write_zone(path, 10, stars))


UCAC4_NAME = f"z{ucac4_zones.SMALL[0]:03d}"
ASTAP_NAME = f"d50_{astap_files.label(10.0, 3.0, 1476)}.1476"


def astap_area() -> bytes:
    """Two stars of one area."""
    stars = [astap_files.Star(10.0, 3.0, 100), astap_files.Star(10.1, 3.1, 105)]
    return _one_file(lambda path: astap_files.write_areas(path, stars))


def siril_file() -> bytes:
    """Two stars at a coarse level."""
    return siril_files.whole([siril_files.Star(10.0, 3.0), siril_files.Star(200.0, -50.0)], 1)


def index_file() -> bytes:
    """One of astrometry.net's, unpacked."""
    return gzip.decompress(min(INDEX_FILES.glob("*.gz"), key=lambda path: path.stat().st_size).read_bytes())


def _gaia() -> Table:
    return Table(
        {
            "source_id": np.array([1, 2], np.int64),
            "ra": np.array([10.0, 10.1]),
            "dec": np.array([20.0, 20.1]),
            "pmra": np.array([1.0, np.nan]),
            "pmdec": np.array([2.0, np.nan]),
            "ref_epoch": np.array([2016.0, 2016.0]),
            "phot_g_mean_mag": np.array([12.0, 13.0], np.float32),
        }
    )


def observations() -> list[bytes]:
    """A file with two observations, one with all that may be told."""
    utc = datetime(2026, 11, 21, tzinfo=UTC)
    two = [
        PointingObservation(utc, Icrs(1.0, 2.0), 0.5, Icrs(1.1, 2.0), look_id=f"look {number}")
        for number in (1, 2)
    ]
    path = folder() / "observations"
    write_observations(path, two)
    return [path.read_bytes()]


def model() -> bytes:
    """A pointing model of two terms."""
    made = PointingModel(
        id="m",
        kind="equatorial",
        site_latitude_deg=48.1,
        does_refraction=False,
        terms=("IH", "ID"),
        coefficients_arcsec=(100.0, -50.0),
        sigma_arcsec=(5.0, 5.0),
        covariance_arcsec2=((25.0, 0.0), (0.0, 25.0)),
        scatter_arcsec=20.0,
        made_utc=datetime(2026, 11, 21, tzinfo=UTC),
    )
    return made.to_json().encode()


def gaia_votable() -> bytes:
    """The same stars as a VOTable."""
    text = io.BytesIO()
    _gaia().write(text, format="votable")
    return text.getvalue()


def gaia_fits() -> bytes:
    """Two stars as the archive's FITS has them."""
    file = io.BytesIO()
    _gaia().write(file, format="fits")
    return file.getvalue()


def gaia_parquet() -> bytes:
    """Two stars as Parquet."""
    import pyarrow
    import pyarrow.parquet

    file = io.BytesIO()
    table = _gaia()
    pyarrow.parquet.write_table(
        pyarrow.table({name: np.asarray(table[name]) for name in table.colnames}), file
    )
    return file.getvalue()


def packed() -> bytes:
    """A packed catalog of three stars."""
    columns = CatalogColumns(
        ra_deg=np.array([10.0, 10.1, 200.0]),
        dec_deg=np.array([20.0, 20.1, -50.0]),
        pm_ra_cosdec_mas_yr=np.array([1.0, -500.0, np.nan]),
        pm_dec_mas_yr=np.array([2.0, 400.0, np.nan]),
        mag=np.array([9.0, 10.0, 11.0]),
        error_curve=np.ones((3, 3)),
    )
    made = _emptied("seeds") / "packed.mnc"
    pack(columns, made, name="seed", band="V", epoch_yr=2000.0, nside=1)
    return made.read_bytes()


def read_packed(data: bytes) -> None:
    """Open a packed catalog, and take stars out of all of it."""
    path = folder() / "packed.mnc"
    path.unlink(missing_ok=True)
    path.write_bytes(data)
    try:
        store = PackedStore(path)
        for center, radius_deg in ((Icrs(10.0, 20.0), 3.0), (Icrs(0.0, 90.0), 180.0)):
            stars = store.cone(center, radius_deg, epoch_yr=2026.9)
            assert np.isfinite(stars.ra_deg).all()
            assert (np.abs(stars.dec_deg) <= 90.0).all()
    except MountnavError as told:
        _said(told)


def journal() -> bytes:
    """A journal of one run, with a look, an order and a note."""
    made = _emptied("seeds") / "journal.sqlite"
    kept = open_journal(made, inline=True)

    async def told() -> None:
        await kept.look(look_of())
        await kept.begin(slew_of())
        await kept.note(note_of("a note"))

    asyncio.run(told())
    kept.close()
    return made.read_bytes()


def read_journal(data: bytes) -> None:
    """Read all of a journal that came from elsewhere."""
    path = _emptied("journals") / "journal.sqlite"
    path.write_bytes(data)
    reader = JournalReader(path)
    asked = (reader.runs, reader.commands, reader.looks, reader.entries, reader.in_flight)
    # and what a service does with it that starts
    for ask in (*asked, lambda: check(database_url(path)), lambda: open_journal(path, inline=True).close()):
        try:
            ask()
        except MountnavError as told:
            _said(told)


def blob(data: bytes) -> None:
    """A camera's file as INDI wraps it: its format and sizes come first, then base64 of it."""
    head, _, encoded = data.partition(b"|")
    words = head.decode("utf-8", "replace").split(" ")
    numbers = []
    for word in words[1:3]:
        with contextlib.suppress(ValueError):
            numbers.append(int(word[:12]))
    size, length = (*numbers, 0, 0)[:2]
    pieces = tuple(encoded[at : at + 64] for at in range(0, len(encoded), 64))
    try:
        content(Blob(words[0], size, length or None, pieces))
    except BrokenBlob as told:
        _said(told)


def blobs() -> list[bytes]:
    """Plain, packed, and tile-compressed."""
    file = b"SIMPLE  =                    T" + bytes(200)
    return [
        b".fits %d %d|" % (len(file), 0) + base64.b64encode(file),
        b".fits.z %d 0|" % len(file) + base64.encodebytes(zlib.compress(file)),
        b".fits.fz 9000 %d|" % len(file) + base64.b64encode(file + b"rest"),
    ]


__all__ = [
    "ASTAP_NAME",
    "UCAC4_NAME",
    "astap_area",
    "blob",
    "blobs",
    "catalog",
    "folder",
    "gaia_fits",
    "gaia_parquet",
    "index_file",
    "journal",
    "packed",
    "read_journal",
    "read_packed",
    "siril_file",
    "ucac4_zone",
    "usno_zone",
]
