"""The online catalog: fresh cache, live, stale cache, and then the catalog that stands behind it.

A cone is taken as a whole from one of them, never in parts from two catalogs. `Stars.steps` tells the way.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.online.fetching import Fetched, fetch
from mountnav.catalog.online.request import NotAnswered, limit_column
from mountnav.catalog.online.source import OnlineSource
from mountnav.catalog.online.tile_cache import (
    CachedArea,
    Record,
    Tile,
    TileCache,
    axis_of,
    cached_area,
    level_for,
    tiles_of,
)
from mountnav.catalog.stars import Catalog, Stars
from mountnav.errors import BadRequest, StarsUnavailable
from mountnav.sky.coordinates import Icrs

FIRST_REST_S = 120.0
"""Seconds for which a source is not asked after its first failure; chosen by hand. Halved, a night without a
network waits for the time limit twice as often."""
LONGEST_REST_S = 900.0
"""Seconds for which a source is not asked however often it failed: each rest is twice the one before, up to
this; chosen by hand. A network that comes back is noticed within so long."""


@dataclass(frozen=True, slots=True)
class Failure:
    """A source's last failure.

    Attributes
    ----------
    until : float
        By `time.monotonic`: when it may be asked again.
    rest_s : float
        How long it rests; the next failure in a row doubles it.
    """

    why: str
    until: float
    rest_s: float

    @property
    def left_s(self) -> float:
        """How long it still rests."""
        return max(self.until - time.monotonic(), 0.0)


_failures: dict[str, Failure] = {}
_lock = threading.Lock()


def resting(key: str) -> Failure | None:
    """The failure for which a source still rests; None if it may be asked.

    Parameters
    ----------
    key : str
        Which source; known in the whole process.
    """
    with _lock:
        failure = _failures.get(key)
    return failure if failure is not None and failure.left_s > 0.0 else None


def failed(key: str, why: str) -> Failure:
    """Let a source rest: two minutes, after each further failure twice as long, at most 15 minutes."""
    with _lock:
        before = _failures.get(key)
        rest_s = FIRST_REST_S if before is None else min(2.0 * before.rest_s, LONGEST_REST_S)
        failure = _failures[key] = Failure(why, time.monotonic() + rest_s, rest_s)
    return failure


def answered(key: str) -> None:
    """The source works: forget its failures."""
    with _lock:
        _failures.pop(key, None)


def joined(parts: Sequence[Stars], source: str) -> Stars | None:
    """Put the stars of all tiles together, brightest first.

    Parameters
    ----------
    parts : sequence of Stars
        At one epoch, none empty; no star lies in two of them.
    source : str
        Name of the catalog.

    Returns
    -------
    Stars or None
        None if there are no parts.
    """
    if not parts:
        return None

    def all_of(what: str) -> NDArray[Any]:
        return np.concatenate([getattr(part, what) for part in parts])

    first = parts[0]
    whole = Stars(
        ra_deg=all_of("ra_deg"),
        dec_deg=all_of("dec_deg"),
        sigma_arcsec=all_of("sigma_arcsec"),
        mag=all_of("mag"),
        pm_ra_cosdec_mas_yr=all_of("pm_ra_cosdec_mas_yr"),
        pm_dec_mas_yr=all_of("pm_dec_mas_yr"),
        epoch_yr=first.epoch_yr,
        band=first.band,
        source=source,
        color_mag=all_of("color_mag"),
        flags=all_of("flags"),
        color_name=first.color_name,
    )
    return whole.only(np.argsort(whole.mag, kind="stable"))


def tiles_text(count: int) -> str:
    """In words: "1 tile", "3 tiles"."""
    return "1 tile" if count == 1 else f"{count} tiles"


def fetched_text(came: Fetched, host: str) -> str:
    """What was fetched from where; empty if nothing was."""
    if not came.records:
        return ""
    split = f", {tiles_text(came.splits)} too full and split" if came.splits else ""
    return f"{tiles_text(len(came.records))} fetched from {host}{split}"


def cached_text(found: CachedArea, is_just_fetched: bool) -> str:
    """Which tiles were taken from the cache, and of which age."""
    today = datetime.now(UTC).date().isoformat()
    parts = []
    for records, what in ((found.stale, "stale "), (found.fresh, "")):
        # a tile of today that was there before is not worth a word beside those that came just now
        told = [record.date for record in records if not (is_just_fetched and record.date == today)]
        if told:
            days = min(told) if min(told) == max(told) else f"{min(told)} to {max(told)}"
            tiles = tiles_text(len(told)).replace(" ", f" {what}", 1)
            parts.append(f"{tiles} of {days} taken" if what else f"{tiles} from the cache of {days}")
    return ", ".join(parts)


Array = NDArray[np.float64]

MOST_REQUESTS = 16
"""For one cone. A wider prefetch goes on in rounds."""
FASTEST_ARCSEC_YR = 10.5
"""Barnard's star: from so far outside a cone a star may have come."""
DEPTHS_MAG = (12.0, 14.0, 16.0, 18.0, 20.0)
"""To which tiles are fetched if the settings don't say: cones of like depth then share them."""
_PER_ROUND = 3
"""Tiles that share the time of one cone: as many as are asked for at once."""


@dataclass(frozen=True, slots=True)
class Prefetched:
    """Report of a prefetch.

    Attributes
    ----------
    tiles : int
        How many the area has.
    fetched : int
        How many of them were asked for and came.
    problem : str or None
        Why some didn't come.
    """

    tiles: int
    fetched: int
    problem: str | None = None


@dataclass(frozen=True, slots=True)
class CachedTiles:
    """What of a source lies in the cache.

    Attributes
    ----------
    area_deg2 : float
        How much of the sky that is, larger and smaller tiles of the same place counted twice.
    oldest, newest : str
        Days, "2026-08-01"; empty if there are none.
    """

    tiles: int
    stars: int
    area_deg2: float
    size_bytes: int
    oldest: str = ""
    newest: str = ""


class OnlineCatalog:
    """A catalog on the network with its cache. Implements `mountnav.catalog.stars.Catalog`.

    Safe to share between threads, and it may be sent to another process.

    Parameters
    ----------
    cache : Path
        The user's cache folder.
    behind : Catalog or None
        Whose stars are taken where this one has none: the catalogs on this machine, or the embedded one.
    """

    def __init__(self, source: OnlineSource, cache: Path, *, behind: Catalog | None) -> None:
        self.source = source
        self.behind = behind
        self._folder = cache
        self._cache = TileCache(cache, source)
        self._key = f"{source.name} {source.url} {source.table}"

    @property
    def name(self) -> str:
        """Name for provenance."""
        return self.source.name

    @property
    def faintest_mag(self) -> float:
        """Hardly a star is fainter; infinite if that isn't known."""
        return self.source.faintest_mag

    def __reduce__(self) -> tuple[object, tuple[OnlineSource, Path, Catalog | None]]:
        return _opened, (self.source, self._folder, self.behind)

    def __repr__(self) -> str:
        return f"OnlineCatalog({self.source.name!r}, {self.source.host})"

    def cone(
        self, center: Icrs, radius_deg: float, *, epoch_yr: float, mag_limit: float | None = None
    ) -> Stars:
        """Stars within `radius_deg` of `center`, at `epoch_yr`, to `mag_limit`, brightest first.

        Waits for the network for `timeout_s` of the source at most, whatever the server does.

        Parameters
        ----------
        radius_deg : float
            0 to 180.
        epoch_yr : float
            Julian year.
        mag_limit : float, optional
            Faintest magnitude that is wanted, inclusive.

        Returns
        -------
        Stars
            Of this catalog, or of the one behind it: see `Stars.source` and `Stars.steps`.

        Raises
        ------
        BadRequest
            A value is not finite or out of range.
        StarsUnavailable
            There are none, and no catalog behind this one.
        """
        _require_sensible(center, radius_deg, epoch_yr, mag_limit)
        if radius_deg > self.source.max_radius_deg:
            why = f"not asked: a cone of {radius_deg:.1f}° is wider than {self.source.max_radius_deg:g}°"
            return self._from_behind(why, center, radius_deg, epoch_yr, mag_limit)
        axis, reach_deg = self._reach(center, radius_deg, epoch_yr)
        depth = self._depth(mag_limit)
        level = level_for(depth, self.source.faintest_mag, radius_deg)
        found = self._look(axis, reach_deg, level, depth)
        damaged = f"{tiles_text(found.damaged)} in the cache damaged" if found.damaged else ""
        told, why = "", ""
        if not found.is_complete_and_fresh:
            why = self._why_not_asked(found)
            if not why:
                came = self._fetch(found.to_fetch, axis, reach_deg, depth, self.source.timeout_s)
                told = fetched_text(came, self.source.host)
                why = "" if came.failure is None else came.failure.why
                found = self._look(axis, reach_deg, level, depth)
        if found.missing:
            why = why or f"{len(found.missing)} tiles can't be kept in the cache"
            return self._from_behind(why, center, radius_deg, epoch_yr, mag_limit)
        stars = self._joined(found.records, center, radius_deg, epoch_yr, mag_limit)
        if stars is None:
            return self._from_behind("it has no stars here", center, radius_deg, epoch_yr, mag_limit)
        steps = [part for part in (damaged, why, told, cached_text(found, bool(told))) if part]
        return replace(stars, steps=(f"{self.name}: {'; '.join(steps)}",))

    def prefetch(
        self,
        center: Icrs,
        radius_deg: float,
        *,
        mag_limit: float | None = None,
        timeout_s: float | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> Prefetched:
        """Fetch an area into the cache, for a night without network.

        It asks even a source that solves never ask.

        Parameters
        ----------
        radius_deg : float
            Up to 30.
        mag_limit : float, optional
            As deep as cones will ask.
        timeout_s : float, optional
            For each round of three tiles; the source's by default.
        progress : callable, optional
            Told how many tiles came and how many are wanted: before the first one, and as each one comes.

        Returns
        -------
        Prefetched
            What came is kept even if there was a problem.

        Raises
        ------
        BadRequest
            A value is out of range.
        """
        _require_sensible(center, radius_deg, 2000.0, mag_limit)
        if radius_deg > 30.0:
            raise BadRequest(
                f"an area of {radius_deg:g}° radius is too large to be fetched from a server",
                advice="import the catalog instead: `mountnav catalog import`",
            )
        # with the margin that stars need which move into the cones of this night
        axis, reach_deg = self._reach(center, radius_deg, datetime.now(UTC).year + 1.0)
        depth = self._depth(mag_limit)
        level = level_for(depth, self.source.faintest_mag, 0.0)
        found = self._look(axis, reach_deg, level, depth)
        todo = list(found.to_fetch)
        total, fetched = len(todo), 0
        problem = None

        def came_in(record: Record | None) -> None:
            nonlocal fetched
            fetched += record is not None
            if progress is not None:
                # a tile that is too full comes in parts, which nobody could count beforehand
                progress(fetched, max(total, fetched))

        came_in(None)
        while todo and problem is None:
            now, todo = todo[:_PER_ROUND], todo[_PER_ROUND:]
            came = self._fetch(now, axis, reach_deg, depth, timeout_s or self.source.timeout_s, came_in)
            problem = None if came.failure is None else came.failure.why
        found = self._look(axis, reach_deg, level, depth)
        if found.missing and problem is None:
            problem = f"{len(found.missing)} tiles can't be kept in the cache"
        return Prefetched(len(found.records) + len(found.missing), fetched, problem)

    def cached_tiles(self) -> CachedTiles:
        """What lies in the cache."""
        records = list(self._cache.records())
        days = sorted(record.date for record in records)
        return CachedTiles(
            tiles=len(records),
            stars=sum(record.stars for record in records),
            area_deg2=sum(record.tile.area_deg2 for record in records),
            size_bytes=self._cache.size_bytes(),
            oldest=days[0] if days else "",
            newest=days[-1] if days else "",
        )

    def clear(self) -> None:
        """Remove all its tiles from the cache."""
        self._cache.clear()

    def _depth(self, mag_limit: float | None) -> float | None:
        """To which magnitude tiles are fetched; None: all that the table has."""
        if self.source.mag_limit is not None:
            return self.source.mag_limit
        if mag_limit is None or not limit_column(self.source):
            return None
        return next((step for step in DEPTHS_MAG if step >= mag_limit), None)

    def _reach(self, center: Icrs, radius_deg: float, epoch_yr: float) -> tuple[Array, float]:
        """Direction of a cone, and its radius with what stars may have moved since the tiles' epoch."""
        known = self.source.known
        since = self.source.epoch_yr or (known.epoch_yr if known is not None else 2000.0)
        moved_deg = FASTEST_ARCSEC_YR * min(abs(epoch_yr - since), 100.0) / 3600.0
        return axis_of(center.ra_deg, center.dec_deg), min(radius_deg + moved_deg, 180.0)

    def _look(self, axis: Array, reach_deg: float, level: int, depth: float | None) -> CachedArea:
        return cached_area(
            self._cache,
            tiles_of(axis, reach_deg, level),
            mag_limit=depth,
            wanted=lambda tile: tile.touches(axis, reach_deg),
            max_age_days=self.source.max_age_days,
        )

    def _why_not_asked(self, found: CachedArea) -> str:
        if self.source.ask == "never":
            lacking = len(found.missing)
            what = f"{lacking} of {lacking + len(found.records)} tiles are not in the cache, and " * bool(
                lacking
            )
            return f"{what}it is never asked"
        rest = resting(self._key)
        if rest is not None:
            return f"left alone for another {rest.left_s:.0f} s, since: {rest.why}"
        if len(found.to_fetch) > MOST_REQUESTS:
            return f"not asked: the cone would take {len(found.to_fetch)} requests"
        return ""

    def _fetch(
        self,
        tiles: Sequence[Tile],
        axis: Array,
        reach_deg: float,
        depth: float | None,
        timeout_s: float,
        came_in: Callable[[Record], None] = lambda record: None,
    ) -> Fetched:
        came = fetch(
            self.source,
            self._cache,
            tiles,
            mag_limit=depth,
            timeout_s=timeout_s,
            wanted=lambda tile: tile.touches(axis, reach_deg),
            came_in=came_in,
        )
        if came.failure is None:
            answered(self._key)
        elif not (came.records and isinstance(came.failure, NotAnswered)):
            # a server that is merely slow has brought something: the next cone goes on from there
            failed(self._key, came.failure.why)
        return came

    def _joined(
        self,
        records: Sequence[Record],
        center: Icrs,
        radius_deg: float,
        epoch_yr: float,
        mag_limit: float | None,
    ) -> Stars | None:
        """The stars of all tiles in one; None if there are none."""
        parts = []
        for record in records:
            store = self._cache.stars(record) if record.stars else None
            if store is not None:
                parts.append(store.cone(center, radius_deg, epoch_yr=epoch_yr, mag_limit=mag_limit))
        return joined([part for part in parts if len(part)], self.name)

    def _from_behind(
        self, why: str, center: Icrs, radius_deg: float, epoch_yr: float, mag_limit: float | None
    ) -> Stars:
        if self.behind is None:
            raise StarsUnavailable(
                why,
                device=self.name,
                advice="check the network, or import a catalog: `mountnav catalog import`",
            )
        stars = self.behind.cone(center, radius_deg, epoch_yr=epoch_yr, mag_limit=mag_limit)
        return replace(stars, steps=(f"{self.name}: {why}; {stars.source} taken instead", *stars.steps))


def _opened(source: OnlineSource, cache: Path, behind: Catalog | None) -> OnlineCatalog:
    return OnlineCatalog(source, cache, behind=behind)


def _require_sensible(center: Icrs, radius_deg: float, epoch_yr: float, mag_limit: float | None) -> None:
    values = [center.ra_deg, center.dec_deg, radius_deg, epoch_yr, 0.0 if mag_limit is None else mag_limit]
    if not np.all(np.isfinite(values)) or abs(center.dec_deg) > 90.0 or not 0.0 <= radius_deg <= 180.0:
        raise BadRequest(
            f"no cone of radius {radius_deg}° at RA {center.ra_deg}°, Dec {center.dec_deg}°, "
            f"epoch {epoch_yr}, magnitude limit {mag_limit}",
            advice="all values must be finite, Dec within -90..90 and the radius within 0..180",
        )
