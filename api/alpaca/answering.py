"""One request to a member, from its parameters to its answer: the checks in the order that suits all clients.

::

    parameters 400 -> connected 0x407 -> implemented 0x400 -> range 0x401 -> parked 0x408 -> state 0x40B

[Alpaca §3]
"""

from __future__ import annotations

import inspect
import logging
from collections.abc import Mapping

from api.access.callers import Caller
from api.alpaca.codec import NOTHING, required
from api.alpaca.connection import Client
from api.alpaca.errors import AlpacaError, NotTaken, error_of, not_implemented, parked
from api.alpaca.member import Member
from api.alpaca.members_motion import ABILITIES, PARKING, SLEWING, TRACKING
from api.alpaca.members_state import COMMON, READING, SITE
from api.alpaca.telescope import AlpacaTelescope, Call
from api.problems import Refused, internal_problem, problem_of
from mountnav.errors import MountnavError

__all__ = ["MEMBERS", "NAMES", "answer", "read_parameters"]


MEMBERS: dict[tuple[str, str], Member] = {
    (member.verb, member.name): member
    for member in (*COMMON, *ABILITIES, *READING, *SITE, *SLEWING, *PARKING, *TRACKING)
}
"""By verb and name."""
NAMES = frozenset(name for _, name in MEMBERS)


_log = logging.getLogger(__name__)


def read_parameters(member: Member, given: Mapping[str, str]) -> dict[str, object]:
    """A member's own parameters. Raises `BadParameter`."""
    values: dict[str, object] = {}
    any_case = member.verb == "GET"
    for parameter in member.takes:
        name = parameter.name.lower() if any_case else parameter.name
        if parameter.fallback is not None and name not in given:
            values[parameter.name] = parameter.fallback
        else:
            values[parameter.name] = parameter.read(
                parameter.name, required(given, parameter.name, any_case=any_case)
            )
    return values


async def answer(
    device: AlpacaTelescope,
    member: Member,
    values: Mapping[str, object],
    caller: Caller,
    client: Client,
    *,
    stops_given: int | None = None,
) -> tuple[object, AlpacaError | None]:
    """What a member answers: its value (`NOTHING` where there is none), and how it was refused.

    Parameters
    ----------
    stops_given : int, optional
        How many stops the telescope had been given when the request came; left out: it comes now.
    """
    error: AlpacaError
    try:
        if stops_given is None:
            stops_given = device.dispatcher.stops_given(device.id)
        call = Call(caller, client, values, stops_given)
        if not member.offline:
            device.require_connected(client)
        if not member.able(device):
            raise not_implemented(f"{member.verb} {member.name}", member.why_not)
        for bound in member.ranges:
            bound.check(call)
        if not member.parked and device.is_parked:
            raise parked(member.name)
        value = member.act(device, call)
        if inspect.isawaitable(value):
            value = await value
    except NotTaken as refusal:
        error = refusal
        if member.orders:
            device.audit.note(
                caller,
                member.orders,
                telescope=device.id,
                request=values,
                outcome=refusal.slug,
                detail=refusal.words,
            )
    except AlpacaError as failure:
        error = failure
    except Refused as refused:
        error = error_of(refused.problem)
    except MountnavError as trouble:
        error = error_of(problem_of(trouble))
    except Exception:
        # a client must get an answer that it can read; what it was is for the log
        _log.exception("unexpected error in %s %s of %s", member.verb, member.name, device.id)
        error = error_of(internal_problem())
    else:
        return (value if member.has_value else NOTHING), None
    return (member.default if member.has_value else NOTHING), error
