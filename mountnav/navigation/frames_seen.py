"""Whether a frame shows the sky of now: its pixels are new, and the sky in it moved as the mount did.

A camera that hands out the frame before (a buffer that is one behind), or the same one again and again, with
a new time in its header, would have each slew answered by the sky of before it: the mount would be synced on
a place where the tube no longer looks. A frame is believed

- when its pixels are not those of an earlier frame, and
- when, since the last frame that was believed, the sky in it moved as the mount says that it did; or, where
  that isn't known (the first frame, a very small slew, zero points that jumped) or is not so (play, a slip,
  another side of the pier), when frames taken afterwards, at the same place, agree.
"""

from __future__ import annotations

import hashlib
import math
from collections import deque
from dataclasses import dataclass, field
from datetime import datetime

import numpy as np
from numpy.typing import NDArray

from mountnav.frames import Frame
from mountnav.navigation.reports import CameraIdentity, Look
from mountnav.navigation.vetoes import apart_arcsec
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import displaced, offset_arcsec, separation_arcsec

_KEPT = 32
"""Fingerprints that are remembered, frames: a buffer of more is not known of any camera. Doubled, so is the
memory: some bytes each."""
_ALIKE = 0.5
"""So much of a motion may be missing or too much in the sky; an old frame misses all of it. Chosen by hand,
half-way. Doubled, any frame counts as fresh."""
_STOOD = 0.3
"""With less of the motion than this the sky stood still: an old frame, or a tube that didn't follow. Chosen
by hand. Doubled, an honest small slew with play is called an old frame."""
_SETTLES_ARCSEC = 3.0
"""A reading settles by as much beside what was synced, beyond its steps, without any slew, ″. Chosen by hand.
Doubled, small slews prove no frame fresh."""
_FLOOR_ARCSEC = 5.0
"""Added to what looks scatter: seeing and the worm between two frames, ″. Chosen by hand. Doubled, small
slews prove no frame fresh."""
_AGREE_AFTER_STANDING = 2
"""So many more frames must agree that the sky stood still before a tube is said not to follow; a camera that
is two behind shows the old place twice. Doubled, a tube that doesn't follow costs two more exposures."""
LAGS = 2
"""A camera that was caught with an old frame so often, with no other proof between, is broken. Chosen by
hand. Doubled, two more looks are spoiled before it is said."""
_INLINE_BYTES = 1 << 20
"""More than this, about 1 ms of work, goes to a thread. Doubled, the event loop stands still for 2 ms at a
frame."""
_NOTHING_BEFORE = "no earlier frame since the last sync proves that this one is new"


@dataclass(frozen=True, slots=True)
class Sight:
    """What is to be thought of a solved frame.

    Attributes
    ----------
    doubt : str
        In words, why another frame is needed before anything is done by it; empty: it is believed.
    lagged : str
        In words, that frames before it were old ones; empty if none was.
    agreed : tuple of Look
        Frames before it that were doubted, and are believed now since this one agrees with them.
    """

    doubt: str = ""
    lagged: str = ""
    agreed: tuple[Look, ...] = ()


@dataclass(slots=True)
class _Waiting:
    look: Look
    stood: bool


@dataclass(slots=True)
class CameraFrames:
    """The frames of one camera.

    Attributes
    ----------
    lags : int
        How often it handed out an old frame, since a frame was last proven by a motion at once.
    last : Look or None
        The last look that was believed.
    """

    lags: int = 0
    last: Look | None = None
    _counts: bool = False
    _prints: deque[tuple[bytes, datetime | None]] = field(default_factory=lambda: deque(maxlen=_KEPT))
    _waiting: list[_Waiting] = field(default_factory=list)

    def repeats(self, frame: Frame, print_: bytes) -> bool:
        """Whether its pixels are those of an earlier exposure; remembers them.

        A frame that is one value all over (a cap on the tube, daylight) says nothing.
        """
        for known, utc in self._prints:
            if known == print_ and utc != frame.mid_exposure_utc:
                return not _flat(frame.pixels)
        if (print_, frame.mid_exposure_utc) not in self._prints:
            self._prints.append((print_, frame.mid_exposure_utc))
        return False

    def judge(
        self,
        found: Look,
        *,
        allowed_arcsec: float,
        resolution_arcsec: float,
        moved_utc: datetime | None,
        synced: Look | None,
        confirmed_later: bool,
    ) -> Sight:
        """Judge a solved frame by those before it; a believed one is what the next are compared with.

        Parameters
        ----------
        allowed_arcsec : float
            How far two frames of one place may be apart.
        resolution_arcsec : float
            The mount's.
        moved_utc : datetime or None
            End of the mount's last order to move.
        synced : Look or None
            The look that the mount was last synced on.
        confirmed_later : bool
            Nothing is done by it alone: it may pass where there is nothing to compare it with, and the next
            one then needs its own proof.
        """
        doubt, stood, proven = self._against(found, allowed_arcsec, resolution_arcsec, moved_utc, synced)
        if doubt == _NOTHING_BEFORE and confirmed_later:
            # two in a row that agree are as good as proven
            before = self.last
            self._counts = (
                before is not None
                and before.segment_id == found.segment_id
                and before.mid_exposure_utc < found.mid_exposure_utc
                and separation_arcsec(before.believed, found.believed) <= allowed_arcsec + resolution_arcsec
                and apart_arcsec(before, found) <= allowed_arcsec + resolution_arcsec
            )
            self.last, self._waiting = found, []
            return Sight()
        waiting = [
            earlier
            for earlier in self._waiting
            if earlier.look.segment_id == found.segment_id
            and earlier.look.mid_exposure_utc < found.mid_exposure_utc
            and separation_arcsec(earlier.look.believed, found.believed) <= allowed_arcsec + resolution_arcsec
        ]
        # the last frames before it, as long as they agree with it
        agreed: list[Look] = []
        for earlier in reversed(waiting):
            if apart_arcsec(earlier.look, found) > allowed_arcsec + resolution_arcsec:
                break
            agreed.insert(0, earlier.look)
        if doubt and len(agreed) < (_AGREE_AFTER_STANDING if stood else 1):
            self._waiting = [*waiting, _Waiting(found, stood)]
            return Sight(doubt)
        lagged = ""
        if not stood and any(earlier.stood for earlier in waiting):
            lagged = "it handed out a frame from before the mount's last slew, as if it were a new one"
            self.lags += 1
        elif proven:
            self.lags = 0
        self.last, self._counts, self._waiting = found, True, []
        return Sight(lagged=lagged, agreed=tuple(agreed))

    def _against(
        self,
        found: Look,
        allowed_arcsec: float,
        resolution_arcsec: float,
        moved_utc: datetime | None,
        synced: Look | None,
    ) -> tuple[str, bool, bool]:
        """Doubt in words, whether the sky stood still, and whether a motion proves the frame new."""
        last = self.last
        if last is None or not self._counts:
            return _NOTHING_BEFORE, False, False
        if last.look_id == found.look_id:
            return "", False, False
        then = _believed_then(last, found, synced)
        noise = _noise_arcsec(last, found) + resolution_arcsec
        seen_moved = separation_arcsec(found.seen, last.seen)
        if then is None:
            return _NOTHING_BEFORE, False, False
        moved = separation_arcsec(found.believed, then)
        was_off = offset_arcsec(last.seen, then)
        expected = displaced(found.believed, was_off.east_arcsec, was_off.north_arcsec)
        miss = separation_arcsec(found.seen, expected)
        if moved > 2.0 * noise:
            if miss <= _ALIKE * moved:
                return "", False, True
            words = f"the mount moved {moved:.0f}″ since the last frame, the sky in it {seen_moved:.0f}″"
            return words, seen_moved <= _STOOD * moved + noise, False
        ordered = moved_utc is not None and moved_utc > last.after.utc
        if found.segment_id != last.segment_id:
            # the order may have been the sync on the last frame; more than the mount's own steps is a slew
            ordered = ordered and moved > resolution_arcsec + _SETTLES_ARCSEC
        if ordered:
            return f"the slew of {moved:.0f}″ was too small to prove the frame new", False, False
        if miss <= allowed_arcsec + noise:
            return "", False, False
        return f"the mount didn't move since the last frame, the sky in it {seen_moved:.0f}″", False, False


class FramesSeen:
    """The frames of a telescope, each camera for itself."""

    def __init__(self) -> None:
        self._cameras: dict[CameraIdentity, CameraFrames] = {}

    def of(self, camera: CameraIdentity) -> CameraFrames:
        """Those of one camera."""
        return self._cameras.setdefault(camera, CameraFrames())


def fingerprint(pixels: NDArray[np.generic]) -> bytes:
    """Digest of all pixels with their shape and type: noise makes it another one for each exposure.

    Parameters
    ----------
    pixels : ndarray, shape (height, width)
        The frame, ADU.
    """
    # an axis that repeats itself in memory holds nothing new
    distinct = pixels[tuple(slice(0, 1) if step == 0 else slice(None) for step in pixels.strides)]
    digest = hashlib.blake2b(f"{pixels.shape} {pixels.dtype.str}".encode(), digest_size=16)
    digest.update(np.ascontiguousarray(distinct).view(np.uint8).data)
    return digest.digest()


def takes_long(pixels: NDArray[np.generic]) -> bool:
    """Whether a fingerprint of so many pixels is too slow to be made while others wait (over ~1 ms)."""
    return bool(pixels.nbytes > _INLINE_BYTES and 0 not in pixels.strides)


def _flat(pixels: NDArray[np.generic]) -> bool:
    return pixels.size == 0 or bool((pixels == pixels.flat[0]).all())


def _noise_arcsec(last: Look, found: Look) -> float:
    sigmas = [look.solution.center_sigma_arcsec for look in (last, found)]
    return _FLOOR_ARCSEC + 3.0 * math.hypot(*(sigma if math.isfinite(sigma) else 0.0 for sigma in sigmas))


def _believed_then(last: Look, found: Look, synced: Look | None) -> Icrs | None:
    """Where the mount would say today that it was at the last look; None when nobody knows."""
    if found.segment_id == last.segment_id:
        return last.believed
    return last.seen if synced is not None and synced.look_id == last.look_id else None


__all__ = ["LAGS", "CameraFrames", "FramesSeen", "Sight", "fingerprint", "takes_long"]
