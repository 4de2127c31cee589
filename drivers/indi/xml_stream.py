"""Cuts a stream of bytes into XML elements that follow each other without a root; what is broken is skipped.

INDI's stream is no XML document: it has no root, never ends, and one lost byte must not end it. Therefore no
XML library reads it, but this: elements, attributes, text, comments and declarations, nothing else. There are
no document types, so no entities but the five of XML and numbered characters. After something broken nothing
counts until the next element that INDI knows begins, and that something was lost is told once.

The result doesn't depend on where the stream is cut, and a message of n bytes costs a time of order n.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field

MOST_TAG_BYTES = 16_384
MOST_MESSAGE_BYTES = 1 << 30
MOST_DEPTH = 8
_KEPT_TEXT_BYTES = 96
_EXCERPT_BYTES = 80

_VECTORS = [
    verb + kind for verb in ("def", "set", "new") for kind in ("Text", "Number", "Switch", "Light", "BLOB")
]
MESSAGES = frozenset(
    [f"{name}Vector" for name in _VECTORS]
    + ["delProperty", "message", "getProperties", "enableBLOB", "pingRequest", "pingReply"]
)
"""Elements that stand at the top of INDI's stream, and nowhere else."""

_NAME = rb"[A-Za-z_][\w:.\-]*"
_ATTRIBUTE = re.compile(rb"\s+(" + _NAME + rb")\s*=\s*(?:'([^'<]*)'|\"([^\"<]*)\")")
_TAG = re.compile(
    rb"<(?P<end>/?)(?P<name>" + _NAME + rb")"
    rb"(?P<attributes>(?:\s+" + _NAME + rb"\s*=\s*(?:'[^'<]*'|\"[^\"<]*\"))*)\s*(?P<alone>/?)>"
)
_QUOTES_CLOSED = re.compile(rb"<[^'\"]*(?:(?:'[^']*'|\"[^\"]*\")[^'\"]*)*>")
_BEGINS_MESSAGE = re.compile(rb"<(" + rb"|".join(sorted(name.encode() for name in MESSAGES)) + rb")[\s/>]")
_LONGEST_BEGINNING = max(map(len, MESSAGES)) + 2
_REFERENCE = re.compile(r"&(?:(amp|lt|gt|quot|apos)|#(\d{1,7})|#[xX]([0-9a-fA-F]{1,6}));")
_NAMED = {"amp": "&", "lt": "<", "gt": ">", "quot": '"', "apos": "'"}


@dataclass(frozen=True, slots=True)
class Element:
    """One element, whole.

    Attributes
    ----------
    tag : str
    attributes : dict
    pieces : tuple of bytes
        What stands directly in it, in the pieces it came in: a large file is not copied here.
    children : tuple of Element
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
    why : str
    excerpt : bytes
        Where it was broken.
    """

    why: str
    excerpt: bytes


@dataclass(slots=True)
class _Open:
    tag: str
    attributes: dict[str, str]
    text: list[bytes] = field(default_factory=list)
    children: list[Element] = field(default_factory=list)


class ElementStream:
    """Bytes in, elements out.

    Parameters
    ----------
    most_bytes : int
        A longer message counts as broken.
    """

    def __init__(self, most_bytes: int = MOST_MESSAGE_BYTES) -> None:
        self._most_bytes = most_bytes
        self._buffer = bytearray()
        self._at = 0
        self._open: list[_Open] = []
        self._raw: list[bytes] = []
        self._message_bytes = 0
        self._text_bytes = 0
        self._junk = b""
        self._lost = False
        self._skip_to = b""
        self._found: list[Element | Malformed] = []

    def feed(self, data: bytes) -> list[Element | Malformed]:
        """Take bytes, and return what they complete."""
        self._buffer += data
        while self._step():
            pass
        del self._buffer[: self._at]
        self._at = 0
        found, self._found = self._found, []
        return found

    def _step(self) -> bool:
        """Take one piece of the buffer; False when more bytes are needed."""
        if self._skip_to:
            return self._skip()
        if self._lost:
            return self._seek()
        begin = self._buffer.find(b"<", self._at)
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

    def _skip(self) -> bool:
        """Pass over a comment or a declaration."""
        end = self._buffer.find(self._skip_to, self._at)
        if end < 0:
            self._at = max(self._at, len(self._buffer) - len(self._skip_to) + 1)
            return False
        self._at = end + len(self._skip_to)
        self._skip_to = b""
        return True

    def _seek(self) -> bool:
        """Look for the next message after something broken."""
        begin = self._buffer.find(b"<", self._at)
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
        if not self._open:
            if len(self._junk) < _EXCERPT_BYTES:
                self._junk = (self._junk + (text if self._junk else text.lstrip()))[:_EXCERPT_BYTES]
            return True
        self._message_bytes += len(text)
        if self._message_bytes > self._most_bytes:
            self._break("the message is too long", self._raw[0] if self._raw else b"")
            return False
        self._open[-1].text.append(text)
        room = _KEPT_TEXT_BYTES - self._text_bytes
        if room > 0:
            self._raw.append(text[:room])
        self._text_bytes += len(text)
        return True

    def _take_tag(self) -> bool:
        buffer, begin = self._buffer, self._at
        head = bytes(buffer[begin : begin + 4])
        if b"<!--".startswith(head) or head == b"<!--":
            if len(head) < 4:
                return False
            self._at, self._skip_to = begin + 4, b"-->"
            return True
        if head[:2] == b"<?":
            self._at, self._skip_to = begin + 2, b"?>"
            return True
        end = begin
        while True:
            end = _first_angle(buffer, end + 1, begin + MOST_TAG_BYTES)
            if end < 0:
                if len(buffer) - begin < MOST_TAG_BYTES:
                    return False
                return self._break("a tag doesn't end", bytes(buffer[begin : begin + _EXCERPT_BYTES]))
            if buffer[end] == 0x3C:
                return self._break("a tag was cut", bytes(buffer[begin:end]), end - begin)
            tag = bytes(buffer[begin : end + 1])
            match = _TAG.fullmatch(tag)
            if match is not None:
                self._at = end + 1
                return self._take_whole_tag(tag, match)
            if _QUOTES_CLOSED.fullmatch(tag):
                return self._break("that is no tag", tag)

    def _take_whole_tag(self, tag: bytes, match: re.Match[bytes]) -> bool:
        name = match["name"].decode()
        self._message_bytes += len(tag)
        self._end_text()
        if match["end"]:
            if not self._open or self._open[-1].tag != name or match["alone"] or match["attributes"]:
                return self._break("an end without its beginning", tag, 0)
            self._raw.append(tag)
            self._close()
            return True
        if self._open and name in MESSAGES:
            self._at -= len(tag)
            return self._break("a message was cut by the next one", tag, 0)
        if len(self._open) == MOST_DEPTH:
            return self._break("elements lie too deep", tag, 0)
        attributes: dict[str, str] = {}
        for attribute in _ATTRIBUTE.finditer(match["attributes"]):
            quoted = attribute[2] if attribute[2] is not None else attribute[3]
            attributes.setdefault(attribute[1].decode(), plain_text(quoted))
        if not self._open:
            self._raw, self._message_bytes = [], len(tag)
        self._raw.append(tag)
        self._open.append(_Open(name, attributes))
        if match["alone"]:
            self._close()
        return True

    def _end_text(self) -> None:
        left_out = self._text_bytes - _KEPT_TEXT_BYTES
        if left_out > 0:
            self._raw.append(b"...%d bytes left out..." % left_out)
        self._text_bytes = 0

    def _close(self) -> None:
        one = self._open.pop()
        top = not self._open
        raw = b"".join(self._raw) if top else b""
        element = Element(one.tag, one.attributes, tuple(one.text), tuple(one.children), raw)
        if top:
            self._found.append(element)
        else:
            self._open[-1].children.append(element)

    def _break(self, why: str, excerpt: bytes, passed: int = 1) -> bool:
        """Give up the open message, and look for the next one."""
        self._tell(why, excerpt)
        self._open, self._raw, self._text_bytes = [], [], 0
        self._at = min(self._at + passed, len(self._buffer))
        self._lost = True
        return True

    def _tell(self, why: str, excerpt: bytes) -> None:
        self._found.append(Malformed(why, bytes(excerpt[:_EXCERPT_BYTES])))


def _first_angle(buffer: bytearray, start: int, end: int) -> int:
    """The first ``<`` or ``>``, or -1."""
    close = buffer.find(b">", start, end)
    opened = buffer.find(b"<", start, close if close >= 0 else end)
    return opened if opened >= 0 else close


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
