"""Members that every Alpaca device has: who it is, connection, actions [Alpaca §4]."""

from __future__ import annotations

from api.alpaca.errors import AlpacaError, Number
from api.alpaca.member import Member, Parameter, never, nothing, truth, words
from api.alpaca.telescope import AlpacaTelescope, Call
from mountnav import __version__

INTERFACE_VERSION = 4
"""ITelescopeV4."""


def _description(device: AlpacaTelescope, call: Call) -> str:
    return f"{device.id}: {device.mount.name}, guarded by mountnav"


def _driver_info(device: AlpacaTelescope, call: Call) -> str:
    return f"mountnav {__version__}: every order is checked against this telescope's limits before it is sent"


def _driver_version(device: AlpacaTelescope, call: Call) -> str:
    return ".".join(__version__.split(".")[:2])


def _name(device: AlpacaTelescope, call: Call) -> str:
    return device.name


def _connected(device: AlpacaTelescope, call: Call) -> bool:
    return device.connected(call.client)


async def _set_connected(device: AlpacaTelescope, call: Call) -> None:
    if call.flag("Connected"):
        await device.connect(call.client)
    else:
        device.disconnect(call.client)


async def _connect(device: AlpacaTelescope, call: Call) -> None:
    device.connecting.begin(call.client)


def _connecting(device: AlpacaTelescope, call: Call) -> bool:
    if (failure := device.connecting.failed_before(call.client)) is not None:
        raise failure
    return device.connecting.under_way


def _disconnect(device: AlpacaTelescope, call: Call) -> None:
    device.disconnect(call.client)


def _action(device: AlpacaTelescope, call: Call) -> str:
    name = call.given["Action"]
    raise AlpacaError(Number.ACTION_NOT_IMPLEMENTED, f"there is no action {name}: this telescope has none")


_UNSEEN = "nothing goes to the mount unseen: use the members of the interface"
_COMMAND = (Parameter("Command", words), Parameter("Raw", truth))

MEMBERS: tuple[Member, ...] = (
    Member("GET", "name", _name, offline=True, default=""),
    Member("GET", "description", _description, default=""),
    Member("GET", "driverinfo", _driver_info, offline=True, default=""),
    Member("GET", "driverversion", _driver_version, offline=True, default=""),
    Member("GET", "interfaceversion", lambda device, call: INTERFACE_VERSION, offline=True),
    Member("GET", "supportedactions", lambda device, call: [], default=[]),
    Member("GET", "connected", _connected, offline=True, default=False),
    Member("PUT", "connected", _set_connected, takes=(Parameter("Connected", truth),), offline=True),
    Member("PUT", "connect", _connect, offline=True),
    Member("GET", "connecting", _connecting, offline=True, default=False),
    Member("PUT", "disconnect", _disconnect, offline=True),
    Member(
        "PUT",
        "action",
        _action,
        takes=(Parameter("Action", words), Parameter("Parameters", words, fallback="")),
        answers=True,
        default="",
    ),
    Member("PUT", "commandblind", nothing, takes=_COMMAND, able=never, why_not=_UNSEEN),
    Member(
        "PUT",
        "commandbool",
        nothing,
        takes=_COMMAND,
        able=never,
        answers=True,
        default=False,
        why_not=_UNSEEN,
    ),
    Member(
        "PUT", "commandstring", nothing, takes=_COMMAND, able=never, answers=True, default="", why_not=_UNSEEN
    ),
)

__all__ = ["INTERFACE_VERSION", "MEMBERS"]
