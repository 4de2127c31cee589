"""What became of a command nobody saw the end of, judged by where the mount stands now: a guess."""

from __future__ import annotations

from enum import StrEnum

from mountnav.devices import MountReading
from mountnav.journal.records import CommandRecord
from mountnav.navigation.kinds import from_mount
from mountnav.sky.coordinates import Apparent, Icrs
from mountnav.sky.sphere import separation_arcsec

NEAR_ARCSEC = 120.0
"""A mount this near to a place is taken to stand there; or three of its steps, if that is more."""


class Likely(StrEnum):
    """What the mount's reading says."""

    CARRIED_OUT = "carried out"
    UNDER_WAY = "under way"
    NOT_CARRIED_OUT = "not carried out"
    PARTLY = "partly carried out"
    UNTOLD = "can't be told"


Judgment = tuple[Likely, str, float | None]


def named(command: CommandRecord) -> str:
    """A command in words."""
    what = {"set-clock": "an order to set the clock", "set-site": "an order to set the site"}.get(
        command.order
    )
    if what is None:
        article = "an" if command.order[0] in "aeiou" else "a"
        what = f"{article} {command.order}"
    if command.place is None:
        return what
    kind = "apparent " if isinstance(command.place, Apparent) else ""
    return f"{what} to {kind}RA {command.place.ra_deg:.4f}° Dec {command.place.dec_deg:+.4f}°"


def judged(
    command: CommandRecord, now: MountReading, resolution_arcsec: float, *, overtaken: bool = False
) -> Judgment:
    """Judge what became of a command.

    Parameters
    ----------
    command : CommandRecord
        Begun, and not closed.
    now : MountReading
        Where the mount stands.
    resolution_arcsec : float
    overtaken : bool
        Whether other commands in flight came behind it: then the reading tells little of this one.

    Returns
    -------
    likely : Likely
    words : str
    miss_arcsec : float or None
        Between the reading and the ordered place.
    """
    sent = f"sent or not at {command.utc:%H:%M:%S} UTC; "
    stands = f"the mount now stands at {_shown(now.place)}"
    near = max(NEAR_ARCSEC, 3.0 * resolution_arcsec)
    miss = None if command.place is None else _apart(now.place, command.place)
    if overtaken and miss is None:
        return Likely.UNTOLD, f"{sent}{stands}; another order was in flight behind it", None
    if miss is not None:
        likely, words = _of_a_place(command, now, miss, near)
        return likely, f"{sent}{stands}, {_arc(miss)} from there: {words}", miss
    likely, words = _of_a_state(command, now, near)
    return likely, f"{sent}{stands}: {words}", None


def _of_a_place(command: CommandRecord, now: MountReading, miss: float, near: float) -> tuple[Likely, str]:
    came = None if command.before is None else _apart(now.place, command.before.place)
    if command.order == "sync":
        return _of_a_sync(command, miss, came)
    if now.slewing:
        return Likely.UNDER_WAY, "it says it is moving, the slew is probably under way"
    if miss <= near:
        if came is not None and came <= near:
            return Likely.UNTOLD, "it stood there before, so this doesn't tell whether it moved"
        return Likely.CARRIED_OUT, "it probably arrived"
    if came is not None and came <= near:
        return Likely.NOT_CARRIED_OUT, f"and {_arc(came)} from where it was: it probably never moved"
    return Likely.PARTLY, "it stopped on the way, drifted since, or somebody else moved it"


def _of_a_sync(command: CommandRecord, miss: float, came: float | None) -> tuple[Likely, str]:
    """A sync changes what the mount says at once, so the nearer of the two places tells; if they differ."""
    advice = "look, before its position is trusted"
    if came is None or command.before is None or command.place is None:
        return Likely.UNTOLD, f"whether it took the sync isn't known: {advice}"
    size = _apart(command.before.place, command.place)
    if miss < 0.25 * size:
        return Likely.CARRIED_OUT, f"it probably took the sync (of {_arc(size)}): {advice}"
    if came < 0.25 * size:
        return Likely.NOT_CARRIED_OUT, f"it probably did not take the sync (of {_arc(size)}): {advice}"
    return Likely.UNTOLD, f"whether it took the sync (of {_arc(size)}) isn't known: {advice}"


def _of_a_state(command: CommandRecord, now: MountReading, near: float) -> tuple[Likely, str]:
    """Orders without a place, by what the mount says of itself."""
    order = command.order
    if order in ("park", "home") and now.slewing:
        return Likely.UNDER_WAY, f"it says it is moving, the {order} is probably under way"
    if order == "stop":
        if now.slewing is None:
            return Likely.UNTOLD, "it can't say whether it moves: look at it"
        if now.slewing:
            return Likely.NOT_CARRIED_OUT, "it says it is STILL MOVING: stop it again"
        return Likely.CARRIED_OUT, "it says it is not moving"
    if order == "track":
        wanted, said = command.facts.get("on"), now.tracking
        if not isinstance(wanted, bool) or said is None:
            return Likely.UNTOLD, "whether it tracks as ordered isn't known"
        words = "it tracks" if said else "it does not track"
        return (Likely.CARRIED_OUT if said is wanted else Likely.NOT_CARRIED_OUT), words
    told = {
        "park": (now.parked, True, "it says it is parked", "it says it is not parked"),
        "unpark": (now.parked, False, "it says it is not parked", "it says it is parked"),
        "home": (now.at_home, True, "it says it is at home", "it says it is not at home"),
    }.get(order)
    if told is not None and told[0] is not None:
        state, wanted_state, yes, no = told
        return (Likely.CARRIED_OUT, yes) if state is wanted_state else (Likely.NOT_CARRIED_OUT, no)
    if command.before is not None and (moved := _apart(now.place, command.before.place)) > near:
        return Likely.UNTOLD, f"{_arc(moved)} from where it was when it was ordered"
    return Likely.UNTOLD, "whether it was carried out isn't known"


def _apart(a: Apparent | Icrs, b: Apparent | Icrs) -> float:
    """Distance on the sky, whatever kinds and dates the two places are of."""
    return separation_arcsec(from_mount(a), from_mount(b))


def _shown(place: Apparent | Icrs) -> str:
    return f"RA {place.ra_deg:.4f}° Dec {place.dec_deg:+.4f}°"


def _arc(arcsec: float) -> str:
    if arcsec < 120:
        return f"{arcsec:.0f}″"
    return f"{arcsec / 60:.1f}′" if arcsec < 7200 else f"{arcsec / 3600:.1f}°"
