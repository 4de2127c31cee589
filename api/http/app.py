"""The FastAPI application, made from settings: routes, errors, access, and its life from start to rest.

`listeners_of` makes the listeners besides HTTP that the settings ask for.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from functools import cache
from typing import TYPE_CHECKING, Any

from fastapi import APIRouter, FastAPI, Request
from fastapi.openapi.docs import get_swagger_ui_html
from fastapi.responses import HTMLResponse, JSONResponse, Response
from fastapi.routing import APIRoute
from fastapi_offline import FastAPIOffline
from starlette.routing import Route

from api import problems
from api.access.keys import KeyStore, open_keys
from api.access.security import TokenRequired
from api.alpaca.server import alpaca_routes
from api.http import guards
from api.http.examples import give_examples
from api.http.field_words import describe
from api.http.night_views import FramePathBody
from api.http.operation_words import say_what_it_does
from api.http.routes import (
    audit,
    capabilities,
    catalogs,
    doctor,
    events,
    forecast,
    frames,
    health,
    jobs,
    journal,
    last_frame,
    leases,
    metrics,
    night,
    objects,
    offsets,
    orders,
    page,
    pointing,
    reload,
    sky_view,
    solve,
    stops,
    telescopes,
    tonight,
    wire,
)
from api.http.routes.help import router as help_router
from api.http.strict_requests import KnownQueryOnly
from api.listeners.admission import descriptors_at_hand, nova_shares
from api.listeners.listeners import Listener, Listeners
from api.service import open_service
from mountnav import __version__
from mountnav.catalog.catalog_set import open_catalogs
from mountnav.catalog.stars import Catalog
from mountnav.errors import MountnavError
from mountnav.masking import mask_logs
from mountnav.settings.observatory import Settings
from mountnav.sky.iers import iers_status, override_dut1
from mountnav.tasks import begun

if TYPE_CHECKING:
    from api.service import Service

__all__ = ["listeners_of"]


_KEYS_TOLD_S = 3600.0
"""Between two looks at keys that end soon, s; each is told once a day. Doubled, it is told an hour later."""
_ABOUT = """Finds out where telescopes really point, and puts them where they should.

Angles are in degrees unless the name says otherwise, places are ICRS unless `frame` says otherwise.
Long work answers 202 with a job; follow it at `/v1/jobs/{id}` or on `/v1/events`.
Errors are `application/problem+json` with a stable `type`."""


def create_app(settings: Settings, *, catalog: Catalog | None = None) -> FastAPI:
    """Make the application. Telescopes are opened when its lifespan begins.

    Parameters
    ----------
    catalog : Catalog, optional
        Instead of the embedded one and those of the settings.
    """
    mask_logs()

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        await asyncio.to_thread(iers_status)  # the tables are read before the first request
        override_dut1(settings.site.dut1_s)
        try:
            service = await open_service(
                settings,
                await asyncio.to_thread(open_catalogs, settings.catalogs.choice())
                if catalog is None
                else catalog,
            )
        except MountnavError as error:
            # for who serves: told in one line there
            app.state.failure = error
            raise
        app.state.service = service
        service.keys = app.state.keys
        told = begun(_tell_of_keys(app.state.keys), "ends of keys", died=lambda _: None)
        service.listeners = listeners_of(service, getattr(app.state, "http_address", None), app.state.turns)
        try:
            await service.listeners.start()
            yield
        finally:
            told.cancel()
            # A second interrupt must not come between a moving mount and its stop.
            await asyncio.shield(service.halt())

    # an observatory may have no internet: the description page brings its scripts along
    app = FastAPIOffline(
        title="mountnav",
        version=__version__,
        description=_ABOUT,
        lifespan=lifespan,
        generate_unique_id_function=_name_of,
        license_info={"name": "Apache-2.0", "identifier": "Apache-2.0"},
    )
    app.state.settings = settings
    problems.install(app)
    guards.install(app, settings)
    app.router.routes.extend(_common_routes().routes)
    if settings.alpaca.enabled:
        app.router.routes.extend(alpaca_routes(lambda: app.state.service, lambda: app.state.keys))
    # the page asks for the key itself
    app.include_router(page.router)
    app.include_router(help_router)
    _describe_beside(app)
    app.router.routes.insert(0, Route("/docs", _described_by_night, include_in_schema=False))
    return app


async def _tell_of_keys(keys: KeyStore) -> None:
    """Say in the log which keys end soon, at the start and each hour."""
    while True:
        keys.tell_ends()
        await asyncio.sleep(_KEYS_TOLD_S)


async def _described_by_night(request: Request) -> Response:
    """The description of the interface, as `FastAPIOffline` has it: dark in the dark, red at night."""
    root = request.scope.get("root_path", "")
    drawn = get_swagger_ui_html(
        openapi_url=f"{root}/openapi.json",
        title="mountnav: API",
        oauth2_redirect_url="/docs/oauth2-redirect",
        swagger_js_url=f"{root}/static-offline-docs/swagger-ui-bundle.js",
        swagger_css_url=f"{root}/static-offline-docs/swagger-ui.css",
        swagger_favicon_url=f"{root}/favicon.ico",
    )
    theme = (
        f'<link rel="stylesheet" href="{root}/web/docs.css">'
        f'<script src="{root}/web/js/first.js"></script><script src="{root}/web/js/docs.js"></script>'
    )
    return HTMLResponse(bytes(drawn.body).decode().replace("</head>", f"{theme}</head>", 1))


def _describe_beside(app: FastAPI) -> None:
    """Have the description of the interface made in a thread, when it is first asked for.

    FastAPI makes it in the event loop: 0.8 s, in which a stop of another caller would wait.
    """
    one_makes_it, make = asyncio.Lock(), app.openapi

    def with_bodies_left_out() -> dict[str, Any]:
        if app.openapi_schema is None:
            described = _without_null_bodies(make())
            _add_body_of_frames(described)
            describe(described)
            say_what_it_does(described)
            give_examples(described)
            app.openapi_schema = described
        return app.openapi_schema

    app.openapi = with_bodies_left_out  # type: ignore[method-assign]

    async def described(request: Request) -> JSONResponse:
        async with one_makes_it:
            return JSONResponse(await asyncio.to_thread(app.openapi))

    assert app.openapi_url is not None
    app.router.routes.insert(0, Route(app.openapi_url, described, include_in_schema=False))


def _without_null_bodies(schema: dict[str, Any]) -> dict[str, Any]:
    """A body that may be left out needs no null besides: generated clients fail where one is told."""
    for operations in schema["paths"].values():
        for operation in operations.values():
            for content in operation.get("requestBody", {}).get("content", {}).values():
                either = content["schema"].get("anyOf", [])
                bodies = [body for body in either if body != {"type": "null"}]
                if len(bodies) == 1 < len(either):
                    content["schema"] = bodies[0]
    return schema


def _add_body_of_frames(schema: dict[str, Any]) -> None:
    """Put the one body into the description that its route reads by itself, among other kinds of content.

    What it refers to is there already, for orders have targets, too.
    """
    body = FramePathBody.model_json_schema(ref_template="#/components/schemas/{model}")
    body.pop("$defs", None)
    schema["components"]["schemas"]["FramePathBody"] = body


@cache
def _common_routes() -> APIRouter:
    """The routes that every application has, whatever its settings, ready before the first request.

    FastAPI takes the functions behind included routes apart when the first request comes. A first stop would
    wait for that: 0.2 s on a fast computer, while the event loop does nothing else. The applications of one
    process, as in tests, share these routes.
    """
    common = APIRouter(generate_unique_id_function=_name_of)
    common.include_router(health.router, prefix="/v1", dependencies=[KnownQueryOnly])
    shut = (
        telescopes,
        orders,
        pointing,
        wire,
        night,
        frames,
        journal,
        doctor,
        jobs,
        events,
        solve,
        catalogs,
        last_frame,
        offsets,
        sky_view,
        tonight,
        forecast,
        leases,
        audit,
        stops,
        objects,
        capabilities,
        reload,
    )
    for router in (resource.router for resource in shut):
        common.include_router(router, prefix="/v1", dependencies=[TokenRequired, KnownQueryOnly])
    common.include_router(metrics.router, dependencies=[TokenRequired, KnownQueryOnly])
    # matching a path that none of them has makes all of them ready
    no_route = {"type": "http", "method": "GET", "path": "/", "root_path": "", "headers": []}
    for route in common.routes:
        route.matches(no_route)
    return common


def _name_of(route: APIRoute) -> str:
    return route.name


def listeners_of(
    service: Service, http_address: tuple[str, int] | None, turns: guards.Turns | None = None
) -> Listeners:
    """Make the listeners of a service; none is started yet.

    Parameters
    ----------
    http_address : (str, int) or None
        Where HTTP is served, for discovery; None where no socket stands behind the application.
    turns : Turns, optional
        Of the loop, which the ports that speak HTTP share.
    """
    settings = service.settings
    made: dict[str, Callable[[], Listener]] = {}
    # each protocol's code is loaded only where its listener is wanted
    if settings.indi_server.enabled:
        made["indi"] = lambda: _indi(service)
    if settings.lx200_server.enabled:
        made["lx200"] = lambda: _lx200(service)
    if settings.stellarium.enabled:
        made["stellarium"] = lambda: _stellarium(service)
    if settings.nova.enabled:
        made["nova"] = lambda: _nova(service, turns or guards.Turns())
    if http_address is not None and settings.alpaca.enabled and settings.alpaca.discovery:
        made["alpaca-discovery"] = lambda: _discovery(service, http_address)
    if http_address is not None and settings.solver_commands.enabled:
        made["solver-commands"] = lambda: _solver_commands(service)
    return Listeners(made)


def _solver_commands(service: Service) -> Listener:
    from api.solver_daemon.listener import CALLS_OF_SERVICE, SolverOnLoop, SolverSocket

    on_loop = SolverOnLoop(service.solver, lambda: service.solve_settings(None), asyncio.get_running_loop())
    return SolverSocket(on_loop, most_calls=CALLS_OF_SERVICE, takes_over=True)


def _indi(service: Service) -> Listener:
    from api.indi_server.server import IndiServer

    return IndiServer(service, service.settings.indi_server)


def _lx200(service: Service) -> Listener:
    from api.planetarium.lx200_server import Lx200Server

    return Lx200Server(service, service.settings.lx200_server)


def _stellarium(service: Service) -> Listener:
    from api.planetarium.stellarium_server import StellariumServer

    return StellariumServer(service, service.settings.stellarium)


def _nova(service: Service, turns: guards.Turns) -> Listener:
    from api.http.connections import Bounds, Gate
    from api.nova.server import NovaServer

    settings = service.settings
    shared = nova_shares(descriptors_at_hand())
    gate = Gate(
        Bounds(most=shared.clients, each_address=max(1, shared.clients // 2), stops=0, fresh=shared.fresh),
        turns=turns.reading,
    )
    keys = None if settings.nova.open else open_keys(settings, wide=not settings.nova.is_loopback)
    return NovaServer(
        service,
        protocol=gate.protocol(),
        guarded=lambda app: guards.nova_guard(app, turns, keys),
        shares=shared,
    )


def _discovery(service: Service, http_address: tuple[str, int]) -> Listener:
    from api.alpaca.discovery import Discovery

    return Discovery(service.settings.alpaca, http_address)
