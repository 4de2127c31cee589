"""The process that speaks with a Dask cluster for the service.

It is started by `api.solver.cluster`, never by hand. Dask's client, its memory, its waiting and its pickles
stay here: a stop in the service never waits for any of it, and whatever answers here, the service reads data.
Frames reach it as they reach a solving process; several are under way at once, so that each has a number.

A frame crosses the network once: it is sent to one worker, and its task is bound to that one. If the worker
dies the frame is not sent again: the service solves it.
"""

from __future__ import annotations

import itertools
import logging
import mmap
import os
import socket
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from api.solver.attached import attached
from api.solver.frame_bytes import pack_pixels
from api.solver.messages import (
    Answer,
    BadAnswer,
    ClusterSeen,
    ClusterSetup,
    ClusterTask,
    Done,
    Forget,
    Relayed,
    SharedPixels,
    packed,
    read,
    receive,
    send,
)
from api.solver.on_worker import NotHere, make_ready, solved_look

if TYPE_CHECKING:
    from distributed import Client, Future

PRIORITY = 1000
"""Of a look, as Dask counts: before an archive's chunks, whose priority is 0 where nothing else is asked."""

CONNECT_S = 5.0
"""Until a scheduler has to answer. Doubled, a wrong address is told twice as late."""

RETRY_S = 2.0
"""Between two tries to reach a scheduler. Doubled, looks come back to a cluster twice as late."""

_COMM_S = 3.0
"""Until a worker has to take a connection: one that died a moment ago takes none. Dask's own 30 s would cost
a look its deadline."""

_SEEN_EACH_S = 1.0
"""Between two looks at who is there. Doubled, a change of workers is told twice as late."""

_AT_ONCE = 64
"""Frames under way: each holds a thread that waits. Doubled, twice as many."""


class Away(Exception):
    """The cluster can't take a frame now."""


class Relay:
    """Sends frames to the cluster, and answers back.

    Parameters
    ----------
    link : socket.socket
        To the service.
    """

    def __init__(self, link: socket.socket, setup: ClusterSetup) -> None:
        self._link, self._setup = link, setup
        self._sending = threading.Lock()
        self._threads = ThreadPoolExecutor(_AT_ONCE, "look")
        self._client: Client | None = None
        self._away = "not connected yet"
        self._futures: dict[int, Future[bytes]] = {}
        self._forgotten: set[int] = set()
        self._choosing = threading.Lock()
        self._readied = itertools.count()
        self._given: Counter[str] = Counter()
        self._masters: dict[int, bytes] = {}
        self._masters_there: dict[tuple[str, int], Any] = {}
        self._seen: ClusterSeen | None = None
        self._ready: dict[str, Future[None]] = {}

    def run(self) -> None:
        """Take what the service asks until it is gone."""
        threading.Thread(target=self._keep_connected, name="cluster", daemon=True).start()
        while True:
            asked, files = receive(self._link)
            if isinstance(asked, Forget):
                self._forget(asked.number)
                continue
            assert isinstance(asked, ClusterTask)
            if asked.task.calibration is not None and asked.task.calibration_number is not None:
                self._masters[asked.task.calibration_number] = packed(asked.task.calibration)
                asked = replace(asked, task=replace(asked.task, calibration=None))
            self._threads.submit(self._carry_out, asked, files[0])

    def _tell(self, answer: Answer) -> None:
        with self._sending, suppress(OSError):  # a service that is gone ends this process
            send(self._link, answer)

    def _carry_out(self, asked: ClusterTask, file: int) -> None:
        number = asked.number
        try:
            if number in self._forgotten:
                return
            answer = Relayed(number, self._answered(asked, file))
        except BaseException as error:  # whatever it is, the service solves the frame itself
            answer = Relayed(number, None, _why(error))
        finally:
            os.close(file)
            self._futures.pop(number, None)
            self._forgotten.discard(number)
        self._tell(answer)

    def _answered(self, asked: ClusterTask, file: int) -> Done:
        client = self._client
        if client is None:
            raise Away(self._away)
        source = asked.task.source
        assert isinstance(source, SharedPixels)
        with mmap.mmap(file, os.fstat(file).st_size, prot=mmap.PROT_READ) as mapped:
            pixels = np.frombuffer(mapped, source.dtype).reshape(source.shape)
            content = pack_pixels(pixels)
            del pixels
        with self._worker(client) as address:
            there = client.scatter(content, workers=[address], direct=True, hash=False, timeout=asked.most_s)
            # the pickle of the task is made here: what Dask's own would do with it is no concern of ours
            resource = self._setup.resource
            future = client.submit(
                solved_look,
                self._setup.given,
                packed(asked.task),
                there,
                self._masters_for(client, address, asked.task.calibration_number),
                asked.most_s,
                key=f"mountnav-look-{os.getpid()}-{asked.number}",
                pure=False,
                retries=0,
                priority=PRIORITY,
                workers=[address],
                allow_other_workers=False,
                resources=None if resource is None else {resource: 1},
            )
            self._futures[asked.number] = future
            if asked.number in self._forgotten:
                raise Away("nobody waits for it any more")
            try:
                answer = read(future.result(timeout=asked.most_s))
            finally:
                for one in (future, there):
                    one.cancel()
        if not isinstance(answer, Done):
            raise BadAnswer("it is no answer to a frame")
        return answer

    def _masters_for(self, client: Client, address: str, number: int | None) -> Any:
        """The masters of that number on that worker, sent there once; nothing for none."""
        if number is None:
            return b""
        key = (address, number)
        if key not in self._masters_there:
            self._masters_there[key] = client.scatter(
                self._masters[number], workers=[address], direct=True, hash=False
            )
        return self._masters_there[key]

    @contextmanager
    def _worker(self, client: Client) -> Iterator[str]:
        """The worker with the least to do for each of its threads."""
        with self._choosing:
            there = _workers(client, self._setup.resource)
            usable = {one: threads for one, threads in there.items() if self._is_ready(one)}
            if not usable:
                raise Away("no worker can be asked")
            busy = client.processing()

            def load(address: str) -> float:
                return (max(len(busy.get(address, ())), self._given[address])) / max(1, usable[address])

            address = min(usable, key=load)
            self._given[address] += 1
        try:
            yield address
        finally:
            with self._choosing:
                self._given[address] -= 1

    def _forget(self, number: int) -> None:
        future = self._futures.get(number)
        if future is None:
            self._forgotten.add(number)
        else:
            self._threads.submit(future.cancel)

    def _keep_connected(self) -> None:
        import dask
        from distributed import Client

        dask.config.set({"distributed.comm.timeouts.connect": _COMM_S})
        while True:
            try:
                client = Client(
                    self._setup.scheduler,
                    timeout=CONNECT_S,
                    set_as_default=False,
                    direct_to_workers=True,
                    name="mountnav",
                )
            except Exception as error:
                self._seem(0, f"the scheduler doesn't answer: {error or type(error).__name__}")
                time.sleep(RETRY_S)
                continue
            self._masters_there.clear()
            self._ready.clear()
            self._client = client
            with suppress(Exception):  # whatever it is, the connection is made anew
                while client.status == "running":
                    self._look(client)
                    time.sleep(_SEEN_EACH_S)
            self._client = None
            self._seem(0, "the scheduler is gone")
            # it may wait for a scheduler that never comes
            threading.Thread(target=_closed, args=(client,), daemon=True).start()

    def _look(self, client: Client) -> None:
        """See which workers are there, and have those that are new made ready."""
        there = _workers(client, self._setup.resource)
        if client.status != "running":
            return
        for gone in self._ready.keys() - there.keys():
            del self._ready[gone]
        for address in there.keys() - self._ready.keys():
            self._ready[address] = client.submit(
                make_ready,
                self._setup.given,
                key=f"mountnav-ready-{os.getpid()}-{next(self._readied)}",
                pure=False,
                retries=0,
                priority=PRIORITY,
                workers=[address],
                allow_other_workers=False,
            )
        count = sum(map(self._is_ready, there))
        trouble = ""
        if not count:
            trouble = "the cluster has no worker that may be asked"
            for address in there:
                future = self._ready[address]
                trouble = f"{address} is starting, or busy with something else"
                if future.status == "error":
                    trouble = f"{address}: {future.exception(timeout=CONNECT_S)}"
                    break
        self._seem(count, trouble)

    def _is_ready(self, address: str) -> bool:
        future = self._ready.get(address)
        return future is not None and future.status == "finished"

    def _seem(self, workers: int, trouble: str) -> None:
        """Tell how the cluster is, where that has changed."""
        self._away = trouble
        seen = ClusterSeen(workers, trouble[:300])
        if seen != self._seen:
            self._seen = seen
            self._tell(seen)


def _why(error: BaseException) -> str:
    """Why there is no answer, for people."""
    if isinstance(error, CancelledError):
        return "the worker or the scheduler that had it is gone"
    if isinstance(error, Away | NotHere):
        return str(error)[:500]
    return f"{type(error).__name__}: {error}"[:500]


def _workers(client: Client, resource: str | None) -> dict[str, int]:
    """Threads of the workers that are there, by address; none while the scheduler is away."""
    workers = client.scheduler_info(n_workers=-1).get("workers", {})
    return {
        address: int(told["nthreads"])
        for address, told in workers.items()
        if told.get("status", "running") == "running"
        and (resource is None or told.get("resources", {}).get(resource, 0) >= 1)
    }


def _closed(client: Client) -> None:
    with suppress(Exception):
        client.close(timeout=CONNECT_S)


def main() -> None:
    """Connect, then send frames until the service is gone."""
    link = attached()
    # what Dask logs of a scheduler that is gone is told by the service, once
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    try:
        setup, _ = receive(link)
        assert isinstance(setup, ClusterSetup)
        Relay(link, setup).run()
    except (EOFError, OSError):
        return
    finally:
        # threads that wait for a cluster keep no process alive
        sys.stderr.flush()
        os._exit(0)


if __name__ == "__main__":
    main()
