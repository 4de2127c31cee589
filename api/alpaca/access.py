"""Who calls by Alpaca: a key by HTTP Basic or X-API-Key where there are keys, unless the door is open."""

from __future__ import annotations

from starlette.datastructures import Headers
from starlette.types import Scope

from api.access.callers import Caller, Face, Role
from api.access.keys import KeyStore
from api.access.security import address_of, caller_from_headers


def alpaca_caller(scope: Scope, keys: KeyStore, *, is_open: bool) -> Caller:
    """The caller of a request.

    Parameters
    ----------
    scope : Scope
    keys : KeyStore
    is_open : bool
        Whether whoever reaches the port may operate without a key: the standard itself knows none. A key
        that is sent all the same counts.

    Raises
    ------
    Refused
        401 with WWW-Authenticate: no key, or none that is known.
    """
    headers, address = Headers(scope=scope), address_of(scope)
    if is_open and keys.guards and "authorization" not in headers and "x-api-key" not in headers:
        return Caller(f"alpaca {address}", Role.OPERATE, Face.ALPACA, address)
    return caller_from_headers(headers, address, keys=keys, face=Face.ALPACA, basic=True)


__all__ = ["alpaca_caller"]
