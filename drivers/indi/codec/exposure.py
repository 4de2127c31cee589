"""One exposure behind INDI: its file unwrapped, which file is its own, its middle; no I/O.

".z" is zlib's own format [INDI white paper, appendix]; ".fz" is a tile-compressed FITS file, which is read as
such and stays as it is. Drivers send such a file in a buffer that is longer than it: `length` says how long.

INDI doesn't say which exposure a file belongs to. A file counts as the one that was asked for when it came
after the driver had begun, not before its exposure could be over, has the exposure that was ordered in its
header, and not the time of an earlier file.

What a driver says of its exposure may come late, out of order, or not at all: some expose before they say
that they begin, some say it when the file is already there, some only say that they are done. So a file that
came early by what we heard, but not by when we ordered it, is kept, and counts when no other comes: soon
after its driver said that it is done, or long after it should have been. If it came before its driver said
that it began, it counts only with a time in its header that fits.
"""

from __future__ import annotations

import binascii
import zlib
from collections.abc import Iterable
from dataclasses import dataclass, field
from datetime import datetime

from drivers.generic.exposure import ExposureTimes, TimeSource, lasted_otherwise
from drivers.indi.codec.messages import Blob, Changed, State
from mountnav.reading.unpacking import most_unpacked

_WHITE = b" \t\r\n"


class BrokenBlob(ValueError):
    """A BLOB that can't be unwrapped."""


def content(blob: Blob) -> bytes | bytearray:
    """Return the file in a BLOB.

    Raises
    ------
    BrokenBlob
        If it is empty, cut short, or not what it says.
    """
    packed: bytes | bytearray
    packed = decoded = _decoded(blob.encoded)
    if blob.length is not None:
        if blob.length > len(packed):
            raise BrokenBlob(f"{len(packed)} of {blob.length} bytes are there")
        del decoded[blob.length :]
    if blob.format.lower().endswith(".z"):
        packed = _inflated(packed, blob.size)
    elif not blob.format.lower().endswith(".fz") and blob.size > len(packed):
        raise BrokenBlob(f"{len(packed)} of {blob.size} bytes are there")
    if not packed:
        raise BrokenBlob("it is empty")
    return packed


def _decoded(pieces: Iterable[bytes]) -> bytearray:
    """Decode piece by piece: no step is long, so that other threads, a stop's among them, get their turn."""
    plain, carried = bytearray(), b""
    try:
        for piece in pieces:
            dense = carried + piece.translate(None, _WHITE)
            whole = len(dense) & ~3
            plain += binascii.a2b_base64(dense[:whole])
            carried = dense[whole:]
        if carried:
            plain += binascii.a2b_base64(carried)
    except binascii.Error as fault:
        raise BrokenBlob(f"that is not base64: {fault}") from fault
    return plain


def _inflated(packed: bytes | bytearray, size: int) -> bytes:
    if not 0 < size <= most_unpacked(len(packed)):
        raise BrokenBlob(
            f"{len(packed)} bytes unpack to {size}, it says: no picture of the sky packs so well"
        )
    machine = zlib.decompressobj()
    try:
        plain = machine.decompress(packed, size + 1)
    except zlib.error as fault:
        raise BrokenBlob(f"it can't be unpacked: {fault}") from fault
    if len(plain) != size or not machine.eof:
        raise BrokenBlob(f"it unpacks to {len(plain)} bytes or more, {size} were promised")
    return plain


_SOONEST = 0.9
"""The part of the exposure time after which a file can be its own. Below 1, because a driver's clock and
the way of a message differ from ours. Chosen by hand; lower takes the file of an earlier exposure for
ours."""
_LATER_S = 0.5
"""How long a better file is awaited after the driver said that the exposure is done, when one has come that
may be an earlier exposure's. Chosen by hand."""
_UNSAID_S = 10.0
"""The same for a driver that never says that it is done, counted from when the exposure should be over.
Chosen by hand; it delays the frames of such drivers only."""
_HEADER = TimeSource("its header", "its header gives no time", "its header is")


@dataclass(slots=True)
class Exposure:
    """What was ordered, and what has been heard of it.

    Attributes
    ----------
    ordered : datetime
        When, by our clock.
    ordered_s : float
        The same, monotonic.
    count : int
        How many messages had come until then.
    answered : bool
        Whether all was heard that the driver had to say to the order at once.
    begun, begun_s
        When its driver was heard to have begun.
    ended_s : float or None
        When it was heard to have ended without being done.
    done : bool
        Its driver says that it was exposed: the file is written, packed and sent only then, which may take a
        small computer many seconds.
    done_s : float
        When it was first heard to be.
    overtaken : bool
        Another program ordered an exposure meanwhile: its driver has dropped this one.
    early : (Blob, datetime) or None
        The last file that came when the exposure could be over since it was ordered, but not since it was
        heard to have begun.
    early_s : float
        When.
    doubtful : bool
        The file that counts may be another's: its header must have a time that fits.
    dropped : list of str
        Why files were dropped.
    files : list of (Blob, datetime)
        With the time of arrival.
    """

    exposure_s: float
    ordered: datetime
    ordered_s: float
    count: int
    answered: bool = False
    begun: datetime | None = None
    begun_s: float = 0.0
    ended_s: float | None = None
    done: bool = False
    done_s: float = 0.0
    failed: bool = False
    overtaken: bool = False
    dropped: list[str] = field(default_factory=list)
    early: tuple[Blob, datetime] | None = None
    early_s: float = 0.0
    doubtful: bool = False
    files: list[tuple[Blob, datetime]] = field(default_factory=list)

    def take_state(self, state: State, utc: datetime, at_s: float) -> None:
        """Take in what the driver claims of the exposure."""
        if self.begun is None:
            self._take_first(state, utc, at_s)
            return
        self.failed = self.failed or state is State.ALERT
        if state is State.OK and not self.done:
            self.done, self.done_s = True, at_s
        if state is State.BUSY:
            self.ended_s = None
        elif self.ended_s is None and not self.done:
            self.ended_s = at_s

    def _take_first(self, state: State, utc: datetime, at_s: float) -> None:
        match state:
            case State.BUSY:
                self.begun, self.begun_s = utc, at_s
                # what was done before was another's, or its driver speaks out of order
                self.done, self.ended_s = False, None
            case State.OK if self._can_be_over(at_s) and not self.done:
                self.done, self.done_s = True, at_s
            case State.ALERT if self.answered and self.ended_s is None:
                # an earlier exposure's, or a refusal that came late: nothing better may follow
                self.ended_s = at_s

    def _can_be_over(self, at_s: float) -> bool:
        return at_s >= self.ordered_s + _SOONEST * self.exposure_s

    def take_files(self, event: Changed, utc: datetime, at_s: float) -> str | None:
        """Take in the files of a message; return why one was dropped."""
        dropped = None
        for blob in event.values.values():
            if not isinstance(blob, Blob) or blob.is_empty:
                continue
            if not self._can_be_over(at_s):
                dropped = "too early for this exposure"
            elif not self.done and (self.begun is None or at_s < self.begun_s + _SOONEST * self.exposure_s):
                self.early, self.early_s = (blob, utc), at_s
            else:
                self.files.append((blob, utc))
        return dropped

    def settle(self, at_s: float) -> None:
        """Take the early file for this exposure's own: it should be over, and no later one has come."""
        if self.early is None or self.files:
            return
        if self.done:
            said, over_s = True, max(self.done_s, self.early_s) + _LATER_S
        else:
            said, over_s = False, max(self.begun_s, self.ordered_s) + self.exposure_s + _UNSAID_S
        if at_s > over_s:
            before_begun = self.begun is not None and self.early_s < self.begun_s
            self.doubtful = before_begun or not said
            self.files.append(self.early)
            self.early = None

    def is_of_another(self, told_s: float | None) -> bool:
        """Whether the exposure that a file's header reports is not the one that was ordered."""
        return lasted_otherwise(told_s, self.exposure_s)

    def middle(self, by_header: datetime | None, came: datetime, tolerance_s: float) -> tuple[datetime, str]:
        """Mid-exposure, and whose clock says so; see `Moments.middle`."""
        return self._moments(came).middle(by_header, tolerance_s, _HEADER)

    def why_not(
        self, by_header: datetime | None, came: datetime, tolerance_s: float, *, clocks_agree: bool
    ) -> str | None:
        """Tell why a file can't be this exposure's by its header's time, if it can't.

        Parameters
        ----------
        by_header : datetime or None
            Mid-exposure.
        came : datetime
            When the file arrived, by our clock.
        clocks_agree : bool
            Whether the clock of its computer agreed with ours lately.
        """
        moments = self._moments(came)
        if self.doubtful and (by_header is None or not moments.allow(by_header, tolerance_s)):
            return "it came before its driver said that it began, and gives no time that fits"
        if by_header is not None and clocks_agree and moments.are_after(by_header, tolerance_s):
            return "it was exposed before this exposure was ordered"
        return None

    def _moments(self, came: datetime) -> ExposureTimes:
        return ExposureTimes(self.exposure_s, self.ordered, self.begun or self.ordered, came)
