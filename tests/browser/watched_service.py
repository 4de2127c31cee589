"""A real service in a thread, with fakes on pseudo-terminals, and a wire to it that can be cut."""

from __future__ import annotations

import math
import selectors
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime

from fastapi import FastAPI

from api.http.app import create_app
from api.http.serving import make_server
from api.observatory.observatory import Telescope
from mountnav.catalog.embedded import embedded_catalog
from mountnav.clock import utc_now
from mountnav.settings.observatory import Settings
from mountnav.sky.chain import icrs_to_observed, observed_to_icrs
from mountnav.sky.coordinates import Icrs, Observed
from mountnav.sky.sphere import displaced
from mountnav.units import julian_year
from tests.settings_text import SERVICE_AND_SITE

_FAR_ARCSEC = 5.0 * 3600.0

TOML = (
    SERVICE_AND_SITE
    + """
[[telescope]]
id = "east"
exposure_s = 0.5
[telescope.mount]
url = "fake+lx200://?dialect=onstep"
mounting = "fork"
slew_rate_deg_s = 150.0
[telescope.mount.errors]
ih_arcsec = 400.0
id_arcsec = -300.0
[telescope.limits]
horizon_deg = [[0, 10], [90, 22], [180, 8], [270, 30]]
[telescope.camera]
kind = "simulated"
width_px = 1200
height_px = 900
scale_arcsec_px = 4.0
rotation_deg = 20.0
[telescope.centering]
settle_s = 0.0
[telescope.night]
enabled = true
# no night begins by itself, at whatever hour the tests run
begin_sun_below_deg = -90
[[telescope]]
id = "slow"
exposure_s = 0.5
[telescope.mount]
url = "fake+lx200://?dialect=onstep"
mounting = "fork"
slew_rate_deg_s = 0.5
[telescope.camera]
kind = "simulated"
width_px = 1200
height_px = 900
scale_arcsec_px = 4.0
"""
)


@dataclass
class Served:
    """The running service."""

    app: FastAPI
    port: int

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def telescope(self, name: str) -> Telescope:
        found: Telescope = self.app.state.service.observatory.telescope(name)
        return found

    def truly(self, name: str) -> Icrs:
        """Where a fake's tube truly looks."""
        mechanics = self.telescope(name).mechanics
        assert mechanics is not None
        return mechanics.truth()

    def near(self, name: str) -> Icrs:
        """The richest of the places five degrees from where a telescope looks, high above its limits."""
        settings: Settings = self.app.state.settings
        now, here, catalog = utc_now(), self.truly(name), embedded_catalog()
        around = [
            displaced(here, _FAR_ARCSEC * math.sin(turn), _FAR_ARCSEC * math.cos(turn))
            for turn in (math.tau * one / 8 for one in range(8))
        ]
        high = [
            one
            for one in around
            if isinstance(one, Icrs)
            and icrs_to_observed(one, now, settings.site.site, settings.air.air).alt_deg > 50.0
        ]
        return max(
            high, key=lambda one: len(catalog.cone(one, 0.4, epoch_yr=julian_year(now), mag_limit=11.0))
        )

    def place_at(self, alt_deg: float, az_deg: float, utc: datetime | None = None) -> Icrs:
        """What stands there now."""
        settings: Settings = self.app.state.settings
        seen = Observed(az_deg, alt_deg, utc or utc_now())
        return observed_to_icrs(seen, settings.site.site, settings.air.air)


@contextmanager
def served(toml: str = TOML) -> Iterator[Served]:
    """Serve until the block ends."""
    app = create_app(Settings.parse(toml))
    server = make_server(app, log_level="error")
    with socket.create_server(("127.0.0.1", 0)) as listening:
        listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]}, name="watched service")
        thread.start()
        try:
            while not server.started:
                assert thread.is_alive(), "the service did not start"
                time.sleep(0.02)
            yield Served(app, listening.getsockname()[1])
        finally:
            server.should_exit = True
            thread.join()


class Wire:
    """A TCP proxy to the service, whose connections can be cut, and laid again."""

    def __init__(self, to_port: int) -> None:
        self._to = to_port
        self._selector = selectors.DefaultSelector()
        self._ends: dict[socket.socket, socket.socket] = {}
        self._uncut = threading.Event()
        self._uncut.set()
        self._over = False
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port = self._listening.getsockname()[1]
        self._selector.register(self._listening, selectors.EVENT_READ)
        self._thread = threading.Thread(target=self._run, name="wire")
        self._thread.start()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def cut(self) -> None:
        """Reset all connections and refuse new ones."""
        self._uncut.clear()

    def lead_to(self, port: int) -> None:
        """Another service from the next connection on: cut it before, and lay it after."""
        self._to = port

    def lay(self) -> None:
        """Let connections through again."""
        self._uncut.set()

    def close(self) -> None:
        self._over = True
        self._thread.join()

    def _run(self) -> None:
        while not self._over:
            for key, _ in self._selector.select(0.05):
                if key.fileobj is self._listening:
                    self._accept()
                elif isinstance(key.fileobj, socket.socket):
                    self._carry(key.fileobj)
            if not self._uncut.is_set():
                for end in list(self._ends):
                    self._drop(end)
        for end in list(self._ends):
            self._drop(end)
        self._selector.close()
        self._listening.close()

    def _accept(self) -> None:
        near, _ = self._listening.accept()
        if not self._uncut.is_set():
            near.close()
            return
        far = socket.create_connection(("127.0.0.1", self._to))
        for one, other in ((near, far), (far, near)):
            self._ends[one] = other
            self._selector.register(one, selectors.EVENT_READ)

    def _carry(self, end: socket.socket) -> None:
        other = self._ends.get(end)
        if other is None:
            return
        try:
            content = end.recv(65536)
            if content:
                other.sendall(content)
                return
        except OSError:
            pass
        self._drop(end)

    def _drop(self, end: socket.socket) -> None:
        other = self._ends.pop(end, None)
        if other is None:
            return
        self._ends.pop(other, None)
        for one in (end, other):
            self._selector.unregister(one)
            one.close()
