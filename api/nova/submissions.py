"""What the nova face remembers: sessions, submissions with their jobs, and images for a while; all in bounds.

Ids are random and fit 31 bits (StellarSolver reads them as such), so they could be guessed: who asks must
show the session with which a submission was sent, or come from the address that sent it. Everybody else is
told that there is none.
"""

from __future__ import annotations

import asyncio
import os
import secrets
from collections import OrderedDict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from datetime import datetime
from typing import IO, Literal

import numpy as np
from numpy.typing import NDArray

from api.access.callers import Caller
from api.nova.codec import Asked, NovaError
from mountnav.sky.wcs_numbers import Value
from mountnav.solution import Solution, Verdict

__all__ = ["Result", "Session", "Sessions", "Submission", "Submissions", "result_of"]

Array = NDArray[np.float64]
Status = Literal["queued", "solving", "success", "failure"]

_ID_BITS = 31
"""Of an id: readers take it for a signed number of 32 bits."""
_SESSION_BYTES = 24
"""Random bytes of a session's secret: 192 bits, out of reach of guessing."""
_SESSIONS_MOST = 500
"""Sessions that are kept; the one used least recently goes. Doubled, a client that logs in without end takes
another 200 kB."""
_SUBMISSIONS_MOST = 500
"""Submissions that are kept, some 150 kB each at most; the oldest that is done goes. Doubled, 75 MB more."""
_PAIRS_MOST = 2000
"""Identified stars of a job that are kept, the brightest, for the files that hold them. Doubled, twice the
memory of each job."""
_LOG_MOST = 20_000
"""Characters of a job's log; chosen by hand, far above ours."""
_IMAGES_BYTES = 512_000_000
"""Images that are kept for pictures and new FITS files, all together; they lie where temporary files do. The
oldest goes. Doubled, twice the space there."""


@dataclass(slots=True)
class Session:
    """A client that has logged in.

    Attributes
    ----------
    secret : str
        What it shows with its requests.
    key_sha256 : str or None
        Of the key it logged in with; None where no key was needed.
    used_s : float
        When it was last used, by the loop's clock.
    """

    secret: str
    caller: Caller
    key_sha256: str | None
    used_s: float


class Sessions:
    """The sessions; one that isn't used for long is forgotten.

    Parameters
    ----------
    keep_s : float
        For how long.
    valid : callable
        Whether a session's key still may solve.
    """

    def __init__(self, keep_s: float, valid: Callable[[Session], bool], clock_s: Callable[[], float]) -> None:
        self._keep_s, self._valid, self._clock_s = keep_s, valid, clock_s
        self._sessions: OrderedDict[str, Session] = OrderedDict()

    def __len__(self) -> int:
        return len(self._sessions)

    def begin(self, caller: Caller, key_sha256: str | None) -> Session:
        """Begin one."""
        session = Session(secrets.token_urlsafe(_SESSION_BYTES), caller, key_sha256, self._clock_s())
        self._sessions[session.secret] = session
        while len(self._sessions) > _SESSIONS_MOST:
            self._sessions.popitem(last=False)
        return session

    def of(self, secret: object) -> Session | None:
        """The session of a secret; None if it is over, or its key was revoked."""
        found = self._sessions.get(secret) if isinstance(secret, str) else None
        if found is None:
            return None
        if self._clock_s() - found.used_s > self._keep_s or not self._valid(found):
            del self._sessions[found.secret]
            return None
        found.used_s = self._clock_s()
        self._sessions.move_to_end(found.secret)
        return found

    def forget(self) -> None:
        """Let go of those that are over."""
        now_s = self._clock_s()
        for secret in [one.secret for one in self._sessions.values() if now_s - one.used_s > self._keep_s]:
            del self._sessions[secret]


@dataclass(frozen=True, slots=True)
class Result:
    """What is kept of a solution.

    Attributes
    ----------
    cards : dict
        The WCS.
    x_px, y_px, ra_deg, dec_deg, flux, mag : ndarray, shape (n,)
        Of the identified stars, 0-based, the brightest first.
    seen_px : ndarray, shape (m, 2)
        What was measured, 0-based, the brightest first.
    """

    cards: dict[str, Value]
    x_px: Array
    y_px: Array
    ra_deg: Array
    dec_deg: Array
    flux: Array
    mag: Array
    seen_px: NDArray[np.float32]


def result_of(solution: Solution, cards: dict[str, Value], verdict: Verdict) -> Result:
    """Keep of a solution what the files and pictures need."""
    pairs = solution.identified
    used = np.flatnonzero(pairs.used)
    order = used[np.argsort(-pairs.flux[used], kind="stable")][:_PAIRS_MOST]
    return Result(
        cards,
        pairs.x_px[order],
        pairs.y_px[order],
        pairs.ra_deg[order],
        pairs.dec_deg[order],
        pairs.flux[order],
        pairs.mag[order],
        verdict.seen_px,
    )


@dataclass(slots=True, eq=False)
class Submission:
    """An upload and the one job of it.

    Attributes
    ----------
    id, job_id, image_id, calibration_id : int
        Random, none of them twice at a time.
    session : Session
        With which it was sent.
    name, sha256 : str
        Of the file.
    picture : bool
        A PNG or JPEG.
    image : IO or None
        The upload, while it is kept.
    came_s : float
        By the loop's clock.
    objects : tuple of str
        Names of what is in the field.
    error : str
        Why it was not solved.
    done : Event
        Set when the job has ended.
    """

    id: int
    job_id: int
    image_id: int
    calibration_id: int
    session: Session
    name: str
    sha256: str
    asked: Asked
    picture: bool
    image: IO[bytes] | None
    came_s: float
    status: Status = "queued"
    started_utc: datetime | None = None
    finished_utc: datetime | None = None
    result: Result | None = None
    objects: tuple[str, ...] = ()
    error: str = ""
    log: str = ""
    done: asyncio.Event = field(default_factory=asyncio.Event)

    @property
    def ended(self) -> bool:
        """Whether the job has ended."""
        return self.status in ("success", "failure")

    def succeed(self, result: Result, objects: tuple[str, ...], utc: datetime, log: str) -> None:
        """It was solved."""
        self.result, self.objects = result, objects
        self.status, self.finished_utc = "success", utc
        self.log = log[:_LOG_MOST]
        self.done.set()

    def fail(self, error: str, utc: datetime, log: str) -> None:
        """It was not solved."""
        self.status, self.finished_utc = "failure", utc
        self.error, self.log = error, log[:_LOG_MOST]
        self.done.set()

    def let_go(self) -> None:
        """Close its image. Twice is fine."""
        if self.image is not None:
            self.image.close()
            self.image = None


class Submissions:
    """All submissions, the oldest first. Used from the loop's thread alone.

    Parameters
    ----------
    keep_s : float
        After so long one is forgotten.
    images : int
        Images that are kept at a time; each holds a file descriptor.
    """

    def __init__(self, keep_s: float, images: int, clock_s: Callable[[], float]) -> None:
        self._keep_s, self._images, self._clock_s = keep_s, images, clock_s
        self._all: OrderedDict[int, Submission] = OrderedDict()
        self._jobs: dict[int, Submission] = {}
        self._taken: set[int] = set()

    def __len__(self) -> int:
        return len(self._all)

    def __iter__(self) -> Iterator[Submission]:
        return iter(list(self._all.values()))

    def add(
        self,
        session: Session,
        asked: Asked,
        *,
        name: str,
        sha256: str,
        picture: bool,
        image: IO[bytes],
    ) -> Submission:
        """Take a submission in."""
        made = Submission(
            self._new_id(),
            self._new_id(),
            self._new_id(),
            self._new_id(),
            session,
            name,
            sha256,
            asked,
            picture,
            image,
            self._clock_s(),
        )
        self._all[made.id] = self._jobs[made.job_id] = made
        self.forget()
        return made

    def of(self, submission_id: int, session: Session | None, address: str) -> Submission:
        """A submission of the caller's own. Raises `NovaError` 404."""
        return self._own(self._all.get(submission_id), session, address)

    def of_job(self, job_id: int, session: Session | None, address: str) -> Submission:
        """The submission of a job of the caller's own. Raises `NovaError` 404."""
        return self._own(self._jobs.get(job_id), session, address)

    def of_session(self, session: Session) -> list[Submission]:
        """All that this caller has sent."""
        return [one for one in self._all.values() if _same(one.session, session)]

    def forget(self) -> None:
        """Let go of what is too old, and of the oldest where there is too much."""
        now_s = self._clock_s()
        for one in [*self._all.values()]:
            too_old = now_s - one.came_s > self._keep_s
            if one.ended and (too_old or len(self._all) > _SUBMISSIONS_MOST):
                self._drop(one)
        kept = [one for one in self._all.values() if one.image is not None and one.ended]
        size = sum(os.fstat(one.image.fileno()).st_size for one in kept if one.image is not None)
        while kept and (len(kept) > self._images or size > _IMAGES_BYTES):
            oldest = kept.pop(0)
            assert oldest.image is not None
            size -= os.fstat(oldest.image.fileno()).st_size
            oldest.let_go()

    def close(self) -> None:
        """Let go of all."""
        for one in [*self._all.values()]:
            self._drop(one)

    def _drop(self, one: Submission) -> None:
        one.let_go()
        del self._all[one.id], self._jobs[one.job_id]
        self._taken -= {one.id, one.job_id, one.image_id, one.calibration_id}

    def _own(self, found: Submission | None, session: Session | None, address: str) -> Submission:
        own = found is not None and (
            found.session.caller.address == address if session is None else _same(found.session, session)
        )
        if found is None or not own:
            raise NovaError("not found: there is none, or it is somebody else's", status=404)
        if self._clock_s() - found.came_s > self._keep_s:
            raise NovaError("not found: it was forgotten, as all uploads are after a while", status=404)
        return found

    def _new_id(self) -> int:
        while True:
            number = secrets.randbits(_ID_BITS)
            if number and number not in self._taken:
                self._taken.add(number)
                return number


def _same(one: Session, other: Session) -> bool:
    """Whether two sessions are of one caller: those of one key are; without keys, those of one address."""
    if one.key_sha256 is None or other.key_sha256 is None:
        return one is other or (
            one.key_sha256 is other.key_sha256 and one.caller.address == other.caller.address
        )
    return one.key_sha256 == other.key_sha256
