"""After a refusal: whether the mount does it all the same; then it is stopped, told, and no longer trusted.

One bit of an answer may flip, a driver may answer an order that it took with an alarm: "no" is a word, and
words are checked by readings. This is the one place for it, for all families and all orders.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress

from drivers.generic.language import Readout
from drivers.generic.session import Session
from mountnav.clock import pause, utc_now
from mountnav.devices import SlewState, moved_arcsec
from mountnav.errors import DeviceError, DeviceRefused, RefusedButDone

_LATELY_S = 2.0
"""A reading so old still tells how the mount stood before an order. Doubled, its drift hides more."""

Stop = Callable[[], Awaitable[None]]
Took = Callable[[Readout], bool | None]
"""Whether a reading shows that the order was carried out; None where it can't tell."""


class Refusals:
    """Looks after one mount that has said no.

    Parameters
    ----------
    tended : Tended
    stop : callable
        Stops the mount until it is seen at rest; raises `DeviceError`.
    """

    def __init__(self, tended: Session, stop: Stop) -> None:
        self._tended = tended
        self._stop = stop

    async def before(self) -> Readout:
        """How the mount stood before an order: its last reading, or a new one."""
        last = self._tended.judge.last
        if last is not None and (utc_now() - last.utc).total_seconds() < _LATELY_S:
            return last
        return await self._tended.look()

    @asynccontextmanager
    async def seen_to(
        self,
        order: str,
        before: Readout,
        *,
        took: Took | None = None,
        undo: Callable[[], Awaitable[object]] | None = None,
        stops: bool = True,
    ) -> AsyncIterator[None]:
        """Send an order within this: a refusal that its readings belie is raised as `RefusedButDone`.

        Parameters
        ----------
        order : str
            In words: "the slew".
        before : Readout
            How it stood.
        took : callable, optional
            What shows besides motion that it did it.
        undo : callable, optional
            Takes back what it did without moving.
        stops : bool
            Whether it is stopped when its place has changed, and not only when it says that it slews: after
            all orders but a sync.

        Raises
        ------
        DeviceRefused
            As the order did: the mount stays where it was.
        RefusedButDone
            It did it, and was stopped, if that could be done.
        DeviceSilent, DeviceGarbled, DeviceMissing
            It said no, and can't be read since.
        """
        log, began = self._tended.language.log, self._tended.language.log.count
        # somebody else's motion, then: it is not ours to stop, and tells nothing of the refusal
        moved_already = bool(before.slewing) or self._tended.in_motion
        try:
            yield
        except DeviceRefused as refusal:
            said = any(one.way == "driver->mount" for one in log.entries(began))
            if moved_already or not said:  # the driver's own no
                raise
            done = await self._belied(refusal, before, took)
            if done is None:
                raise
            raise await self._ended(order, refusal, done, undo, stops=stops) from refusal

    async def _belied(self, refusal: DeviceRefused, before: Readout, took: Took | None) -> str | None:
        """What the mount does although it said no, in words; None if it does nothing."""
        tended, loop = self._tended, asyncio.get_running_loop()
        orders = self._orders()
        until = loop.time() + tended.timing.start_grace_s
        while True:
            # what one that says it rests tells on its way is believed late, and it must be stopped at once
            done = self._did(before, await self._looked(refusal), took)
            if done is not None:
                # one answer may be wrong as well: two in a row that show it are enough to stop it
                done = self._did(before, await self._looked(refusal), took)
            if orders != self._orders():
                return None  # what it does now may be by another order
            if done is not None or loop.time() > until:
                return done
            await pause(min(0.2, tended.timing.poll_s))

    def _orders(self) -> tuple[str | None, int, int, int]:
        tended = self._tended
        return tended.job, tended.stops, tended.pulses, tended.links

    async def _looked(self, refusal: DeviceRefused) -> Readout:
        try:
            return await self._tended.glimpse()
        except DeviceError as trouble:
            raise await self._unread(refusal, trouble) from refusal

    def _did(self, before: Readout, now: Readout, took: Took | None) -> str | None:
        free_arcsec = self._tended.timing.resting_arcsec + 2.0 * self._tended.language.resolution_arcsec
        moved = moved_arcsec(before.reading, now.reading)
        if moved > free_arcsec:
            return f"moved by {moved / 3600.0:.2f}°" if moved >= 36.0 else f"moved by {moved:.0f}″"
        if now.slewing:
            return "moved"
        if took is not None and took(now) and took(before) is False:
            return "did it"
        return None

    async def _unread(self, refusal: DeviceRefused, trouble: DeviceError) -> DeviceError:
        """It said no and can't be read: it may move, and a stop is owed."""
        tended = self._tended
        tended.state, tended.stop_owed = SlewState.LOST, True
        if tended.job is None:
            # an order to move sees to that itself
            with suppress(DeviceError):
                await tended.language.send_stop(0)
        return type(trouble)(
            f"said no ({refusal.what}), and whether it does it all the same can't be seen: {trouble.what}",
            device=tended.name,
            advice="look at the mount before anything moves",
        )

    async def _ended(
        self,
        order: str,
        refusal: DeviceRefused,
        done: str,
        undo: Callable[[], Awaitable[object]] | None,
        *,
        stops: bool,
    ) -> RefusedButDone:
        """Stop what it does, let its position not count, tell; what is to be raised."""
        tended = self._tended
        said = f"{order}: said refused ({refusal.what}), but {done}"
        tended.language.log.note("event", meaning=said)
        # before the stop is through: nothing else may be sent out by this position meanwhile
        tended.distrust(f"it said no to {order}, and {done}")
        advice = "its position doesn't count: solve a frame and sync (recover), and see to its line"
        try:
            if done == "did it":
                if undo is not None:
                    await undo()
                    said = f"{said}; undone"
            elif stops or done == "moved":
                await self._stop()
                tended.state = SlewState.STOPPED
                said = f"{said}; stopped"
        except DeviceError as trouble:
            tended.state, tended.stop_owed = SlewState.LOST, True
            said = f"{said}, and could not be stopped: {trouble.what}"
            advice = "it may be moving: stop it, or cut its power"
        tended.tell("refused-but-done", {"order": order, "why": said})
        return RefusedButDone(said, device=tended.name, advice=advice)


__all__ = ["Refusals"]
