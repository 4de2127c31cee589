"""What stands before an order: is the mount busy, able, parked, trusted? A refusal is written down."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from mountnav.clock import Clock
from mountnav.devices import Mount, MountReading, Skilled
from mountnav.errors import Busy, DeviceRefused, MountnavError, OutsideLimits, Refusal
from mountnav.journal.records import Order
from mountnav.mount.agreement import Agreement
from mountnav.mount.guarding import Guard
from mountnav.mount.sending import Sender
from mountnav.mount.standing import Standing
from mountnav.sky.coordinates import Apparent, Icrs


class Admission:
    """Lets orders to one mount pass, or refuses them.

    Parameters
    ----------
    mount : Mount
        Only asked for its name and its skills.
    guard : Guard
    standing : Standing
    sender : Sender
        Writes refusals down.
    clock : Clock
    agreement : Agreement
        Of mount and settings: nothing is slewed without.

    Attributes
    ----------
    job : str or None
        The order that holds the mount.
    """

    def __init__(
        self,
        mount: Mount,
        guard: Guard,
        standing: Standing,
        sender: Sender,
        clock: Clock,
        agreement: Agreement,
    ) -> None:
        self._agreement = agreement
        self._mount = mount
        self._guard = guard
        self._standing = standing
        self._sender = sender
        self._clock = clock
        self.job: Order | None = None

    @asynccontextmanager
    async def held(self, order: Order) -> AsyncIterator[None]:
        """Hold the mount for one order to move; a second one is refused, a stop under way waited for."""
        await self.require_free(order)
        self.job = order
        try:
            yield
        finally:
            self.job = None

    async def require_free(self, order: Order) -> None:
        """Refuse an order while another one holds the mount, once no stop is under way. Raises `Busy`."""
        await self._sender.settled()
        if self.job is not None:
            busy = self.busy()
            await self._sender.refused(order, busy)
            raise busy

    def busy(self) -> Busy:
        """What is said to an order while another one holds the mount."""
        return Busy(f"a {self.job} is running", device=self._mount.name, advice="wait for it, or stop it")

    async def skilled(self, order: Order) -> Skilled:
        """Give the mount as one that has skills. Raises `DeviceRefused` if it has none."""
        if isinstance(self._mount, Skilled):
            return self._mount
        raise await self.unsupported(order)

    async def unsupported(self, order: Order) -> DeviceRefused:
        """Write down that the mount can't do this, and give what is to be raised."""
        refusal = DeviceRefused(f"it can't: {order}", device=self._mount.name, reason=Refusal.UNSUPPORTED)
        await self._sender.refused(order, refusal)
        return refusal

    async def ready(
        self,
        order: Order,
        *,
        place: Apparent | Icrs | None = None,
        needs_trust: bool = True,
        parked_too: bool = False,
    ) -> MountReading:
        """Read the mount, and refuse to move one that is parked, lost, or by day.

        Raises
        ------
        DeviceRefused, OutsideLimits, DeviceError
        """
        before = await self._standing.reading()
        if self._standing.trusted:
            self._guard.stood(before)
        refusal = self.unfit(order, before, needs_trust=needs_trust, parked_too=parked_too)
        if refusal is not None:
            await self._sender.refused(order, refusal, before, place)
            raise refusal
        if order == "slew":
            # to park and to go home is to go by its own axes: both stay possible, as do stop and recover
            try:
                await self._agreement.require(order)
            except DeviceRefused as contradicted:
                await self._sender.refused(order, contradicted, before, place)
                raise
        return before

    def unfit(
        self, order: Order, before: MountReading, *, needs_trust: bool = True, parked_too: bool = False
    ) -> MountnavError | None:
        """What speaks against moving the mount as it stands, as what is to be raised; None: nothing."""
        if before.parked and not parked_too:
            return DeviceRefused(
                f"the {order} refused: it is parked",
                device=self._mount.name,
                advice="unpark it first",
                reason=Refusal.PARKED,
            )
        if needs_trust and not self._standing.trusted:
            return DeviceRefused(
                f"the {order} refused: its position can't be trusted ({self._standing.why_untrusted})",
                device=self._mount.name,
                advice="order first light if it was just set up, else recover: both look at the sky; or "
                "let it find its home",
                reason=Refusal.UNTRUSTED,
            )
        if order == "home":
            try:
                self._guard.require_night(self._clock.utc())
            except OutsideLimits as day:
                return day
        return None
