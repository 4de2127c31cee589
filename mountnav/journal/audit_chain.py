"""The audit as a chain: each row holds the hash of all before it, and a seal that only the service can make.

A row's hash is SHA-256 of the hash before it, its number in the chain and its content: whoever changes,
removes, inserts or reorders one breaks the chain at that row. Its seal is HMAC-SHA256 of that hash by a key
that lies in a file of its own: whoever can write the database, and can't read that file, can't make the chain
anew behind his change. Retention removes rows and leaves a gap that tells how many, with the hash the chain
went on from, sealed as well. Writers take their turns at one row, the head: several services may write one
journal.
"""

from __future__ import annotations

import contextlib
import hashlib
import hmac
import json
import logging
import os
import secrets
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from sqlalchemy import URL, Connection, Text, delete, func, insert, select, type_coerce, update
from sqlalchemy.sql.elements import ColumnElement

from mountnav.errors import BadSettings
from mountnav.files import FILE_MODE, make_private_folder
from mountnav.journal.database import FAULTS, connectable, plain_json, plain_text
from mountnav.journal.tables import audit, audit_gap, audit_head
from mountnav.journal.upgrading import unusable

__all__ = [
    "AuditFault",
    "AuditHead",
    "AuditKey",
    "AuditProof",
    "append_audit",
    "chain_old_rows",
    "open_audit_key",
    "prove",
    "remove_audits",
]

_log = logging.getLogger(__name__)

_FORM = "mountnav-audit-1"
"""What is hashed, and how. Another form of rows needs another name, or old chains break."""
_BEGIN = "0" * 64
"""The hash before the first row."""
_KEY_BYTES = 32
"""Of the key that seals: 256 bits, as long as what HMAC-SHA256 gives. Halved, 128 are still out of reach."""
_SEAL_HEX = 32
"""Digits of a seal that are kept: 128 bits. Halved, 64 bits, a forger's luck is still one in 1e19."""
_KEY_ID_HEX = 8
"""Digits that name a key, so that two machines on one journal are told apart. Doubled, seals get longer."""
_AT_ONCE = 1000
"""Rows read at once; a row takes some 500 bytes. Doubled, twice the memory."""
_CONTENT = (
    "run_id",
    "utc",
    "telescope",
    "caller",
    "role",
    "face",
    "address",
    "what",
    "request",
    "outcome",
    "detail",
    "status",
    "job_id",
)
_MOST_TOLD = 20
"""Lines about rows whose seal could not be checked; the rest is counted. Doubled, a longer answer."""


class AuditKey:
    """The key that seals an audit.

    Parameters
    ----------
    secret : bytes
        32 of them, random.
    """

    def __init__(self, secret: bytes) -> None:
        self._secret = secret
        self.id = hashlib.sha256(b"mountnav-audit-key" + secret).hexdigest()[:_KEY_ID_HEX]

    def seal(self, *parts: object) -> str:
        """The seal of what these parts say."""
        said = json.dumps([_FORM, *parts]).encode()
        return f"{self.id}:{hmac.new(self._secret, said, 'sha256').hexdigest()[:_SEAL_HEX]}"


def open_audit_key(path: Path) -> AuditKey | None:
    """The key in a file, made (mode 0600) if there is none; None where that can't be, which is logged.

    An order must not wait for a key: a journal without one is a chain all the same, but not sealed.
    """
    try:
        return read_audit_key(path)
    except FileNotFoundError:
        pass
    except BadSettings as wrong:
        _log.error("the audit is not sealed: %s", wrong)
        return None
    try:
        make_private_folder(path.parent)
        handle, made = tempfile.mkstemp(dir=path.parent, prefix=".audit-key-")
        try:
            with os.fdopen(handle, "w", encoding="ascii") as file:
                os.fchmod(file.fileno(), FILE_MODE)
                file.write(secrets.token_hex(_KEY_BYTES) + "\n")
                file.flush()
                os.fsync(file.fileno())
            # whole or not at all; another process may have been faster
            with contextlib.suppress(FileExistsError):
                os.link(made, path)
        finally:
            os.unlink(made)
        return read_audit_key(path)
    except (OSError, BadSettings) as wrong:
        _log.error("the audit is not sealed: its key can't be kept in %s: %s", path, wrong)
        return None


def read_audit_key(path: Path) -> AuditKey:
    """The key in a file.

    Raises
    ------
    FileNotFoundError
        There is none.
    BadSettings
        It can't be read, or holds no key.
    """
    try:
        # a byte more than a key: whatever else was named is not read whole
        with path.open("rb") as file:
            text = file.read(2 * _KEY_BYTES + 2)
        secret = bytes.fromhex(text.decode("ascii").strip())
    except FileNotFoundError:
        raise
    except (OSError, ValueError) as wrong:
        raise BadSettings(
            f"the audit's key can't be read: {getattr(wrong, 'strerror', None) or 'it is none'}",
            device=str(path),
            advice="it must be readable by the user that runs the service, 64 hexadecimal digits",
        ) from wrong
    if len(secret) != _KEY_BYTES:
        raise BadSettings("the file holds no key of an audit", device=str(path), advice="name another one")
    return AuditKey(secret)


@dataclass(frozen=True, slots=True)
class AuditHead:
    """Where a chain stands: kept elsewhere, it shows later that no row was cut off its end.

    Attributes
    ----------
    chain_no : int
        Of the newest row.
    sha256 : str
        Its hash.
    """

    chain_no: int
    sha256: str

    def __str__(self) -> str:
        return f"{self.chain_no}:{self.sha256}"


@dataclass(frozen=True, slots=True)
class AuditFault:
    """Where a chain breaks first.

    Attributes
    ----------
    row_id : int or None
        Of the row; None at the end of the chain.
    chain_no : int or None
        Its number in the chain.
    what : str
        What was done to it, in words.
    """

    row_id: int | None
    chain_no: int | None
    what: str


@dataclass(frozen=True, slots=True)
class AuditProof:
    """What came of going through an audit.

    Attributes
    ----------
    rows : int
        That were looked at.
    removed : int
        That retention has removed, by its sealed gaps.
    head : AuditHead or None
        Where the chain stands; None of one without rows.
    fault : AuditFault or None
        Where it breaks first; None: it holds.
    unproven : tuple of str
        What no key at hand proves: it was written without a key, or by another machine.
    sealed : int
        Rows whose seals were checked, and hold.
    """

    rows: int
    removed: int
    head: AuditHead | None
    fault: AuditFault | None
    unproven: tuple[str, ...]
    sealed: int


def row_sha256(before: str, chain_no: int, content: Mapping[str, Any]) -> str:
    """The hash of a row: of the one before it, its number and its content."""
    said = [_FORM, before, chain_no, *(_told(name, content[name]) for name in _CONTENT)]
    text = json.dumps(said, sort_keys=True, separators=(",", ":"), default=repr)
    return hashlib.sha256(text.encode("ascii")).hexdigest()


def _told(name: str, value: Any) -> object:
    """A value as it comes back from any database."""
    if name == "utc":
        if isinstance(value, str):
            try:
                value = datetime.fromisoformat(value)
            except ValueError:
                return value
        aware = value.replace(tzinfo=UTC) if value.tzinfo is None else value.astimezone(UTC)
        return str(aware.isoformat(timespec="microseconds"))
    if name == "request":
        if isinstance(value, str):
            try:
                return json.loads(value)
            except ValueError:
                return value
        return json.loads(json.dumps(plain_json(value)))
    return plain_text(value) if isinstance(value, str) else value


def append_audit(connection: Connection, values: Mapping[str, Any], key: AuditKey | None) -> None:
    """Write a row behind the last one, in a transaction of the caller's."""
    head = _locked_head(connection)
    chain_no = head.chain_no + 1
    sha256 = row_sha256(head.sha256, chain_no, values)
    seal = None if key is None else key.seal("row", chain_no, sha256)
    connection.execute(insert(audit).values({**values, "chain_no": chain_no, "sha256": sha256, "seal": seal}))
    _put_head(connection, AuditHead(chain_no, sha256), key)


def _locked_head(connection: Connection) -> AuditHead:
    """The head, which other writers wait for until the transaction ends; they write behind it."""
    # SQLite has no FOR UPDATE, and needs none: its transactions begin with the lock
    found = connection.execute(select(audit_head).with_for_update()).mappings().first()
    if found is not None:
        return AuditHead(found["chain_no"], found["sha256"])
    # somebody has removed it: the chain goes on behind its last row, and the proof finds it out
    last = select(audit.c.chain_no, audit.c.sha256).where(audit.c.chain_no.is_not(None))
    row = connection.execute(last.order_by(audit.c.chain_no.desc()).limit(1)).first()
    head = AuditHead(0, _BEGIN) if row is None else AuditHead(row[0], row[1])
    connection.execute(insert(audit_head).values(id=1, chain_no=head.chain_no, sha256=head.sha256, seal=None))
    return head


def _put_head(connection: Connection, head: AuditHead, key: AuditKey | None) -> None:
    seal = None if key is None else key.seal("head", head.chain_no, head.sha256)
    connection.execute(update(audit_head).values(chain_no=head.chain_no, sha256=head.sha256, seal=seal))


def chain_old_rows(connection: Connection) -> int:
    """Chain the rows of a journal of before, as they are found; return how many. They have no seals."""
    connection.execute(insert(audit_head).values(id=1, chain_no=0, sha256=_BEGIN, seal=None))
    head, last_id = AuditHead(0, _BEGIN), 0
    # by name: a later version's columns aren't there yet
    columns = [column for column in _columns(connection) if column.key in ("row_id", *_CONTENT)]
    while True:
        query = select(*columns).where(audit.c.row_id > last_id).order_by(audit.c.row_id).limit(_AT_ONCE)
        rows = connection.execute(query).mappings().all()
        if not rows:
            break
        for row in rows:
            head = AuditHead(head.chain_no + 1, row_sha256(head.sha256, head.chain_no + 1, dict(row)))
            chained = {"chain_no": head.chain_no, "sha256": head.sha256}
            connection.execute(update(audit).where(audit.c.row_id == row["row_id"]).values(chained))
        last_id = rows[-1]["row_id"]
    _put_head(connection, head, None)
    return head.chain_no


def remove_audits(
    connection: Connection,
    *conditions: ColumnElement[bool],
    most: int,
    why: str,
    run_id: str,
    utc: datetime,
    key: AuditKey | None,
) -> int:
    """Remove the oldest rows that fulfill all conditions, and leave gaps that tell of them.

    Parameters
    ----------
    most : int
        So many at once.
    why : str
        What for, such as ``older than 1100 days``.
    run_id : str
        Of the run that removes them.
    """
    oldest = select(audit.c.row_id, audit.c.chain_no, audit.c.sha256).where(*conditions)
    _locked_head(connection)
    rows = connection.execute(oldest.order_by(audit.c.row_id).limit(most)).all()
    if not rows:
        return 0
    chained = sorted((row for row in rows if row.chain_no is not None), key=lambda row: int(row.chain_no))
    at = 0
    while at < len(chained):
        end = at
        while end + 1 < len(chained) and chained[end + 1].chain_no == chained[end].chain_no + 1:
            end += 1
        _leave_gap(
            connection,
            chained[at].chain_no,
            chained[end].chain_no,
            chained[end].sha256,
            why,
            run_id,
            utc,
            key,
        )
        at = end + 1
    connection.execute(delete(audit).where(audit.c.row_id.in_([row.row_id for row in rows])))
    return len(rows)


def _leave_gap(
    connection: Connection,
    first_no: int,
    last_no: int,
    last_sha256: str,
    why: str,
    run_id: str,
    utc: datetime,
    key: AuditKey | None,
) -> None:
    """Write a gap down; gaps that meet become one, if this key has made them."""
    columns = audit_gap.c
    near = select(audit_gap).where((columns.last_no == first_no - 1) | (columns.first_no == last_no + 1))
    for one in connection.execute(near.order_by(columns.first_no)).mappings().all():
        if _gap_holds(dict(one), [] if key is None else [key]) is not (None if key is None else True):
            # it is left as it is, for the proof to judge
            continue
        first_no = min(first_no, one["first_no"])
        if one["last_no"] > last_no:
            last_no, last_sha256 = one["last_no"], one["last_sha256"]
        connection.execute(delete(audit_gap).where(columns.first_no == one["first_no"]))
    seal = None if key is None else key.seal("gap", first_no, last_no, last_sha256)
    connection.execute(
        insert(audit_gap).values(
            first_no=first_no,
            last_no=last_no,
            last_sha256=last_sha256,
            why=why,
            removed_utc=utc,
            run_id=run_id,
            seal=seal,
        )
    )


def _gap_holds(gap: Mapping[str, Any], keys: Sequence[AuditKey]) -> bool | None:
    return _seal_holds(gap["seal"], keys, "gap", gap["first_no"], gap["last_no"], gap["last_sha256"])


def _seal_holds(seal: str | None, keys: Sequence[AuditKey], *parts: object) -> bool | None:
    """Whether a seal is that of these parts; None: no key at hand can tell."""
    for key in keys:
        if seal is not None and seal.startswith(f"{key.id}:"):
            return hmac.compare_digest(seal.encode(), key.seal(*parts).encode())
    return None


def _columns(connection: Connection) -> list[ColumnElement[Any]]:
    """All columns, as they lie in a file: what somebody wrote there may be of no kind at all."""
    if connection.dialect.name != "sqlite":
        return list(audit.c)
    raw = ("utc", "request")
    return [
        type_coerce(column, Text).label(column.key) if column.key in raw else column for column in audit.c
    ]


def head_of(connection: Connection) -> AuditHead | None:
    """Where the chain stands; None without a row."""
    found = connection.execute(select(audit_head.c.chain_no, audit_head.c.sha256)).first()
    return None if found is None or found[0] == 0 else AuditHead(found[0], found[1])


def prove(url: URL, keys: Sequence[AuditKey] = (), expected: Iterable[AuditHead] = ()) -> AuditProof:
    """Go through an audit from its first row to its last. Changes nothing; services may go on writing.

    Parameters
    ----------
    keys : sequence of AuditKey
        Whose seals are checked.
    expected : iterable of AuditHead
        Where the chain once stood, as logs and reports told.

    Raises
    ------
    JournalFailed
        It can't be read at all.
    BadSettings
        It is of another version.
    NotFound
        There is none.
    """
    from mountnav.journal.reading import JournalReader

    # whether it is there at all, and of today's version
    JournalReader(url).runs(1)
    engine = connectable(url, "read")
    try:
        with engine.connect() as connection:
            if connection.dialect.name == "postgresql":
                # all of it as it was at one instant: the head must not be newer than the rows
                connection = connection.execution_options(isolation_level="REPEATABLE READ")
            with connection.begin():
                return _Walk(connection, keys, expected).proof()
    except FAULTS as error:
        raise unusable(error, url) from error
    finally:
        engine.dispose()


class _Broken(Exception):
    def __init__(self, row_id: int | None, chain_no: int | None, what: str) -> None:
        super().__init__(what)
        self.fault = AuditFault(row_id, chain_no, what)


class _Walk:
    """One way along a chain."""

    def __init__(
        self, connection: Connection, keys: Sequence[AuditKey], expected: Iterable[AuditHead]
    ) -> None:
        self._connection = connection
        self._keys = keys
        self._expected = {one.chain_no: one.sha256 for one in expected}
        gaps = connection.execute(select(audit_gap)).mappings().all()
        self._gaps = {gap["first_no"]: dict(gap) for gap in gaps}
        self._no, self._sha256 = 0, _BEGIN
        self._row_id = 0
        self._rows = self._removed = self._sealed = 0
        self._unsealed: list[tuple[int, int, str]] = []

    def proof(self) -> AuditProof:
        """Walk it."""
        fault: AuditFault | None = None
        try:
            for row in self._in_order():
                self._step(row)
            self._end()
        except _Broken as broken:
            fault = broken.fault
        stray = select(func.min(audit.c.row_id)).where(audit.c.chain_no.is_(None))
        outside = self._connection.execute(stray).scalar()
        if outside is not None and (fault is None or fault.row_id is None or outside < fault.row_id):
            fault = AuditFault(outside, None, "it was inserted: it has no place in the chain")
        head = None if self._no == 0 else AuditHead(self._no, self._sha256)
        return AuditProof(self._rows, self._removed, head, fault, self._told(), self._sealed)

    def _in_order(self) -> Iterable[Mapping[str, Any]]:
        columns = _columns(self._connection)
        last = 0
        while True:
            query = select(*columns).where(audit.c.chain_no > last).order_by(audit.c.chain_no, audit.c.row_id)
            rows = self._connection.execute(query.limit(_AT_ONCE)).mappings().all()
            yield from map(dict, rows)
            if len(rows) < _AT_ONCE:
                return
            last = rows[-1]["chain_no"]

    def _step(self, row: Mapping[str, Any]) -> None:
        row_id, no = row["row_id"], row["chain_no"]
        if no <= self._no:
            raise _Broken(row_id, no, "it was inserted: its number in the chain is taken")
        self._over_gaps(row_id, no)
        self._rows += 1
        if row_id <= self._row_id:
            raise _Broken(row_id, no, "it was reordered: it stands before the row that it follows")
        sha256 = row_sha256(self._sha256, no, row)
        if sha256 != row["sha256"]:
            raise _Broken(row_id, no, self._why_not(row, no))
        if no in self._expected and self._expected[no] != sha256:
            raise _Broken(row_id, no, "it, or one before it, was altered: its hash was another once")
        self._sealed_or_not(row, no, sha256)
        self._no, self._sha256, self._row_id = no, sha256, row_id

    def _why_not(self, row: Mapping[str, Any], no: int) -> str:
        """What breaks a chain at a row: it is another than the one that was written, or stands elsewhere."""
        held = _seal_holds(row["seal"], self._keys, "row", no, row["sha256"])
        if held:
            return "it was altered: its content doesn't fit its hash, which is that of the service"
        if held is False:
            return "it was altered, inserted or reordered: neither its hash nor its seal fits"
        return "it, or the one before it, was altered or reordered: its hash doesn't fit"

    def _over_gaps(self, row_id: int | None, no: int) -> None:
        while self._no + 1 < no:
            gap = self._gaps.pop(self._no + 1, None)
            if gap is None:
                first, last = self._no + 1, no - 1
                which = f"number {first}" if first == last else f"numbers {first} to {last}"
                were = "row before it was" if first == last else "rows before it were"
                raise _Broken(row_id, no, f"{last - first + 1} {were} removed ({which})")
            self._take_gap(gap, row_id)
            if self._no >= no:
                raise _Broken(row_id, no, "it was inserted: retention has removed what had its number")

    def _take_gap(self, gap: Mapping[str, Any], row_id: int | None) -> None:
        first, last = gap["first_no"], gap["last_no"]
        if last < first:
            raise _Broken(row_id, first, "a gap was altered")
        if _gap_holds(gap, self._keys) is False:
            raise _Broken(row_id, first, f"rows {first} to {last} were removed, and not by the service")
        if _gap_holds(gap, self._keys) is None:
            self._note(first, last, "removed rows")
        self._removed += last - first + 1
        self._no, self._sha256 = last, gap["last_sha256"]
        if self._expected.get(last, self._sha256) != self._sha256:
            raise _Broken(row_id, last, "what was removed before it was altered: its hash was another once")

    def _sealed_or_not(self, row: Mapping[str, Any], no: int, sha256: str) -> None:
        held = _seal_holds(row["seal"], self._keys, "row", no, sha256)
        if held is False:
            raise _Broken(row["row_id"], no, "it was altered, and its hash made again: its seal doesn't fit")
        if held is None:
            self._note(no, no, "rows")
        else:
            self._sealed += 1

    def _end(self) -> None:
        while (gap := self._gaps.pop(self._no + 1, None)) is not None:
            self._take_gap(gap, None)
        if self._gaps:
            first = min(self._gaps)
            raise _Broken(None, first, f"a gap at number {first} fits nowhere")
        found = self._connection.execute(select(audit_head)).mappings().all()
        if len(found) != 1:
            raise _Broken(None, self._no or None, "the head of the chain is missing, or not alone")
        head = found[0]
        if head["chain_no"] > self._no:
            raise _Broken(
                None,
                self._no + 1,
                f"rows {self._no + 1} to {head['chain_no']} were removed from the end of the chain",
            )
        if (head["chain_no"], head["sha256"]) != (self._no, self._sha256):
            raise _Broken(self._row_id or None, head["chain_no"], "rows behind the head were inserted")
        held = _seal_holds(head["seal"], self._keys, "head", head["chain_no"], head["sha256"])
        if held is False:
            raise _Broken(None, self._no, "the head was altered: its seal doesn't fit")
        if held is None and self._no:
            self._note(self._no, self._no, "the head of the chain, at")
        if late := [no for no in self._expected if no > self._no]:
            raise _Broken(
                None,
                self._no + 1,
                f"rows {self._no + 1} to {max(late)} were removed from the end of the chain",
            )

    def _note(self, first: int, last: int, what: str) -> None:
        if self._unsealed and self._unsealed[-1][2] == what and self._unsealed[-1][1] == first - 1:
            first = self._unsealed.pop()[0]
        self._unsealed.append((first, last, what))

    def _told(self) -> tuple[str, ...]:
        told = [f"{what} {first} to {last}" for first, last, what in self._unsealed[:_MOST_TOLD]]
        if more := len(self._unsealed) - len(told):
            told.append(f"and {more} more")
        return tuple(told)
