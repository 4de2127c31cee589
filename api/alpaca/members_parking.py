"""Members that park, unpark and go home: begun at once, watched by AtPark, AtHome and Slewing [Alpaca §5]."""

from __future__ import annotations

from api.alpaca.member import Member, with_skill
from api.alpaca.telescope import AlpacaTelescope, Call
from api.orders.vocabulary import HomeOrder, ParkOrder, SetParkOrder, UnparkOrder
from mountnav.devices import Skill

_AT_ONCE_S = 0.5
"""So long an unpark is waited for: most mounts have it done by then, and a client sees it at once."""


def _runs(device: AlpacaTelescope, kind: str) -> bool:
    """Whether this is just what is done, whoever ordered it."""
    job = device.snapshot.job
    return job is not None and job.kind == kind


async def _park(device: AlpacaTelescope, call: Call) -> None:
    """Once more is harmless, whoever began it. What this client has under way makes room: parking is safe."""
    if (device.is_parked and not device.is_slewing) or _runs(device, "park"):
        return

    def arrived() -> None:
        device.stations.remember("park", device.snapshot)

    await device.motion.begin(call.caller, call.client, ParkOrder(), supersede=True, arrived=arrived)


async def _unpark(device: AlpacaTelescope, call: Call) -> None:
    """Once more is harmless; so is one that isn't needed."""
    await device.motion.stopped()
    if _runs(device, "unpark") or (not device.is_parked and not _runs(device, "park")):
        return

    def arrived() -> None:
        device.stations.forget("park")

    await device.motion.begin(call.caller, call.client, UnparkOrder(), arrived=arrived)
    await device.motion.wait(_AT_ONCE_S)
    if not device.motion.under_way:
        await device.motion.ended()


async def _find_home(device: AlpacaTelescope, call: Call) -> None:
    def arrived() -> None:
        device.stations.remember("home", device.snapshot)

    await device.motion.begin(call.caller, call.client, HomeOrder(), arrived=arrived)


async def _set_park(device: AlpacaTelescope, call: Call) -> None:
    await device.carry_out(call, SetParkOrder())


can_unpark = with_skill(Skill.PARK, Skill.UNPARK)

MEMBERS: tuple[Member, ...] = (
    Member("PUT", "park", _park, able=with_skill(Skill.PARK), orders="park"),
    Member("PUT", "unpark", _unpark, able=can_unpark, orders="unpark"),
    Member("PUT", "findhome", _find_home, able=with_skill(Skill.HOME), parked=False, orders="home"),
    Member("PUT", "setpark", _set_park, able=with_skill(Skill.SET_PARK), orders="set-park"),
)

__all__ = ["MEMBERS", "can_unpark"]
