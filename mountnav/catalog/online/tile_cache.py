"""Tiles on disk: what was fetched, from where, when; written as a whole or not at all, checked when opened.

::

    <cache>/online/<name>/<fingerprint>/<level>/
        <pixel>.json          the record: the tile is what this says
        <pixel>-<hash>.mnc    its stars, packed; none if it has none

The record names the file of stars by its hash and is renamed into place last. So processes that fetch the
same tile at the same time do double work and no harm: whoever comes last wins, with a file of its own, and
removes the others'. Only that last step, renaming and removing, takes a lock.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import threading
from collections import OrderedDict
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

from mountnav.catalog.online.source import OnlineSource
from mountnav.catalog.online.tiles import SMALLEST_LEVEL, Tile
from mountnav.catalog.packed import PackedStore
from mountnav.catalog.packed.packing import CatalogColumns, pack
from mountnav.errors import BadSettings
from mountnav.files import locked
from mountnav.parsing import json_of

MOST_OPEN = 256
DOUBTFUL_DAYS = 0.5
"""For so long an empty answer that may be an error counts: a night; the next night asks again."""
_NSIDE = 1
"""Of the packed files: a tile is read as a whole anyway."""


@dataclass(frozen=True, slots=True)
class Record:
    """What is known of a tile.

    Attributes
    ----------
    level, pixel : int
    source : str
        Name of the catalog.
    table, asked : str
        The table, and the address that was asked.
    mag_limit : float or None
        To which it was fetched; None: all the table has.
    fetched_utc : str
        ISO 8601.
    epoch_yr : float
    band, color_name : str
    stars : int
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
        return (now - datetime.fromisoformat(self.fetched_utc)).total_seconds() / 86400.0

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
    source : OnlineSource
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
