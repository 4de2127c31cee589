"""The INDI server: every telescope of the service as a device, for all clients that connect."""

from __future__ import annotations

import asyncio

from api.events import Event
from api.indi_server.connection import Connection
from api.indi_server.device import IndiTelescope, device_names
from api.indi_server.orders import Answer
from api.indi_server.publisher import LeftSelections
from api.indi_server.vectors import saying
from api.listeners.doors import Door
from api.listeners.tcp import TcpPort, Turns
from api.service import Service
from mountnav.clock import utc_now
from mountnav.settings.faces import IndiServerSettings
from mountnav.tasks import begun

_WORDS = {
    "mount-link-lost": "[ERROR] the link to the mount was lost: {why}",
    "mount-link-back": "[INFO] the link to the mount is back",
    "mount-untrusted": "[WARNING] the mount's position can't be trusted: {why}",
    "mount-sync-elsewhere": "[ERROR] the mount synced to another place, {miss_arcsec}″ off",
    "mount-refused-but-done": "[ERROR] {why}",
    "mount-contradiction": "[WARNING] mount and settings contradict each other: {why}",
    "mount-trusted": "[INFO] the mount's position is trusted again",
    "stop-failed": "[ERROR] the mount could not be stopped: {problem}",
    "mount-limit-stop": "[WARNING] stopped at a limit: {words}",
    "mount-limit-stop-failed": "[ERROR] at a limit, and it could not be stopped: {words}",
    "synced": "[INFO] sync: {outcome}",
}
"""What the service tells of a mount, as clients read it."""


class IndiServer:
    """Serves all telescopes by INDI.

    Parameters
    ----------
    settings : IndiServerSettings, optional
        Instead of the service's own.
    """

    def __init__(self, service: Service, settings: IndiServerSettings | None = None) -> None:
        self._service = service
        self._settings = settings or service.settings.indi_server
        self._connections: set[Connection] = set()
        self._left = LeftSelections()
        self._turns = Turns()
        telescopes = service.settings.telescope
        names = device_names(telescopes)
        shown = self._settings.telescopes
        telescopes = tuple(one for one in telescopes if not shown or one.id in shown)
        self._devices = {
            names[telescope.id]: IndiTelescope(
                service,
                telescope,
                names[telescope.id],
                changed=self._changed,
                say=self._tell,
                died=self._died,
            )
            for telescope in telescopes
        }
        self._listening = TcpPort(
            self._settings.host,
            self._settings.port,
            self._serve,
            name="INDI",
            full=_full,
            lets_in=Door(self._settings.admits, service.audit, "indi_server").lets_in,
            refused=saying("", "[ERROR] goodbye: this address is not let in", utc_now()),
        )
        self._events: asyncio.Task[None] | None = None

    @property
    def address(self) -> tuple[str, int]:
        """Host and port it listens at; known once it was started."""
        return self._listening.address

    async def start(self) -> None:
        """Listen.

        Raises
        ------
        BadSettings
            The address can't be had.
        """
        await asyncio.gather(*(device.start() for device in self._devices.values()))
        try:
            await self._listening.start()
        except BaseException:
            await self.stop()
            raise
        self._follow()

    async def stop(self) -> None:
        """Let all clients go, and listen no more. Jobs go on."""
        await self._listening.stop()
        if self._events is not None:
            self._events.cancel()
            await asyncio.gather(self._events, return_exceptions=True)
        for device in self._devices.values():
            await device.close()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        connection = Connection(
            self._devices, self._left, self._turns, reader, writer, silence_s=self._settings.silence_s
        )
        self._connections.add(connection)
        try:
            await connection.run()
        finally:
            self._connections.discard(connection)

    def _follow(self) -> None:
        self._events = begun(self._follow_events(), "INDI messages", died=self._died)

    def _died(self, fault: Exception) -> None:
        """What all clients are told from is gone: they are let go, and find it whole when they come again."""
        for connection in self._connections:
            connection.fail(fault)
        if self._events is not None and self._events.done():
            self._follow()

    def _changed(self) -> None:
        for connection in self._connections:
            connection.changed()

    def _tell(self, device: IndiTelescope, answer: Answer) -> None:
        for connection in self._connections:
            connection.tell(device, answer)

    async def _follow_events(self) -> None:
        by_id = {device.id: device for device in self._devices.values()}
        async for event in self._service.events.follow():
            device, words = by_id.get(str(event.data.get("telescope"))), words_of_event(event)
            if device is not None and words is not None:
                for connection in self._connections:
                    connection.say(device, words)


def _full(clients: int) -> bytes:
    return saying("", f"[ERROR] goodbye: {clients} clients are here already", utc_now())


def words_of_event(event: Event) -> str | None:
    """What clients are told of an event; None: it doesn't concern them."""
    if event.kind == "job":
        return _words_of_job(event.data)
    form = _WORDS.get(event.kind)
    if form is None:
        return None
    try:
        return form.format(**event.data)
    except KeyError:
        return form.partition(": {")[0]


def _words_of_job(data: dict[str, object]) -> str | None:
    kind, state = data.get("kind"), data.get("state")
    if state == "running":
        return f"[INFO] {kind}"
    if state == "succeeded":
        return f"[INFO] {kind} done"
    found = data.get("problem")
    if state == "failed" and isinstance(found, dict):
        return f"[ERROR] {kind}: {found.get('detail')}"
    return f"[WARNING] {kind} cancelled" if state == "cancelled" else None


__all__ = ["IndiServer", "words_of_event"]
