"""Cuts a stream of bytes into XML elements that follow each other without a root; what is broken is skipped.

INDI's stream is no XML document: it has no root, never ends, and one lost byte must not end it. Therefore no
XML library reads it, but this: elements, attributes, text, comments and declarations, nothing else. There are
no document types, so no entities but the five of XML and numbered characters. After something broken nothing
counts until the next element that INDI knows begins, and that something was lost is reported once.

The result doesn't depend on where the stream is cut. Each byte is looked at a fixed number of times, however
it is cut: where a tag that isn't whole yet was read to is remembered. What one message, one tag and one
comment may take is bounded, and `ElementStream.parts` does the work in parts that are short enough for a
loop's turn.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field

MOST_TAG_BYTES = 16_384
"""Of a tag, a comment or a declaration. Drivers' longest hold sentences of a few hundred bytes; doubled, a
step takes twice as long."""
MOST_ATTRIBUTES = 64
"""Of a tag; INDI's own have at most ten."""
MOST_MESSAGE_BYTES = 1 << 30
"""Of a message with its files: an image of 800 MB in base64. Chosen by hand, to bound our memory."""
MOST_PLAIN_BYTES = 1 << 20
"""Of a message, its files' contents left out. A long list of switches has some 20,000."""
MOST_ELEMENTS = 2000
"""In a message. All are made a value of in one go, some 3 us each: doubled, a loop's longest turn doubles."""
MOST_DEPTH = 8
"""Of elements in one another; INDI's own messages have two levels. Chosen by hand."""
PART_WORK = 16_384
"""Units of `ElementStream.work` in a part: about a millisecond. Doubled, a stop waits longer for its turn."""
_STEP_WORK = 64
"""What a tag or a text costs besides its bytes, in bytes of a tag that are read."""
_COPIED_BYTES = 32
"""So many bytes of text are copied at the cost of one that is read."""
_GATHERED_BYTES = 65_536
"""Small pieces of text are joined when they are so many bytes. Doubled, a copy in one turn takes longer."""
_KEPT_TEXT_BYTES = 96
"""So much of each text of a message is kept as it came, for a recording. Chosen by hand."""
_KEPT_RAW_BYTES = 16_384
"""So much of a message is kept as it came, to be recorded; only files' contents make one longer."""
_EXCERPT_BYTES = 80
"""So much of what is malformed is quoted in a log. Chosen by hand: one line."""

_VECTORS = [
    verb + kind for verb in ("def", "set", "new") for kind in ("Text", "Number", "Switch", "Light", "BLOB")
]
MESSAGES = frozenset(
    [f"{name}Vector" for name in _VECTORS]
    + ["delProperty", "message", "getProperties", "enableBLOB", "pingRequest", "pingReply"]
)
"""Elements that stand at the top of INDI's stream, and nowhere else."""
_FILE = "oneBLOB"

# what was taken is not given back (`++`, `*+`): whatever comes, each byte of a tag is matched once
_NAME = rb"[A-Za-z_][\w:.\-]*+"
_ATTRIBUTE = re.compile(rb"\s++(" + _NAME + rb")\s*+=\s*+(?:'([^'<]*+)'|\"([^\"<]*+)\")")
_TAG = re.compile(
    rb"<(?P<end>/?)(?P<name>" + _NAME + rb")"
    rb"(?P<attributes>(?:\s++" + _NAME + rb"\s*+=\s*+(?:'[^'<]*+'|\"[^\"<]*+\"))*+)\s*+(?P<alone>/?)>"
)
_TURNS = {b"": re.compile(rb"[<>'\"]"), b"'": re.compile(rb"[<']"), b'"': re.compile(rb"[<\"]")}
"""Where a tag goes on otherwise, by the quote that is open."""
_BEGINS_MESSAGE = re.compile(rb"<(" + rb"|".join(sorted(name.encode() for name in MESSAGES)) + rb")[\s/>]")
_LONGEST_BEGINNING = max(map(len, MESSAGES)) + 2
"""So many bytes show whether a message begins: its name, the bracket before and a byte after."""
_REFERENCE = re.compile(r"&(?:(amp|lt|gt|quot|apos)|#(\d{1,7})|#[xX]([0-9a-fA-F]{1,6}));", re.ASCII)
_NAMED = {"amp": "&", "lt": "<", "gt": ">", "quot": '"', "apos": "'"}


@dataclass(frozen=True, slots=True)
class Element:
    """One element, whole.

    Attributes
    ----------
    pieces : tuple of bytes
        What stands directly in it, in the pieces it came in: a large file is not copied here.
    raw : bytes
        As it came, long texts abbreviated; empty for children.
    """

    tag: str
    attributes: dict[str, str]
    pieces: tuple[bytes, ...]
    children: tuple[Element, ...]
    raw: bytes = b""

    @property
    def text(self) -> bytes:
        """What stands directly in it, as it came."""
        return b"".join(self.pieces)


@dataclass(frozen=True, slots=True)
class Malformed:
    """Something in the stream was broken: what it belonged to is lost.

    Attributes
    ----------
    excerpt : bytes
        Where it was broken.
    device : str or None
        Which device it names, "" for none; None where that can't be known.
    """

    why: str
    excerpt: bytes
    device: str | None = None


@dataclass(slots=True)
class _Open:
    tag: str
    attributes: dict[str, str]
    text: list[bytes] = field(default_factory=list)
    gathered: bytearray = field(default_factory=bytearray)
    children: list[Element] = field(default_factory=list)

    def take(self, text: bytes) -> None:
        """Keep text; small pieces are gathered, for a piece costs more than its bytes."""
        self.gathered += text
        if len(self.gathered) >= _GATHERED_BYTES:
            self.text.append(bytes(self.gathered))
            self.gathered.clear()

    def whole(self, raw: bytes) -> Element:
        pieces = (*self.text, bytes(self.gathered)) if self.gathered else tuple(self.text)
        return Element(self.tag, self.attributes, pieces, tuple(self.children), raw)


class ElementStream:
    """Bytes in, elements out.

    Parameters
    ----------
    most_bytes : int
        A longer message counts as broken.

    Attributes
    ----------
    work : int
        What was done so far, in bytes of tags that were read: of the order of the bytes that came.
    """

    def __init__(self, most_bytes: int = MOST_MESSAGE_BYTES) -> None:
        self.work = 0
        self._most_bytes = most_bytes
        self._buffer = bytearray()
        self._at = 0
        self._read = 0
        """How far the tag that begins at `_at` was read."""
        self._quote = b""
        self._quotes = 0
        self._open: list[_Open] = []
        self._raw: list[bytes] = []
        self._raw_bytes = self._raw_left_out = 0
        self._message_bytes = self._plain_bytes = self._elements = 0
        self._text_bytes = 0
        self._junk = b""
        self._lost = False
        self._skip_to = b""
        self._skipped = 0
        self._found: list[Element | Malformed] = []

    def feed(self, data: bytes) -> list[Element | Malformed]:
        """Take bytes, and return what they complete."""
        return [found for part in self.parts(data) for found in part]

    def parts(self, data: bytes) -> Iterator[list[Element | Malformed]]:
        """Take bytes, and yield what they complete: after each part other tasks may have a turn."""
        self._buffer += data
        begun = self.work
        while self._step():
            if self.work - begun >= PART_WORK:
                yield self._taken()
                begun = self.work
        yield self._taken()

    def _taken(self) -> list[Element | Malformed]:
        del self._buffer[: self._at]
        self._at = 0
        found, self._found = self._found, []
        return found

    def _step(self) -> bool:
        """Take one piece of the buffer; False when more bytes are needed."""
        self.work += _STEP_WORK
        if self._skip_to:
            return self._skip()
        if self._lost:
            return self._seek()
        if self._read:
            return self._take_tag()
        begin = self._find(b"<", self._at, len(self._buffer))
        end = begin if begin >= 0 else len(self._buffer)
        if end > self._at:
            if not self._take_text(bytes(memoryview(self._buffer)[self._at : end])):
                return True
            self._at = end
        if begin < 0:
            return False
        if self._junk:
            self._tell("there is text between two messages", self._junk.rstrip())
            self._junk = b""
        return self._take_tag()

    def _find(self, what: bytes, start: int, end: int) -> int:
        """Where something is next, or -1."""
        found = self._buffer.find(what, start, end)
        self.work += ((found if found >= 0 else min(end, len(self._buffer))) - start) // _COPIED_BYTES
        return found

    def _skip(self) -> bool:
        """Pass over a comment or a declaration."""
        limit = self._at + MOST_TAG_BYTES - self._skipped
        end = self._find(self._skip_to, self._at, limit)
        if end >= 0:
            self._at = end + len(self._skip_to)
            self._skip_to = b""
            return True
        if len(self._buffer) >= limit:
            begun = b"<!--" if self._skip_to == b"-->" else b"<?"
            self._skip_to = b""
            return self._break("a comment doesn't end", begun, limit - self._at)
        at = max(self._at, len(self._buffer) - len(self._skip_to) + 1)
        self._skipped += at - self._at
        self._at = at
        return False

    def _seek(self) -> bool:
        """Look for the next message after something broken."""
        begin = self._find(b"<", self._at, len(self._buffer))
        self._at = begin if begin >= 0 else len(self._buffer)
        if begin < 0:
            return False
        if _BEGINS_MESSAGE.match(self._buffer, begin):
            self._lost = False
            return True
        if len(self._buffer) - begin < _LONGEST_BEGINNING:
            return False
        self._at += 1
        return True

    def _take_text(self, text: bytes) -> bool:
        """Keep text where it belongs; False if the message is too long."""
        self.work += len(text) // _COPIED_BYTES
        if not self._open:
            if len(self._junk) < _EXCERPT_BYTES:
                self._junk = (self._junk + (text if self._junk else text.lstrip()))[:_EXCERPT_BYTES]
            return True
        if not self._fits(len(text), plain=self._open[-1].tag != _FILE):
            self._break("the message is too long", self._raw[0] if self._raw else b"")
            return False
        self._open[-1].take(text)
        room = _KEPT_TEXT_BYTES - self._text_bytes
        if room > 0:
            self._keep_raw(text[:room])
        self._text_bytes += len(text)
        return True

    def _fits(self, more: int, *, plain: bool) -> bool:
        """Count more bytes of the open message; False if they are too many."""
        self._message_bytes += more
        self._plain_bytes += more if plain else 0
        return self._message_bytes <= self._most_bytes and self._plain_bytes <= MOST_PLAIN_BYTES

    def _take_tag(self) -> bool:
        buffer, begin = self._buffer, self._at
        if not self._read:
            head = bytes(buffer[begin : begin + 4])
            if b"<!--".startswith(head) or head == b"<!--":
                if len(head) < 4:
                    return False
                self._at, self._skip_to, self._skipped = begin + 4, b"-->", 0
                return True
            if head[:2] == b"<?":
                self._at, self._skip_to, self._skipped = begin + 2, b"?>", 0
                return True
            self._read, self._quote, self._quotes = 1, b"", 0
        limit = begin + MOST_TAG_BYTES
        while True:
            start = begin + self._read
            turn = _TURNS[self._quote].search(buffer, start, limit)
            end = min(len(buffer), limit) if turn is None else turn.start()
            self.work += end - start + 1
            if turn is None:
                self._read = end - begin
                if len(buffer) < limit:
                    return False
                return self._break("a tag doesn't end", bytes(buffer[begin : begin + _EXCERPT_BYTES]))
            self._read = end + 1 - begin
            mark = buffer[end : end + 1]
            if mark == b"<":
                return self._break("a tag was cut", bytes(buffer[begin:end]), end - begin)
            if mark == b">":
                return self._take_whole_tag(bytes(buffer[begin : end + 1]))
            self._quote = b"" if self._quote else bytes(mark)
            self._quotes += 1
            if self._quotes > 2 * MOST_ATTRIBUTES:
                return self._break("a tag has too many attributes", bytes(buffer[begin:end]))

    def _take_whole_tag(self, tag: bytes) -> bool:
        self.work += len(tag)
        match = _TAG.fullmatch(tag)
        if match is None:
            return self._break("that is no tag", tag)
        self._at += len(tag)
        self._read = 0
        name = match["name"].decode()
        self._end_text()
        if match["end"]:
            if not self._open or self._open[-1].tag != name or match["alone"] or match["attributes"]:
                return self._break("an end without its beginning", tag, 0)
            self._fits(len(tag), plain=True)
            self._keep_raw(tag)
            self._close()
            return True
        if self._open and name in MESSAGES:
            self._at -= len(tag)
            return self._break("a message was cut by the next one", tag, 0)
        if len(self._open) == MOST_DEPTH:
            return self._break("elements lie too deep", tag, 0)
        if not self._open:
            self._raw, self._raw_bytes, self._raw_left_out = [], 0, 0
            self._message_bytes = self._plain_bytes = self._elements = 0
        self._elements += 1
        if not self._fits(len(tag), plain=True) or self._elements > MOST_ELEMENTS:
            return self._break("the message is too long", self._raw[0] if self._raw else tag, 0)
        attributes: dict[str, str] = {}
        for attribute in _ATTRIBUTE.finditer(match["attributes"]):
            quoted = attribute[2] if attribute[2] is not None else attribute[3]
            attributes.setdefault(attribute[1].decode(), plain_text(quoted))
        self._keep_raw(tag)
        self._open.append(_Open(name, attributes))
        if match["alone"]:
            self._close()
        return True

    def _keep_raw(self, piece: bytes) -> None:
        if self._raw_left_out or self._raw_bytes + len(piece) > _KEPT_RAW_BYTES:
            self._raw_left_out += len(piece)
            return
        self._raw.append(piece)
        self._raw_bytes += len(piece)

    def _end_text(self) -> None:
        left_out = self._text_bytes - _KEPT_TEXT_BYTES
        if left_out > 0:
            self._keep_raw(b"...%d bytes left out..." % left_out)
        self._text_bytes = 0

    def _close(self) -> None:
        one = self._open.pop()
        if self._open:
            self._open[-1].children.append(one.whole(b""))
            return
        if self._raw_left_out:
            self._raw.append(b"...%d bytes left out..." % self._raw_left_out)
        self._found.append(one.whole(b"".join(self._raw)))

    def _break(self, why: str, excerpt: bytes, passed: int = 1) -> bool:
        """Give up the open message, and look for the next one."""
        self._tell(why, excerpt)
        self._open, self._raw, self._text_bytes, self._read = [], [], 0, 0
        self._at = min(self._at + passed, len(self._buffer))
        self._lost = True
        return True

    def _tell(self, why: str, excerpt: bytes) -> None:
        self._found.append(Malformed(why, bytes(excerpt[:_EXCERPT_BYTES])))


def plain_text(text: bytes) -> str:
    """What a text means: UTF-8, or Latin-1 where it is none; references resolved, stray ``&`` left alone."""
    try:
        decoded = text.decode("utf-8")
    except UnicodeDecodeError:
        # some drivers write a degree sign as one byte
        decoded = text.decode("latin-1")
    return _REFERENCE.sub(_resolved, decoded) if "&" in decoded else decoded


def _resolved(match: re.Match[str]) -> str:
    if match[1]:
        return _NAMED[match[1]]
    code = int(match[2]) if match[2] else int(match[3], 16)
    return chr(code) if 0 < code < 0x110000 and not 0xD800 <= code < 0xE000 else match[0]
