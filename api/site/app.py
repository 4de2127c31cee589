"""The application of a site: its page, its JSON, and STOP ALL. Nothing else can be ordered through it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager
from datetime import datetime
from pathlib import Path
from typing import Annotated, Literal

from fastapi import APIRouter, Depends, FastAPI, Request, Response
from pydantic import BaseModel, Field
from starlette.datastructures import Headers
from starlette.types import Scope

from api import problems
from api.access.callers import Caller, Role
from api.access.keys import KeyStore
from api.access.log_rates import KnownCallers
from api.access.rate_limits import RateLimit, TokenBuckets
from api.access.security import OwnMachineOnly, address_of, caller_from_headers, require_role
from api.http.bodies import BodyLimit
from api.http.fair_scheduling import FairRequests, RequestTurns
from api.http.headers import BoundedHeads, HeadAsGet, SafeHeaders
from api.http.routes.page import Encodings, IfNoneMatch, asset_answer
from api.http.strict_requests import KnownQueryOnly, ShortTargets
from api.problems import Refused, responses
from api.site.remote import Health, Remote, Seen, StopTold, TelescopeSeen
from mountnav import __version__
from mountnav.clock import utc_now
from mountnav.masking import mask_logs
from mountnav.settings.site_file import SiteFile, SitePageSettings

_SHARED = {"first.js": "js/first.js", "icon.svg": "icon.svg"}
"""Files of this page that are a service's page's: their paths here and there."""
_MOST_BODY_KB = 4.0
"""Nothing that is asked here has a body; a stop is taken with whatever comes."""

_RATE_PER_S, _BURST = 20.0, 60
"""Requests of a caller; the page sends one each 2 s. Stops are never limited."""

_THREADS_EACH = 4
"""Threads for each service: names are looked up there, and a lookup that hangs holds one."""


class TelescopeOnSite(BaseModel):
    """A telescope as its service tells of it."""

    id: str
    connected: bool | None = Field(description="null where it isn't told, here and below")
    activity: str | None = Field(description="idle, slewing, tracking, parked, ...")
    tracking: bool | None
    parked: bool | None
    slewing: bool | None
    ra_deg: float | None = Field(description="ICRS")
    dec_deg: float | None = Field(description="ICRS")
    altitude_deg: float | None
    azimuth_deg: float | None
    problem: str | None
    warnings: list[str]


class TelescopeStopOnSite(BaseModel):
    """What came of STOP ALL at one telescope."""

    telescope: str
    stopped: bool | None = Field(description="null: not known")
    problem: str | None = None


class StopOnSite(BaseModel):
    """What came of STOP ALL at one service."""

    name: str
    given_utc: datetime
    stopped: bool | None = Field(description="null: not known; look at the telescopes")
    problem: str | None = None
    telescopes: list[TelescopeStopOnSite] = Field(default_factory=list)


class ServiceOnSite(BaseModel):
    """One service as it was seen last."""

    name: str
    url: str
    state: Health = Field(
        description="waiting (not asked yet), ok, degraded, silent (no answer), refused (the key), strange "
        "(what answers is no mountnav)"
    )
    problem: str | None = Field(description="Why it is silent, refused or strange")
    answered_utc: datetime | None = Field(description="When what stands here was told")
    age_s: float | None = Field(description="How old that is")
    version: str | None
    concerns: list[str] = Field(description="What its health tells")
    telescopes: list[TelescopeOnSite]
    stop: StopOnSite | None = Field(description="What came of the last STOP ALL")


class SiteView(BaseModel):
    """All services of the site."""

    utc: datetime
    may_stop: bool = Field(description="Whether the caller's key may STOP ALL")
    services: list[ServiceOnSite]


class SiteStopView(BaseModel):
    """What came of STOP ALL, at each service."""

    stopped: bool | None = Field(
        description="true: all; false: one at least was not stopped; null: not known"
    )
    services: list[StopOnSite]


class SiteHealthView(BaseModel):
    """That the page of the site lives; it says nothing of the services."""

    status: Literal["ok"] = "ok"
    version: str


def keys_of(page: SitePageSettings) -> KeyStore:
    """The keys that this page asks for."""
    where = page.keys_file or Path("/nonexistent/mountnav-site-keys.json")
    return KeyStore(
        where, token_sha256=page.api_token_sha256, always=page.keys_file is not None or not page.is_loopback
    )


def create_site(settings: SiteFile) -> FastAPI:
    """Make the application; services are asked as soon as its lifespan begins."""
    mask_logs()
    keys = keys_of(settings.site)
    remotes = [Remote(one) for one in settings.service]

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        threads = ThreadPoolExecutor(_THREADS_EACH * len(remotes) + 8, "site")
        asyncio.get_running_loop().set_default_executor(threads)
        try:
            for one in remotes:
                one.open(settings.site.poll_s)
            yield
        finally:
            await asyncio.gather(*(one.close() for one in remotes))
            threads.shutdown(wait=False, cancel_futures=True)

    app = FastAPI(
        title="mountnav site",
        version=__version__,
        lifespan=lifespan,
        docs_url=None,
        redoc_url=None,
        openapi_url=None,
    )
    app.state.remotes, app.state.keys = remotes, keys
    problems.install(app)
    app.include_router(router)
    _guard(app, keys)
    return app


async def _may_see(request: Request) -> Caller:
    caller = caller_from_headers(request.headers, address_of(request.scope), keys=request.app.state.keys)
    require_role(caller, Role.VIEW)
    return caller


async def _may_stop(request: Request) -> Caller:
    caller = caller_from_headers(request.headers, address_of(request.scope), keys=request.app.state.keys)
    require_role(caller, Role.OPERATE)
    return caller


async def _remotes(request: Request) -> list[Remote]:
    found: list[Remote] = request.app.state.remotes
    return found


Remotes = Annotated[list[Remote], Depends(_remotes)]
router = APIRouter()


@router.get("/v1/site", dependencies=[KnownQueryOnly])
async def get_site(caller: Annotated[Caller, Depends(_may_see)], remotes: Remotes) -> SiteView:
    """All services as they were seen last. Asks none of them."""
    now_utc = utc_now()
    return SiteView(
        utc=now_utc,
        may_stop=caller.role.includes(Role.OPERATE),
        services=[_service(one, now_utc) for one in remotes],
    )


@router.post("/v1/stop", dependencies=[Depends(_may_stop)], responses=responses())
async def stop_site(remotes: Remotes, response: Response) -> SiteStopView:
    """STOP ALL at each service, side by side; answers within 2 s. Needs no body."""
    told = await asyncio.gather(*(one.stop_all() for one in remotes))
    known = [one.stopped for one in told]
    stopped = False if False in known else None if None in known else True
    response.status_code = 200 if stopped else 502 if stopped is False else 202
    return SiteStopView(
        stopped=stopped,
        services=[_stop(one, stop) for one, stop in zip(remotes, told, strict=True)],
    )


@router.get("/v1/health", dependencies=[KnownQueryOnly])
async def get_health() -> SiteHealthView:
    """That the page lives."""
    return SiteHealthView(version=__version__)


@router.get("/")
async def get_page(if_none_match: IfNoneMatch = None, accepted: Encodings = "") -> Response:
    """The page itself."""
    return asset_answer("api.site", "index.html", if_none_match, accepted)


@router.get("/web/{path:path}", responses=responses(404))
async def get_asset(path: str, if_none_match: IfNoneMatch = None, accepted: Encodings = "") -> Response:
    """One of its files, or of those that a service's page has as well."""
    package = "api" if path in _SHARED else "api.site"
    return asset_answer(package, _SHARED.get(path, path), if_none_match, accepted)


def _guard(app: FastAPI, keys: KeyStore) -> None:
    """What stands before all routes, as before those of a service (`api.http.guards`)."""

    def caller_of(scope: Scope) -> Caller:
        return caller_from_headers(Headers(scope=scope), address_of(scope), keys=keys)

    def name_of(scope: Scope) -> str | None:
        try:
            return caller_of(scope).name
        except Refused:
            return f"({address_of(scope)})"

    def may_stop(scope: Scope) -> bool:
        try:
            return caller_of(scope).role.includes(Role.OPERATE)
        except Refused:
            return False

    app.add_middleware(BodyLimit, max_body_kb=_MOST_BODY_KB, max_upload_mb=_MOST_BODY_KB / 1000)
    app.add_middleware(RateLimit, buckets=TokenBuckets(_RATE_PER_S, _BURST), name_of=name_of)
    app.add_middleware(KnownCallers, shows_who=caller_of)
    app.add_middleware(OwnMachineOnly, keys=keys)
    app.add_middleware(HeadAsGet)
    app.add_middleware(ShortTargets)
    app.add_middleware(FairRequests, may_stop=may_stop, turns=RequestTurns())
    app.add_middleware(BoundedHeads)
    build = app.build_middleware_stack
    app.build_middleware_stack = lambda: SafeHeaders(build())  # type: ignore[method-assign]


def _service(one: Remote, now_utc: datetime) -> ServiceOnSite:
    seen: Seen = one.seen
    at = seen.answered_utc
    return ServiceOnSite(
        name=one.settings.name,
        url=one.settings.url,
        state=seen.state,
        problem=seen.problem,
        answered_utc=at,
        age_s=None if at is None else max(0.0, (now_utc - at).total_seconds()),
        version=seen.version,
        concerns=list(seen.concerns),
        telescopes=[_telescope(telescope) for telescope in seen.telescopes],
        stop=None if one.stop is None else _stop(one, one.stop),
    )


def _telescope(seen: TelescopeSeen) -> TelescopeOnSite:
    fields: Mapping[str, object] = {name: getattr(seen, name) for name in TelescopeOnSite.model_fields}
    return TelescopeOnSite.model_validate({**fields, "warnings": list(seen.warnings)})


def _stop(one: Remote, told: StopTold) -> StopOnSite:
    return StopOnSite(
        name=one.settings.name,
        given_utc=told.given_utc,
        stopped=told.stopped,
        problem=told.problem,
        telescopes=[
            TelescopeStopOnSite(telescope=id_, stopped=stopped, problem=words)
            for id_, stopped, words in told.telescopes
        ],
    )
