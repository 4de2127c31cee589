"""The index of the blind search as the service knows it: there, being built, or missing, and why."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable
from pathlib import Path

from api.solver.link import ProcessEnded, ProcessLink
from api.solver.messages import Built, Done, Fault, Progress, Setup
from mountnav.catalog.catalog_set import CatalogSet
from mountnav.catalog.packed import PackedStore
from mountnav.catalog.stars import Catalog
from mountnav.errors import MountnavError
from mountnav.tasks import waited_for

_log = logging.getLogger(__name__)
BUILDER = "api.solver.index_process"
_TOLD_EACH = 0.1
"""Share of the index after which an event reports progress: ten events for a build. Halved, twenty."""
_PAUSE_S = 300.0
"""After a failure, before it is tried again."""

Tell = Callable[[str, dict[str, object]], None]


class BlindIndexKeeper:
    """Knows where the index lies, and has it built, once, when it is first needed.

    It is built by a process of its own, so that hinted frames are solved meanwhile.

    Parameters
    ----------
    catalog : Catalog
        Only a packed one has an index; of a shelf the embedded one.
    tell : callable
        ``tell(kind, data)``: told of each tenth of the building.
    """

    def __init__(self, catalog: Catalog, tell: Tell) -> None:
        self._catalog = catalog.indexed if isinstance(catalog, CatalogSet) else catalog
        self._tell = tell
        self._path: Path | None = None
        self._share: float | None = None
        self._trouble = (
            "not built yet; the first frame that needs it sees to that, or `mountnav catalog index`"
        )
        self._failed = False
        self._not_before_s = 0.0
        self._building: asyncio.Task[None] | None = None

    @property
    def path(self) -> Path | None:
        """Where it lies; None as long as there is none."""
        return self._path

    @property
    def may_come(self) -> bool:
        """Whether there is none yet, and one is being built or can be."""
        return self._path is None and isinstance(self._catalog, PackedStore)

    @property
    def failed(self) -> bool:
        """Whether the last try to find or build it failed: frames without a hint may stay unsolved."""
        return self._failed and self._path is None and self._share is None

    @property
    def state(self) -> str:
        """For people and programs: "ready", "building 40 %", or "none: " and why."""
        if self._path is not None:
            return "ready"
        return f"none: {self._trouble}" if self._share is None else f"building {100.0 * self._share:.0f} %"

    async def find(self) -> None:
        """Look whether it was built before. Builds nothing."""
        if not isinstance(self._catalog, PackedStore):
            self._trouble = f"the catalog {self._catalog.name} can't have one"
            return
        try:
            self._path = await asyncio.to_thread(_existing, self._catalog)
        except MountnavError as error:
            self._failed, self._trouble = True, str(error)
        except Exception as error:  # hinted frames are solved all the same
            _log.exception("looking for the blind index failed unexpectedly")
            self._failed = True
            self._trouble = f"it could not be looked for: {type(error).__name__}; the log has more"

    async def wait(self, wait_s: float) -> Path | None:
        """Wait until it is there, having it built if need be.

        Parameters
        ----------
        wait_s : float
            No longer than this; the building goes on after it.

        Returns
        -------
        Path or None
            None: `state` tells why not.
        """
        if self._path is None and isinstance(self._catalog, PackedStore):
            if self._building is None or self._building.done():
                if time.monotonic() < self._not_before_s:
                    return None
                self._building = waited_for(self._build(self._catalog), "blind index")
            await asyncio.wait({self._building}, timeout=max(0.0, wait_s))
        return self._path

    async def close(self) -> None:
        """End the building, if it is going on; the next one begins again."""
        if self._building is not None:
            self._building.cancel()
            await asyncio.gather(self._building, return_exceptions=True)

    async def _build(self, catalog: PackedStore) -> None:
        self._share, self._failed = 0.0, False
        try:
            await self.find()  # another program may have built it since
            if self._path is None:
                self._path = await self._built(catalog)
        except ProcessEnded as ended:
            # killed by hand, or by the kernel for want of memory
            self._failed = True
            self._trouble = (
                f"it could not be built: {ended}; it takes 0.4 GB of memory. "
                f"A frame that needs it tries again after {_PAUSE_S / 60.0:g} min; "
                "by hand: mountnav catalog index"
            )
        except MountnavError as error:
            self._failed, self._trouble = True, f"it could not be built: {error}"
        except Exception as error:
            _log.exception("building the blind index failed unexpectedly")
            self._failed = True
            self._trouble = f"it could not be built: {type(error).__name__}; the log has more"
        finally:
            self._share = None
            self._not_before_s = time.monotonic() + _PAUSE_S
        self._told()

    async def _built(self, catalog: PackedStore) -> Path:
        process = ProcessLink.start(BUILDER)
        try:
            await process.send(Setup(catalog, None))
            self._told()
            told = 0.0
            while True:
                match await process.receive():
                    case Progress(share=share):
                        self._share = share
                        if share >= told + _TOLD_EACH:
                            told = share
                            self._told()
                    case Built(path=path):
                        return path
                    case Done(fault=Fault() as fault):
                        raise fault.error()
        finally:
            await asyncio.shield(process.close())

    def _told(self) -> None:
        _log.log(
            logging.WARNING if self.state.startswith("none") else logging.INFO, "blind index: %s", self.state
        )
        self._tell("blind-index", {"state": self.state})


def _existing(catalog: PackedStore) -> Path | None:
    # imported late: the service itself never searches, and saves the memory
    from mountnav.identification.blind.cache import installed_index

    found = installed_index(catalog)
    return None if found is None else found.path
