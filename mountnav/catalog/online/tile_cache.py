"""HEALPix tiles of mixed levels on disk: written whole or not at all, checked when they are opened.

::

    <cache>/online/<name>/<fingerprint>/<level>/
        <pixel>.json          the record: the tile is what this says
        <pixel>-<hash>.mnc    its stars, packed; none if it has none

The record names the file of stars by its hash and is renamed into place last. So processes that fetch the
same tile at the same time do double work and no harm: the last one wins, with a file of its own, and
removes the others'. Only that last step, renaming and removing, takes a lock.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.online.request import Circle
from mountnav.catalog.online.source import OnlineSource
from mountnav.catalog.packed import PackedStore
from mountnav.catalog.packed.packing import CatalogColumns, pack
from mountnav.catalog.packed.pixels import pixel_centers
from mountnav.catalog.space_motion import places, unit_vectors
from mountnav.errors import BadSettings
from mountnav.files import locked
from mountnav.parsing import json_of
from mountnav.units import SECONDS_PER_DAY, SKY_DEG2

Array = NDArray[np.float64]

SMALLEST_LEVEL, LARGEST_LEVEL = 3, 11
"""Tiles of 7.3° to 1.7′."""
_START_LEVEL = 6
"""HEALPix level at which the tiles of a cone are looked for first, before they are divided; chosen by hand,
for speed alone: the tiles found are the same."""
_EDGE_POINTS = 16
"""Points on each of a tile's four edges by which its distance from a cone is judged, with a margin for what
lies between them; chosen by hand. Halved, the margin doubles, and a few tiles more are fetched than
needed."""
_PADDING_DEG = 60.0 / 3600.0
"""A tile is asked for with this margin: a server's index may hold the places of another epoch."""
_DEPTHS = ((12.5, 4), (14.5, 5), (17.0, 6))
"""To which magnitude a tile of which level holds some thousand stars at most in the Milky Way."""
_DEEPEST_LEVEL = 7
"""Level of tiles that are fetched deeper than `_DEPTHS`: 0.46° wide. One level more, and deep tiles come in
four times as many requests of a quarter of the stars."""
_WIDE_DEG = 0.35
"""Cones of a larger radius are fetched in tiles one level larger, so that a few requests do; chosen by hand.
Halved, common fields of 1° fetch more sky than they need."""


@dataclass(frozen=True, slots=True, order=True)
class Tile:
    """A HEALPix pixel.

    Attributes
    ----------
    level : int
        nside is 2**level.
    pixel : int
        NESTED.
    """

    level: int
    pixel: int

    @property
    def nside(self) -> int:
        """Resolution."""
        return int(2**self.level)

    @property
    def parent(self) -> Tile:
        """The tile of the next coarser level that holds it."""
        return Tile(self.level - 1, self.pixel >> 2)

    @property
    def children(self) -> tuple[Tile, ...]:
        """The four tiles that it is split into."""
        return tuple(Tile(self.level + 1, 4 * self.pixel + one) for one in range(4))

    @property
    def area_deg2(self) -> float:
        """Square degrees."""
        return SKY_DEG2 / (12 * self.nside**2)

    def circle(self) -> Circle:
        """A circle that holds the tile with a margin."""
        center = _center(self)
        edge = _edge(self)
        half_chord = 0.5 * float(np.sqrt(((edge - center[:, np.newaxis]) ** 2).sum(axis=0).max()))
        ra_deg, dec_deg = places(center[:, np.newaxis])
        radius_deg = 2.0 * float(np.degrees(np.arcsin(half_chord)))
        return Circle(float(ra_deg[0]), float(dec_deg[0]), radius_deg * 1.002 + _PADDING_DEG)

    def holds(self, ra_deg: Array, dec_deg: Array) -> NDArray[np.bool_]:
        """Which positions lie in it, exactly: each position lies in one tile of a level."""
        from astropy import units
        from astropy_healpix import lonlat_to_healpix

        pixels = lonlat_to_healpix(ra_deg * units.deg, dec_deg * units.deg, nside=self.nside, order="nested")
        inside: NDArray[np.bool_] = np.asarray(pixels == self.pixel)
        return inside

    def touches(self, axis: Array, radius_deg: float) -> bool:
        """Whether a cone reaches into it; true for some that it misses by a 32nd of their size.

        Parameters
        ----------
        axis : ndarray, shape (3,)
            Unit vector of the cone's center.
        """
        # its points stand a 16th of a side apart: no place of the edge is farther from one than half that
        slack_deg = np.degrees(1.1 * np.sqrt(4.0 * np.pi / (12 * self.nside**2)) / _EDGE_POINTS)
        chord2 = ((_edge(self) - axis[:, np.newaxis]) ** 2).sum(axis=0).min()
        if chord2 <= (2.0 * np.sin(np.radians(min(radius_deg + slack_deg, 180.0)) / 2.0)) ** 2:
            return True
        ra_deg, dec_deg = places(axis[:, np.newaxis])
        return bool(self.holds(ra_deg, dec_deg)[0])


def tiles_of(axis: Array, radius_deg: float, level: int) -> list[Tile]:
    """The tiles of a level that a cone reaches into.

    Parameters
    ----------
    axis : ndarray, shape (3,)
        Unit vector of the cone's center.
    level : int
        `SMALLEST_LEVEL` to `LARGEST_LEVEL`.

    Returns
    -------
    list of Tile
        In rising order; none is missing.
    """
    start = min(level, _START_LEVEL)
    reach = np.radians(min(radius_deg + _largest_radius_deg(start), 180.0))
    chosen = np.flatnonzero(axis @ pixel_centers(2**start) >= np.cos(reach))
    found = [Tile(start, int(pixel)) for pixel in chosen]
    found = [tile for tile in found if tile.touches(axis, radius_deg)]
    while found and found[0].level < level:
        found = [child for tile in found for child in tile.children if child.touches(axis, radius_deg)]
    return found


def level_for(mag_limit: float | None, faintest_mag: float, radius_deg: float) -> int:
    """How large tiles are: a few thousand stars in each, and few of them for a cone.

    Parameters
    ----------
    mag_limit : float or None
        To which they are fetched.
    faintest_mag : float
        Of the table; infinite if unknown.
    radius_deg : float
        Of the cone.

    Returns
    -------
    int
        Where the sky is richer, or the table deeper, than thought, the server's overflow splits a tile.
    """
    deep = min(faintest_mag, np.inf if mag_limit is None else mag_limit)
    level = next((one for depth, one in _DEPTHS if deep <= depth), _DEEPEST_LEVEL)
    return level - 1 if radius_deg > _WIDE_DEG else level


def axis_of(ra_deg: float, dec_deg: float) -> Array:
    """Unit vector, shape (3,)."""
    return np.asarray(unit_vectors(ra_deg, dec_deg), dtype=float).reshape(3)


def _largest_radius_deg(level: int) -> float:
    # the farthest corner of a pixel is 1.13 sides from its center or nearer (HEALPix, max_pixrad)
    return float(np.degrees(1.2 * np.sqrt(4.0 * np.pi / (12 * 4**level))))


@lru_cache(maxsize=4096)
def _edge(tile: Tile) -> Array:
    """Points of its edge, shape (3, 4 * _EDGE_POINTS), as unit vectors."""
    from astropy_healpix import boundaries_lonlat

    lon, lat = boundaries_lonlat([tile.pixel], step=_EDGE_POINTS, nside=tile.nside, order="nested")
    return np.asarray(unit_vectors(lon.to_value("deg")[0], lat.to_value("deg")[0]), dtype=float)


@lru_cache(maxsize=4096)
def _center(tile: Tile) -> Array:
    from astropy_healpix import healpix_to_lonlat

    lon, lat = healpix_to_lonlat([tile.pixel], nside=tile.nside, order="nested")
    return axis_of(float(lon.to_value("deg")[0]), float(lat.to_value("deg")[0]))


MOST_OPEN = 256
"""Tiles that are kept open (mapped) at once; chosen by hand, below the usual limit of 1024 open files.
Halved, only prefetching over large areas opens files more often."""
DOUBTFUL_DAYS = 0.5
"""For so long an empty answer that may be an error counts: a night; the next night asks again."""
_NSIDE = 1
"""Of the packed files: a tile is read as a whole anyway."""


@dataclass(frozen=True, slots=True)
class Record:
    """What is known of a tile.

    Attributes
    ----------
    source : str
        Name of the catalog.
    table, asked : str
        The table, and the address that was asked.
    mag_limit : float or None
        To which it was fetched; None: all the table has.
    fetched_utc : str
        ISO 8601.
    left_out : int
        Rows without a position, or twice there.
    file : str
        Name of the file of stars; empty if there are none.
    sha256 : str
        Of that file.
    is_split : bool
        The server had more than fits into one answer: see the tiles of the next finer level.
    is_doubtful : bool
        Without a star where the sky has some, by a table that may not cover the whole sky: believed for
        `DOUBTFUL_DAYS` only.
    """

    level: int
    pixel: int
    source: str
    table: str
    asked: str
    mag_limit: float | None
    fetched_utc: str
    epoch_yr: float
    band: str
    color_name: str
    stars: int
    left_out: int = 0
    file: str = ""
    sha256: str = ""
    is_split: bool = False
    is_doubtful: bool = False

    @property
    def tile(self) -> Tile:
        """Which tile."""
        return Tile(self.level, self.pixel)

    @property
    def date(self) -> str:
        """Day on which it was fetched: "2026-08-01"."""
        return self.fetched_utc[:10]

    def age_days(self, now: datetime) -> float:
        """How old it is; negative if the clock was wrong."""
        return (now - datetime.fromisoformat(self.fetched_utc)).total_seconds() / SECONDS_PER_DAY

    def is_fresh(self, now: datetime, max_age_days: float) -> bool:
        """Whether it needn't be fetched again."""
        return self.age_days(now) <= (min(max_age_days, DOUBTFUL_DAYS) if self.is_doubtful else max_age_days)

    def is_deep_enough(self, mag_limit: float | None) -> bool:
        """Whether it holds all stars to a magnitude; None: to the end of the table."""
        return self.mag_limit is None or (mag_limit is not None and self.mag_limit >= mag_limit - 1e-9)


class TileCache:
    """The tiles of one source. Any number of threads and processes may use the same folder.

    Parameters
    ----------
    cache : Path
        The user's cache folder; it need not exist.
    """

    def __init__(self, cache: Path, source: OnlineSource) -> None:
        self.folder = cache / "online" / source.name
        self._source = source
        self._tiles = self.folder / source.fingerprint()
        self._open: OrderedDict[Path, PackedStore] = OrderedDict()
        self._lock = threading.Lock()

    def record(self, tile: Tile) -> Record | None:
        """The record of a tile; None if there is none, or it is damaged."""
        path = self._record_path(tile)
        try:
            record = Record(**json_of(path.read_text("utf-8")))
            datetime.fromisoformat(record.fetched_utc)
        except (OSError, ValueError, TypeError):
            return None
        return record if record.tile == tile else None

    def covering(self, tile: Tile, mag_limit: float | None) -> Record | None:
        """The record of the tile or of a larger one around it that is deep enough and not split."""
        while tile.level >= SMALLEST_LEVEL:
            record = self.record(tile)
            if record is not None and not record.is_split and record.is_deep_enough(mag_limit):
                return record
            tile = tile.parent
        return None

    def is_split(self, tile: Tile, mag_limit: float | None) -> bool:
        """Whether the tile is known to hold more stars than one answer may, to that magnitude."""
        record = self.record(tile)
        if record is None or not record.is_split:
            return False
        return mag_limit is None or (record.mag_limit is not None and record.mag_limit <= mag_limit)

    def stars(self, record: Record) -> PackedStore | None:
        """Open the stars of a tile.

        Parameters
        ----------
        record : Record
            Of a tile that has some.

        Returns
        -------
        PackedStore or None
            None if the file is missing or damaged: its hash is compared when it is first opened.
        """
        path = self._record_path(record.tile).with_name(record.file)
        with self._lock:
            if path in self._open:
                self._open.move_to_end(path)
                return self._open[path]
        try:
            if hashlib.sha256(path.read_bytes()).hexdigest() != record.sha256:
                return None
            store = PackedStore(path)
        except (OSError, BadSettings):
            return None
        if len(store) != record.stars or store.header.epoch_yr != record.epoch_yr:
            return None
        with self._lock:
            self._open[path] = store
            while len(self._open) > MOST_OPEN:
                self._open.popitem(last=False)
        return store

    def keep(self, record: Record, columns: CatalogColumns | None) -> Record:
        """Write a tile.

        Parameters
        ----------
        record : Record
            Without file and hash.
        columns : CatalogColumns or None
            Its stars; None if it has none, or is split.

        Returns
        -------
        Record
            As written.

        Raises
        ------
        OSError, BadSettings
            The cache can't be written.
        """
        path = self._record_path(record.tile)
        path.parent.mkdir(parents=True, exist_ok=True)
        own = f".{os.getpid()}-{threading.get_ident()}-{record.pixel}"
        fresh, note = path.with_name(f"{own}.mnc"), path.with_name(f"{own}.json")
        try:
            if columns is not None and columns.ra_deg.size:
                pack(
                    columns,
                    fresh,
                    name=record.source,
                    band=record.band,
                    epoch_yr=record.epoch_yr,
                    nside=_NSIDE,
                    color_name=record.color_name,
                    made_from=f"{record.table or record.source}, fetched {record.fetched_utc}",
                )
                digest = hashlib.sha256(fresh.read_bytes()).hexdigest()
                record = replace(record, file=f"{record.pixel}-{digest[:12]}.mnc", sha256=digest)
            note.write_text(json.dumps(asdict(record), indent=1, sort_keys=True) + "\n", "utf-8")
            # two who keep the same tile must not remove each other's stars from under the record
            with self._writing():
                if record.file:
                    fresh.replace(path.with_name(record.file))
                note.replace(path)
                for older in path.parent.glob(f"{record.pixel}-*.mnc"):
                    if older.name != record.file:
                        # who has it mapped keeps it; who has just read the old record reads again
                        with suppress(OSError):
                            older.unlink()
        finally:
            fresh.unlink(missing_ok=True)
            note.unlink(missing_ok=True)
        return record

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """Hold the folder against other threads and processes."""
        with locked(self.folder / "lock"):
            yield

    def records(self) -> Iterator[Record]:
        """All tiles that hold something, in no order."""
        for path in sorted(self._tiles.glob("*/*.json")):
            with suppress(ValueError):
                record = self.record(Tile(int(path.parent.name), int(path.stem)))
                if record is not None and not record.is_split:
                    yield record

    def size_bytes(self) -> int:
        """What all of it takes on disk, tiles of earlier settings included."""
        size = 0
        for folder, _, names in os.walk(self.folder):
            for name in names:
                # what is being written or removed meanwhile may be gone by now, under this name
                with suppress(FileNotFoundError):
                    size += Path(folder, name).stat().st_size
        return size

    def clear(self) -> None:
        """Remove all tiles of the source, those of earlier settings too."""
        with self._lock:
            self._open.clear()
        shutil.rmtree(self.folder, ignore_errors=True)

    def _record_path(self, tile: Tile) -> Path:
        return self._tiles / str(tile.level) / f"{tile.pixel}.json"


def utc_text() -> str:
    """Now, as records have it."""
    return datetime.now(UTC).isoformat(timespec="seconds")


@dataclass(frozen=True, slots=True)
class CachedArea:
    """What the cache has of an area.

    Attributes
    ----------
    fresh, stale : tuple of Record
        Sound tiles; none lies inside another.
    missing : tuple of Tile
        Those that are not there, not deep enough, or damaged.
    damaged : int
        How many were found damaged.
    """

    fresh: tuple[Record, ...]
    stale: tuple[Record, ...]
    missing: tuple[Tile, ...]
    damaged: int = 0

    @property
    def records(self) -> tuple[Record, ...]:
        """All that can be used."""
        return (*self.stale, *self.fresh)

    @property
    def to_fetch(self) -> tuple[Tile, ...]:
        """What is not there, and what is old."""
        return (*self.missing, *(record.tile for record in self.stale))

    @property
    def is_complete_and_fresh(self) -> bool:
        """Whether nothing needs to be fetched."""
        return not self.missing and not self.stale


def cached_area(
    cache: TileCache,
    tiles: Sequence[Tile],
    *,
    mag_limit: float | None,
    wanted: Callable[[Tile], bool],
    max_age_days: float,
) -> CachedArea:
    """See what the cache has.

    Parameters
    ----------
    tiles : sequence of Tile
        Of one level, covering the area.
    mag_limit : float or None
        How deep they must be.
    wanted : callable
        Whether a smaller tile is needed too.
    max_age_days : float
        Older ones are stale.
    """
    found: dict[Tile, Record] = {}
    damaged: set[Tile] = set()
    missing: list[Tile] = []
    for tile in tiles:
        records, lacking = _of_tile(cache, tile, mag_limit, wanted, damaged)
        found |= {record.tile: record for record in records}
        missing += lacking
    now = datetime.now(UTC)
    outer = [record for tile, record in found.items() if not any(one in found for one in _around(tile))]
    # parts of a larger tile that was found for a neighbor are there with it
    missing = [tile for tile in missing if not any(one in found for one in _around(tile))]
    return CachedArea(
        fresh=tuple(record for record in outer if record.is_fresh(now, max_age_days)),
        stale=tuple(record for record in outer if not record.is_fresh(now, max_age_days)),
        missing=tuple(missing),
        damaged=len(damaged),
    )


def _of_tile(
    cache: TileCache,
    tile: Tile,
    mag_limit: float | None,
    wanted: Callable[[Tile], bool],
    damaged: set[Tile],
) -> tuple[list[Record], list[Tile]]:
    """Records that cover a tile, and what of it is missing."""
    record = cache.covering(tile, mag_limit)
    if record is not None and not _is_sound(cache, record):
        # its stars may have been replaced since the record was read
        record = cache.covering(tile, mag_limit)
    if record is not None and _is_sound(cache, record):
        return [record], []
    if record is not None:
        damaged.add(record.tile)
    if tile.level >= LARGEST_LEVEL:
        return [], [tile]
    is_split = cache.is_split(tile, mag_limit)
    parts = [child for child in tile.children if wanted(child)]
    if not is_split and not any(cache.record(child) for child in parts):
        return [], [tile]
    records: list[Record] = []
    missing: list[Tile] = []
    for child in parts:
        there, lacking = _of_tile(cache, child, mag_limit, wanted, damaged)
        records += there
        missing += lacking
    # some parts of a tile that isn't known to be too full: fetched as a whole it is one request
    return (records, missing) if is_split or not missing else ([], [tile])


def _is_sound(cache: TileCache, record: Record) -> bool:
    return record.stars == 0 or cache.stars(record) is not None


def _around(tile: Tile) -> list[Tile]:
    """The larger tiles that hold a tile."""
    around = []
    while tile.level > SMALLEST_LEVEL:
        tile = tile.parent
        around.append(tile)
    return around
