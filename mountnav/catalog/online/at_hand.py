"""Which tiles of a cone are in the cache, however large they are, and which are to be fetched."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

from mountnav.catalog.online.tile_cache import Record, TileCache
from mountnav.catalog.online.tiles import LARGEST_LEVEL, SMALLEST_LEVEL, Tile


@dataclass(frozen=True, slots=True)
class AtHand:
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


def look(
    cache: TileCache,
    tiles: Sequence[Tile],
    *,
    mag_limit: float | None,
    wanted: Callable[[Tile], bool],
    max_age_days: float,
) -> AtHand:
    """See what the cache has.

    Parameters
    ----------
    cache : TileCache
    tiles : sequence of Tile
        Of one level, covering the area.
    mag_limit : float or None
        How deep they must be.
    wanted : callable
        Whether a smaller tile is needed too.
    max_age_days : float
        Older ones are stale.

    Returns
    -------
    AtHand
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
    return AtHand(
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
