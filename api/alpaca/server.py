"""The Alpaca server as an ASGI application: paths, verbs, callers, plain-text refusals [Alpaca §1, §2, §6].

It answers below ``/api``, ``/management`` and ``/setup`` of the service's port. No web framework reads its
paths or parameters: their ways (redirected slashes, JSON errors, 422) are not the standard's. A caller
shows a key by HTTP Basic or X-API-Key where there are keys, unless the settings ask for none.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping, Sequence

from starlette.datastructures import Headers
from starlette.requests import Request
from starlette.responses import HTMLResponse, PlainTextResponse, Response
from starlette.routing import BaseRoute, Mount, Route
from starlette.types import ASGIApp, Receive, Scope, Send

from api.access.callers import Caller, Face, Role
from api.access.keys import KeyStore
from api.access.security import address_of, caller_from_headers, require_role, require_telescope, stops_before
from api.alpaca.answering import MEMBERS, NAMES, answer, read_parameters
from api.alpaca.codec import (
    BadParameter,
    DevicePath,
    ManagementPath,
    SetupPath,
    Transactions,
    envelope,
    from_form,
    from_query,
    read_path,
    unsigned,
)
from api.alpaca.connection import Client
from api.alpaca.errors import words_of
from api.alpaca.management import ids_path, management_value, server_page, telescope_page, unique_ids
from api.alpaca.telescope import AlpacaTelescope
from api.observatory.observatory import Telescope
from api.problems import Refused
from api.service import Service

__all__ = ["AlpacaServer", "alpaca_app", "alpaca_caller", "alpaca_routes"]


def alpaca_caller(scope: Scope, keys: KeyStore, *, admits: Callable[[str], bool]) -> Caller:
    """The caller of a request.

    Parameters
    ----------
    admits : callable (str) -> bool
        Whether who comes from an address may operate without a key: the standard itself knows none. A key
        that is sent all the same counts.

    Raises
    ------
    Refused
        401 with WWW-Authenticate: no key, or none that is known.
    """
    headers, address = Headers(scope=scope), address_of(scope)
    if keys.guards and admits(address) and "authorization" not in headers and "x-api-key" not in headers:
        return Caller(f"alpaca {address}", Role.OPERATE, Face.ALPACA, address)
    return caller_from_headers(headers, address, keys=keys, face=Face.ALPACA, basic=True)


_FORM = "application/x-www-form-urlencoded"
_LONGEST_BODY = 64_000
"""Longest form, bytes; chosen by hand, far above what a member takes. Doubled, nonsense takes twice the
memory."""
_ROOTS = ("api", "management", "setup")
_CLOSED = PlainTextResponse("the service is starting or shutting down", status_code=503)


def alpaca_app(service_getter: Callable[[], Service], keys_getter: Callable[[], KeyStore]) -> ASGIApp:
    """The Alpaca server.

    Parameters
    ----------
    service_getter : callable
        The running service, at the time of a request.
    keys_getter : callable
        Its keys.
    """
    return AlpacaServer(service_getter, keys_getter)


def alpaca_routes(
    service_getter: Callable[[], Service], keys_getter: Callable[[], KeyStore]
) -> list[BaseRoute]:
    """The Alpaca server as routes for an application's router; none of them stands in its OpenAPI."""
    app = alpaca_app(service_getter, keys_getter)
    return [
        # without these three a framework would redirect them to a slash at their end
        *(Route(f"/{name}", app, include_in_schema=False) for name in _ROOTS),
        *(Mount(f"/{name}", app, name=f"alpaca-{name}") for name in _ROOTS),
    ]


class AlpacaServer:
    """Answers Alpaca requests for all telescopes of a service.

    Parameters
    ----------
    service_getter, keys_getter : callable
        See `alpaca_app`.
    """

    def __init__(self, service_getter: Callable[[], Service], keys_getter: Callable[[], KeyStore]) -> None:
        self._service = service_getter
        self._keys = keys_getter
        self._transactions = Transactions()
        self._devices: list[AlpacaTelescope] = []
        self._known: Sequence[Telescope] = ()
        self._of: Service | None = None
        self._making = asyncio.Lock()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        assert scope["type"] == "http", "nothing else is routed here"
        response = await self._respond(Request(scope, receive))
        await response(scope, receive, send)

    async def devices(self, service: Service) -> list[AlpacaTelescope]:
        """All telescopes, in the order of the settings at the start; those that came later follow.

        A number stands for one telescope as long as the service runs: one that was taken out keeps its
        number, and is not connected any more.
        """
        telescopes = service.dispatcher.telescopes
        known = self._known
        same = len(known) == len(telescopes) and all(a is b for a, b in zip(known, telescopes, strict=True))
        if self._of is service and same:
            return self._devices
        async with self._making:
            # a disk is waited for in a thread, never in the event loop
            telescopes = service.dispatcher.telescopes
            ids = await asyncio.to_thread(
                unique_ids, ids_path(service.settings), [telescope.id for telescope in telescopes]
            )
            devices = self._devices if self._of is service else []
            self._devices = self._made(service, devices, telescopes, ids)
            self._of, self._known = service, telescopes
        return self._devices

    def _made(
        self,
        service: Service,
        before: list[AlpacaTelescope],
        telescopes: Sequence[Telescope],
        ids: Mapping[str, str],
    ) -> list[AlpacaTelescope]:
        """The devices, each of those before at its number."""
        devices = list(before)
        for one in telescopes:
            known = next((device for device in devices if device.id == one.id), None)
            if known is not None and known.telescope is one:
                continue
            number = len(devices) if known is None else known.number
            made = AlpacaTelescope(
                *(number, ids[one.id], one, service.dispatcher, service.settings, service.audit),
                time.monotonic,
            )
            devices[number : number + 1] = [made]
        return devices

    async def _respond(self, request: Request) -> Response:
        path = _path_of(request.scope)
        asked = read_path(path)
        if asked is None:
            status = 400 if path == "/api" or path.startswith("/api/") else 404
            return _refused(
                f"there is nothing at {path}: paths are lower case, without a slash at their end", status
            )
        try:
            service = self._service()
        except AttributeError:
            return _CLOSED
        devices, settings = await self.devices(service), service.settings
        if isinstance(asked, ManagementPath):
            return self._management(request, asked, devices, settings.alpaca.location)
        try:
            caller = alpaca_caller(request.scope, self._keys(), admits=settings.alpaca.admits)
            require_role(caller, Role.VIEW)
            # the number of a device that isn't there is refused below, in the words of the standard
            if asked.number is not None and asked.number < len(devices):
                require_telescope(caller, devices[asked.number].id)
        except Refused as refusal:
            found = refusal.problem
            return PlainTextResponse(words_of(found), status_code=found.status, headers=refusal.headers)
        if isinstance(asked, SetupPath):
            return _setup(request, asked, devices, caller)
        return await self._member(request, asked, devices, caller)

    def _management(
        self, request: Request, asked: ManagementPath, devices: list[AlpacaTelescope], location: str
    ) -> Response:
        if request.method != "GET":
            return _wrong_verb(request.method, "GET")
        try:
            given = from_query(request.scope["query_string"])
        except BadParameter as bad:
            return _refused(str(bad))
        return _json(
            envelope(
                unsigned(given.get("clienttransactionid")),
                self._transactions.next(),
                management_value(asked.page, devices, location),
                of_device=False,
            )
        )

    async def _member(
        self, request: Request, asked: DevicePath, devices: list[AlpacaTelescope], caller: Caller
    ) -> Response:
        if asked.number >= len(devices):
            return _refused(f"there is no telescope {asked.number}: there are {len(devices)}, the first is 0")
        if asked.command not in NAMES:
            return _refused(f"a telescope has no member {asked.command}")
        if request.method not in ("GET", "PUT"):
            return _wrong_verb(request.method, "GET, PUT")
        member = MEMBERS.get((request.method, asked.command))
        if member is None:
            return _refused(f"{asked.command} has no {request.method}")
        try:
            if request.method == "GET":
                given = from_query(request.scope["query_string"])
                client_id, transaction = given.get("clientid"), given.get("clienttransactionid")
            else:
                given = from_form(await _body(request))
                client_id, transaction = given.get("ClientID"), given.get("ClientTransactionID")
            values = read_parameters(member, given)
        except BadParameter as bad:
            return _refused(str(bad))
        number = self._transactions.next()
        client = Client(caller.address, unsigned(client_id))
        devices[asked.number].heard(client)
        device = devices[asked.number]
        value, error = await answer(
            device, member, values, caller, client, stops_given=stops_before(request).get(device.id)
        )
        return _json(envelope(unsigned(transaction), number, value, error))


async def _body(request: Request) -> bytes:
    """The body of a form. Raises `BadParameter` for one that is too long."""
    kind = request.headers.get("content-type", _FORM).partition(";")[0].strip().lower()
    body = bytearray()
    async for chunk in request.stream():
        body += chunk
        if len(body) > _LONGEST_BODY:
            raise BadParameter("the body is too long for a form")
    return bytes(body) if kind == _FORM else b""


def _setup(request: Request, asked: SetupPath, devices: list[AlpacaTelescope], caller: Caller) -> Response:
    if request.method != "GET":
        return _wrong_verb(request.method, "GET")
    if asked.number is None:
        return HTMLResponse(server_page([one for one in devices if caller.reaches(one.id)]))
    if asked.number >= len(devices):
        return _refused(f"there is no telescope {asked.number}")
    return HTMLResponse(telescope_page(devices[asked.number]))


def _path_of(scope: Scope) -> str:
    """The whole path, whether or not this application is mounted below a part of it."""
    path, root = str(scope["path"]), str(scope.get("root_path", ""))
    return path if not root or path.startswith(root) else root + path


def _json(body: bytes) -> Response:
    return Response(body, media_type="application/json")


def _refused(words: str, status: int = 400) -> Response:
    return PlainTextResponse(words, status_code=status)


def _wrong_verb(verb: str, allowed: str) -> Response:
    return PlainTextResponse(f"{verb} is not possible here", status_code=405, headers={"Allow": allowed})
