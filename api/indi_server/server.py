"""The INDI server: every telescope of the service as a device, for all clients that connect."""

from __future__ import annotations

import asyncio
from collections.abc import Collection

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
from mountnav.settings.telescope import TelescopeSettings
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
        self._devices = {name: self._made(one, name) for name, one in self._shown().items()}
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

    def _shown(self) -> dict[str, TelescopeSettings]:
        """The telescopes that are devices, by what they are called."""
        telescopes = self._service.settings.telescope
        names, shown = device_names(telescopes), self._settings.telescopes
        return {names[one.id]: one for one in telescopes if not shown or one.id in shown}

    def _made(self, telescope: TelescopeSettings, name: str) -> IndiTelescope:
        return IndiTelescope(
            self._service, telescope, name, changed=self._changed, say=self._tell, died=self._died
        )

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

    async def renew(self, touched: Collection[str]) -> None:
        """Show the telescopes that the service has now; clients stay, and are told what went and came.

        Parameters
        ----------
        touched : collection of str
            Ids of those that have come, changed or gone. What shows none of them is left as it is.
        """
        shown = self._shown()
        gone = [
            device
            for name, device in self._devices.items()
            if device.id in touched or name not in shown or shown[name].id != device.id
        ]
        for device in gone:
            del self._devices[device.name]
            self._left.drop(device.name)
            for connection in self._connections:
                connection.lose(device)
        await asyncio.gather(*(device.close() for device in gone))
        fresh = [self._made(one, name) for name, one in shown.items() if name not in self._devices]
        await asyncio.gather(*(device.start() for device in fresh))
        self._devices |= {device.name: device for device in fresh}
        # in the order of the settings, as clients that come now would have them
        for name in shown:
            self._devices[name] = self._devices.pop(name)
        for device in fresh:
            for connection in self._connections:
                connection.find(device)

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
        async for event in self._service.events.follow():
            about, words = str(event.data.get("telescope")), words_of_event(event)
            device = next((one for one in self._devices.values() if one.id == about), None)
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
