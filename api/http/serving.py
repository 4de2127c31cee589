"""`mountnav serve`: uvicorn with one worker, which stops the mounts before it lets go of the clients."""

from __future__ import annotations

import asyncio
import gc
import logging
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from types import FrameType
from typing import Any

import uvicorn
from fastapi import FastAPI

from api.access.log_rates import limit_log_rates
from api.demo.observatory import demo_journal
from api.http.app import create_app
from api.http.connections import Bounds, Gate
from api.http.routes import truth
from api.http.service_log import begin_log
from api.http.service_manager import ServiceManager
from api.http.strict_requests import KnownQueryOnly
from api.listeners.admission import ask_for_enough, descriptors_at_hand, nova_shares, shares
from api.listeners.tls import HANDSHAKES, Certificate, Handshakes, ShakingHands
from api.observatory.virtual import VirtualHeader, virtual_days
from api.service import Service
from mountnav.clock import utc_now, virtual_time
from mountnav.errors import BadSettings, MountnavError
from mountnav.settings.observatory import Settings
from mountnav.sky.iers import read_tables
from mountnav.tasks import begun, fault_words

_log = logging.getLogger(__name__)

_GOODBYE_S = 5
"""How long uvicorn lets open requests end at the shutdown, s; the mounts are stopped before. Doubled, a
stop of the service takes up to 5 s longer."""
_GIVE_WAY_S = 0.001
"""Longest time that a thread keeps the interpreter from the event loop, s: a fifth of Python's default, so
that a stop passes threads that compute. Halved, threads compute a little slower."""
_WAITING = 1024
"""Connections that the kernel keeps until they are accepted; beyond it clients try again after a second."""


class ObservatoryServer(uvicorn.Server):
    """A uvicorn server whose first act of going down is to stop what moves.

    uvicorn alone waits for open connections first (an event stream never ends by itself) and only then
    tells the application: a slewing mount would slew on.
    """

    def __init__(self, config: uvicorn.Config, app: FastAPI, *, own_process: bool = False) -> None:
        super().__init__(config)
        self._observatory_app = app
        self._own_process = own_process
        self._manager = ServiceManager() if own_process else ServiceManager({})
        self._watchdog: asyncio.Task[None] | None = None
        self.handshakes: Handshakes | None = None
        self.certificate: Certificate | None = None
        self._renewing: asyncio.Task[None] | None = None

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """A closed terminal (SIGHUP) ends the service as SIGTERM does: the mounts are stopped first.

        It reads nothing again: keys are followed as their file changes, telescopes by `POST /v1/reload`.
        Where SIGHUP is ignored (nohup) it stays so.
        """
        with super().capture_signals():
            if threading.current_thread() is not threading.main_thread():
                yield
                return
            before = signal.getsignal(signal.SIGHUP)
            if before != signal.SIG_IGN:
                signal.signal(signal.SIGHUP, self.handle_exit)
            try:
                yield
            finally:
                signal.signal(signal.SIGHUP, before)

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start as uvicorn does; then, in a process of its own, let no answer wait for housekeeping."""
        await super().startup(sockets)
        for listener in sockets or ():
            # uvicorn's backlog is also how many are accepted in one turn: few, so that idle ones can be
            # closed in between; the kernel may keep more waiting
            listener.listen(_WAITING)
        if self.certificate is not None:
            self._renewing = self.certificate.kept_up()
        if not self._own_process or self.should_exit:
            return
        self._watchdog = begun(self._manager.feed_watchdog(), "watchdog", died=self._unfed)
        self._manager.tell("READY=1", f"STATUS={_status(self._observatory_app)}")
        # what is here by now stays: going through all of it took the collector up to 0.2 s each time
        gc.collect()
        gc.freeze()
        # a thread that computes (a simulated sky, a journal's page) gives way to the answers after this time
        sys.setswitchinterval(_GIVE_WAY_S)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Stop the mounts, end the event streams, then go down as uvicorn does."""
        self._manager.tell("STOPPING=1", "STATUS=stopping the mounts")
        service: Service | None = getattr(self._observatory_app.state, "service", None)
        if service is not None:
            await service.halt()
        if self._renewing is not None:
            self._renewing.cancel()
        if self.handshakes is not None:
            self.handshakes.end()
        await super().shutdown(sockets)
        if self._watchdog is not None:
            self._watchdog.cancel()

    def _unfed(self, fault: Exception) -> None:
        """The watchdog is fed no more: the manager ends this service, which is said beforehand."""
        _log.error("the watchdog can't be fed: %s", fault_words(fault))


def _status(app: FastAPI) -> str:
    """A line for `systemctl status`."""
    settings: Settings = app.state.settings
    host, port = app.state.http_address
    names = ", ".join(one.id for one in settings.telescope)
    return f"observatory at {_url(settings, host, port)}: {names}"


def _url(settings: Settings, host: str, port: int) -> str:
    scheme = "http" if settings.service.tls == "off" else "https"
    return f"{scheme}://{f'[{host}]' if ':' in host else host}:{port}"


def make_server(app: FastAPI, *, log_level: str = "info", own_process: bool = False) -> ObservatoryServer:
    """Make the server; the socket is bound by the caller. `own_process`: it has the process for itself.

    Raises
    ------
    BadSettings
        The certificate can't be had.
    """
    settings: Settings = app.state.settings
    descriptors = descriptors_at_hand()
    nova = nova_shares(descriptors).descriptors(settings.nova.queue) if settings.nova.enabled else 0
    shared = shares(descriptors, len(settings.telescope), nova)
    gate = Gate(
        Bounds(
            most=min(settings.service.max_connections, shared.http),
            each_address=min(settings.service.connections_per_address, max(1, shared.http // 2)),
            stops=shared.stops,
            fresh=shared.fresh,
        ),
        turns=app.state.turns.reading,
    )
    service = settings.service
    certificate = Certificate(
        service.tls,
        (service.certificate, service.certificate_key),
        settings.journal.where,
        service.host,
        "service",
    )
    context, handshakes = certificate.context(), Handshakes(HANDSHAKES)
    plain = gate.protocol()

    def shaking_hands(**told: Any) -> asyncio.BaseProtocol:
        assert context is not None
        return ShakingHands(handshakes, asyncio.get_running_loop(), plain(**told), context)

    config = uvicorn.Config(
        # outermost: no answer of a virtual observatory goes out without saying so
        VirtualHeader(app) if virtual_time() is not None else app,
        log_level=log_level,
        timeout_graceful_shutdown=_GOODBYE_S,
        server_header=False,
        # the same whatever else is installed: its deadlines and bounds are ours
        http=plain if context is None else shaking_hands,  # type: ignore[arg-type]
        # `begin_log` has made ready for all of the process
        log_config=None if own_process else uvicorn.config.LOGGING_CONFIG,
        loop="asyncio",
        ws="none",
        backlog=shared.burst,
    )
    # without a handler of their own all of them write by the root's, which in other processes is another's
    limit_log_rates(*("",) if own_process else ("uvicorn", "uvicorn.access"))
    server = ObservatoryServer(config, app, own_process=own_process)
    if context is not None:
        server.certificate, server.handshakes = certificate, handshakes
    return server


def bind(host: str, port: int) -> socket.socket:
    """Take the address before anything else is started, so that a taken port is reported plainly.

    Raises
    ------
    BadSettings
        The address can't be had.
    """
    try:
        listener = socket.create_server(
            (host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET
        )
        # asyncio does this for sockets of its own making; without it each answer waits 40 ms for an ACK
        listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return listener
    except (OSError, UnicodeError) as error:
        why = getattr(error, "strerror", None) or str(error)
        raise BadSettings(
            f"can't listen on {host} port {port}: {why}",
            device="service",
            advice="set service.host and service.port to an address of this machine that is free",
        ) from error


def serve(
    settings: Settings, *, log_level: str | None = None, read_again: Callable[[], Settings] | None = None
) -> int:
    """Serve until interrupted; the exit code. With `[demo]` it is a virtual observatory, and says where.

    Parameters
    ----------
    read_again : callable, optional
        Reads the settings once more, for `POST /v1/reload`. Raises `BadSettings`.

    Raises
    ------
    BadSettings
        The address can't be had, or a virtual observatory would write into a real one's journal.
    """
    ask_for_enough()
    begin_log(settings.service.log_form, log_level or settings.service.log_level)
    with ExitStack() as standing:
        if settings.demo is not None:
            read_tables()
            standing.enter_context(_tidy_when_terminated())
            settings = standing.enter_context(demo_journal(settings))
            assert settings.demo is not None
            standing.enter_context(virtual_days(settings.demo, settings.site.site))
        listener = standing.enter_context(bind(settings.service.host, settings.service.port))
        app = create_app(settings)
        app.state.read_again = read_again
        app.state.http_address = listener.getsockname()[:2]
        if settings.demo is not None:
            app.include_router(truth.router, prefix="/v1", dependencies=[KnownQueryOnly])
        # uvicorn doesn't say which port a socket of ours has got
        print(_told(settings, listener), flush=True)
        server = make_server(app, log_level=log_level or settings.service.log_level, own_process=True)
        if server.certificate is not None and settings.service.tls == "self":
            print(f"its certificate: SHA-256 fingerprint {server.certificate.fingerprint}", flush=True)
        with _failing_plainly(app):
            server.run(sockets=[listener])
    return 0 if server.started else 1


@contextmanager
def _failing_plainly(app: FastAPI) -> Iterator[None]:
    """Raise what kept the application from starting, instead of uvicorn's traceback and its exit code 3.

    With that code a unit starts the service again for ever, whatever is wrong with its settings.
    """
    log = logging.getLogger("uvicorn.error")

    def known(record: logging.LogRecord) -> bool:
        return getattr(app.state, "failure", None) is None or "Traceback" not in record.getMessage()

    log.addFilter(known)
    try:
        yield
    except SystemExit:
        if getattr(app.state, "failure", None) is None:
            raise
    finally:
        log.removeFilter(known)
    failure: MountnavError | None = getattr(app.state, "failure", None)
    if failure is not None:
        raise failure


@contextmanager
def _tidy_when_terminated() -> Iterator[None]:
    """Let SIGTERM unwind this process as SIGINT does: uvicorn gives both back when it has gone down."""

    def end(number: int, _: FrameType | None) -> None:
        sys.exit(128 + number)

    before = {number: signal.signal(number, end) for number in (signal.SIGTERM, signal.SIGHUP)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _told(settings: Settings, listener: socket.socket) -> str:
    host, port = listener.getsockname()[:2]
    url = _url(settings, host, port)
    if settings.demo is None:
        return f"observatory at {url}"
    return (
        f"virtual observatory at {url} from {utc_now():%Y-%m-%d %H:%M:%S} UTC on, "
        f"{settings.demo.speed:g} times as fast\n"
        f"its description: {url}/docs\nwhere its tubes truly look: {url}/v1/virtual"
    )
