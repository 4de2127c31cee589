"""A whole service on real sockets, all faces open, its fake mount's wire in sight: to be attacked."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager

from api.http.app import create_app
from api.http.serving import bind, make_server
from api.observatory.fake_mounts import GERMAN
from api.service import Service
from drivers.fakes.bench import FakeOnPty, FakeOnTcp
from drivers.fakes.wire_fake import WireFake
from drivers.registry import make_fake
from mountnav.clock import utc_now
from mountnav.settings.observatory import Settings
from mountnav.simulation.mechanics import Mechanics, PointingErrors
from mountnav.sky.chain import hour_angle_to_icrs, icrs_to_apparent
from mountnav.sky.coordinates import Air, Apparent, HourAngle, Site
from tests.waiting import until

SITE = Site(47.0, 11.0, 600.0)
OBSERVATORY = """
[service]
port = 0
state_poll_s = 0.2
rate_limit_per_s = 0
[solving]
worker = false
blind = "never"
[site]
latitude_deg = 47.0
longitude_deg = 11.0
height_m = 600.0
[alpaca]
discovery = false
[indi_server]
enabled = true
port = 0
[lx200_server]
enabled = true
port = 0
[stellarium]
enabled = true
port = 0
[[telescope]]
id = "east"
exposure_s = 0.2
[telescope.mount]
url = "fake+lx200://?dialect=onstep"
mounting = "german"
slew_rate_deg_s = 40.0
acceleration_deg_s2 = 8.0
[telescope.camera]
kind = "simulated"
width_px = 400
height_px = 300
scale_arcsec_px = 4.0
[telescope.centering]
settle_s = 0.0
[telescope.limits]
sun_cone_deg = 0.0
solar_filter = true
"""
"""The Sun is no limit here: a test that ends otherwise at another hour of the day would tell nothing."""
_MOVES = (
    b":MS",
    b":MA",
    b":MN",
    b":MP",
    b":Mn",
    b":Ms",
    b":Me",
    b":Mw",
    b":Mg",
    b":CM",
    b":CS",
    b":h",
    b":T",
)
_TOLD_ONLY = (b":h?", b":T?")
STOP = b":Q#"


class Standing:
    """The service, and what a judge sees of it.

    Attributes
    ----------
    service : Service
    port : int
        Of HTTP.
    bench : FakeOnPty or FakeOnTcp
    fake : WireFake
    mechanics : Mechanics
        Where the tube truly is.
    """

    def __init__(self, service: Service, port: int, bench: FakeOnPty | FakeOnTcp) -> None:
        self.service = service
        self.port = port
        self.bench = bench
        assert isinstance(bench.fake, WireFake)
        self.fake: WireFake = bench.fake
        self.mechanics: Mechanics = bench.fake.mechanics

    def door(self, name: str) -> tuple[str, int]:
        """Where a face without HTTP listens."""
        state = self.service.listeners.states[name]
        assert state.port is not None, state.problem
        return "127.0.0.1", state.port

    def mark(self) -> int:
        """The present end of the wire's log."""
        return len(self.fake.heard)

    def moving_words(self, since: int = 0) -> list[bytes]:
        """What the mount has heard since then that moves, stops or syncs it, or changes its tracking."""
        return [
            word
            for word in self.fake.heard[since:]
            if (word.startswith(_MOVES) and not word.startswith(_TOLD_ONLY)) or word == STOP
        ]

    def gotos(self, since: int = 0) -> int:
        """How many slews it was sent since then."""
        return self.moving_words(since).count(b":MS#")

    async def on_its_way(self, since: int, what: str = "on its way") -> None:
        """Wait until it was sent its one slew since then."""
        await until(lambda: self.gotos(since) == 1, what)

    @contextmanager
    def silent_wire(self) -> Iterator[None]:
        """Nothing that moves may be on the wire within."""
        mark = self.mark()
        yield
        assert self.moving_words(mark) == []

    async def idle(self) -> None:
        """Wait until no job holds the telescope."""
        await until(lambda: self.service.jobs.running_on("east") is None, "idle")


@asynccontextmanager
async def standing(
    toml: str = OBSERVATORY, bench: FakeOnPty | FakeOnTcp | None = None
) -> AsyncIterator[Standing]:
    """Serve an observatory on ports of its own; with a bench, its mount is on that one."""
    app = create_app(Settings.parse(toml))
    listener = bind("127.0.0.1", 0)
    app.state.http_address = listener.getsockname()[:2]
    server = make_server(app, log_level="warning")
    serving = asyncio.create_task(server.serve(sockets=[listener]))
    try:
        await until(lambda: server.started or serving.done(), "serving")
        assert not serving.done(), serving
        service: Service = app.state.service
        found = bench or service.observatory.telescope("east").bench
        assert found is not None
        yield Standing(service, listener.getsockname()[1], found)
    finally:
        server.should_exit = True
        with contextlib.suppress(asyncio.CancelledError):
            await serving


@contextmanager
def fake_on_tcp() -> Iterator[tuple[FakeOnTcp, str]]:
    """The same mount as an outsider that outlives services and cables, and the settings for it."""
    mechanics = Mechanics(
        SITE, Air(), PointingErrors(), machine=GERMAN, slew_rate_deg_s=40.0, acceleration_deg_s2=8.0
    )
    fake = make_fake("lx200", "onstep", mechanics, clock=utc_now, monotonic=time.monotonic)
    with FakeOnTcp(fake) as bench:
        url = bench.address.replace("socket://", "tcp://")
        before, _, after = OBSERVATORY.partition('url = "fake+lx200://?dialect=onstep"')
        after = after.replace("slew_rate_deg_s = 40.0\nacceleration_deg_s2 = 8.0\n", "")
        camera, limits = after.index("[telescope.camera]"), after.index("[telescope.centering]")
        folder = '[telescope.camera]\nkind = "folder"\npath = "/"\n'
        yield bench, f'{before}url = "lx200+{url}?dialect=onstep"{after[:camera]}{folder}{after[limits:]}'


def up_now(ha_deg: float, dec_deg: float) -> Apparent:
    """A place of date at an hour angle of now."""
    utc = utc_now()
    return icrs_to_apparent(hour_angle_to_icrs(HourAngle(ha_deg, dec_deg, utc), SITE, Air()), utc)
