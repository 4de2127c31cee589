"""A camera behind INDI whose driver says things in the order and time that a test wants.

Real drivers differ in that: some expose in a thread and are done before they say that they begin, some never
say so, some pack and send long after they are done. Written from the white paper, with nothing of our codec.
"""

from __future__ import annotations

import asyncio
import base64
import contextlib
import io
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from typing import Any
from xml.etree import ElementTree

import numpy as np
from astropy.io import fits

NAME = "Odd CCD"
Step = str | float
"""busy, ok, alert, idle: what it says of its exposure; expose: it does; file, old file; a pause in seconds"""


@dataclass
class OddCamera:
    """Server, driver and camera in one.

    Attributes
    ----------
    steps : list of Step
        What follows upon an order to expose.
    clock_off : timedelta
        Of the camera's computer.
    timed : bool
        Whether files tell their time.
    chip : str
        ``CCD1``, or ``CCD2`` for the guide chip.
    frame : list of float
        X, Y, width, height that are read out.
    stubborn : bool
        It keeps its frame.
    stale : bool
        What it says of its connection crosses the order to connect, and that takes it a moment.
    mute : bool
        It answers no question.
    ordered : list of (name, dict)
    """

    steps: list[Step] = field(default_factory=lambda: ["busy", "expose", "file", "ok"])
    clock_off: timedelta = timedelta(0)
    timed: bool = True
    chip: str = "CCD1"
    frame: list[float] = field(default_factory=lambda: [0.0, 0.0, 64.0, 48.0])
    stubborn: bool = False
    mute: bool = False
    connected: bool = True
    stale: bool = False
    ordered: list[tuple[str, dict[str, str]]] = field(default_factory=list)
    blobs: int = 0
    port: int = 0

    def __post_init__(self) -> None:
        self._writers: list[asyncio.StreamWriter] = []
        self._served: list[asyncio.Future[None]] = []
        self._tasks: set[asyncio.Task[None]] = set()
        self._state, self._left_s = "Idle", 0.0
        self._began = self._before = datetime.now(UTC)
        self._server: asyncio.Server | None = None

    async def __aenter__(self) -> OddCamera:
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", 0)
        self.port = self._server.sockets[0].getsockname()[1]
        return self

    async def __aexit__(self, *_: object) -> None:
        assert self._server is not None
        self._server.close()
        for task in self._tasks:
            task.cancel()
        for writer in self._writers:
            writer.close()
        await asyncio.gather(*self._served)

    def url(self, options: str = "") -> str:
        return f"indi://127.0.0.1:{self.port}/Odd%20CCD?{options}".rstrip("?")

    def orders(self) -> list[str]:
        return [name for name, _ in self.ordered]

    # -- the wire --------------------------------------------------------------------------------

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._writers.append(writer)
        over: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._served.append(over)
        parser: Any = ElementTree.XMLPullParser(["start", "end"])
        parser.feed("<indi>")
        depth = 1
        with contextlib.suppress(OSError):
            while data := await reader.read(65536):
                parser.feed(data)
                for event, element in parser.read_events():
                    depth += 1 if event == "start" else -1
                    if event == "end" and depth == 2:
                        self._take(element)
        over.set_result(None)

    def say(self, xml: str) -> None:
        for writer in self._writers:
            if not writer.is_closing():
                writer.write(xml.encode())

    def _take(self, told: ElementTree.Element) -> None:
        if told.tag == "getProperties" and not self.mute:
            self.define(told.get("name", ""))
        elif told.tag == "enableBLOB":
            self.blobs += 1
        elif told.tag.startswith("new"):
            values = {one.get("name", ""): (one.text or "").strip() for one in told}
            name = told.get("name", "")
            self.ordered.append((name, values))
            self._obey(name, values)

    def _of_chip(self, what: str) -> str:
        return f"{'GUIDER' if self.chip == 'CCD2' else 'CCD'}_{what}"

    def define(self, only: str = "") -> None:
        on = ("Off", "On") if self.connected else ("On", "Off")
        frame = dict(zip(("X", "Y", "WIDTH", "HEIGHT"), map(str, self.frame), strict=True))
        left = {f"{self._of_chip('EXPOSURE')}_VALUE": str(self._left_s)}
        size = {"CCD_MAX_X": "64", "CCD_MAX_Y": "48", "CCD_PIXEL_SIZE": "4"}
        for name, kind, state, values in (
            ("CONNECTION", "Switch", "Ok", {"CONNECT": on[1], "DISCONNECT": on[0]}),
            (self._of_chip("EXPOSURE"), "Number", self._state, left),
            (self._of_chip("FRAME"), "Number", "Ok", frame),
            (self._of_chip("INFO"), "Number", "Ok", size),
            (self.chip, "BLOB", "Idle", {self.chip: ""}),
        ):
            if only in ("", name) and (self.connected or name == "CONNECTION"):
                inside = "".join(
                    f"<def{kind} name='{key}'>{value}</def{kind}>" for key, value in values.items()
                )
                self.say(
                    f"<def{kind}Vector device='{NAME}' name='{name}' state='{state}' perm='rw'>"
                    f"{inside}</def{kind}Vector>"
                )

    def set_numbers(self, name: str, state: str, **values: float) -> None:
        inside = "".join(f"<oneNumber name='{key}'>{value}</oneNumber>" for key, value in values.items())
        self.say(f"<setNumberVector device='{NAME}' name='{name}' state='{state}'>{inside}</setNumberVector>")

    def begin_anew(self) -> None:
        """Its driver was started again, and nobody says that the old one is gone."""
        self.connected, self._state = False, "Idle"
        for task in self._tasks:
            task.cancel()
        self.define()

    def overtake(self) -> None:
        """Another program orders an exposure: the server passes that on."""
        name = self._of_chip("EXPOSURE")
        self.say(
            f"<newNumberVector device='{NAME}' name='{name}'><oneNumber name='{name}_VALUE'>9</oneNumber>"
            "</newNumberVector>"
        )

    # -- the driver ------------------------------------------------------------------------------

    def _obey(self, name: str, values: dict[str, str]) -> None:
        if name == "CONNECTION" and self.stale:
            self.define(name)
            self.stale = False
            asyncio.get_running_loop().call_later(0.2, self._obey, name, values)
        elif name == "CONNECTION":
            self.connected = values["CONNECT"] == "On"
            self.define()
        elif name == self._of_chip("FRAME"):
            if not self.stubborn:
                self.frame = [float(values[one]) for one in ("X", "Y", "WIDTH", "HEIGHT")]
            self.define(name)
        elif name == self._of_chip("ABORT_EXPOSURE"):
            for task in self._tasks:
                task.cancel()
            self._tell("Idle", 0.0)
        elif name == self._of_chip("EXPOSURE") and self.connected:
            exposure_s = float(values[f"{name}_VALUE"])
            self._began = datetime.now(UTC)
            rest = [*self.steps]
            while rest and rest[0] in ("busy", "ok", "alert", "idle"):
                self._say_of(str(rest.pop(0)), exposure_s)
            task = asyncio.create_task(self._go_on(rest, exposure_s))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def _go_on(self, steps: list[Step], exposure_s: float) -> None:
        for step in steps:
            if step == "expose":
                self._began = datetime.now(UTC)
                await asyncio.sleep(exposure_s + 0.02)
            elif isinstance(step, float):
                await asyncio.sleep(step)
            elif step == "file":
                self._send(exposure_s, self._began)
                self._before = self._began
            elif step == "old file":
                self._send(exposure_s, self._before - timedelta(seconds=5.0))
            else:
                self._say_of(step, exposure_s)

    def _say_of(self, step: str, exposure_s: float) -> None:
        self._tell({"busy": "Busy", "ok": "Ok", "alert": "Alert", "idle": "Idle"}[step], exposure_s)

    def _tell(self, state: str, exposure_s: float) -> None:
        self._state, self._left_s = state, exposure_s if state == "Busy" else 0.0
        name = self._of_chip("EXPOSURE")
        self.set_numbers(name, state, **{f"{name}_VALUE": self._left_s})

    def _send(self, exposure_s: float, began: datetime) -> None:
        width, height = (int(one) for one in self.frame[2:])
        file = fits.PrimaryHDU(np.full((height, width), 100, np.uint16))
        file.header["EXPTIME"] = exposure_s
        if self.timed:
            file.header["DATE-OBS"] = f"{began + self.clock_off:%Y-%m-%dT%H:%M:%S.%f}"
        buffer = io.BytesIO()
        file.writeto(buffer)
        whole = buffer.getvalue()
        self.say(
            f"<setBLOBVector device='{NAME}' name='{self.chip}' state='Ok'><oneBLOB name='{self.chip}' "
            f"size='{len(whole)}' format='.fits'>{base64.b64encode(whole).decode()}</oneBLOB></setBLOBVector>"
        )
