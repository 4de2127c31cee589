"""Whether a telescope's mount answers, and how it is opened: one lost answer is no lost mount [Alpaca §4]."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable

from api.alpaca.refusals import AlpacaError, error_of
from api.http.faults import problem_of
from api.observatory import Telescope
from api.orders.watching import Watch
from mountnav.errors import MountnavError
from mountnav.tasks import begun

_log = logging.getLogger(__name__)

GRACE_S = 10.0
"""So long after the last good reading a telescope counts as connected."""
_TRY_AGAIN_S = 10.0


class MountLink:
    """The mount of one telescope, as somebody at the other end of a cable knows it.

    Parameters
    ----------
    telescope : Telescope
    watch : Watch
        Who reads it.
    now_s : callable
        Seconds of the machine that never run back.
    """

    def __init__(self, telescope: Telescope, watch: Watch, now_s: Callable[[], float]) -> None:
        self._telescope = telescope
        self._watch = watch
        self._now_s = now_s
        self._good_s: float | None = None
        self._good_revision = -1
        self._tried_s: float | None = None
        self._reopening: asyncio.Task[None] | None = None

    def is_up(self) -> bool:
        """Whether the mount answers, or did until just now."""
        snapshot = self._watch.latest
        if snapshot.state.connected and snapshot.state.reading is not None:
            if snapshot.revision != self._good_revision:
                self._good_s, self._good_revision = self._now_s(), snapshot.revision
            return True
        return self._good_s is not None and self._now_s() - self._good_s < GRACE_S

    async def open(self) -> None:
        """Open the mount if it is not open.

        Raises
        ------
        AlpacaError
            It can't be opened, or doesn't answer.
        """
        telescope = self._telescope
        try:
            await telescope.ready()
        except MountnavError as error:
            _log.warning("%s could not be opened for an Alpaca client: %s", telescope.id, error)
            raise error_of(problem_of(error)) from None
        if not self.is_up() and (await self._watch.refresh()).state.reading is None:
            state = self._watch.latest.state
            raise AlpacaError(0x502, f"{telescope.id}: {state.problem or 'the mount does not answer'}")

    def reopen_soon(self) -> None:
        """Look for a mount that was lost, in the background, and not too often."""
        now_s = self._now_s()
        if self._reopening is not None and not self._reopening.done():
            return
        if self._tried_s is not None and now_s - self._tried_s < _TRY_AGAIN_S:
            return
        self._tried_s = now_s
        name = f"alpaca reopens {self._telescope.id}"
        # the mount stays away, as clients see; the next look tries again
        self._reopening = begun(self._reopen(), name, died=lambda _: self._watch.wake())

    async def _reopen(self) -> None:
        try:
            await self._telescope.ready()
        except MountnavError as error:
            _log.info("%s is still not connected: %s", self._telescope.id, error)
        self._watch.wake()

    def close(self) -> None:
        """Look for it no more."""
        if self._reopening is not None:
            self._reopening.cancel()


__all__ = ["GRACE_S", "MountLink"]
