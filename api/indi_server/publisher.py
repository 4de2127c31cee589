"""What each INDI client has chosen and been sent, and what it is to be sent next.

In a common INDI server the selection of ON_COORD_SET is the device's, so that one client's SYNC can turn
another's goto into a sync. Here it is each connection's. But `indi_setprop` in a script chooses in one
connection and sends the position in the next one: a SYNC that was chosen, not used, and left behind is
taken over by the next client of the same machine that chooses nothing itself. It is shown to that client as
its selection.

Sent is the difference between what a client knows and what is so: one that reads slowly misses what was in
between, and costs no memory. Answers and messages are kept for it in their order, up to a bound. No I/O:
`news` says when there is something to send.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping

from api.indi_server.device import IndiTelescope
from api.indi_server.orders import Answer
from api.indi_server.parser import Asked
from api.indi_server.properties import MAIN
from api.indi_server.vectors import Vector, definition, deletion, saying, setting, switches
from drivers.indi.codec.messages import State
from mountnav.clock import utc_now

__all__ = ["SYNC", "USUAL", "LeftSelections", "Publisher", "Selections"]


_LEFT_LIVES_S = 300.0
"""How long a choice of ON_COORD_SET outlives the client that made it, s: `indi_setprop` connects, sets and
leaves. Doubled, a later client is more likely to sync where it means to slew."""
USUAL, SYNC = "TRACK", "SYNC"


class LeftSelections:
    """Where a SYNC was left behind.

    Parameters
    ----------
    now_s : callable () -> float
        A clock that only goes on.
    """

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s = now_s
        self._left: dict[tuple[str, str], float] = {}

    def leave(self, host: str, device: str) -> None:
        """A client of a machine goes, and has chosen SYNC."""
        self._left = {key: at_s for key, at_s in self._left.items() if self._counts(at_s)}
        self._left[host, device] = self._now_s()

    def is_left(self, host: str, device: str) -> bool:
        """Whether a client of that machine takes over a SYNC."""
        at_s = self._left.get((host, device))
        return at_s is not None and self._counts(at_s)

    def forget(self, host: str, device: str) -> None:
        """Somebody there has chosen since."""
        self._left.pop((host, device), None)

    def drop(self, device: str) -> None:
        """The device has gone; one that gets its name is another one."""
        self._left = {key: at_s for key, at_s in self._left.items() if key[1] != device}

    def _counts(self, at_s: float) -> bool:
        return self._now_s() - at_s < _LEFT_LIVES_S


class Selections:
    """One client's, by device.

    Parameters
    ----------
    left : LeftSelections
        Of all clients.
    host : str
        Its machine.
    """

    def __init__(self, left: LeftSelections, host: str) -> None:
        self._left, self._host = left, host
        self._own: dict[str, str] = {}

    def of(self, device: str) -> str:
        """What its coordinates mean to a device: TRACK, SLEW or SYNC."""
        if device in self._own:
            return self._own[device]
        return SYNC if self._left.is_left(self._host, device) else USUAL

    def choose(self, device: str, mode: str) -> None:
        """It has chosen; or its sync is done."""
        self._own[device] = mode
        self._left.forget(self._host, device)

    def drop(self, device: str) -> None:
        """The device has gone; one that gets its name is another one."""
        self._own.pop(device, None)

    def leave(self) -> None:
        """It goes."""
        for device, mode in self._own.items():
            if mode == SYNC:
                self._left.leave(self._host, device)
        self._own.clear()


_MOST_UNSENT_BYTES = 1 << 20
"""What may wait to be sent to a client before its connection is given up, bytes. Doubled, a hundred clients
that take nothing hold 200 MB."""
_ENOUGH_BYTES = 65_536
"""With so much unsent, the client's further questions wait until it has taken it, bytes; chosen by hand.
Doubled, one that asks faster than it reads holds twice the memory."""
_MOST_ASKED = 1000
"""Different questions that are remembered: no client has so many, and none may fill the memory."""
_MODES = {"TRACK": "Track", "SLEW": "Slew", "SYNC": "Sync"}
_FOR_EVER = 1 << 62
"""A revision that no reading reaches: the property is held back until it is released."""


class Publisher:
    """What one client knows.

    Parameters
    ----------
    selections : Selections
        What it has chosen of ON_COORD_SET.

    Attributes
    ----------
    news : asyncio.Event
        There may be something to send.
    overflowed : asyncio.Event
        More is kept for it than it may have.
    room : asyncio.Event
        Little is kept for it: what it asks may be answered.
    off : dict
        Whether it has disconnected a device.
    """

    def __init__(self, devices: Mapping[str, IndiTelescope], selections: Selections) -> None:
        self.news, self.overflowed, self.room = asyncio.Event(), asyncio.Event(), asyncio.Event()
        self.room.set()
        self._deaf = False
        self._selections = selections
        self.off: dict[str, bool] = {}
        self._devices = devices
        self._unsent: list[bytes] = []
        self._unsent_bytes = 0
        self._asked: set[tuple[str, str]] = set()
        self._known: dict[tuple[str, str], Vector] = {}
        self._held: dict[tuple[str, str], int] = {}

    def tell(self, device: IndiTelescope, answer: Answer) -> None:
        """Tell how something ended, with its words."""
        if not self._wants(device.name, answer.name) and not self._wants(device.name, ""):
            return
        vector = self.shown(device).get(answer.name)
        if vector is None:
            if answer.words:
                self.send(saying(device.name, answer.words, utc_now()))
            return
        key = (device.name, answer.name)
        told = vector if answer.state is None else vector.with_state(answer.state)
        if key not in self._known:
            self.send(definition(device.name, vector, utc_now()))
        self._known[key] = told
        if answer.state is not None:
            # so that a client which looks now and then sees it too
            self._held[key] = device.revision + 1
        else:
            self._held.pop(key, None)
        self.send(setting(device.name, told, utc_now(), answer.words))

    def say(self, device: IndiTelescope, words: str) -> None:
        """Tell a message of a device."""
        if self._wants(device.name, ""):
            self.send(saying(device.name, words, utc_now()))

    def send(self, data: bytes) -> None:
        """Keep something to be sent."""
        if self._deaf or self.overflowed.is_set():
            return
        self._unsent.append(data)
        self._unsent_bytes += len(data)
        if self._unsent_bytes > _ENOUGH_BYTES:
            self.room.clear()
        if self._unsent_bytes > _MOST_UNSENT_BYTES:
            # it never reads: what is kept for it ends here
            self.overflowed.set()
            self._unsent.clear()
        self.news.set()

    def forget(self, device: str) -> None:
        """Tell that a device has gone; one that gets its name is told of anew."""
        known = [key for key in self._known if key[0] == device]
        for key in known:
            del self._known[key]
        self._held = {key: until for key, until in self._held.items() if key[0] != device}
        self.off.pop(device, None)
        self._selections.drop(device)
        if known:
            self.send(deletion(device, "", utc_now()))

    def end(self) -> None:
        """Keep nothing more: it hears nothing any more."""
        self._deaf = True
        self.unsent()

    def _wants(self, device: str, name: str) -> bool:
        asked = self._asked
        return bool({("", ""), (device, "")} & asked) or (name != "" and (device, name) in asked)

    def ask(self, asked: Asked) -> None:
        """Define what is asked for, and tell of it from now on."""
        if len(self._asked) < _MOST_ASKED:
            self._asked.add((asked.device, asked.name if asked.device else ""))
        utc = utc_now()
        for device in self._devices.values():
            if asked.device not in ("", device.name):
                continue
            for name, vector in self.shown(device).items():
                if asked.name not in ("", name):
                    continue
                self._known[device.name, name] = vector
                self._held.pop((device.name, name), None)
                fresh = device.time_now() if name == "TIME_UTC" else vector
                self.send(definition(device.name, fresh, utc))

    def hold(self, device: IndiTelescope, name: str) -> None:
        """Tell no change of a property until `release`."""
        self._held[device.name, name] = _FOR_EVER

    def release(self, device: IndiTelescope, name: str) -> None:
        """Tell changes again."""
        self._held.pop((device.name, name), None)

    def out(self) -> bytes:
        """All that is to be sent now."""
        return self.unsent() + self._differences()

    def unsent(self) -> bytes:
        """What is kept to be sent, in its order."""
        data = b"".join(self._unsent)
        self._unsent.clear()
        self._unsent_bytes = 0
        self.room.set()
        return data

    def is_connected(self, device: IndiTelescope) -> bool:
        """Whether a device is there and connected, for this client."""
        return device.was_connected and not self.off.get(device.name, False)

    def shown(self, device: IndiTelescope) -> dict[str, Vector]:
        """All that this client sees of a device."""
        on = self.is_connected(device)
        state = State.ALERT if on and not device.connected else State.OK if on else State.IDLE
        own = {
            "CONNECTION": Vector(
                "CONNECTION",
                "Connection",
                MAIN,
                "Switch",
                "rw",
                state,
                switches("CONNECT" if on else "DISCONNECT", CONNECT="Connect", DISCONNECT="Disconnect"),
            ),
            "DRIVER_INFO": device.driver_info(),
        }
        if not on:
            return own
        mode = Vector(
            "ON_COORD_SET",
            "On Set",
            MAIN,
            "Switch",
            "rw",
            State.OK,
            switches(self._selections.of(device.name), **_MODES),
        )
        return own | {"ON_COORD_SET": mode} | device.vectors

    def _differences(self) -> bytes:
        """What it knows wrongly, or not yet, or still."""
        utc, out = utc_now(), []
        for device in self._devices.values():
            shown = self.shown(device)
            for name, vector in shown.items():
                key = (device.name, name)
                known = self._known.get(key)
                if known == vector or not self._wants(*key) or device.revision < self._held.get(key, 0):
                    continue
                self._held.pop(key, None)
                self._known[key] = vector
                out.append((setting if known is not None else definition)(device.name, vector, utc))
            for key in [known for known in self._known if known[0] == device.name and known[1] not in shown]:
                del self._known[key]
                self._held.pop(key, None)
                out.append(deletion(*key, utc))
        return b"".join(out)
