"""What an operator imported: catalogs of orbital elements and satellites by name, and SPK files.

Each import is one file in a folder: an index in SQLite, or the SPK file itself. It is written beside and put
in its place at once, so that no reader ever sees a half of it; a running service takes it up with its next
question. Names are compared as the bundled ones are: letters small, without blanks, brackets and accents.
"""

from __future__ import annotations

import gzip
import json
import os
import re
import shutil
import sqlite3
import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, suppress
from dataclasses import asdict, dataclass, fields
from datetime import UTC, datetime
from functools import lru_cache
from io import TextIOWrapper
from pathlib import Path
from typing import Any, Final, Literal

from mountnav.clock import utc_now
from mountnav.ephemeris.elements import Covariance, OrbitElements, OwnForces
from mountnav.ephemeris.ephemeris import Ephemeris
from mountnav.ephemeris.mpc import mpc_lines, read_mpc_json, read_mpc_line
from mountnav.ephemeris.omm import looks_like_omm, read_omm
from mountnav.ephemeris.satellite import EarthSatellite, SatelliteElements
from mountnav.ephemeris.sbdb import looks_like_sbdb, read_sbdb, require_orbit
from mountnav.ephemeris.small_body import SmallBody
from mountnav.ephemeris.tle import iterate_tle, looks_like_tle
from mountnav.errors import BadRequest, NotFound
from mountnav.files import MOST_TEXT_BYTES, locked, open_buffered, open_unpacked, read_text
from mountnav.sky.kernel import Kernel, use_kernels
from mountnav.sky.named import in_one_form, name_key

Elements = OrbitElements | SatelliteElements
Kind = Literal["minor-planet", "comet", "satellite"]

SUFFIX: Final = ".mne"
"""Of an index in the folder."""
KERNEL_SUFFIX: Final = ".bsp"
"""Of an SPK file in the folder."""
_FORMAT: Final = 1
"""Version of the index; one of another is told and left alone."""
_SLUG: Final = re.compile(r"[a-z0-9][a-z0-9_-]{0,39}")
_LONGEST_LINE: Final = 4000
"""Letters of a line of a catalog at most; those of MPCORB have 203."""
_MOST_OBJECTS: Final = 20_000_000
"""Objects of a catalog at most: ten times the minor planets that are known. Doubled, a file without end fills
the disk."""
_MOST_WRONG: Final = 0.01
"""So many lines of a catalog may be none before it is refused: the MPC's have a dozen in a million. Doubled,
half of a damaged file passes for a whole one."""
_MOST_RECORD: Final = 1_000_000
"""Letters of one record of a JSON catalog at most. Doubled, a file that was made for it takes twice the
memory."""
_MOST_SOUGHT: Final = 300
"""Names that begin as a search does, of which the shortest are shown. Doubled, an answer takes twice as
long."""
_PART: Final = ".part-"
"""How the name of a file begins that isn't written whole yet."""
_BATCH: Final = 20_000
"""Objects between two progress reports."""
_RIGHTS: Final = "check the folder's rights, or name another: [ephemerides] folder or MOUNTNAV_EPHEMERIDES"


def ephemerides_folder(configured: Path | None = None) -> Path:
    """Where imports lie.

    Parameters
    ----------
    configured : Path, optional
        `[ephemerides] folder`; goes before all else.

    Returns
    -------
    Path
        Else $MOUNTNAV_EPHEMERIDES, $XDG_DATA_HOME/mountnav/ephemerides or
        ~/.local/share/mountnav/ephemerides. It need not exist.
    """
    if configured is not None:
        return configured
    if told := os.environ.get("MOUNTNAV_EPHEMERIDES"):
        return Path(told)
    data = os.environ.get("XDG_DATA_HOME")
    return (Path(data) if data else Path.home() / ".local" / "share") / "mountnav" / "ephemerides"


@dataclass(frozen=True, slots=True)
class Import:
    """One import in the folder.

    Attributes
    ----------
    slug : str
        What commands call it.
    source : str
        The file that it was made from.
    imported_utc : datetime or None
        None: not known.
    objects : int
        Of a catalog; bodies of an SPK file.
    what : str
        "elements" or "kernel".
    problem : str or None
        Why it can't be used.
    """

    slug: str
    path: Path
    source: str = ""
    imported_utc: datetime | None = None
    objects: int = 0
    what: str = "elements"
    problem: str | None = None


@dataclass(frozen=True, slots=True)
class Entry:
    """An object of a catalog.

    Attributes
    ----------
    slug : str
        Of its import.
    """

    name: str
    kind: Kind
    slug: str
    elements: Elements

    def ephemeris(self) -> Ephemeris:
        """Where it stands when. Raises `BadRequest` for elements that lead nowhere."""
        return _followed(self.elements)


@lru_cache(maxsize=64)
def _followed(elements: Elements) -> Ephemeris:
    """Kept, for what is integrated once is quick from then on."""
    return EarthSatellite(elements) if isinstance(elements, SatelliteElements) else SmallBody(elements)


class Imports:
    """The folder of imports, read as it is asked.

    Parameters
    ----------
    folder : Path
        It need not exist.
    files : iterable of Path
        SPK files elsewhere that count before those in the folder.
    """

    def __init__(self, folder: Path, files: Iterable[Path] = ()) -> None:
        self.folder = folder
        self._files = tuple(files)
        self._lock = threading.Lock()
        self._seen: tuple[tuple[str, int, int], ...] | None = None
        self._open: dict[str, sqlite3.Connection] = {}
        self._problems: dict[str, str] = {}

    def all(self) -> list[Import]:
        """Every import, in the order of their names; one that can't be used with its problem."""
        found = []
        for path in self._paths():
            try:
                found.append(_about_kernel(path) if path.suffix == KERNEL_SUFFIX else _about(path))
            except BadRequest as wrong:
                found.append(Import(path.stem, path, problem=wrong.what))
        return found

    def find(self, name: str) -> list[Entry]:
        """All objects of exactly that name, number or designation, each once, by its newest elements."""
        key = name_key(name)
        if not key:
            return []
        return _newest(
            self._entries(
                "SELECT o.kind, o.name, o.elements FROM names n JOIN objects o ON o.id = n.object "
                "WHERE n.key = ? LIMIT 50",
                (key,),
            )
        )

    def search(self, text: str, count: int = 20) -> list[Entry]:
        """Objects with a name that begins so, the shortest name first; nothing for an empty text."""
        key = name_key(text)
        if not key:
            return []
        # the last letter that there is ends what begins so; of very many the first of the alphabet do
        found = self._entries(
            "SELECT o.kind, o.name, o.elements FROM "
            "(SELECT key, object FROM names WHERE key >= ? AND key < ? ORDER BY key LIMIT ?) n "
            "JOIN objects o ON o.id = n.object ORDER BY length(n.key), n.key",
            (key, key + "\U0010ffff", _MOST_SOUGHT),
        )
        return _newest(found)[:count]

    def ephemeris(self, name: str) -> Ephemeris | None:
        """The object of a name; None if there is none.

        Raises
        ------
        BadRequest
            Several have it, or its elements lead nowhere.
        """
        found = self.find(name)
        if not found:
            return None
        if len(found) > 1:
            told = ", ".join(_told(one) for one in found[:5])
            raise BadRequest(
                f"{len(found)} objects are called {name!r}: {told}", advice="give the whole name"
            )
        return found[0].ephemeris()

    def refresh(self) -> None:
        """Take up what was imported or forgotten since."""
        with self._lock:
            self._refresh()

    def _entries(self, query: str, values: tuple[object, ...]) -> list[Entry]:
        found = []
        with self._lock:
            self._refresh()
            for slug, database in self._open.items():
                try:
                    rows = database.execute(query, values).fetchall()
                    found += [Entry(name, kind, slug, _unpacked(kind, text)) for kind, name, text in rows]
                except (sqlite3.Error, ValueError, TypeError, KeyError) as damaged:
                    raise BadRequest(
                        f"the imported ephemerides {slug} are damaged: {damaged}",
                        advice=f"mountnav ephemeris forget {slug}, and import the file again",
                    ) from damaged
        return found

    def _paths(self) -> list[Path]:
        try:
            return sorted(one for one in self.folder.iterdir() if one.suffix in (SUFFIX, KERNEL_SUFFIX))
        except OSError:
            return []

    def _refresh(self) -> None:
        seen = []
        for path in self._paths():
            with suppress(OSError):
                state = path.stat()
                seen.append((path.name, state.st_ino, state.st_mtime_ns))
        if tuple(seen) == self._seen:
            return
        self._seen = tuple(seen)
        for database in self._open.values():
            database.close()
        self._open, kernels = {}, []
        for path in (*self._files, *(self.folder / name for name, _, _ in seen)):
            with suppress(BadRequest):  # `all` tells of it
                if path.suffix == KERNEL_SUFFIX:
                    kernels.append(Kernel(path))
                else:
                    self._open[path.stem] = _opened(path)
        use_kernels(kernels)

    def close(self) -> None:
        """Close all files."""
        with self._lock:
            for database in self._open.values():
                database.close()
            self._open, self._seen = {}, None

    def __del__(self) -> None:
        # one that another took the place of: whoever still holds it may ask it to the end
        for database in self._open.values():
            database.close()


def _told(one: Entry) -> str:
    if isinstance(one.elements, SatelliteElements):
        return f"{one.name} (NORAD {one.elements.norad_id})"
    return one.name


def _newest(entries: list[Entry]) -> list[Entry]:
    """Of an object that several imports have, the one with the newest elements."""
    best: dict[tuple[str, object], Entry] = {}
    for one in entries:
        of_satellite = one.elements.norad_id if isinstance(one.elements, SatelliteElements) else 0
        which = (name_key(one.name), of_satellite)
        known = best.get(which)
        if known is None or _epoch(one.elements) > _epoch(known.elements):
            best[which] = one
    return list(best.values())


def _epoch(elements: Elements) -> float:
    if isinstance(elements, SatelliteElements):
        return elements.epoch_utc.timestamp()
    return elements.epoch_jd


class _InUse:
    imports: Imports | None = None
    lock = threading.Lock()


def use_imports(folder: Path | None = None, files: Iterable[Path] = ()) -> Imports:
    """Let names be found in a folder from now on, and its SPK files count."""
    made = Imports(ephemerides_folder(folder), files)
    with _InUse.lock:
        if _InUse.imports is not None:
            _InUse.imports.close()
        _InUse.imports = made
    made.refresh()
    return made


def imports() -> Imports:
    """The imports in use: of the usual folder, if nothing else was told."""
    with _InUse.lock:
        known = _InUse.imports
    return use_imports() if known is None else known


# -- writing -------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Outcome:
    """What an import did.

    Attributes
    ----------
    refused : int
        Lines that were none, ...
    first_refused : tuple of str
        ... the first of them.
    """

    slug: str
    objects: int
    refused: int = 0
    first_refused: tuple[str, ...] = ()


def import_file(
    path: Path, folder: Path, slug: str | None = None, progress: Callable[[int], None] = lambda count: None
) -> Outcome:
    """Import a catalog of elements, satellites, or an SPK file; one of the same slug is replaced.

    Parameters
    ----------
    path : Path
        MPCORB.DAT, CometEls.txt, their JSON forms (gzip or not), answers of SBDB, TLE or OMM catalogs, or
        .bsp.
    folder : Path
        It is made if it isn't there.
    slug : str, optional
        What to call it; else made of the file's name.
    progress : callable (count)
        Called now and then.

    Raises
    ------
    BadRequest
        It is nothing that is read, too much of it is wrong, or it can't be written.
    """
    named = slug if slug is not None else slug_of(path)
    if not _SLUG.fullmatch(named):
        raise BadRequest(
            f"{named!r} is not a name of an import", advice="small letters, digits, - and _, 40 at most"
        )
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with locked(folder / ".lock"):
            for left in folder.glob(f"{_PART}*"):  # of an import that was killed
                left.unlink(missing_ok=True)
            if path.suffix.lower() == KERNEL_SUFFIX:
                return _import_kernel(path, folder, named)
            return _import_elements(path, folder, named, progress)
    except OSError as refused:
        raise BadRequest(
            f"{path.name} can't be imported into {folder}: {refused.strerror or refused}", advice=_RIGHTS
        ) from refused


def slug_of(path: Path) -> str:
    """What an import of a file is called if nothing is told: its name in small letters, without endings."""
    plain = re.sub(
        r"[^a-z0-9_-]+", "-", path.name.lower().removesuffix(".gz").rpartition(".")[0] or path.name.lower()
    )
    return plain.strip("-_")[:40] or "import"


def forget(folder: Path, slug: str) -> Import:
    """Remove an import. Raises `NotFound`, or `BadRequest` if it can't be removed."""
    for one in Imports(folder).all():
        if one.slug == slug:
            try:
                with locked(folder / ".lock"):
                    one.path.unlink(missing_ok=True)
            except OSError as refused:
                raise BadRequest(
                    f"{one.path.name} can't be removed: {refused.strerror}", advice=_RIGHTS
                ) from refused
            return one
    raise NotFound(f"no import is called {slug!r}", advice="mountnav ephemeris list shows them")


def _import_kernel(path: Path, folder: Path, slug: str) -> Outcome:
    kernel = Kernel(path)
    number, part = tempfile.mkstemp(dir=folder, prefix=_PART)
    try:
        with open_buffered(path) as source, os.fdopen(number, "wb") as target:
            shutil.copyfileobj(source, target, 1 << 20)
            target.flush()
            os.fsync(target.fileno())
        Kernel(Path(part))
        Path(part).chmod(0o644)
        Path(part).replace(folder / f"{slug}{KERNEL_SUFFIX}")
    except BaseException:
        Path(part).unlink(missing_ok=True)
        raise
    return Outcome(slug, len({segment.target for segment in kernel.segments}))


def _import_elements(path: Path, folder: Path, slug: str, progress: Callable[[int], None]) -> Outcome:
    number, name = tempfile.mkstemp(dir=folder, prefix=_PART)
    os.close(number)
    part = Path(name)
    try:
        with closing(sqlite3.connect(part, isolation_level=None)) as database:
            outcome = _filled(database, path, slug, progress)
        descriptor = os.open(part, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
        part.chmod(0o644)
        part.replace(folder / f"{slug}{SUFFIX}")
    except sqlite3.Error as refused:
        raise BadRequest(f"the index can't be written: {refused}", advice="is the disk full?") from refused
    finally:
        part.unlink(missing_ok=True)
        Path(f"{part}-journal").unlink(missing_ok=True)
    return outcome


def _filled(database: sqlite3.Connection, path: Path, slug: str, progress: Callable[[int], None]) -> Outcome:
    # the file is thrown away if anything fails: no journal is wanted
    database.execute("PRAGMA journal_mode = OFF")
    database.execute("PRAGMA synchronous = OFF")
    database.execute("CREATE TABLE about (key TEXT PRIMARY KEY, value TEXT NOT NULL)")
    database.execute(
        "CREATE TABLE objects "
        "(id INTEGER PRIMARY KEY, kind TEXT NOT NULL, name TEXT NOT NULL, elements TEXT NOT NULL)"
    )
    database.execute("CREATE TABLE names (key TEXT NOT NULL, object INTEGER NOT NULL)")
    database.execute("BEGIN")
    objects = refused = 0
    first: list[str] = []
    for one in _read(path):
        if isinstance(one, str):
            refused += 1
            if len(first) < 5:
                first.append(one)
            if refused > 100 and refused > _MOST_WRONG * (refused + objects):
                break
            continue
        objects += 1
        if objects > _MOST_OBJECTS:
            raise BadRequest(f"{path.name} has more than {_MOST_OBJECTS / 1e6:g} million objects")
        kind, text = _packed(one)
        database.execute("INSERT INTO objects VALUES (?, ?, ?, ?)", (objects, kind, one.name, text))
        keys = {_quick_key(name) for name in _names(one)}
        database.executemany("INSERT INTO names VALUES (?, ?)", [(key, objects) for key in keys if key])
        if objects % _BATCH == 0:
            progress(objects)
    if refused and refused > _MOST_WRONG * (refused + objects):
        raise BadRequest(
            f"{refused} of {refused + objects} entries of {path.name} can't be read: {'; '.join(first[:3])}",
            advice="is it whole, and of a kind that is read? `mountnav docs moving-targets` lists them",
        )
    if not objects:
        raise BadRequest(
            f"there are no elements in {path.name}",
            advice="`mountnav docs moving-targets` lists what can be read",
        )
    database.execute("CREATE INDEX by_key ON names (key)")
    about = {
        "source": path.name[:200],
        "imported_utc": utc_now().isoformat(),
        "objects": str(objects),
    }
    database.executemany("INSERT INTO about VALUES (?, ?)", list(about.items()))
    database.execute(f"PRAGMA user_version = {_FORMAT}")
    database.execute("COMMIT")
    return Outcome(slug, objects, refused, tuple(first))


_PLAIN: Final = re.compile(r"[A-Za-z0-9 ()'-]*")
_DROPPED: Final = str.maketrans("", "", " ()'-")


def _quick_key(name: str) -> str:
    """What `name_key` makes of it, ten times faster for the letters that nearly all names are of."""
    if not _PLAIN.fullmatch(name):
        return name_key(name)
    return in_one_form(_ZEROS.sub("", name.translate(_DROPPED).lower()))


_ZEROS: Final = re.compile(r"(?<![0-9])0+(?=[0-9])")


def _names(one: Elements) -> tuple[str, ...]:
    if isinstance(one, SatelliteElements):
        return (one.name, f"NORAD {one.norad_id}", one.international_id)
    return (one.name, *one.aliases)


def _read(path: Path) -> Iterator[Elements | str]:
    """Each object of a file, or what is wrong with it."""
    packed = path.suffix.lower() == ".gz"
    with open_unpacked(path, packed=packed) as raw:
        try:
            head = raw.read(65_536).decode("utf-8-sig", "replace")
        except (OSError, EOFError, gzip.BadGzipFile) as wrong:
            raise BadRequest(f"{path.name} can't be unpacked: {wrong}") from wrong
    if head.lstrip()[:1] in ("{", "["):
        yield from _read_json(path, packed)
    elif looks_like_omm(head):
        yield from _whole(path)
    elif looks_like_tle(head):
        yield from _read_tle(path, packed)
    else:
        yield from _read_mpc(path, packed)


def _lines(path: Path, packed: bool) -> Iterator[str]:
    """Lines of a file, none longer than is taken for one."""
    with open_unpacked(path, packed=packed) as raw, TextIOWrapper(raw, "utf-8-sig", "replace") as text:
        try:
            while line := text.readline(_LONGEST_LINE):
                yield line
        except (OSError, EOFError, gzip.BadGzipFile) as wrong:
            raise BadRequest(f"{path.name} is damaged: {wrong}") from wrong


def _read_mpc(path: Path, packed: bool) -> Iterator[Elements | str]:
    for number, line in mpc_lines(_lines(path, packed)):
        try:
            yield read_mpc_line(line, f"line {number}")
        except BadRequest as wrong:
            yield wrong.what


def _read_tle(path: Path, packed: bool) -> Iterator[Elements | str]:
    # a set that is wrong doesn't end the others: the next one begins at the next first line
    waiting: list[str] = []
    for raw in _lines(path, packed):
        line = raw.rstrip()
        if not line or line.startswith("#"):
            continue
        waiting.append(line)
        if not line.startswith("2 ") or len(waiting) < 2 or not waiting[-2].startswith("1 "):
            if len(waiting) > 3:
                yield f"no elements: {waiting[0][:30]!r}"
                waiting = waiting[-2:]
            continue
        try:
            yield from iterate_tle(waiting[-3:])
        except BadRequest as wrong:
            yield wrong.what
        waiting = []
    if waiting:
        yield f"elements that are cut off: {waiting[0][:30]!r}"


def _whole(path: Path) -> Iterator[Elements | str]:
    """Messages of a file that is read whole."""
    try:
        yield from read_omm(read_text(path, 50 * MOST_TEXT_BYTES))
    except UnicodeDecodeError as wrong:
        raise BadRequest(f"{path.name} is not UTF-8 text") from wrong


def _read_json(path: Path, packed: bool) -> Iterator[Elements | str]:
    """Records of a JSON list, one by one, however long it is; or a single record."""
    for number, record in enumerate(_records(path, packed), 1):
        at = f"record {number}"
        try:
            if not isinstance(record, dict):
                raise BadRequest(f"{at} is not a JSON object")
            require_orbit(record)
            if looks_like_sbdb(record):
                yield read_sbdb(record)
            elif "MEAN_MOTION" in record:
                yield from read_omm(json.dumps(record))
            else:
                inner = record.get("mpc_orb")
                yield read_mpc_json(inner if isinstance(inner, dict) else record, at)
        except BadRequest as wrong:
            yield wrong.what


def _records(path: Path, packed: bool) -> Iterator[Any]:
    decoder = json.JSONDecoder()
    buffer, in_list, at_end = "", None, False
    with open_unpacked(path, packed=packed) as raw, TextIOWrapper(raw, "utf-8-sig", "replace") as text:
        while True:
            buffer = buffer.lstrip(" \t\r\n,")
            if in_list is None and buffer:
                in_list = buffer[0] == "["
                buffer = buffer[1:] if in_list else buffer
                continue
            if in_list and buffer.startswith("]"):
                return
            try:
                record, end = decoder.raw_decode(buffer)
            except (json.JSONDecodeError, RecursionError, ValueError):
                if at_end:
                    if buffer.strip() or in_list:
                        raise BadRequest(f"the JSON of {path.name} is broken or cut off") from None
                    return
                if len(buffer) > _MOST_RECORD:
                    raise BadRequest(
                        f"a record of {path.name} is longer than {_MOST_RECORD} letters"
                    ) from None
                # twice as much as is there: a long record isn't tried at each step
                try:
                    more = text.read(max(65_536, len(buffer)))
                except (OSError, EOFError, gzip.BadGzipFile) as wrong:
                    raise BadRequest(f"{path.name} is damaged: {wrong}") from wrong
                at_end = not more
                buffer += more
                continue
            yield record
            buffer = buffer[end:]


def _packed(one: Elements) -> tuple[Kind, str]:
    # no asdict: it copies deep, and takes longer than all else
    values = {item.name: getattr(one, item.name) for item in fields(one)}
    if isinstance(one, SatelliteElements):
        values["epoch_utc"] = one.epoch_utc.isoformat()
        return "satellite", json.dumps(values, separators=(",", ":"))
    for part in ("covariance", "forces"):
        values[part] = None if values[part] is None else asdict(values[part])
    return "comet" if one.comet else "minor-planet", json.dumps(values, separators=(",", ":"))


def _unpacked(kind: str, text: str) -> Elements:
    values = json.loads(text)
    if kind == "satellite":
        return SatelliteElements(**values | {"epoch_utc": datetime.fromisoformat(values["epoch_utc"])})
    covariance, forces = values.pop("covariance", None), values.pop("forces", None)
    return OrbitElements(
        **values | {"aliases": tuple(values["aliases"])},
        covariance=None
        if covariance is None
        else Covariance(tuple(tuple(row) for row in covariance["matrix"]), tuple(covariance["elements"])),
        forces=None if forces is None else OwnForces(**forces),
    )


def _opened(path: Path) -> sqlite3.Connection:
    """An index, for reading. Raises `BadRequest`."""
    try:
        # what is in its place is never changed, only replaced
        database = sqlite3.connect(
            f"{path.absolute().as_uri()}?mode=ro&immutable=1", uri=True, check_same_thread=False
        )
        try:
            version = database.execute("PRAGMA user_version").fetchone()[0]
            if version != _FORMAT:
                raise BadRequest(f"{path.name} is an index of version {version}, not {_FORMAT}")
        except BaseException:
            database.close()
            raise
    except sqlite3.Error as damaged:
        raise BadRequest(f"{path.name} is not an index: {damaged}") from damaged
    return database


def _about(path: Path) -> Import:
    with closing(_opened(path)) as database:
        try:
            told = dict(database.execute("SELECT key, value FROM about").fetchall())
            return Import(
                path.stem,
                path,
                told["source"],
                datetime.fromisoformat(told["imported_utc"]).astimezone(UTC),
                int(told["objects"]),
            )
        except (sqlite3.Error, KeyError, ValueError) as damaged:
            raise BadRequest(f"{path.name} is damaged: {damaged}") from damaged


def _about_kernel(path: Path) -> Import:
    kernel = Kernel(path)
    changed = datetime.fromtimestamp(path.stat().st_mtime, UTC)
    bodies = {segment.target for segment in kernel.segments}
    return Import(path.stem, path, kernel.segments[0].source, changed, len(bodies), "kernel")
