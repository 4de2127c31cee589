"""Fetching of tiles: some at a time, split where the server has too much, all over at the deadline.

Each request runs in a thread of its own that nobody waits for longer than the deadline: neither a name server
that doesn't answer nor a server that sends a byte each second can hold a solve. A thread that is late ends by
itself at its next read, since its client is closed.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from mountnav.catalog.online.answer import columns_of, roles_of
from mountnav.catalog.online.request import (
    MOST_ROWS,
    NotAnswered,
    Overflow,
    SourceFailed,
    Unusable,
    get,
    new_client,
    question,
    quoted,
)
from mountnav.catalog.online.source import OnlineSource
from mountnav.catalog.online.stars import only, stars_of
from mountnav.catalog.online.tile_cache import LARGEST_LEVEL, Record, Tile, TileCache, utc_text
from mountnav.catalog.star_counts import density_deg2 as density_deg2_at
from mountnav.errors import BadSettings

if TYPE_CHECKING:
    import httpx

AT_A_TIME = 3
"""Requests to one server at a time; chosen by hand, with no measurement. Doubled, prefetching may be faster,
and servers may refuse."""
DEEPEST_BELIEVED_MAG = 17.0
"""V; what a table may hold beyond isn't counted on: bands differ, and few tables are complete there."""
SUSPICIOUS_COUNT = 10.0
"""An answer without a star is no answer where the model of the sky has so many: its counts are good to a
factor of two or so, and by chance alone a tile of ten stars is empty once in 20,000."""


@dataclass(slots=True)
class Fetched:
    """What came of it.

    Attributes
    ----------
    records : list of Record
        Tiles that are now in the cache.
    failure : SourceFailed or None
        What ended it before all was there.
    splits : int
        How many tiles were too full.
    """

    records: list[Record] = field(default_factory=list)
    failure: SourceFailed | None = None
    splits: int = 0


def fetch(
    source: OnlineSource,
    cache: TileCache,
    tiles: Sequence[Tile],
    *,
    mag_limit: float | None,
    timeout_s: float,
    wanted: Callable[[Tile], bool],
    came_in: Callable[[Record], None] = lambda record: None,
) -> Fetched:
    """Fetch tiles into the cache.

    Parameters
    ----------
    mag_limit : float or None
        To which magnitude.
    timeout_s : float
        For all of them together.
    wanted : callable
        Of the parts of a tile that must be split: which are to be fetched.
    came_in : callable, optional
        Told of each tile as it comes.

    Returns
    -------
    Fetched
        What came is in the cache even if the rest failed.
    """
    end = time.monotonic() + timeout_s
    waiting = list(tiles)
    under_way = 0
    done: queue.SimpleQueue[tuple[Tile, Record | SourceFailed]] = queue.SimpleQueue()
    result = Fetched()
    client = new_client(source.url, timeout_s)

    def ask(tile: Tile) -> None:
        try:
            done.put((tile, _fetched(client, source, cache, tile, mag_limit, end)))
        except SourceFailed as failure:
            done.put((tile, failure))
        except (OSError, BadSettings) as unwritable:
            done.put((tile, Unusable(f"the cache can't be written: {quoted(str(unwritable))}")))
        except Exception as unforeseen:  # a thread's own end would leave its caller to the deadline
            what = f"{type(unforeseen).__name__}: {unforeseen}"
            done.put((tile, Unusable(f"its answer can't be used: {quoted(what)}")))

    try:
        while waiting or under_way:
            while waiting and under_way < AT_A_TIME:
                threading.Thread(target=ask, args=(waiting.pop(0),), daemon=True, name="stars").start()
                under_way += 1
            try:
                tile, came = done.get(timeout=max(end - time.monotonic(), 0.0))
            except queue.Empty:
                got = f", {len(result.records)} tiles came" if result.records else ""
                result.failure = NotAnswered(f"no answer within {timeout_s:g} s{got}")
                break
            under_way -= 1
            if isinstance(came, Record):
                result.records.append(came)
                came_in(came)
            elif isinstance(came, Overflow) and tile.level < LARGEST_LEVEL:
                result.splits += 1
                waiting += [child for child in tile.children if wanted(child)]
            else:
                result.failure = _in_time(came, timeout_s)
                break
    finally:
        client.close()
    return result


def _in_time(failure: SourceFailed, timeout_s: float) -> SourceFailed:
    if isinstance(failure, NotAnswered) and failure.why == "no answer in time":
        return NotAnswered(f"no answer within {timeout_s:g} s")
    return failure


def _fetched(
    client: httpx.Client,
    source: OnlineSource,
    cache: TileCache,
    tile: Tile,
    mag_limit: float | None,
    end: float,
) -> Record:
    """One tile, from the question to the file."""
    circle = tile.circle()
    asked = question(source, circle, mag_limit)
    blank = Record(
        tile.level,
        tile.pixel,
        source=source.name,
        table=source.table,
        asked=asked,
        mag_limit=mag_limit,
        fetched_utc=utc_text(),
        epoch_yr=0.0,
        band="",
        color_name="",
        stars=0,
    )
    try:
        columns = columns_of(get(client, asked, end=end), asked_rows=MOST_ROWS)
    except Overflow:
        cache.keep(replace(blank, is_split=True), None)
        raise
    if not columns or columns[0].values.size == 0:
        return cache.keep(replace(blank, is_doubtful=_is_doubtful(source, tile, mag_limit)), None)
    roles = roles_of(columns, source)
    received = stars_of(roles, source, circle)
    stars = received.columns
    inside = tile.holds(stars.ra_deg, stars.dec_deg)
    if mag_limit is not None:
        inside &= stars.mag <= mag_limit
    stars = only(stars, inside)
    count = int(stars.ra_deg.size)
    doubtful = count == 0 and _is_doubtful(source, tile, mag_limit)
    record = replace(
        blank,
        epoch_yr=roles.epoch_yr,
        band=roles.band,
        color_name=roles.color_name,
        stars=count,
        left_out=received.without_place + received.doubled,
        is_doubtful=doubtful,
    )
    return cache.keep(record, stars)


def _is_doubtful(source: OnlineSource, tile: Tile, mag_limit: float | None) -> bool:
    """Whether a tile without any star may be an error of the server's.

    Of a table that is known to cover the whole sky it is one, and raises `Unusable`. Another table may cover
    a part of the sky only: its empty answer counts for a short time.
    """
    deep_mag = min(source.faintest_mag if mag_limit is None else mag_limit, source.faintest_mag)
    circle = tile.circle()
    density_deg2 = float(density_deg2_at(circle.ra_deg, circle.dec_deg, min(deep_mag, DEEPEST_BELIEVED_MAG)))
    expected = tile.area_deg2 * density_deg2
    if expected < SUSPICIOUS_COUNT:
        return False
    if source.known is None:
        return True
    raise Unusable(
        f"an empty answer for {tile.area_deg2:.1f} square degrees, where there are about {expected:.0f} stars"
    )
