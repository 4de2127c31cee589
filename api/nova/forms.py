"""The body of a request: `request-json` of a url-encoded form, or of a multipart form with a file beside it.

Multipart is taken apart here and not by the library that the HTTP routes use: client.py of astrometry.net
ends the lines of its boundaries by a bare line feed, which that one refuses. What comes is searched for the
next boundary as a whole, so that no body takes longer than its length; parts, their heads and their texts
are bounded, and a file goes to a spool without a name as it comes.
"""

from __future__ import annotations

import hashlib
import re
import tempfile
from dataclasses import dataclass
from typing import IO
from urllib.parse import parse_qs

from api.nova.codec import MOST_JSON_BYTES, NovaError

__all__ = ["Form", "Multipart", "boundary_of", "read_urlencoded", "spooled", "too_large"]

_MOST_PARTS = 20
"""Parts of a form; clients send two. Doubled, nothing changes but for nonsense."""
_MOST_HEAD_BYTES = 4096
"""Of one part; clients send 200. Doubled, nonsense takes twice the memory."""
_MOST_FIELDS = 20
"""Fields of a url-encoded form; clients send one."""
_LONGEST_NAME = 100
"""Characters of a file's name that are kept; it is shown in logs and replies."""
_LONGEST_BOUNDARY = 200
"""Bytes of a boundary; RFC 2046 allows 70."""
_BOUNDARY = re.compile(
    r'^multipart/[a-z0-9.+-]+\s*;(?:.*;)?\s*boundary=(?:"([^"]+)"|([^;\s]+))', re.IGNORECASE
)
_DISPOSITION = re.compile(rb"^content-disposition\s*:(.*)$", re.IGNORECASE | re.MULTILINE)
_PARAMETER = re.compile(rb';\s*(name|filename)\s*=\s*(?:"((?:[^"\\]|\\.)*)"|([^;\s]+))', re.IGNORECASE)
_JSON_FIELD, _FILE_FIELD = "request-json", "file"


@dataclass(slots=True)
class Form:
    """What a form holds.

    Attributes
    ----------
    json : bytes or None
        The field `request-json`.
    file : IO or None
        The spooled file, to be closed by who takes the form.
    name : str
        The file's name, without folders and odd characters.
    size : int
        Of the file, bytes.
    sha256 : str
        Of the file, in hexadecimal digits; empty until the form is complete.
    """

    json: bytes | None = None
    file: IO[bytes] | None = None
    name: str = "upload"
    size: int = 0
    sha256: str = ""

    def close(self) -> None:
        """Let go of the file. Twice is fine."""
        if self.file is not None:
            self.file.close()
            self.file = None


def boundary_of(content_type: str) -> bytes | None:
    """The boundary of a multipart body; None for any other type. Raises `NovaError` for one without."""
    if not content_type.lower().lstrip().startswith("multipart/"):
        return None
    found = _BOUNDARY.match(content_type.strip())
    boundary = (found[1] or found[2]).encode("latin-1", "replace") if found else b""
    if not boundary or len(boundary) > _LONGEST_BOUNDARY:
        raise NovaError("the multipart body gives no boundary")
    return boundary


def read_urlencoded(body: bytes) -> Form:
    """Read a url-encoded form. Raises `NovaError`."""
    try:
        fields = parse_qs(body.decode("utf-8"), keep_blank_values=True, max_num_fields=_MOST_FIELDS)
    except ValueError as fault:
        raise NovaError(f"the form can't be read: {fault}") from fault
    found = fields.get(_JSON_FIELD)
    return Form(json=None if not found else found[0].encode("utf-8", "surrogatepass"))


class Multipart:
    """Takes a multipart body apart as it comes.

    Parameters
    ----------
    most_bytes : int
        Longest file.
    """

    def __init__(self, boundary: bytes, most_bytes: int) -> None:
        self.form = Form()
        self._token = b"\n--" + boundary
        self._most_bytes = most_bytes
        # the first boundary has no line before it
        self._buffer = bytearray(b"\n")
        self._state = self._preamble
        self._parts = 0
        self._field = ""
        self._text = bytearray()
        self._hash = hashlib.sha256()
        self._ended = False

    def feed(self, data: bytes) -> None:
        """Take what came. Raises `NovaError`; the form is to be closed then."""
        self._buffer += data
        while not self._ended and self._state():
            pass
        if self._ended:
            self._buffer.clear()

    def finish(self) -> Form:
        """The form, complete. Raises `NovaError` where its end is missing."""
        if not self._ended:
            raise NovaError("the multipart body is cut short")
        self.form.sha256 = self._hash.hexdigest()
        if self.form.file is not None:
            self.form.file.flush()
        return self.form

    def _preamble(self) -> bool:
        at = self._buffer.find(self._token)
        if at < 0:
            del self._buffer[: -len(self._token)]
            return False
        del self._buffer[: at + len(self._token)]
        self._state = self._boundary
        return True

    def _boundary(self) -> bool:
        """After a boundary: two dashes end the body, a line end begins a part."""
        end = self._buffer.find(b"\n", 0, _MOST_HEAD_BYTES)
        if self._buffer[:2] == b"--":
            self._ended = True
            return False
        if end < 0:
            if len(self._buffer) > _LONGEST_BOUNDARY:
                raise NovaError("the multipart body is malformed after a boundary")
            return False
        if self._buffer[:end].strip():
            raise NovaError("the multipart body is malformed after a boundary")
        del self._buffer[: end + 1]
        self._parts += 1
        if self._parts > _MOST_PARTS:
            raise NovaError(f"the form has more than {_MOST_PARTS} parts")
        self._state = self._head
        return True

    def _head(self) -> bool:
        """The lines of a part's head, up to an empty one."""
        head = bytes(self._buffer[: _MOST_HEAD_BYTES + 4])
        found = re.search(rb"\A\r?\n|\r?\n\r?\n", head)
        if found is None:
            if len(self._buffer) > _MOST_HEAD_BYTES:
                raise NovaError("the head of a part is too long")
            return False
        del self._buffer[: found.end()]
        self._begin_part(head[: found.start()].replace(b"\r\n", b"\n"))
        self._state = self._data
        return True

    def _begin_part(self, head: bytes) -> None:
        disposition = _DISPOSITION.search(head)
        given = {} if disposition is None else _parameters(disposition[1])
        self._field = given.get("name", "")
        if self._field == _FILE_FIELD:
            if self.form.file is not None:
                raise NovaError("the form has more than one file")
            self.form.file = tempfile.TemporaryFile(prefix="mountnav-nova-")  # noqa: SIM115
            self.form.name = _plain_name(given.get("filename", ""))
        self._text.clear()

    def _data(self) -> bool:
        at = self._buffer.find(self._token)
        if at < 0:
            # the last bytes may be the beginning of a boundary, and of the line end before it
            keep = len(self._token) + 1
            if len(self._buffer) > keep:
                self._take(memoryview(self._buffer)[:-keep])
                del self._buffer[:-keep]
            return False
        before = at - 1 if at > 0 and self._buffer[at - 1 : at] == b"\r" else at
        self._take(memoryview(self._buffer)[:before])
        del self._buffer[: at + len(self._token)]
        if self._field == _JSON_FIELD:
            self.form.json = bytes(self._text)
        self._state = self._boundary
        return True

    def _take(self, data: memoryview) -> None:
        """Keep a piece of a part."""
        with data:
            if self._field == _FILE_FIELD and self.form.file is not None:
                self.form.size += len(data)
                if self.form.size > self._most_bytes:
                    raise too_large(self._most_bytes)
                self._hash.update(data)
                self.form.file.write(data)
                return
            if len(self._text) + len(data) > MOST_JSON_BYTES:
                raise NovaError(f"a field has more than {MOST_JSON_BYTES} bytes", status=413)
            self._text += data


def spooled(form: Form, content: bytes) -> None:
    """Make a form's file of something that came otherwise."""
    form.file = tempfile.TemporaryFile(prefix="mountnav-nova-")  # noqa: SIM115
    form.file.write(content)
    form.file.flush()
    form.size, form.sha256 = len(content), hashlib.sha256(content).hexdigest()


def too_large(most_bytes: int) -> NovaError:
    """What is said of an upload that is too long."""
    return NovaError(f"the upload is larger than {most_bytes / 1e6:g} MB", status=413)


def _parameters(disposition: bytes) -> dict[str, str]:
    found = {}
    for name, quoted, bare in _PARAMETER.findall(disposition):
        value = re.sub(rb"\\(.)", rb"\1", quoted) if quoted else bare
        found[name.decode("ascii").lower()] = value.decode("utf-8", "replace")
    return found


def _plain_name(name: str) -> str:
    """A file's name as it is shown: its last part, printable."""
    last = re.split(r"[/\\]", name)[-1]
    shown = "".join(letter if letter.isprintable() else "_" for letter in last)[-_LONGEST_NAME:]
    return shown or "upload"
