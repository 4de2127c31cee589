"""The jobs of the nova face: a queue of its own before the service's solver, verdicts, files of images.

One job is solved at a time, so that an upload by REST waits for one of these at most; looks wait for none.
"""

from __future__ import annotations

import asyncio
import logging
import os
import tempfile
from collections.abc import Awaitable, Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from io import FileIO
from typing import IO, TYPE_CHECKING, Protocol, TypeVar

from api.nova.codec import Asked, NovaError, hint_of, picture_kind
from api.nova.forms import Form
from api.nova.products import object_names, picture
from api.nova.submissions import Result, Session, Submission, Submissions, result_of
from api.problems import Refused
from api.service import Service
from api.solver.link import Upload
from mountnav.clock import utc_now
from mountnav.errors import BadFrame, MountnavError
from mountnav.reading.content import OnDisk
from mountnav.reading.fits_headers import chosen_hdu, walk
from mountnav.settings.faces import NovaSettings
from mountnav.sky.wcs import is_zpn
from mountnav.sky.wcs_numbers import TOUCHES_ALONE, Value, linear_cards, touching_cards, wcs_numbers
from mountnav.tasks import begun

if TYPE_CHECKING:
    from mountnav.frames import Frame, Hint
    from mountnav.solution import Verdict

__all__ = ["NovaJobs"]

T = TypeVar("T")

_log = logging.getLogger(__name__)

_HEAD_BYTES = 16
"""Of a file, to tell what it is."""
_EQUINOX = 2000.0
"""What readers of astrometry.net's files look for; the positions are ICRS."""
_MOST_PIXELS = 62_000_000
"""Of an image that is brought into the service's own memory, for a picture, a negative, another file:
the largest detectors in common use. It costs up to 500 MB, one at a time; doubled, a gigabyte."""


class _Beside(Protocol):
    """Does something in the face's own thread."""

    def __call__(self, work: Callable[..., T], *given: object) -> Awaitable[T]: ...


class NovaJobs:
    """Begins jobs and ends them all when the service goes down.

    Parameters
    ----------
    beside : callable
        See `_Beside`.
    """

    def __init__(
        self, service: Service, settings: NovaSettings, submissions: Submissions, beside: _Beside
    ) -> None:
        self._service, self._settings = service, settings
        self._submissions, self._beside = submissions, beside
        self._under_way = 0
        self._turn = asyncio.Semaphore(1)
        self._heavy = asyncio.Semaphore(1)
        self._tasks: set[asyncio.Task[None]] = set()

    def require_room(self) -> None:
        """Raise `NovaError` 429 where all places of the queue are taken."""
        if self._under_way >= self._settings.queue:
            raise NovaError(
                f"{self._under_way} uploads are under way, and no more are taken: send it again in a moment",
                status=429,
            )

    @contextmanager
    def place(self) -> Iterator[None]:
        """Hold a place in the queue while an upload is received. Raises `NovaError` 429: there is none."""
        self.require_room()
        self._under_way += 1
        try:
            yield
        finally:
            self._under_way -= 1

    async def begin(self, session: Session, asked: Asked, form: Form) -> Submission:
        """Begin to solve what a form holds; its file is the submission's from now on."""
        assert form.file is not None
        image = form.file
        kind = picture_kind(os.pread(image.fileno(), _HEAD_BYTES, 0))
        width = asked.width_px
        if width is None and asked.scale is not None and asked.scale[0] != "arcsecperpix":
            width = await self._beside(_width_px, image, kind)
        hint, lost = hint_of(asked, width)
        made = self._submissions.add(
            session, asked, name=form.name, sha256=form.sha256, picture=kind == "picture", image=image
        )
        form.file = None
        self._under_way += 1
        task = begun(self._carried_out(made, hint, lost), "nova job", died=lambda _: None)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return made

    async def close(self) -> None:
        """End all jobs."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def _carried_out(self, job: Submission, hint: Hint | None, lost: str) -> None:
        verdict: Verdict | None = None
        error = "the service is shutting down"
        try:
            async with self._turn:
                job.status, job.started_utc = "solving", utc_now()
                verdict = await self._solved(job, hint)
        except (MountnavError, Refused) as fault:
            error = fault.problem.detail if isinstance(fault, Refused) else str(fault)
        except Exception:
            _log.exception("a job of the nova API failed unexpectedly")
            error = "a fault in mountnav: its log says more"
        finally:
            self._under_way -= 1
            if verdict is None or verdict.solution is None:
                error = _why(verdict) if verdict is not None else error
                job.fail(error, utc_now(), _told(job, hint, lost, verdict, error))
            else:
                await self._succeeded(job, hint, lost, verdict)
            self._submissions.forget()

    async def _succeeded(self, job: Submission, hint: Hint | None, lost: str, verdict: Verdict) -> None:
        solution = verdict.solution
        assert solution is not None
        cards: dict[str, Value] = (linear_cards if job.asked.linear else touching_cards)(solution.wcs)
        result = result_of(solution, cards | {"EQUINOX": _EQUINOX}, verdict)
        log = _told(job, hint, lost, verdict, "")
        try:
            objects = tuple(await self._beside(object_names, result))
        except (RuntimeError, MountnavError):
            # going down, or a date without a table: it is solved all the same
            objects = ()
        job.succeed(result, objects, utc_now(), log)

    async def _solved(self, job: Submission, hint: Hint | None) -> Verdict:
        assert job.image is not None
        settings = replace(self._service.solve_settings(None), budget_s=self._settings.budget_s)
        upload = Upload(job.name, job.image.fileno(), stars=job.asked.stars)
        if not job.asked.invert:
            return await self._service.solver.solve_upload(upload, hint, settings)
        try:
            frame = await self._service.solver.read_upload(upload)
        except BadFrame:
            # a list of stars has no negative; what is neither is refused there
            return await self._service.solver.solve_upload(upload, hint, settings)
        # the negative has no header: what the image's own says is taken from here
        with await self._beside(_inverted, frame) as file:
            return await self._service.solver.solve_upload(
                Upload(job.name, file.fileno()), hint or frame.hint, settings
            )

    # -- files -----------------------------------------------------------------------------------------------

    def wcs_header(self, job: Submission, result: Result) -> bytes:
        """The WCS as a FITS header without data."""
        from mountnav.reading.fits_update import wcs_header

        return wcs_header(result.cards, history=(f"solved by mountnav: {job.name}",))

    async def new_fits(self, job: Submission, result: Result) -> IO[bytes]:
        """The image as FITS, with its WCS, in a file without a name. Raises `NovaError` 404."""
        async with self._heavy:
            image = job.image
            if image is None:
                raise NovaError("not found: the image is not kept any more", status=404)
            try:
                if picture_kind(os.pread(image.fileno(), _HEAD_BYTES, 0)) == "fits":
                    return await self._beside(_updated, image, result.cards, job.name)
                # packed files and pictures are read where they can do no harm
                _require_size(result.cards)
                frame = await self._service.solver.read_upload(Upload(job.name, image.fileno()))
                return await self._beside(_as_fits, frame, result.cards)
            except BadFrame as fault:
                raise NovaError(f"not found: no image was uploaded ({fault})", status=404) from fault

    async def picture(self, job: Submission, result: Result) -> bytes:
        """The image with its stars circled, as a PNG; stars on black where there is no image."""
        async with self._heavy:
            frame: Frame | None = None
            if job.image is not None and _pixels(result.cards) <= _MOST_PIXELS:
                try:
                    frame = await self._service.solver.read_upload(Upload(job.name, job.image.fileno()))
                except BadFrame:
                    frame = None  # a list of stars
            return await self._beside(_drawn, result, frame, job.picture)


def _width_px(image: IO[bytes], kind: str) -> int | None:
    """Width of a frame by its header, for scales that are told by it; None where that isn't plain."""
    with FileIO(image.fileno(), closefd=False) as file:
        try:
            if kind == "fits":
                shape = chosen_hdu(walk(OnDisk(file), "upload"), None, "upload").shape
                return int(shape[-1]) or None
            if kind == "picture":
                from PIL import Image

                file.seek(0)
                with Image.open(file) as opened:
                    return int(opened.width)
        except Exception:  # a damaged file raises whatever it likes; its reader tells what is wrong
            return None
    return None


def _pixels(cards: Mapping[str, Value]) -> int:
    return int(cards["IMAGEW"]) * int(cards["IMAGEH"])


def _require_size(cards: Mapping[str, Value]) -> None:
    """Raise `NovaError` for an image that is too large to be brought into the service's memory."""
    if _pixels(cards) > _MOST_PIXELS:
        raise NovaError("not found: the image is too large to be made into another file", status=404)


def _spool(content: bytes) -> IO[bytes]:
    """A file without a name that holds this."""
    file = tempfile.TemporaryFile(prefix="mountnav-nova-")  # noqa: SIM115
    file.write(content)
    file.flush()
    return file


def _inverted(frame: Frame) -> IO[bytes]:
    """A frame's negative as a FITS file. Raises `BadFrame`."""
    import numpy as np

    from mountnav.reading.fits_update import fits_of_frame

    if frame.pixels.size > _MOST_PIXELS:
        raise BadFrame("it is too large to be inverted", device=frame.source, advice="invert it yourself")
    return _spool(fits_of_frame(np.nanmax(frame.pixels) - frame.pixels, {}, checksum=False))


def _updated(image: IO[bytes], cards: dict[str, Value], name: str) -> IO[bytes]:
    from mountnav.reading.fits_update import updated_fits

    with FileIO(image.fileno(), closefd=False) as file:
        return _spool(updated_fits(OnDisk(file), cards, history=("WCS by mountnav",), name=name))


def _as_fits(frame: Frame, cards: dict[str, Value]) -> IO[bytes]:
    from mountnav.reading.fits_update import fits_of_frame

    return _spool(fits_of_frame(frame.pixels, cards, history=("WCS by mountnav",)))


def _drawn(result: Result, frame: Frame | None, rows_from_top: bool) -> bytes:
    return picture(result, frame, rows_from_top=rows_from_top)


def _why(verdict: Verdict) -> str:
    """Why a frame was not solved, in one line."""
    return f"{verdict.reason}: {verdict.detail}" if verdict.detail else str(verdict.reason)


def _told(job: Submission, hint: Hint | None, lost: str, verdict: Verdict | None, error: str) -> str:
    """The log of a job."""
    lines = [f"mountnav: {job.name}", f"hint: {_hint_words(hint)}"]
    if lost:
        lines.append(lost)
    if verdict is not None:
        lines += [f"note: {note}" for note in verdict.notes]
        lines += [f"contradicted: {one}" for one in verdict.contradictions]
        lines.append(f"{verdict.measured} sources measured; {verdict.times.total_s:.3f} s")
    if verdict is None or verdict.solution is None:
        return "\n".join([*lines, f"Did not solve: {error}", ""])
    solution = verdict.solution
    numbers = wcs_numbers(solution.wcs)
    lines += [
        f"Field center: (RA,Dec) = ({numbers.ra_deg:.6f}, {numbers.dec_deg:.6f}) deg.",
        f"pixel scale {numbers.pixscale_arcsec:.6g} arcsec/pix",
        f"orientation {numbers.orientation_deg:.4f} deg, parity {numbers.determinant_sign:+d}",
        f"{solution.pairs} stars, rms {solution.rms_arcsec:.3f} arcsec, {solution.mode}, {solution.catalog}",
        f"probability of a wrong position: {solution.false_probability:.1e}",
    ]
    if is_zpn(solution.wcs):
        lines.append(f"WARNING: {TOUCHES_ALONE}")
    found = 0 if numbers.determinant_sign > 0 else 1
    if job.asked.parity not in (2, found):
        lines.append(f"parity {job.asked.parity} was asked for, {found} was found")
    return "\n".join([*lines, ""])


def _hint_words(hint: Hint | None) -> str:
    if hint is None:
        return "none given"
    words = []
    if hint.center is not None:
        words.append(
            f"within {hint.radius_deg:g} deg of ({hint.center.ra_deg:.4f}, {hint.center.dec_deg:.4f}) deg"
        )
    low, high = hint.scale_low_arcsec_px, hint.scale_high_arcsec_px
    if low is not None or high is not None:
        words.append(f"scale {low or 0:g} to {'any' if high is None else format(high, 'g')} arcsec/pix")
    return ", ".join(words)
