"""The nova API as an ASGI application: routes with and without a slash at their end, JSON sent as plain text.

Errors are HTTP 200 with `status` "error", as this protocol has them; other numbers are for what programs know
by number. Reading needs no session here, as at nova's own server: then the caller's address decides what is
his (`api.nova.submissions`).
"""

from __future__ import annotations

import asyncio
import ipaddress
import json
import logging
import math
import os
import re
from collections.abc import AsyncIterator, Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from typing import IO, Any, TypeVar

from starlette.requests import ClientDisconnect, Request
from starlette.responses import PlainTextResponse, Response, StreamingResponse
from starlette.types import Message, Receive, Scope, Send

from api.access.audit import Seldom
from api.access.callers import Caller, Face, Role
from api.access.keys import KeyStore
from api.access.rate_limits import WAITS_S, TokenBuckets
from api.access.security import THIS_MACHINE, address_of
from api.nova.codec import (
    MOST_JSON_BYTES,
    NovaError,
    calibration,
    error_reply,
    read_asked,
    read_request,
    stars_text,
)
from api.nova.forms import Form, Multipart, boundary_of, read_urlencoded, spooled, too_large
from api.nova.jobs import NovaJobs
from api.nova.products import annotations_of, axy_table, corr_table, rdls_table
from api.nova.submissions import Result, Session, Sessions, Submission, Submissions
from api.service import Service
from mountnav.errors import MountnavError
from mountnav.settings.faces import NovaSettings

__all__ = ["NovaApp"]

T = TypeVar("T")

_log = logging.getLogger(__name__)

_HOLD_S = 1.0
"""A question about a job that isn't done is answered after so long at the latest, s: by then most are done,
and the client needn't wait for its next poll. Doubled, a long solve's polls take twice as long."""
_MOST_BODY_BYTES = 2 * MOST_JSON_BYTES
"""Of a url-encoded form: JSON grows by half in it."""
_FEED_BYTES = 262_144
"""What came of an upload is handed on in pieces of this many bytes: fewer changes of the thread."""
_UNKNOWN_BYTES = 1_000_000
"""So much of a file is taken before it is known who sends it. All known clients send the session first."""
_UNKNOWN_S, _UPLOAD_S = 30.0, 600.0
"""A form has so long until its JSON is there, and an upload of a known client to its end, s: 128 MB at
2 Mbit/s. Doubled, clients that dribble hold their places twice as long."""
_FORM_BYTES = 2 * MOST_JSON_BYTES
"""What a form holds beside its file."""
_DRAIN_S = 20.0
"""So long the rest of a refused upload is taken, and thrown away, s: a client that still sends reads no
answer. Doubled, a refused client holds its connection twice as long."""
_STRANGERS_EACH, _STRANGERS_ALL = 1, 60
"""Rows of the audit a minute for logins with a bad key: of one address, and of all."""
_LONGEST_KEY = 200
"""Characters of a key that are looked at; ours have 47."""
_MOST_ID_DIGITS = 10
"""Digits of an id of 31 bits."""

_TOO_SLOW = 408
"""Of HTTP: the request didn't come in time."""
_PIECE_BYTES = 262_144
"""A large file is sent in pieces of so many bytes."""

_JSON = "text/plain; charset=utf-8"
_FITS = "application/fits"


class NovaApp:
    """Answers the nova API for one service. Plain ASGI.

    Parameters
    ----------
    keys : KeyStore
        The service's, as they guard this port.
    images : int
        Images that are kept at a time.
    """

    def __init__(self, service: Service, settings: NovaSettings, keys: KeyStore, *, images: int) -> None:
        self._service, self._settings, self._keys = service, settings, keys
        keep_s = settings.keep_minutes * 60.0
        clock_s = asyncio.get_running_loop().time
        self.sessions = Sessions(keep_s, self._may_solve, clock_s)
        self.submissions = Submissions(keep_s, images, clock_s)
        # one thread for all that strangers send: a hostile body keeps other uploads waiting, and nobody else
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="nova")
        self._jobs = NovaJobs(service, settings, self.submissions, self._beside)
        self._most_bytes = int(settings.max_upload_mb * 1e6)
        rate = service.settings.service.rate_limit_per_s
        self._buckets = TokenBuckets(rate, service.settings.service.rate_burst) if rate > 0 else None
        self._strangers = Seldom(_STRANGERS_EACH, _STRANGERS_ALL)
        self._forgetting: asyncio.TimerHandle | None = None
        self._forget_regularly()

    async def close(self) -> None:
        """End the jobs and forget everything."""
        if self._forgetting is not None:
            self._forgetting.cancel()
        await self._jobs.close()
        self.submissions.close()
        self._thread.shutdown(wait=False, cancel_futures=True)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] != "http":
            return
        whole = begun = False

        async def received() -> Message:
            nonlocal whole, begun
            message, begun = await receive(), True
            whole = whole or message["type"] != "http.request" or not message.get("more_body", False)
            return message

        request = Request(scope, received)
        try:
            response = await self._respond(request)
        except NovaError as error:
            # who waits for leave to send its body reads the answer instead; who was too slow has had its time
            if not whole and error.status != _TOO_SLOW and (begun or "expect" not in request.headers):
                await self._drain(request)
            response = _json(error_reply(error.words), error.status)
        except ClientDisconnect:
            return
        except MountnavError as error:
            response = _json(error_reply(str(error)))
        except Exception:
            _log.exception("a request to the nova API failed unexpectedly")
            response = _json(error_reply("a fault in mountnav: its log says more"), 500)
        await response(scope, receive, send)

    async def _respond(self, request: Request) -> Response:
        # a server's address that is typed with a slash at its end: what stands before nova's own joins them
        path = _SLASHES.sub("/", request.url.path).rstrip("/") or "/"
        for pattern, answer in _ROUTES:
            found = pattern.fullmatch(path)
            if found is None:
                continue
            if request.method not in ("GET", "POST"):
                raise NovaError(f"{request.method} is not possible here", status=405)
            await self._hold_back(request)
            number = found.groupdict().get("id")
            return await answer(self, request, 0 if number is None else _id(number))
        raise NovaError("not found: there is nothing at this address", status=404)

    # -- who asks --------------------------------------------------------------------------------------------

    async def _hold_back(self, request: Request) -> None:
        """Let a request wait, or refuse it, where one address asks too much."""
        if self._buckets is None:
            return
        passes, wait_s = self._buckets.wait_s(address_of(request.scope), most_s=WAITS_S)
        if not passes:
            raise NovaError(f"too many requests: wait {max(1, math.ceil(wait_s))} s", status=429)
        if wait_s > 0.0:
            await asyncio.sleep(wait_s)

    def _may_solve(self, session: Session) -> bool:
        """Whether a session's key is still known, and good enough."""
        if session.key_sha256 is None:
            admitted = self._settings.open and self._settings.admits(session.caller.address)
            return admitted or not self._keys.guards
        key = self._keys.known(session.key_sha256)
        return key is not None and key.role.includes(Role.SOLVE)

    async def login(self, request: Request, _: int) -> Response:
        """Begin a session."""
        given = await self._request_json(request, needed=True)
        apikey = given.get("apikey")
        if not isinstance(apikey, str) or not apikey or len(apikey) > _LONGEST_KEY:
            raise NovaError('need "apikey"')
        session = self._begun(apikey, address_of(request.scope))
        return _json(
            {
                "status": "success",
                "message": f"authenticated user: {session.caller.name}",
                "session": session.secret,
            }
        )

    def _begun(self, apikey: str, address: str) -> Session:
        key = self._keys.find(apikey)
        if key is not None and key.role.includes(Role.SOLVE):
            return self.sessions.begin(Caller(key.name, Role.SOLVE, Face.NOVA, address), key.sha256)
        if self._settings.open and self._settings.admits(address):
            return self.sessions.begin(Caller(f"nova {address}", Role.SOLVE, Face.NOVA, address), None)
        if not self._keys.guards and _is_loopback(address):
            return self.sessions.begin(Caller(THIS_MACHINE, Role.SOLVE, Face.NOVA, address), None)
        unnoted = self._strangers.due(address)
        if unnoted is not None:
            outcome = "unauthorized" if key is None else "role-too-low"
            self._service.audit.stranger(
                address, "POST /api/login", status=200, outcome=outcome, unnoted=unnoted
            )
        if key is not None:
            raise NovaError(f"bad apikey: its role {key.role} may not solve")
        raise NovaError("bad apikey")

    def _session(self, given: dict[str, Any]) -> Session:
        """The session that an upload must show. Raises `NovaError`."""
        if "session" not in given:
            raise NovaError('no "session" in JSON.')
        found = self.sessions.of(given["session"])
        if found is None:
            raise NovaError(f'no session with key "{str(given["session"])[:_LONGEST_KEY]}"')
        return found

    async def _own(self, request: Request, number: int, *, job: bool) -> Submission:
        """The caller's own submission, by its id or its job's. Raises `NovaError` 404."""
        given = await self._request_json(request, needed=False)
        session = self._session(given) if given.get("session") else None
        of = self.submissions.of_job if job else self.submissions.of
        found = of(number, session, address_of(request.scope))
        if not self._may_solve(found.session):
            raise NovaError("not found: its key was revoked", status=404)
        return found

    async def _request_json(self, request: Request, *, needed: bool) -> dict[str, Any]:
        """The JSON of a request without a file."""
        form = await self._received(request, 0) if request.method == "POST" else Form()
        form.close()
        if form.json is None or not form.json.strip():
            if needed:
                raise NovaError("no json")
            return {}
        return await self._beside(read_request, form.json)

    # -- uploads ---------------------------------------------------------------------------------------------

    async def upload(self, request: Request, _: int) -> Response:
        """Take an image or a list of stars, and begin to solve it."""
        announced = request.headers.get("content-length", "")
        if (
            announced.isascii()
            and announced.isdigit()
            and int(announced[:20]) > self._most_bytes + _FORM_BYTES
        ):
            raise too_large(self._most_bytes)
        self._jobs.require_room()
        with ExitStack() as held:

            def known(given: dict[str, Any]) -> None:
                # a stranger who dribbles takes no place in the queue
                self._session(given)
                held.enter_context(self._jobs.place())

            form = await self._received(request, self._most_bytes, known)
            try:
                given = await self._beside(read_request, form.json or b"{}")
                session, asked = self._session(given), read_asked(given)
                if given.get("url"):
                    # astroquery sends lists of stars to this address too, without a url
                    raise NovaError("this server fetches nothing from a url: upload the file itself")
                if form.file is None:
                    form.name = "x and y"
                    await self._beside(
                        spooled, form, await self._beside(stars_text, given.get("x"), given.get("y"))
                    )
                elif not form.size:
                    raise NovaError("the file is empty")
                made = await self._jobs.begin(session, asked, form)
            finally:
                form.close()
        self._service.audit.note(
            session.caller, "solve", request={"file": made.name, "bytes": form.size, "submission": made.id}
        )
        return _json({"status": "success", "subid": made.id, "hash": made.sha256})

    async def _received(
        self, request: Request, most_bytes: int, known: Callable[[dict[str, Any]], None] | None = None
    ) -> Form:
        """The form of a request; the caller closes it.

        Parameters
        ----------
        most_bytes : int
            Longest file.
        known : callable, optional
            Told of the JSON as soon as it is there. May raise `NovaError`.

        Raises
        ------
        NovaError
        """
        boundary = boundary_of(request.headers.get("content-type", ""))
        try:
            async with asyncio.timeout(_UNKNOWN_S) as limit:
                if boundary is not None:
                    return await self._parts(request, Multipart(boundary, most_bytes), known, limit)
                body = bytearray()
                async for piece in request.stream():
                    body += piece
                    if len(body) > _MOST_BODY_BYTES:
                        raise NovaError(f"the form is longer than {_MOST_BODY_BYTES} bytes", status=413)
                form = await self._beside(read_urlencoded, bytes(body))
                if known is not None:
                    known(await self._beside(read_request, form.json or b"{}"))
                return form
        except TimeoutError as late:
            raise NovaError("the form took too long", status=_TOO_SLOW) from late

    async def _parts(
        self,
        request: Request,
        parts: Multipart,
        known: Callable[[dict[str, Any]], None] | None,
        limit: asyncio.Timeout,
    ) -> Form:
        """A multipart form as it comes."""
        try:
            waiting, is_known = bytearray(), False
            async for piece in request.stream():
                waiting += piece
                if len(waiting) < _FEED_BYTES and is_known:
                    continue
                await self._beside(parts.feed, bytes(waiting))
                waiting.clear()
                if not is_known and parts.form.json is not None:
                    if known is not None:
                        known(await self._beside(read_request, parts.form.json))
                    limit.reschedule(asyncio.get_running_loop().time() + _UPLOAD_S)
                    is_known = True
                if not is_known and parts.form.size > _UNKNOWN_BYTES:
                    raise NovaError("send request-json with the session before the file")
            await self._beside(parts.feed, bytes(waiting))
            return await self._beside(parts.finish)
        except BaseException:
            parts.form.close()
            raise

    async def _drain(self, request: Request) -> None:
        """Throw away what is still being sent, so that the refusal is read."""
        left = self._most_bytes + _FORM_BYTES
        try:
            async with asyncio.timeout(_DRAIN_S):
                while left > 0:
                    message = await request.receive()
                    if message["type"] != "http.request" or not message.get("more_body", False):
                        return
                    left -= len(message.get("body", b""))
        except (TimeoutError, RuntimeError):
            return

    async def _beside(self, work: Callable[..., T], *given: object) -> T:
        """Do something in the thread of this face."""
        return await asyncio.get_running_loop().run_in_executor(self._thread, work, *given)

    # -- answers ---------------------------------------------------------------------------------------------

    async def submission(self, request: Request, number: int) -> Response:
        """How a submission stands."""
        found = await self._own(request, number, job=False)
        await _hold(found)
        begun = found.started_utc is not None
        # as at nova's own, where an upload is processed when its job has begun; the job is solved after that
        processed = "None" if found.started_utc is None else f"{found.started_utc:%Y-%m-%d %H:%M:%S.%f}"
        told: dict[str, object] = {
            "user": 0,
            "processing_started": processed,
            "processing_finished": processed,
            "user_images": [found.image_id] if begun else [],
            "images": [found.image_id] if begun else [],
            "jobs": [found.job_id] if begun else [],
            "job_calibrations": [[found.job_id, found.calibration_id]] if found.result is not None else [],
        }
        return _json(told | ({"error_message": found.error} if found.error else {}))

    async def job(self, request: Request, number: int) -> Response:
        """How a job stands."""
        found = await self._own(request, number, job=True)
        await _hold(found)
        return _json(_status(found))

    async def calibration(self, request: Request, number: int) -> Response:
        """Where a solved image lies."""
        found = await self._own(request, number, job=True)
        if found.result is None:
            return _json(_no_calibration(number))
        return _json(calibration(found.result.cards, picture=found.picture))

    async def info(self, request: Request, number: int) -> Response:
        """All about a job in one answer."""
        found = await self._own(request, number, job=True)
        told: dict[str, object] = {
            "objects_in_field": list(found.objects),
            "machine_tags": list(found.objects),
            "tags": list(found.objects),
            "original_filename": found.name,
            **_status(found),
        }
        if found.result is not None:
            whole = calibration(found.result.cards, picture=found.picture)
            told["calibration"] = {name: value for name, value in whole.items() if "arcsec" not in name}
        return _json(told)

    async def tags(self, request: Request, number: int) -> Response:
        """Names of what is in the field; people tag nothing here."""
        return _json({"tags": list((await self._own(request, number, job=True)).objects)})

    async def objects_in_field(self, request: Request, number: int) -> Response:
        """Names of what is in the field."""
        return _json({"objects_in_field": list((await self._own(request, number, job=True)).objects)})

    async def annotations(self, request: Request, number: int) -> Response:
        """What stands where in the image."""
        found = await self._own(request, number, job=True)
        if found.result is None:
            return _json(_no_calibration(number))
        return _json({"annotations": await self._beside(annotations_of, found.result)})

    async def myjobs(self, request: Request, _: int) -> Response:
        """The jobs of the caller."""
        session = self._session(await self._request_json(request, needed=True))
        return _json(
            {"status": "success", "jobs": [one.job_id for one in self.submissions.of_session(session)]}
        )

    async def jobs_by_tag(self, request: Request, _: int) -> Response:
        """The caller's jobs with a name in their field."""
        given = await self._request_json(request, needed=False)
        query = request.query_params.get("query", "").strip().lower()
        exact = bool(request.query_params.get("exact"))
        own = self.submissions.of_session(self._session(given)) if given.get("session") else []
        found = [
            one.job_id
            for one in own
            if any(query == name.lower() if exact else query in name.lower() for name in one.objects)
        ]
        return _json({"job_ids": found if query else []})

    async def submission_images(self, request: Request, _: int) -> Response:
        """The images of a submission: one."""
        given = await self._request_json(request, needed=True)
        session = self._session(given)
        number = given.get("subid")
        if isinstance(number, bool) or not isinstance(number, int):
            raise NovaError('need "subid"')
        found = self.submissions.of(number, session, address_of(request.scope))
        return _json({"status": "success", "image_ids": [found.image_id]})

    # -- files -----------------------------------------------------------------------------------------------

    async def wcs_file(self, request: Request, number: int) -> Response:
        """The WCS as a FITS header."""
        found, result = await self._solved(request, number)
        return _file(await self._beside(self._jobs.wcs_header, found, result), "wcs.fits")

    async def new_fits_file(self, request: Request, number: int) -> Response:
        """The image with its WCS, as FITS."""
        found, result = await self._solved(request, number)
        return _download(await self._jobs.new_fits(found, result), "new-image.fits")

    async def rdls_file(self, request: Request, number: int) -> Response:
        """The identified stars' places."""
        _, result = await self._solved(request, number)
        return _file(await self._beside(rdls_table, result), "rdls.fits")

    async def axy_file(self, request: Request, number: int) -> Response:
        """What was measured."""
        _, result = await self._solved(request, number)
        return _file(await self._beside(axy_table, result), "axy.fits")

    async def corr_file(self, request: Request, number: int) -> Response:
        """Measured places beside the catalog's."""
        _, result = await self._solved(request, number)
        return _file(await self._beside(corr_table, result), "corr.fits")

    async def annotated_display(self, request: Request, number: int) -> Response:
        """The image with its stars circled, as a PNG."""
        found, result = await self._solved(request, number)
        return Response(await self._jobs.picture(found, result), media_type="image/png")

    async def joblog(self, request: Request, number: int) -> Response:
        """What was done, in words."""
        found = await self._own(request, number, job=True)
        return PlainTextResponse(found.log or "the job has not ended yet\n")

    async def about(self, request: Request, _: int) -> Response:
        """For people who come with a browser."""
        return PlainTextResponse(
            "mountnav solves images here, by the web API of nova.astrometry.net: set this address as the "
            "server's in your program. See `mountnav docs nova`.\n"
        )

    async def _solved(self, request: Request, number: int) -> tuple[Submission, Result]:
        found = await self._own(request, number, job=True)
        if found.result is None:
            raise NovaError(f"not found: job {number} has no solution", status=404)
        return found, found.result

    def _forget_regularly(self) -> None:
        """Now and then, so that nothing stays because nobody asks."""
        self.submissions.forget()
        self.sessions.forget()
        every_s = min(60.0, self._settings.keep_minutes * 60.0)
        self._forgetting = asyncio.get_running_loop().call_later(every_s, self._forget_regularly)


Answer = Callable[[NovaApp, Request, int], Awaitable[Response]]

_SLASHES = re.compile("//+")
_JOB = "/api/jobs/(?P<id>[^/]+)"
_ROUTES: tuple[tuple[re.Pattern[str], Answer], ...] = tuple(
    (re.compile(path), answer)
    for path, answer in (
        ("/", NovaApp.about),
        ("/api/login", NovaApp.login),
        ("/api/upload", NovaApp.upload),
        ("/api/url_upload", NovaApp.upload),
        ("/api/submissions/(?P<id>[^/]+)", NovaApp.submission),
        (_JOB, NovaApp.job),
        (f"{_JOB}/calibration", NovaApp.calibration),
        (f"{_JOB}/info", NovaApp.info),
        (f"{_JOB}/tags", NovaApp.tags),
        (f"{_JOB}/machine_tags", NovaApp.tags),
        (f"{_JOB}/objects_in_field", NovaApp.objects_in_field),
        (f"{_JOB}/annotations", NovaApp.annotations),
        ("/api/myjobs", NovaApp.myjobs),
        ("/api/jobs_by_tag", NovaApp.jobs_by_tag),
        ("/api/submission_images", NovaApp.submission_images),
        ("/wcs_file/(?P<id>[^/]+)", NovaApp.wcs_file),
        ("/new_fits_file/(?P<id>[^/]+)", NovaApp.new_fits_file),
        ("/rdls_file/(?P<id>[^/]+)", NovaApp.rdls_file),
        ("/axy_file/(?P<id>[^/]+)", NovaApp.axy_file),
        ("/corr_file/(?P<id>[^/]+)", NovaApp.corr_file),
        ("/annotated_display/(?P<id>[^/]+)", NovaApp.annotated_display),
        ("/joblog/(?P<id>[^/]+)", NovaApp.joblog),
    )
)


async def _hold(found: Submission) -> None:
    """Wait a moment for the job's end."""
    try:
        async with asyncio.timeout(_HOLD_S):
            await found.done.wait()
    except TimeoutError:
        return


def _status(found: Submission) -> dict[str, object]:
    told: dict[str, object] = {"status": "processing" if found.status == "queued" else found.status}
    return told | ({"errormessage": found.error} if found.error else {})


def _no_calibration(number: int) -> dict[str, object]:
    return {"error": f"no calibration data available for job {number}"}


def _id(text: str) -> int:
    if not (text.isascii() and text.isdigit() and len(text) <= _MOST_ID_DIGITS):
        raise NovaError("not found: ids are numbers", status=404)
    return int(text)


def _json(told: dict[str, Any], status: int = 200) -> Response:
    return Response(json.dumps(told, allow_nan=False), status_code=status, media_type=_JSON)


def _file(content: bytes, name: str) -> Response:
    return Response(
        content, media_type=_FITS, headers={"Content-Disposition": f'attachment; filename="{name}"'}
    )


def _download(file: IO[bytes], name: str) -> Response:
    """A large file, read as the client takes it: a slow one holds a descriptor and no memory."""

    async def pieces() -> AsyncIterator[bytes]:
        with file:
            at = 0
            while piece := os.pread(file.fileno(), _PIECE_BYTES, at):
                at += len(piece)
                yield piece

    headers = {
        "Content-Disposition": f'attachment; filename="{name}"',
        "Content-Length": str(os.fstat(file.fileno()).st_size),
    }
    return StreamingResponse(pieces(), media_type=_FITS, headers=headers)


def _is_loopback(address: str) -> bool:
    try:
        return ipaddress.ip_address(address).is_loopback
    except ValueError:
        return False
