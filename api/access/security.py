"""Who calls: API keys, or, where there are none, programs on this machine alone; and what the caller may.

`allowed_file` bounds which files of this machine callers may name.
"""

from __future__ import annotations

import base64
import binascii
import ipaddress
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated
from urllib.parse import urlsplit

from fastapi import Depends, Request
from fastapi.security import APIKeyHeader, HTTPAuthorizationCredentials, HTTPBearer
from starlette.applications import Starlette
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from api.access.callers import Caller, Face, Role
from api.access.keys import KeyStore, open_keys
from api.access.roles import LEASED, OF_ALL, ROLES, route_of
from api.problems import Problem, Refused, problem, refusal_response
from mountnav.errors import BadRequest, NotFound

__all__ = ["allowed_file"]


_bearer = HTTPBearer(auto_error=False, description="An API key (`mountnav key new`), or the settings' token")
_key = APIKeyHeader(name="X-API-Key", auto_error=False, description="The same key")

LEASE_HEADER = "Mountnav-Lease"
"""The header in which a lease's holder sends its secret."""
STOPS_GIVEN = "stops_given"
"""Under this name of a request's state stands how many stops each telescope had been given when it came."""
THIS_MACHINE = "this machine"
_PROXIES = ("forwarded", "x-forwarded-for", "x-real-ip", "via")
_HOW = (
    "send it as `Authorization: Bearer KEY` or `X-API-Key: KEY`, "
    "from `mountnav` by --token or MOUNTNAV_TOKEN; `mountnav key new` makes one"
)


def caller_from_headers(
    headers: Mapping[str, str],
    address: str,
    *,
    keys: KeyStore,
    face: Face = Face.REST,
    basic: bool = False,
) -> Caller:
    """Tell who calls, by the headers of a request; for all faces that speak HTTP.

    Parameters
    ----------
    headers : mapping
        Without regard to case, as starlette's.
    address : str
        Where the request came from.
    basic : bool
        Also take HTTP Basic, whose password is the key, for clients that know nothing else. The user's name
        may be anything.

    Returns
    -------
    Caller
        Without keys: ``this machine``, which may do everything (`OwnMachineOnly` keeps others out).

    Raises
    ------
    Refused
        401 with WWW-Authenticate: no key, or none that is known (any more).
    """
    lease_id = headers.get(LEASE_HEADER.lower()) or None
    if not keys.guards:
        return Caller(THIS_MACHINE, Role.CONFIGURE, face, address, lease_id)
    given = _given(headers, basic)
    scheme = "Basic" if basic else "Bearer"
    if given is None:
        found = problem("unauthorized", 401, "no key came with the request", advice=_HOW)
        raise Refused(found, {"WWW-Authenticate": f'{scheme} realm="mountnav"'})
    key = keys.find(given)
    if key is None:
        over = keys.ended(given)
        words, advice = "the key is not known, or was revoked", _HOW
        if over is not None:
            words = f"the key ended at {over.expires_utc:%Y-%m-%d %H:%M} UTC"
            advice = "`mountnav key renew` makes a new one"
        found = problem("unauthorized", 401, words, advice=advice)
        error = "" if basic else ', error="invalid_token"'
        raise Refused(found, {"WWW-Authenticate": f'{scheme} realm="mountnav"{error}'})
    return Caller(key.name, key.role, face, address, lease_id, key.telescopes, key.expires_utc)


def require_telescope(caller: Caller, telescope_id: str) -> None:
    """Raise `Refused` (403 `forbidden`) unless the caller's key is for this telescope."""
    if not caller.reaches(telescope_id):
        found = problem(
            "forbidden",
            403,
            f"the key of {caller.name} is for other telescopes",
            advice="use a key for this telescope; `mountnav key change` widens one",
        )
        raise Refused(found)


def require_all_telescopes(caller: Caller) -> None:
    """Raise `Refused` (403 `forbidden`) if the caller's key is for some telescopes alone."""
    if caller.telescopes is not None:
        found = problem(
            "forbidden",
            403,
            f"the key of {caller.name} is for some telescopes only, and this request covers all of them",
            advice="use a key that is for all telescopes",
        )
        raise Refused(found)


def require_role(caller: Caller, role: Role) -> None:
    """Raise `Refused` (403 `role-too-low`) unless the caller has this role or one above it."""
    if not caller.role.includes(role):
        keyless = caller.face in (Face.LX200, Face.STELLARIUM)
        found = problem(
            "role-too-low",
            403,
            f"{caller.name} has the role {caller.role}, and this needs {role}",
            advice="its port is read_only by the settings" if keyless else f"use a key with the role {role}",
        )
        raise Refused(found)


def address_of(scope: Scope) -> str:
    """Where a request came from: the client's host, as the server (or the proxy that it trusts) tells it."""
    client = scope.get("client")
    return "" if client is None else str(client[0])


def keys_of(app: Starlette) -> KeyStore:
    """The keys of the service that an application is the face of."""
    if not hasattr(app.state, "keys"):
        app.state.keys = open_keys(app.state.settings)
    keys: KeyStore = app.state.keys
    return keys


async def caller_of(
    request: Request,
    _: Annotated[HTTPAuthorizationCredentials | None, Depends(_bearer)] = None,
    __: Annotated[str | None, Depends(_key)] = None,
) -> Caller:
    """Who sends this request, as a dependency. Raises as `caller_from_headers`.

    A coroutine, as all dependencies here: a thread for each would cost more than the request.

    The two unused dependencies are there for the API's description: they say how a key is sent.
    """
    return caller_from_headers(request.headers, address_of(request.scope), keys=keys_of(request.app))


TheCaller = Annotated[Caller, Depends(caller_of)]


class RoleRequired:
    """A dependency that lets callers of a role through: ``dependencies=[Depends(RoleRequired(role))]``."""

    def __init__(self, role: Role) -> None:
        self.role = role

    async def __call__(self, caller: TheCaller) -> Caller:
        """Return the caller. Raises `Refused` 401, 403."""
        require_role(caller, self.role)
        return caller


def stops_before(request: Request) -> Mapping[str, int]:
    """How many stops each telescope had been given when a request came; empty if nobody noted it."""
    found: Mapping[str, int] = getattr(request.state, STOPS_GIVEN, {})
    return found


async def require_role_of_route(request: Request, caller: TheCaller) -> Caller:
    """Let the request through if its caller may what `ROLES` asks for this route.

    What the table doesn't name is for those who may do everything. Where somebody else's lease must be
    heeded and no dispatcher does it, it is done here.

    Raises
    ------
    Refused
        401, 403 ``role-too-low``, 409 ``leased``.
    """
    route = route_of(request.method, request.url.path)
    role = Role.CONFIGURE if route is None else ROLES[route]
    if role is not None:
        require_role(caller, role)
    if (telescope_id := request.path_params.get("telescope_id")) is not None:
        require_telescope(caller, telescope_id)
    if route in OF_ALL:
        require_all_telescopes(caller)
    if route in LEASED:
        request.app.state.service.leases.require(caller, request.path_params["telescope_id"])
    return caller


TokenRequired = Depends(require_role_of_route)
"""For routers: each of their routes asks for the role that stands in `ROLES`."""


class OwnMachineOnly:
    """Refuse, while no keys are configured, what isn't plainly a program's or our own page's on this machine.

    Without keys nothing but the loopback address protects the telescope, and a browser on this machine
    carries requests of any page to it: by name (DNS rebinding: foreign Host) or straight (foreign Origin).
    A proxy on this machine would carry the whole world's.
    Plain ASGI, so that event streams pass unbuffered.

    Parameters
    ----------
    origins : sequence of str
        Pages of these may come in as well.
    """

    def __init__(self, app: ASGIApp, keys: KeyStore | None = None, origins: Sequence[str] = ()) -> None:
        self._app = app
        self._keys = keys
        self._origins = frozenset(origins)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, or refuse it."""
        guarded = self._keys is not None and self._keys.guards
        refusal = None if scope["type"] != "http" or guarded else self._refusal(scope)
        if refusal is None:
            await self._app(scope, receive, send)
        else:
            await refusal_response(scope, refusal)(scope, receive, send)

    def _refusal(self, scope: Scope) -> Problem | None:
        headers = Headers(scope=scope)
        host, origin = headers.get("host", ""), headers.get("origin")
        if not _is_loopback_name(f"//{host}"):
            return problem(
                "forbidden", 403, "the Host header names no loopback address", advice="use 127.0.0.1"
            )
        if origin is not None and not _is_of(origin, host) and origin not in self._origins:
            return problem("forbidden", 403, "the request comes from another site's page")
        if any(name in headers for name in _PROXIES):
            return problem(
                "forbidden",
                403,
                "the request comes through a proxy, and without keys only this machine is let in",
                advice="make keys with `mountnav key new`",
            )
        return None


def _given(headers: Mapping[str, str], basic: bool) -> str | None:
    """The key that came with a request."""
    scheme, _, rest = headers.get("authorization", "").partition(" ")
    if scheme.lower() == "bearer" and rest.strip():
        return rest.strip()
    if basic and scheme.lower() == "basic":
        try:
            _, _, password = base64.b64decode(rest.strip(), validate=True).decode().partition(":")
        except (binascii.Error, UnicodeDecodeError, ValueError):
            return ""
        return password
    return headers.get("x-api-key") or None


def _is_of(origin: str, host: str) -> bool:
    """Whether a page is one of this very host."""
    try:
        return urlsplit(origin).netloc == host
    except ValueError:  # http://[
        return False


def _is_loopback_name(url: str) -> bool:
    try:
        parts = urlsplit(url)
        name = parts.hostname
        # a user belongs to no Host and to no Origin [RFC 9110 §4.2.4]
        return "@" not in parts.netloc and (
            name == "localhost" or ipaddress.ip_address(name or "").is_loopback
        )
    except ValueError:
        return False


def allowed_file(path: Path, folders: Sequence[Path], *, telescope_id: str) -> Path:
    """The file, if it lies in one of the folders.

    Parameters
    ----------
    telescope_id : str
        Whose settings they are of, for the message.

    Raises
    ------
    BadRequest
        It doesn't; links out of a folder don't count.
    NotFound
        There is no such file.
    """
    try:
        real = path.resolve()
        inside = any(real.is_relative_to(folder.resolve()) for folder in folders)
        there = inside and real.is_file()
    # a name with a zero byte; a loop of links, which is a RuntimeError before Python 3.13
    except (OSError, RuntimeError, ValueError) as odd:
        raise BadRequest("that path is empty or invalid", device=telescope_id, advice=str(odd)) from odd
    if not inside:
        raise BadRequest(
            f"{path} is not in a folder that frames may be taken from",
            device=telescope_id,
            advice="set night.folder or night.allowed_folders: "
            + (", ".join(map(str, folders)) or "there are none yet"),
        )
    if not there:
        raise NotFound(f"there is no file {path}", device=telescope_id, advice="check the name")
    return real
