"""What runs on a worker of a Dask cluster: a look solved in a warm process there, as the service would.

A worker must be able to give the same answer: the same version of mountnav and the same catalogs, wherever
they lie there. One that can't says so, and the service solves the look itself.
"""

from __future__ import annotations

import asyncio
import atexit
import hashlib
import json
import threading
from collections import OrderedDict
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from api.solver.frame_bytes import unpack_pixels
from api.solver.limits import Limits
from api.solver.link import Work
from api.solver.messages import Done, Fault, SharedPixels, SolvingThere, Task, unpacked, written
from api.solver.worker import Worker
from mountnav.archive.recipe import of_catalogs
from mountnav.catalog.catalog_set import CatalogSet, open_catalogs
from mountnav.catalog.packed import PackedStore
from mountnav.errors import BadRequest, DeviceError, MountnavError

if TYPE_CHECKING:
    from mountnav.catalog.stars import Catalog
    from mountnav.measuring.calibration import Calibration

_GOODBYE_S = 3.0
"""How long a worker that ends waits for its solving processes; those end by themselves, too."""

_SERVICES = 4
"""Services, each with its settings, whose processes are kept warm: 130 MB each and thread."""

_MASTERS = 8
"""Sets of masters that are kept; a set of 9 Mpx takes 100 MB."""


class NotHere(Exception):
    """The worker can't give the answer that the service would give itself."""


def catalogs_told(catalog: Catalog) -> str:
    """What decides of catalogs and version, to compare.

    Raises
    ------
    BadRequest
        A catalog is online, or of a kind that can't be compared.
    """
    if isinstance(catalog, PackedStore):
        catalog = CatalogSet(catalog)
    if not isinstance(catalog, CatalogSet):
        raise BadRequest(f"the catalog {catalog.name} can't be compared with those of others")
    return json.dumps(of_catalogs(catalog), sort_keys=True)


@dataclass(slots=True)
class _Service:
    """Of one service: what its processes are started with, and those that are free."""

    catalog: CatalogSet | PackedStore
    limits: Limits
    index: Path | None
    free: list[Worker] = field(default_factory=list)


class _There:
    """What a Dask worker keeps between two looks: an event loop, and warm processes."""

    def __init__(self) -> None:
        self._loop = asyncio.new_event_loop()
        threading.Thread(target=self._loop.run_forever, name="mountnav-looks", daemon=True).start()
        self._lock = threading.Lock()
        self._services: OrderedDict[str, _Service] = OrderedDict()
        self._masters: OrderedDict[str, Calibration] = OrderedDict()
        atexit.register(self._close)

    def solved(self, given: SolvingThere, task: Task, pixels: bytes, masters: bytes, most_s: float) -> Done:
        """Solve one look. Raises `NotHere`."""
        with self._lock:
            service = self._service(given)
            calibration = self._kept(masters)
        if task.index is not None and service.index is None:
            raise NotHere("this worker has no index of the whole sky: `mountnav catalog index` builds it")
        source = task.source
        assert isinstance(source, SharedPixels)
        frame = replace(source.frame, pixels=unpack_pixels(pixels, np.dtype(source.dtype), source.shape))
        settings = replace(task.settings, calibration=calibration)
        work = Work(frame, task.hint, settings, None if task.index is None else service.index)
        return asyncio.run_coroutine_threadsafe(self._carried_out(service, work, most_s), self._loop).result()

    def make_ready(self, given: SolvingThere) -> None:
        """Start a process, and wait until it is warm. Raises `NotHere`."""
        with self._lock:
            service = self._service(given)

        async def started() -> str:
            worker = _taken(service)
            worker.open(service.index)
            await worker.at_rest()
            service.free.append(worker)
            return worker.state

        state = asyncio.run_coroutine_threadsafe(started(), self._loop).result()
        if state.startswith("failed"):
            raise NotHere(state)

    async def _carried_out(self, service: _Service, work: Work, most_s: float) -> Done:
        worker = _taken(service)
        worker.open(service.index)
        try:
            async with asyncio.timeout(most_s):
                return Done(verdict=await worker.solve(work, first=True))
        except DeviceError as error:
            raise NotHere(str(error)) from error
        except TimeoutError as error:
            raise NotHere(f"it is not solved within {most_s:.0f} s") from error
        except Exception as error:  # it belongs to the one who asked
            return Done(fault=Fault.of(error))
        finally:
            service.free.append(worker)

    def _service(self, given: SolvingThere) -> _Service:
        key = hashlib.sha256(repr((given.catalogs, given.limits)).encode() + given.catalog).hexdigest()
        if key not in self._services:
            catalog = _same_here(given)
            from mountnav.identification.blind.cache import installed_index

            index = installed_index(catalog.indexed if isinstance(catalog, CatalogSet) else catalog)
            self._services[key] = _Service(catalog, given.limits, None if index is None else index.path)
            while len(self._services) > _SERVICES:
                _, old = self._services.popitem(last=False)
                for worker in old.free:
                    asyncio.run_coroutine_threadsafe(worker.close(), self._loop)
        self._services.move_to_end(key)
        return self._services[key]

    def _kept(self, masters: bytes) -> Calibration | None:
        if not masters:
            return None
        key = hashlib.sha256(masters).hexdigest()
        if key not in self._masters:
            self._masters[key] = unpacked(masters)  # type: ignore[assignment]
            while len(self._masters) > _MASTERS:
                self._masters.popitem(last=False)
        self._masters.move_to_end(key)
        return self._masters[key]

    def _close(self) -> None:
        """End the processes as this one ends."""

        async def closed() -> None:
            for service in self._services.values():
                while service.free:
                    await service.free.pop().close()

        with suppress(TimeoutError):
            asyncio.run_coroutine_threadsafe(closed(), self._loop).result(_GOODBYE_S)


def _taken(service: _Service) -> Worker:
    """A warm process where one is free, else a new one."""
    if service.free:
        return service.free.pop()
    return Worker(service.catalog, _untold, limits=service.limits, tries=1)


def _untold(kind: str, data: dict[str, object]) -> None:
    """Who asks is told by the answer; the log of this worker has the rest."""


def _same_here(given: SolvingThere) -> CatalogSet | PackedStore:
    """The catalogs of this machine that hold the same stars. Raises `NotHere`."""
    with suppress(Exception):  # another version, or another place for the files: those of here may do
        same = unpacked(given.catalog)
        if isinstance(same, CatalogSet | PackedStore) and catalogs_told(same) == given.catalogs:
            return same
    try:
        own = open_catalogs()
        found = catalogs_told(own)
    except MountnavError as error:
        raise NotHere(f"the catalogs of this worker can't be used: {error}") from error
    if found != given.catalogs:
        raise NotHere(f"this worker has another mountnav or other catalogs: {found[:300]}")
    return own


_THERE: list[_There] = []
_MAKING = threading.Lock()


def _there() -> _There:
    with _MAKING:
        if not _THERE:
            _THERE.append(_There())
    return _THERE[0]


def make_ready(given: SolvingThere) -> None:
    """Have a warm process on this worker, so that no look waits for one. Raises `NotHere`."""
    _there().make_ready(given)


def solved_look(given: SolvingThere, task: bytes, pixels: bytes, masters: bytes, most_s: float) -> bytes:
    """Solve a look on the worker that this runs on; the answer as `api.solver.messages` writes it."""
    asked = unpacked(task)
    assert isinstance(asked, Task)
    return written(_there().solved(given, asked, pixels, masters, most_s))
