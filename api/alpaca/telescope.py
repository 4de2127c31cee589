"""One telescope as Alpaca's clients see it: cached state, who is connected, targets, what is under way."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from api.access.audit import Audit
from api.access.callers import Caller
from api.alpaca.connection import Client, Clients, Connecting, MountLink
from api.alpaca.errors import AlpacaError, Number, error_of, failure_of, not_connected
from api.alpaca.motion import Motion, Pulses, Stations
from api.observatory.observatory import Telescope
from api.orders.dispatcher import Dispatcher
from api.orders.kept_motions import KeptAxes, KeptRates
from api.orders.targets import Target
from api.orders.vocabulary import Order
from api.orders.watching import Snapshot, Watch
from api.problems import Problem
from mountnav.clock import sky_s, utc_now
from mountnav.devices import MountAxis, MountReading, Skill, TrackingRate
from mountnav.errors import MountnavError
from mountnav.mount import CheckedMount
from mountnav.settings.observatory import Settings

STALE_S = 15.0
"""A reading older than so many of the machine's seconds says nothing of now."""
_MOST_HEARD = 1000
"""Clients of which it is remembered when they were heard last; the one unheard for longest is forgotten.
Halved, 500 numbers in turn make a real client seem silent."""
_FAILED = 0x50D
"""Error number of a motion by hand that ended by itself; the standard leaves 0x500 to 0xFFF to drivers."""


@dataclass(frozen=True, slots=True)
class Call:
    """One request to a member.

    Attributes
    ----------
    caller : Caller
        As the core knows who orders.
    client : Client
        As Alpaca does.
    given : mapping
        The member's own parameters, read.
    stops_given : int
        How many stops the telescope had been given when it came.
    """

    caller: Caller
    client: Client
    given: Mapping[str, object]
    stops_given: int

    def number(self, name: str) -> float:
        """A parameter that is a number."""
        value = self.given[name]
        assert isinstance(value, int | float)
        return value

    def flag(self, name: str) -> bool:
        """A parameter that is a truth value."""
        return bool(self.given[name])


@dataclass(slots=True)
class Targets:
    """Where the next slew to the target goes; hours and degrees, None while not set."""

    ra_h: float | None = None
    dec_deg: float | None = None
    by: Client | None = None
    """Who set them last."""


class AlpacaTelescope:
    """The device of one telescope. Used from the event loop's thread alone.

    Parameters
    ----------
    number : int
        The device's.
    audit : Audit
        Where it is noted what was refused before it became a job.
    now_s : callable
        Seconds of the machine that never run back.
    """

    def __init__(
        self,
        number: int,
        unique_id: str,
        telescope: Telescope,
        dispatcher: Dispatcher,
        settings: Settings,
        audit: Audit,
        now_s: Callable[[], float],
    ) -> None:
        self.number = number
        self.unique_id = unique_id
        self.telescope = telescope
        self.dispatcher = dispatcher
        self.settings = settings
        self.audit = audit
        self.told = next(one for one in settings.telescope if one.id == telescope.id)
        """What the settings say of it."""
        self.clients = Clients(auto_connect=settings.alpaca.auto_connect)
        self.targets = Targets()
        self.motion = Motion(dispatcher, telescope.id)
        self.pulses = Pulses(dispatcher, telescope.id)
        self.rate: TrackingRate | None = None
        """Which tracking rate was asked for over Alpaca, for when tracking begins."""
        self.link = MountLink(telescope, dispatcher.watch(telescope.id), now_s)
        self.connecting = Connecting(self.link.open, self._count_in, self.id)
        self.stations = Stations()
        """Where parking and homing ended over Alpaca."""
        self.axes = KeptAxes(
            dispatcher, telescope.id, most_s=settings.alpaca.move_axis_s, ended=self._axis_ended
        )
        """Axes that MoveAxis moves."""
        self.offsets = KeptRates(dispatcher, telescope.id, within_s=settings.alpaca.offset_rates_s)
        """Offsets of the tracking rate that were set here."""
        self._now_s = now_s
        self._heard_s: OrderedDict[Client, float] = OrderedDict()

    # -- what it is ------------------------------------------------------------------------------------

    @property
    def id(self) -> str:
        """Of the settings."""
        return self.telescope.id

    @property
    def name(self) -> str:
        """For people."""
        return self.told.name or f"mountnav {self.id}"

    @property
    def mount(self) -> CheckedMount:
        """For what it is and can; never ordered from here."""
        return self.telescope.navigator.mount

    @property
    def watch(self) -> Watch:
        """Who reads it."""
        return self.dispatcher.watch(self.id)

    def can(self, *skills: Skill) -> bool:
        """Whether the mount can all of this."""
        return self.mount.skills.issuperset(skills)

    # -- who is heard ------------------------------------------------------------------------------------

    def heard(self, client: Client) -> None:
        """Take in that a client has asked something, whatever it was: it lives."""
        self._heard_s[client] = self._now_s()
        self._heard_s.move_to_end(client)
        while len(self._heard_s) > _MOST_HEARD:
            self._heard_s.popitem(last=False)

    def silent_s(self, client: Client) -> float | None:
        """For how many seconds a client has asked nothing; None: it has disconnected, or is forgotten."""
        at_s = self._heard_s.get(client)
        return None if at_s is None or not self.clients.connected(client) else self._now_s() - at_s

    def why_silent(self, client: Client) -> str | None:
        """Why a motion that this client began has to end; None while it is heard."""
        silence_s = self.settings.alpaca.silence_s
        if not self.clients.connected(client):
            return "its client has disconnected"
        silent_s = self.silent_s(client)
        lives = silent_s is not None and silent_s <= silence_s
        return None if lives else f"its client was silent for {silence_s:g} s"

    def _axis_ended(self, axis: MountAxis, why: str, problem: Problem | None) -> None:
        number = 0 if axis == "primary" else 1
        found = None if problem is None else failure_of(problem)
        if found is not None and found.number == Number.CANCELLED:
            return  # somebody's stop: no failure
        words = f"MoveAxis of axis {number} has ended by itself: {why}"
        self.motion.fail(AlpacaError(_FAILED if found is None else found.number, words))

    # -- connection ------------------------------------------------------------------------------------

    def connected(self, client: Client) -> bool:
        """Whether this client is connected to a mount that answers."""
        return self.clients.connected(client) and self.link.is_up()

    def require_client(self, client: Client) -> None:
        """Raise 0x407 if this client isn't connected, however the mount stands."""
        if not self.clients.connected(client):
            raise not_connected(self.id)

    def require_connected(self, client: Client) -> None:
        """Raise 0x407 if it isn't. A mount that was lost is looked for in the background."""
        self.require_client(client)
        if not self.link.is_up():
            self.link.reopen_soon()
            raise not_connected(self.id, self.watch.latest.state.problem or "the mount doesn't answer")

    async def connect(self, client: Client) -> None:
        """Open the mount if it is not open, and count this client in.

        Raises
        ------
        AlpacaError
            The mount can't be opened, or doesn't answer.
        """
        await self.link.open()
        self._count_in(client)

    def disconnect(self, client: Client) -> None:
        """Count this client out; one that was just being connected, too."""
        self.connecting.give_up(client)
        self.clients.disconnect(client)
        # what it moves ends by its next repeat: `why_silent`

    def _count_in(self, client: Client) -> None:
        """A client that wasn't connected starts fresh: what others left behind is neither set nor told."""
        if not self.clients.said_so(client):
            setter = self.targets.by
            if setter is None or setter == client or not self._is_at_work(setter):
                self.targets = Targets()
            self.motion.begin_anew(client)
        self.clients.connect(client)

    def _is_at_work(self, client: Client) -> bool:
        """Whether it has a name, and connected by itself: then what it has set stays its own."""
        return client.client_id != 0 and self.clients.said_so(client)

    # -- what is known now -----------------------------------------------------------------------------

    @property
    def snapshot(self) -> Snapshot:
        """The cached state."""
        return self.watch.latest

    @property
    def reading(self) -> MountReading:
        """What the mount said last. Raises 0x502 when that had no answer, or is too old to tell of now."""
        state = self.snapshot.state
        if state.reading is None:
            raise AlpacaError(0x502, f"{self.id}: not known just now: {state.problem or 'no answer'}")
        age_s = (utc_now() - state.reading.utc).total_seconds()
        if age_s > sky_s(STALE_S):
            raise AlpacaError(0x502, f"{self.id}: not known just now: last read {age_s:.0f} s ago")
        return state.reading

    @property
    def is_known(self) -> bool:
        """Whether the mount's last answer tells of now."""
        try:
            return self.reading is not None
        except AlpacaError:
            return False

    @property
    def is_parked(self) -> bool:
        """Whether it is parked, as the mount says, or stands where the last parking ended."""
        parked = self.reading.parked
        return self.stations.is_at("park", self.snapshot) if parked is None else parked

    @property
    def is_home(self) -> bool:
        """Whether it is at its home, as the mount says, or stands where the last homing ended."""
        home = self.reading.at_home
        return self.stations.is_at("home", self.snapshot) if home is None else home

    @property
    def at_park(self) -> bool:
        """AtPark: parked, and the order that led there is over: anyone who sees it may order at once.

        The mount says that it is parked some tenths of a second before the job has ended.
        """
        return self.is_parked and not self.is_slewing

    @property
    def at_home(self) -> bool:
        """AtHome: as `at_park`."""
        return self.is_home and not self.is_slewing

    @property
    def is_tracking(self) -> bool:
        """Whether it follows the sky. A mount that neither tells nor can be told otherwise always does."""
        tracking = self.reading.tracking
        if tracking is None:
            return not self.is_parked and not self.can(Skill.TRACK)
        return tracking and not self.at_park

    @property
    def is_slewing(self) -> bool:
        """Whether it moves, or was ordered to and isn't settled and read again."""
        return self.motion.under_way or bool(self.axes.rates_deg_s) or self.snapshot.slewing

    # -- orders ----------------------------------------------------------------------------------------

    async def check(self, call: Call, place: Target, *, supersede: bool = False) -> None:
        """Refuse at once what a slew there would be refused for; such a refusal is written down.

        Raises
        ------
        MountnavError
            As the dispatcher's `check`.
        """
        try:
            await self.dispatcher.check(self.id, place, supersede=supersede)
        except MountnavError as refusal:
            request = {"target": place.model_dump()}
            self.audit.refused(call.caller, "slew", refusal, telescope=self.id, request=request)
            raise

    async def carry_out(self, call: Call, order: Order) -> None:
        """Give an order that ends soon, and wait for its end.

        Raises
        ------
        AlpacaError
            How it ended.
        MountnavError, Refused
            As the dispatcher's `order`.
        """
        await self.motion.stopped()
        job = await self.dispatcher.order(call.caller, self.id, order, stops_given=call.stops_given)
        await job.ended.wait()
        if job.problem is not None:
            raise error_of(job.problem)

    async def close(self) -> None:
        """Follow nothing any more; the mount is none of its business."""
        await self.axes.close()
        await self.offsets.close()
        await self.motion.close()
        await self.pulses.close()
        self.connecting.close()
        self.link.close()


__all__ = ["AlpacaTelescope", "Call", "Targets"]
