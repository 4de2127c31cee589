"""An import: parts of a catalog are read one by one and kept, then made one packed file that is checked."""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.importing.order import (
    Imported,
    ImportOrder,
    ImportProgress,
    ImportRecord,
    KnowsDeclinations,
    Selection,
    rows_of,
    stamp,
)
from mountnav.catalog.installed import catalog_path, held, unfinished_path
from mountnav.catalog.packed import PackedStore
from mountnav.catalog.packed.packing import CatalogColumns
from mountnav.catalog.packed.spool import PackedFacts, Spool
from mountnav.catalog.readers import CATALOGS, open_reader
from mountnav.catalog.readers.kind import Part, Reader
from mountnav.catalog.stars import StarFlag
from mountnav.errors import BadCatalog, BadRequest, BadSettings
from mountnav.sky.coordinates import Icrs
from mountnav.version import version

BYTES_PER_STAR = 20
"""Of the packed file: 18, and its share of the tables."""
SPOOL_BYTES_PER_STAR = 41
"""Of what is kept until the packed file is there (`mountnav.catalog.packed.spool`)."""
ENOUGH_TO_GUESS_BY = 0.02
"""Share of the source that must be in before the rest is guessed from it."""

ADVICE = (
    "free some room, name a folder on another disk with --folder, or import a part: --mag-limit, --cone, "
    "--dec-range"
)


def needed_bytes(stars: float) -> int:
    """How much an import of so many stars takes while it ends: what was kept, and the packed file."""
    return int(stars * (BYTES_PER_STAR + SPOOL_BYTES_PER_STAR))


def stars_in_files(kind: str, size_bytes: int) -> int | None:
    """How many stars the files hold at most; None if that doesn't follow from their size."""
    record = CATALOGS[kind].source_bytes_per_star
    return None if record is None else size_bytes // record


def require_room(folder: Path, stars: int, stars_in: int) -> None:
    """Refuse what can't fit.

    Parameters
    ----------
    folder : Path
        Where the import writes.
    stars : int
        How many there will be.
    stars_in : int
        How many of these are there already.

    Raises
    ------
    BadSettings
        Tells how much is needed and how much there is.
    """
    if (told := shortage(folder, stars, stars_in)) is not None:
        raise BadSettings(f"there is not enough room: {told}", device=str(folder), advice=ADVICE)


def shortage(folder: Path, stars: float, stars_in: int) -> str | None:
    """Compare what an import still needs with what is free.

    Returns
    -------
    str or None
        None if it fits.
    """
    needed = needed_bytes(stars) - stars_in * SPOOL_BYTES_PER_STAR
    free = shutil.disk_usage(folder).free
    if needed <= free:
        return None
    return f"{stars:,.0f} stars still need {needed / 1e9:.1f} GB, and {free / 1e9:.1f} GB are free"


PARTS_READ = 12
"""Parts of the source that are read a second time, spread evenly, to hold the packed file against them;
chosen by hand. Doubled, the check takes twice as long and finds rarer faults."""
STARS_OF_A_PART = 12
"""The two faintest and brightest, and others spread evenly over the first chunk."""
_RADIUS_DEG = 0.01 / 3600.0
"""Wide against the steps of the packed form (0.3 mas), narrow against the distance of any two stars."""
_MAG_STEP = 0.0011
"""Largest difference by which a magnitude may come back: the packed step of 0.001 mag, and a tenth for
rounding."""
_PM_STEP_MAS_YR = 0.11
"""Largest difference by which a proper motion may come back, mas/yr: the packed step of 0.1, and a tenth for
rounding."""
_COLOR_STEP = 0.0011
"""Largest difference by which a color index may come back: the packed step of 0.001 mag, and a tenth for
rounding."""


def compare_with_source(
    store: PackedStore, reader: Reader, parts: Sequence[Part], selection: Selection
) -> int:
    """Read some parts again and ask the packed file for their stars.

    Parameters
    ----------
    store : PackedStore
        The new file.
    parts : sequence of Part
        All that went in.
    selection : Selection
        What of them.

    Returns
    -------
    int
        How many stars were compared.

    Raises
    ------
    BadCatalog
        One isn't there, or is another.
    """
    compared = 0
    for number in np.unique(np.linspace(0, len(parts) - 1, min(PARTS_READ, len(parts))).astype(int)):
        part = parts[int(number)]
        for columns in reader.read(part):
            stars = selection.of(columns)
            if stars.ra_deg.size == 0:
                continue
            for row in _spread(stars.mag):
                _compare(store, part, rows_of(stars, np.array([row])))
                compared += 1
            break  # the first chunk that holds something wanted is enough
    return compared


def _spread(mag: NDArray[np.float64]) -> list[int]:
    evenly = np.linspace(0, mag.size - 1, min(STARS_OF_A_PART - 2, mag.size)).astype(int)
    return sorted({int(row) for row in (*evenly, np.argmin(mag), np.argmax(mag))})


def _compare(store: PackedStore, part: Part, star: CatalogColumns) -> None:
    ra_deg, dec_deg, mag = float(star.ra_deg[0]), float(star.dec_deg[0]), float(star.mag[0])
    found = store.cone(Icrs(ra_deg % 360.0, dec_deg), _RADIUS_DEG, epoch_yr=store.header.epoch_yr)
    alike = _near(found.mag, mag, _MAG_STEP)
    alike &= _near(found.pm_ra_cosdec_mas_yr, float(star.pm_ra_cosdec_mas_yr[0]), _PM_STEP_MAS_YR)
    alike &= _near(found.pm_dec_mas_yr, float(star.pm_dec_mas_yr[0]), _PM_STEP_MAS_YR)
    if star.flags is not None:
        # the packed form says so of every star without a proper motion, whether its reader did or not
        still = StarFlag.NO_PROPER_MOTION if np.isnan(star.pm_dec_mas_yr[0]) else 0
        alike &= found.flags == star.flags[0] | still
    if star.color_mag is not None:
        alike &= _near(found.color_mag, float(star.color_mag[0]), _COLOR_STEP)
    if not alike.any():
        raise BadCatalog(
            f"the star of magnitude {mag:.3f} at RA {ra_deg:.7f}°, Dec {dec_deg:.7f}° of {part.name} "
            f"isn't in the file that was made of it ({len(found)} stars there, none like it)",
            device=str(store.path),
            advice="a fault of mountnav, or the source was changed meanwhile: import it again, and report it "
            "if it stays",
        )


def _near(found: NDArray[np.float64], wanted: float, step: float) -> NDArray[np.bool_]:
    alike: NDArray[np.bool_] = np.isnan(found) if np.isnan(wanted) else np.abs(found - wanted) <= step
    return alike


_LONGEST_TEXT = 1500
"""The header of a packed file has room for some 4000 bytes."""
_SHARE_OF_VERIFYING = 0.8
"""Share of the stage "checking" that reading the packed file back takes on the progress bar; chosen by hand.
Another value makes the bar run unevenly, no more."""


@runtime_checkable
class KeepsNotes(Protocol):
    """A reader that counts what it leaves out."""

    def notes(self) -> tuple[str, ...]:
        """What was left out of the parts read so far, for people."""
        ...


def import_catalog(
    order: ImportOrder,
    *,
    tell: Callable[[ImportProgress], None] = lambda progress: None,
    note: Callable[[str], None] = lambda text: None,
) -> Imported:
    """Import a catalog, or go on with an import that was interrupted.

    Nothing takes the place of what is there before it is complete and checked. Whatever ends this early, a
    kill included, leaves the parts that are in for the next run.

    Parameters
    ----------
    tell : callable
        Told how far it is, several times a second at most where there is much to read.
    note : callable
        Told, in a sentence, what people may want to know.

    Raises
    ------
    BadRequest
        No such kind; a name that is taken or can't be; nothing is left of the catalog by the selection.
    BadCatalog
        The source is malformed, cut short, or changed while it was read.
    BadSettings
        The folder can't be written, or there is no room.
    Busy
        Another process imports under that name.
    """
    path = catalog_path(order.folder, order.slug)
    _require_free(path, order)
    reader = open_reader(order.kind, order.source)
    parts = _wanted_parts(reader, order)
    unfinished = unfinished_path(order.folder, order.slug)
    try:
        with held(unfinished):
            imported = _Import(order, reader, parts, unfinished, tell, note).run(path)
            shutil.rmtree(unfinished, ignore_errors=True)  # what stays is listed, and `remove` takes it
            return imported
    except OSError as refused:
        raise _refused(refused, unfinished) from refused
    except BadSettings as error:  # what the spool says of a disk: here it is known what can be done
        if isinstance(error.__cause__, OSError):
            raise _refused(error.__cause__, unfinished) from error.__cause__
        raise


class _Import:
    """One run of an import, under its lock."""

    def __init__(
        self,
        order: ImportOrder,
        reader: Reader,
        parts: Sequence[Part],
        unfinished: Path,
        tell: Callable[[ImportProgress], None],
        note: Callable[[str], None],
    ) -> None:
        self._order, self._reader, self._parts, self._unfinished = order, reader, parts, unfinished
        self._tell_progress, self._note = tell, note
        self._progress = ImportProgress(
            "reading", 0.0, 0, len(parts), 0, sum(part.size_bytes for part in parts), 0
        )
        self._told_of_shortage = False

    def run(self, path: Path) -> Imported:
        spool = self._spool()
        try:
            return self._run(spool, path)
        except BaseException:
            if not spool.done:
                shutil.rmtree(self._unfinished, ignore_errors=True)  # nothing in it is worth a second run
            raise

    def _run(self, spool: Spool, path: Path) -> Imported:
        resumed = len(spool.done)
        if resumed:
            self._note(f"resuming: {resumed} of {len(self._parts)} parts are imported")
        self._require_room(spool)
        self._read(spool)
        if spool.count == 0:
            spool.discard()
            raise BadRequest(
                f"no star of {self._order.source} remains: {self._order.selection or 'it holds none'}",
                advice="choose more of it",
            )
        for told in self._reader.notes() if isinstance(self._reader, KeepsNotes) else ():
            self._note(told)
        ready = self._unfinished / path.name
        header = spool.finish(ready, progress=lambda share: self._tell(stage="packing", share=share))
        compared = self._checked(ready, spool.count)
        _require_free(path, self._order)  # another program may have put a file there meanwhile
        ready.replace(path)
        _sync_folder(path.parent)
        return Imported(path, header, len(self._parts), resumed, compared)

    def _spool(self) -> Spool:
        """What an earlier run left, if it fits; else a new start, and a word why."""
        order, reader = self._order, self._reader
        selection = str(order.selection)
        facts = PackedFacts(
            name=reader.name,
            band=reader.band,
            epoch_yr=reader.epoch_yr,
            color_name=reader.color_name,
            made_from=_shortened(f"{order.kind}: {reader.made_from}")
            + (f"; {selection}" if selection else ""),
        )
        record = ImportRecord.of(version(), order.kind, selection, reader.made_from, self._parts)
        earlier = ImportRecord.read(self._unfinished)
        folder = self._unfinished / "spool"
        spool = Spool.open(folder, facts)
        why = None if earlier is None else record.contradicts(earlier, spool.done)
        if earlier is None and spool.done:
            why = "it is not known what the imported parts were made from"
        if why is not None:
            self._note(f"starting over: {why}")
            if spool.done:
                spool.discard()
                spool = Spool.open(folder, facts)
        record.write(self._unfinished)
        return spool

    def _require_room(self, spool: Spool) -> None:
        stars = stars_in_files(self._order.kind, self._progress.size_bytes)
        if stars is not None and self._order.selection.is_everything:
            require_room(self._unfinished, stars, spool.count)

    def _read(self, spool: Spool) -> None:
        for part in self._parts:
            if part.name in spool.done:
                self._add_up(part)
        self._tell(stars=spool.count)
        for part in self._parts:
            if part.name in spool.done:
                continue
            spool.add(part.name, self._chunks(part))
            self._add_up(part)
            self._tell(stars=spool.count)
            self._warn_of_shortage(spool)

    def _chunks(self, part: Part) -> Iterator[CatalogColumns]:
        """The stars of a part that are wanted; refuses a file that is changed while it is read."""
        so_far = self._progress.stars
        try:
            before = stamp(part)
            for columns in self._reader.read(part):
                stars = self._order.selection.of(columns)
                so_far += stars.ra_deg.size
                self._tell(stars=so_far)
                if stars.ra_deg.size:
                    yield stars
            after = stamp(part)
        except OSError as refused:  # told apart from the disk that is written to
            raise BadCatalog(
                f"can't be read: {refused.strerror or refused}",
                device=str(part.path),
                advice="check disk and cable; the imported parts are kept, the same command continues",
            ) from refused
        if after != before:
            raise BadCatalog(
                "was changed while it was read",
                device=str(part.path),
                advice="run the import again when nothing writes there",
            )

    def _checked(self, ready: Path, count: int) -> int:
        self._tell(stage="checking", share=0.0)
        store = PackedStore(ready)
        if len(store) != count:
            raise BadCatalog(f"{len(store)} stars were written, but {count} were read", device=str(ready))
        store.verify(progress=lambda share: self._tell(share=_SHARE_OF_VERIFYING * share))
        compared = compare_with_source(store, self._reader, self._parts, self._order.selection)
        self._tell(share=1.0)
        return compared

    def _warn_of_shortage(self, spool: Spool) -> None:
        done = self._progress.bytes_done / max(1, self._progress.size_bytes)
        if self._told_of_shortage or done < ENOUGH_TO_GUESS_BY:
            return
        if (told := shortage(self._unfinished, spool.count / done, spool.count)) is not None:
            self._told_of_shortage = True
            self._note(f"the disk may get full: as it goes, {told}")

    def _add_up(self, part: Part) -> None:
        self._progress = replace(
            self._progress,
            parts_done=self._progress.parts_done + 1,
            bytes_done=self._progress.bytes_done + part.size_bytes,
        )

    def _tell(
        self,
        *,
        stage: Literal["reading", "packing", "checking"] | None = None,
        share: float | None = None,
        stars: int | None = None,
    ) -> None:
        now = self._progress
        if share is None:
            share = now.bytes_done / max(1, now.size_bytes) if now.stage == "reading" else now.share
        self._progress = replace(
            now, stage=stage or now.stage, share=share, stars=now.stars if stars is None else stars
        )
        self._tell_progress(self._progress)


def _wanted_parts(reader: Reader, order: ImportOrder) -> list[Part]:
    parts = list(reader.parts())
    if isinstance(reader, KnowsDeclinations):
        parts = [part for part in parts if order.selection.wants_some_of(reader.dec_range_deg(part))]
    if not parts:
        raise BadCatalog(
            f"holds nothing of what was asked for ({order.selection or 'all of it'})",
            device=str(order.source),
            advice="check the path, or choose more of it",
        )
    if len({part.name for part in parts}) != len(parts):
        raise ValueError(f"the reader of {order.kind} gives two parts the same name")
    return parts


def _require_free(path: Path, order: ImportOrder) -> None:
    if path.exists() and not order.force:
        raise BadRequest(
            f"there is a catalog {order.slug!r} already: {path}",
            advice="--force puts the new one in its place when it is complete; --name gives it another name",
        )


def _shortened(text: str) -> str:
    return text if len(text) <= _LONGEST_TEXT else text[: _LONGEST_TEXT - 3] + "..."


def _refused(refused: OSError, unfinished: Path) -> BadSettings:
    if refused.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
        advice = f"the imported parts are kept, and the same command continues; {ADVICE}"
    elif refused.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
        advice = "check the rights, or name another folder with --folder"
    else:
        advice = "check disk and cable; the imported parts are kept, and the same command continues"
    return BadSettings(
        f"the import ended: {refused.strerror or refused}",
        device=str(refused.filename or unfinished),
        advice=advice,
    )


def _sync_folder(folder: Path) -> None:
    """Make a rename in the folder last."""
    number = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(number)
    finally:
        os.close(number)
