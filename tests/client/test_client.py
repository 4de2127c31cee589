"""The client of our own API against a real service: no order twice, leases that beat, events that go on."""

from __future__ import annotations

import asyncio
import contextlib
import importlib.util
import inspect
import json
import socket
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import ModuleType
from typing import Any

import httpx
import pytest
from pydantic import TypeAdapter

from api.demo.moving import comet_elements, satellite_lines
from api.http.app import create_app
from api.http.serving import bind, make_server
from api.orders.vocabulary import KINDS, Order
from api.service import Service
from mountnav.client import AsyncClient, Client, JobFailed, ServiceError, orders, requests, results, targets
from mountnav.client.client import Call, Calls
from mountnav.client.requests import Request
from mountnav.client.results import ENDS
from mountnav.client.sending import Known, Pause, Send, sending
from mountnav.client.stream import EventReader
from mountnav.settings.observatory import Settings
from mountnav.sky.coordinates import Air, Site
from tests.settings_text import SERVICE_AND_SITE
from tools.client_orders import PATH, client_orders

DOCS = Path(__file__).parents[2] / "docs"
EXAMPLE = DOCS / "examples" / "ten_targets.py"
DESCRIPTION = DOCS / "openapi.json"
TOML = (
    SERVICE_AND_SITE
    + """
[[telescope]]
id = "east"
exposure_s = 0.1
[telescope.mount]
url = "fake+lx200://?dialect=onstep"
[telescope.mount.errors]
ih_arcsec = 300.0
id_arcsec = -240.0
[telescope.camera]
kind = "simulated"
width_px = 1200
height_px = 900
scale_arcsec_px = 6.0
[telescope.centering]
settle_s = 0.0
[telescope.limits]
sun_cone_deg = 0.0
"""
)


@dataclass
class Served:
    url: str
    port: int
    service: Service


@contextlib.contextmanager
def served(toml: str = TOML) -> Iterator[Served]:
    """The service in a thread of its own, on a real socket."""
    app = create_app(Settings.parse(toml))
    server = make_server(app, log_level="warning")
    with bind("127.0.0.1", 0) as listener:
        port = listener.getsockname()[1]
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]}, name="service")
        thread.start()
        try:
            while not server.started:
                assert thread.is_alive(), "the service did not start"
                time.sleep(0.02)
            mechanics = app.state.service.observatory.telescope("east").mechanics
            # no motor of the world, and no wait for one
            mechanics.slew_rate_deg_s, mechanics.acceleration_deg_s2 = 38.0, 150.0
            yield Served(f"http://127.0.0.1:{port}", port, app.state.service)
        finally:
            server.should_exit = True
            thread.join()


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """One for all: starting it costs more than what is asked of it."""
    patch = pytest.MonkeyPatch()
    patch.setenv("MOUNTNAV_JOURNAL", str(tmp_path_factory.mktemp("client") / "journal.sqlite"))
    with served() as one:
        yield one
    patch.undo()


class Proxy:
    """A wire between client and service that loses answers: `losses` connections end before their first."""

    def __init__(self, port: int) -> None:
        self._port = port
        self.losses = 0
        self.lost = 0
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self._listener.getsockname()[1]}"
        self._ends: list[socket.socket] = []
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                near, _ = self._listener.accept()
                far = socket.create_connection(("127.0.0.1", self._port))
                self._ends += [near, far]
                threading.Thread(target=self._carry, args=(near, far, False), daemon=True).start()
                threading.Thread(target=self._carry, args=(far, near, True), daemon=True).start()

    def _carry(self, source: socket.socket, sink: socket.socket, answers: bool) -> None:
        with contextlib.suppress(OSError):
            while data := source.recv(65536):
                if answers and self.losses > 0:
                    self.losses -= 1
                    self.lost += 1
                    break
                sink.sendall(data)
        for one in (source, sink):
            with contextlib.suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)

    def cut(self) -> None:
        """Cut every connection that is open now."""
        for one in self._ends:
            with contextlib.suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        self._listener.close()
        self.cut()


@pytest.fixture
def proxy(service: Served) -> Iterator[Proxy]:
    one = Proxy(service.port)
    yield one
    one.close()


@pytest.fixture
def client(service: Served) -> Iterator[Client]:
    with Client(service.url, timeout_s=60.0) as one:
        yield one


def somewhere(client: Client, north_deg: float = -2.0) -> targets.Target:
    here = client.telescope("east")["icrs"]
    assert here is not None
    return targets.icrs(here["ra_deg"], here["dec_deg"] + north_deg)


# -- what is asked -------------------------------------------------------------------------------------


def test_questions_are_answered_with_what_their_types_say(client: Client) -> None:
    assert client.health()["ready"]
    (state,) = client.telescopes()
    assert state["id"] == "east"
    assert state["icrs"] is not None
    can = client.capabilities()
    assert "center" in {one["kind"] for one in can["kinds"]}
    (vega,) = client.objects("Vega", count=1)
    assert (vega["kind"], round(vega["icrs"]["dec_deg"])) == ("star", 39)
    assert client.lease_state("east")["held"] is False


def test_a_state_that_has_not_changed_is_not_sent_again(client: Client, service: Served) -> None:
    statuses: list[int] = []
    client._http.event_hooks["response"].append(lambda response: statuses.append(response.status_code))
    first = client.telescope("east")
    until_s = time.monotonic() + 60.0
    while 304 not in statuses and time.monotonic() < until_s:
        again = client.telescope("east")
    assert again == client.known.answers["/v1/telescopes/east"][1]
    assert again["id"] == first["id"]
    assert statuses[0] == 200


def test_the_client_s_orders_are_those_of_the_service() -> None:
    assert PATH.read_text(encoding="utf-8") == client_orders(), "then run: python -m tools.client_orders"


def test_every_kind_of_order_is_one_that_the_service_knows(client: Client) -> None:
    made: dict[str, orders.Order] = {
        "slew": orders.slew(targets.icrs(1.0, 2.0, pm_dec_masyr=3.0)),
        "center": orders.center(
            targets.apparent(1.0, 2.0),
            tolerance_arcsec=10.0,
            correct_by="sync",
            at={"x_px": 1.0, "y_px": 2.0},
            position_angle_deg=5.0,
        ),
        "look": orders.look(exposure_s=1.0),
        "sync": orders.sync(),
        "sync-to": orders.sync_to(targets.altaz(50.0, 180.0)),
        "offset": orders.offset(1.0, 2.0),
        "flip": orders.flip(targets.typed("18h36m56s +38°47′"), planned_s=10.0),
        "follow": orders.follow(targets.named("Moon"), duration_s=600.0, tolerance_arcsec=5.0),
        "forget-rates": orders.forget_rates(),
        "park": orders.park(),
        "unpark": orders.unpark(),
        "set-park": orders.set_park(),
        "home": orders.home(),
        "tracking": orders.tracking(True, rate="lunar"),
        "guide": orders.guide("n", 0.5),
        "offset-rates": orders.offset_rates(0.5, -0.25, for_s=60.0),
        "move-axis": orders.move_axis("secondary", -0.2, for_s=0.5),
        "trust": orders.trust(),
        "set-site-time": orders.set_site_time(),
        "accept-site-time": orders.accept_site_time(),
        "recover": orders.recover(),
        "first-light": orders.first_light(exposure_s=2.0),
        "solve": orders.solve(path="m31.fits", ra_deg=10.7, dec_deg=41.3, radius_deg=2.0, blind="never"),
        "rotate": orders.rotate(30.0, either_way=True),
        "mosaic": orders.mosaic(targets.named("M31"), across=2, down=3, frames=20),
        "spiral-search": orders.spiral_search(targets.named("Vega"), radius_deg=2.0),
        "hold": orders.hold(for_s=600.0),
        "dither": orders.dither(),
        "series": orders.series(target=targets.named("Vega"), looks=5),
        "model-run": orders.model_run(points=10, spread="random", seed=3, put_in_force=False),
    }
    assert set(made) == set(KINDS) == {one["kind"] for one in client.capabilities()["kinds"]}
    for kind, order in made.items():
        assert TypeAdapter[Any](Order).validate_python(order).kind == kind


def test_every_kind_of_target_is_one_that_the_service_knows(client: Client) -> None:
    now = datetime.now(UTC)
    later = now + timedelta(hours=1)
    site = Site(47.0, 11.0, 0.0)
    made: list[targets.Target] = [
        targets.icrs(1.0, 2.0),
        targets.apparent(1.0, 2.0),
        targets.altaz(60.0, 120.0),
        targets.named("Jupiter"),
        targets.typed("18h36m56s +38°47′"),
        targets.rates(
            10.0, 20.0, 0.5, -0.25, begins_utc=now, ends_utc=later, name="a rock", sigma_arcsec=2.0
        ),
        targets.altaz_rates(60.0, 120.0, 5.0, -5.0, begins_utc=now, ends_utc=later.isoformat()),
        targets.path([(now, 10.0, 20.0), (later, 10.5, 20.1)], name="a way"),
        targets.satellite(satellite_lines(now, site)),
        targets.elements(comet_elements(now, site, Air())),
        targets.table(
            "# made by hand\nutc,ra_deg,dec_deg\n"
            + "".join(
                f"{(now + timedelta(minutes=minute)).isoformat()},{10 + 0.01 * minute:.4f},20.0\n"
                for minute in range(8)
            )
        ),
    ]
    assert {one["kind"] for one in made} == set(client.capabilities()["targets"])
    for target in made[:-1]:
        forecast = client.forecast("east", target, hours=0.2)
        assert forecast["events"] == sorted(forecast["events"], key=lambda one: one["utc"])
        assert forecast["moves"] is (target["kind"] not in ("icrs", "apparent", "altaz", "typed"))
        assert (forecast["total_arcsec_s"] or 0.0) > 0.0 or not forecast["moves"]
    with pytest.raises(ValueError, match="time zone"):
        targets.path([(datetime(2026, 11, 26), 1.0, 2.0), (later, 1.0, 2.0)])


def test_a_forecast_of_nothing_is_refused(client: Client) -> None:
    with pytest.raises(ServiceError) as refused:
        client.forecast("east", targets.named("No Such Star"))
    assert refused.value.status == 422
    over = datetime.now(UTC) - timedelta(hours=2)
    gone = targets.rates(1.0, 2.0, 1.0, 1.0, begins_utc=over, ends_utc=over + timedelta(hours=1))
    with pytest.raises(ServiceError) as refused:
        client.forecast("east", gone)
    assert refused.value.slug == "bad-request"


# -- what moves and ends -------------------------------------------------------------------------------


@pytest.mark.long
def test_rates_and_a_held_axis_end_by_themselves(client: Client) -> None:
    client.succeeded(client.order("east", orders.tracking(True)), timeout_s=60.0)
    job = client.succeeded(client.offset_rates("east", 0.5, -0.25, for_s=600.0), timeout_s=60.0)
    assert job["result"] is not None
    rates = client.telescope("east")["rates"]
    assert rates is not None
    assert rates["dec_arcsec_s"] == pytest.approx(-0.25)
    client.succeeded(client.offset_rates("east", 0.0, 0.0), timeout_s=60.0)
    assert client.telescope("east")["rates"] is None
    (can,) = client.capabilities()["telescopes"]
    speed = can["axis_speeds_deg_s"]["secondary"][2]
    first = client.move_axis("east", "secondary", speed, for_s=2.0)
    again = client.move_axis("east", "secondary", speed, for_s=1.0)
    assert again["id"] == first["id"]
    assert client.telescope("east")["axes_moved"][0]["axis"] == "secondary"
    assert client.telescope("east")["slewing"]
    done = client.succeeded(first, timeout_s=60.0)
    assert done["result"] is not None
    assert done["result"]["axes"][0]["why"] == "no further order came in time"
    assert client.telescope("east")["axes_moved"] == []


def test_a_motion_whose_answer_is_lost_is_not_sent_again(
    service: Served, proxy: Proxy, client: Client
) -> None:
    (can,) = client.capabilities()["telescopes"]
    speed = can["axis_speeds_deg_s"]["secondary"][0]
    with Client(proxy.url, timeout_s=60.0) as shaky:
        proxy.losses = 1
        with pytest.raises(httpx.TransportError):
            shaky.move_axis("east", "secondary", speed, for_s=0.5)
    assert proxy.lost == 1
    newest = client.jobs("east", count=1)[0]
    assert newest["kind"] == "move-axis"
    client.wait(newest, timeout_s=60.0)


# -- orders --------------------------------------------------------------------------------------------


@pytest.mark.long
def test_an_order_whose_answer_is_lost_is_one_job(service: Served, proxy: Proxy, client: Client) -> None:
    with Client(proxy.url, timeout_s=60.0) as shaky:
        proxy.losses = 2
        job = shaky.order("east", orders.slew(somewhere(client)))
        assert proxy.lost == 2, "the answers were lost, the orders were not"
        assert shaky.succeeded(job, timeout_s=60.0)["kind"] == "slew"
        slews = [one for one in client.jobs("east") if one["created_utc"] >= job["created_utc"]]
        assert [one["id"] for one in slews] == [job["id"]]
        # a program that was killed gives its order again, with the key that it kept
        keyed = shaky.look("east", key="look-of-the-killed-program", wait_s=30.0)
        assert client.look("east", key="look-of-the-killed-program")["id"] == keyed["id"]


def test_a_failed_job_says_what_and_whether_to_try_again(client: Client) -> None:
    with pytest.raises((JobFailed, ServiceError)) as failed:
        client.succeeded(client.slew("east", target=targets.altaz(-20.0, 90.0)), timeout_s=60.0)
    assert failed.value.slug == "outside-limits"
    assert not failed.value.retryable
    assert failed.value.reasons


def test_a_busy_telescope_names_its_holder_and_can_be_superseded(client: Client) -> None:
    first = client.order("east", orders.series(looks=1000))
    with pytest.raises(ServiceError) as busy:
        client.look("east")
    assert (busy.value.slug, busy.value.status, busy.value.retryable) == ("busy", 409, True)
    assert busy.value.job_id == first["id"]
    assert busy.value.retry_after_s is not None
    with pytest.raises(TimeoutError):
        client.wait(first, timeout_s=0.1)
    second = client.slew("east", target=somewhere(client, -1.0), supersede=True, wait_s=60.0)
    assert second["state"] == "succeeded"
    ended = client.wait(first)
    assert ended["state"] == "cancelled"
    assert client.cancel(first)["state"] == "cancelled", "twice is fine"


def test_stops_are_sent(client: Client) -> None:
    job = client.order("east", orders.series(looks=1000))
    assert client.stop("east")["cancelled_job_id"] == job["id"]
    assert client.wait(job, timeout_s=60.0)["state"] == "cancelled"
    assert client.stop_all()["stopped"]


@pytest.mark.parametrize(
    "places",
    [{}, {"ra_deg": 1.0}, {"ra_deg": 1.0, "dec_deg": 1.0, "target": {}}, {"dec_deg": 1.0, "target": {}}],
)
def test_half_a_place_or_two_are_refused_before_anything_is_sent(
    client: Client, places: dict[str, Any]
) -> None:
    with pytest.raises(TypeError):
        client.slew("east", **places)


# -- leases --------------------------------------------------------------------------------------------


@pytest.mark.long
def test_a_lease_is_kept_by_its_heartbeats_and_carried_by_its_orders(client: Client, service: Served) -> None:
    with Client(service.url, timeout_s=60.0) as other:
        with client.lease("east", ttl_s=5.0, note="a test") as lease:
            held = other.lease_state("east")
            assert (held["held"], held["note"], held["on_expiry"]) == (True, "a test", "stop")
            first_until = held["until_utc"]
            with pytest.raises(ServiceError) as leased:
                other.look("east")
            assert leased.value.slug == "leased"
            assert client.look("east", wait_s=60.0)["state"] == "succeeded"
            until_s = time.monotonic() + 60.0
            while other.lease_state("east")["until_utc"] == first_until:
                assert time.monotonic() < until_s, "no heartbeat came"
                time.sleep(0.05)
            assert lease.held
            assert other.stop("east"), "a stop needs no lease"
        assert other.lease_state("east")["held"] is False
        assert other.look("east", wait_s=60.0)["state"] == "succeeded"


def test_a_lease_may_be_taken_again_and_is_kept_by_heartbeats_again(client: Client) -> None:
    lease = client.lease("east", ttl_s=5.0)
    assert not lease.held
    for _ in range(2):
        with lease:
            first_until = client.lease_state("east")["until_utc"]
        assert not lease.held
    with lease:
        first_until = client.lease_state("east")["until_utc"]
        until_s = time.monotonic() + 60.0
        while client.lease_state("east")["until_utc"] == first_until:
            assert time.monotonic() < until_s, "no heartbeat came"
            time.sleep(0.05)


async def test_a_program_that_is_cancelled_while_it_gives_a_lease_back_ends() -> None:
    beating, go_on = asyncio.Event(), asyncio.Event()

    class Slow(AsyncClient):
        """Its answers come from here, and heartbeats that are cancelled take their time."""

        async def do(self, request: Request[Any]) -> Any:
            if request.method != "PUT":
                return {"lease": "secret"}
            try:
                beating.set()
                await asyncio.Event().wait()
            finally:
                await go_on.wait()

    async def program() -> str:
        async with Slow("http://127.0.0.1:1") as slow:
            async with slow.lease("east", ttl_s=0.01):
                await beating.wait()
            return "went on"

    running = asyncio.create_task(program())
    await beating.wait()
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    running.cancel()
    asyncio.get_running_loop().call_soon(go_on.set)
    with pytest.raises(asyncio.CancelledError):
        await running


@pytest.mark.long
def test_a_lease_that_is_taken_away_is_told_by_its_next_heartbeat(client: Client, service: Served) -> None:
    with client.lease("east", ttl_s=5.0) as lease:
        httpx.delete(f"{service.url}/v1/telescopes/east/lease", params={"force": "true"}, trust_env=False)
        until_s = time.monotonic() + 60.0
        while lease.lost is None:
            assert time.monotonic() < until_s, "it was not noticed"
            time.sleep(0.05)
        assert not lease.held
        with pytest.raises(ServiceError):
            lease.require()
        with pytest.raises(ServiceError) as refused:
            client.look("east")
        assert refused.value.slug == "lease-lost"


# -- events --------------------------------------------------------------------------------------------


@pytest.mark.long
def test_the_events_of_a_job_end_with_it_over_a_cut_connection(proxy: Proxy, client: Client) -> None:
    with Client(proxy.url, timeout_s=60.0) as shaky:
        job = client.center("east", target=somewhere(client, -1.0))
        seen = []
        for event in shaky.events(job=job):
            seen.append(event)
            if len(seen) == 2:
                proxy.cut()
        assert seen[-1].data["state"] in ENDS
        ids = [event.event_id for event in seen]
        assert len(set(ids)) == len(ids), "none twice"
        # nothing was left out: the same as the service tells now, behind where the job stood at first
        again = [event.event_id for event in client.events(job=job)]
        assert again[-1] == ids[-1]
        assert [one for one in ids if one in set(again)] == again
        after = [event.event_id for event in client.events(job=job, after=again[1])]
        assert after == again[2:]


@pytest.mark.long
def test_events_of_one_telescope_and_of_a_job_that_is_none(client: Client) -> None:
    job = client.look("east", wait_s=60.0)
    stream = client.events(telescope="east", after="0")
    kinds = []
    for event in stream:
        kinds.append(event.kind)
        if event.kind == "job" and event.data["job_id"] == job["id"] and event.data["state"] in ENDS:
            break
    assert {"exposing", "solved"} <= set(kinds)
    with pytest.raises(ServiceError) as unknown:
        next(iter(client.events(job="no-such-job")))
    assert unknown.value.slug == "not-found"


# -- the same, awaited ---------------------------------------------------------------------------------


@pytest.mark.long
async def test_the_async_client_does_the_same(service: Served, proxy: Proxy) -> None:
    async with AsyncClient(proxy.url, timeout_s=60.0) as client:
        assert (await client.health())["ready"]
        async with client.lease("east", ttl_s=10.0, on_expiry="keep-tracking") as lease:
            proxy.losses = 1
            job = await client.order("east", orders.look())
            kinds = [event.kind async for event in client.events(job=job)]
            assert kinds[-1] == "job"
            assert (await client.succeeded(job, timeout_s=60.0))["result"]
            assert (await client.wait(job))["state"] == "succeeded"
            assert lease.held
            async with AsyncClient(service.url) as other:
                with pytest.raises(ServiceError) as taken:
                    async with other.lease("east"):
                        pass
            assert taken.value.slug == "leased"
        assert (await client.lease_state("east"))["held"] is False
        with pytest.raises(ServiceError):
            await client.slew("nowhere", 1.0, 2.0)
        assert (await client.stop("east"))["stopped"]


# -- the core that both share ----------------------------------------------------------------------------


def steps_of(request: Request[Any], answers: list[Any]) -> tuple[list[Send | Pause], Any]:
    """Carry out a request with answers that are told; what was done, and the end."""
    steps = sending(request, Known(), 5.0)
    done: list[Send | Pause] = []
    came: Any = None
    try:
        while True:
            done.append(steps.send(came))
            came = answers.pop(0) if isinstance(done[-1], Send) else None
    except StopIteration as end:
        return done, end.value


LATE = httpx.ReadTimeout("late")


def test_the_key_of_an_order_is_kept_over_its_attempts() -> None:
    done, job = steps_of(requests.slew("east", 1.0, 2.0), [LATE, LATE, httpx.Response(202, json={"id": "j"})])
    sent = [one for one in done if isinstance(one, Send)]
    assert len(sent) == 3
    assert len({one.arguments["headers"]["Idempotency-Key"] for one in sent}) == 1
    assert job == {"id": "j"}
    other, _ = steps_of(requests.slew("east", 1.0, 2.0), [httpx.Response(202, json={})])
    assert isinstance(other[0], Send)
    assert other[0].arguments["headers"]["Idempotency-Key"] != sent[0].arguments["headers"]["Idempotency-Key"]


def test_what_may_not_be_sent_again_is_not() -> None:
    lease = requests.take_lease("east", ttl_s=30.0, on_expiry="stop", note="", force=False)
    with pytest.raises(httpx.ReadTimeout):
        steps_of(lease, [LATE])
    done, _ = steps_of(lease, [httpx.ConnectError("refused"), httpx.Response(201, json={})])
    assert len([one for one in done if isinstance(one, Send)]) == 2, "the first never arrived"
    with pytest.raises(httpx.ReadTimeout):
        steps_of(requests.stop("east"), [LATE] * 4)


def test_a_service_that_is_asked_too_often_says_when_to_come_again() -> None:
    too_many = httpx.Response(
        429, json={"type": "urn:mountnav:problem:too-many-requests", "retry_after_s": 2.5, "retryable": True}
    )
    done, _ = steps_of(requests.health(), [too_many, httpx.Response(200, json={})])
    assert [one.seconds for one in done if isinstance(one, Pause)] == [2.5]
    with pytest.raises(ServiceError) as refused:
        steps_of(requests.health(), [too_many] * 4)
    assert refused.value.slug == "too-many-requests"


def test_an_answer_that_is_no_problem_is_told_as_it_is() -> None:
    with pytest.raises(ServiceError, match="Bad Gateway") as refused:
        steps_of(requests.health(), [httpx.Response(502, text="<h1>Bad Gateway</h1>")])
    assert (refused.value.status, refused.value.slug, refused.value.retryable) == (
        502,
        "service-error",
        False,
    )


def test_a_page_in_place_of_an_answer_is_a_problem_whatever_its_status() -> None:
    # a heartbeat that stumbled over it would end, and the lease with it
    with pytest.raises(ServiceError, match="Log in") as refused:
        steps_of(requests.keep_lease("east", "secret"), [httpx.Response(200, text="<h1>Log in</h1>")])
    assert refused.value.status == 200


def test_a_kept_answer_is_the_services_whatever_a_program_makes_of_it() -> None:
    known, asked = Known(), requests.telescope("east")

    def answered(response: httpx.Response) -> dict[str, Any]:
        steps = sending(asked, known, 5.0)
        steps.send(None)
        with pytest.raises(StopIteration) as end:
            steps.send(response)
        answer: dict[str, Any] = end.value.value
        return answer

    first = answered(httpx.Response(200, json={"warnings": []}, headers={"ETag": '"1"'}))
    first["warnings"].append("mine")
    again = answered(httpx.Response(304))
    assert again == {"warnings": []}
    again["warnings"].append("mine")
    assert answered(httpx.Response(304)) == {"warnings": []}


def test_both_clients_have_the_calls_of_all_requests() -> None:
    names = {name for name, call in vars(Calls).items() if isinstance(call, Call)}
    assert {"telescopes", "order", "slew", "stop"} <= names
    with Client("http://127.0.0.1:1") as client:
        for name in names:
            made = getattr(requests, name)
            assert getattr(AsyncClient, name).__doc__ == made.__doc__
            assert inspect.signature(getattr(client, name)) == inspect.signature(made)


def test_events_are_read_out_of_lines() -> None:
    reader = EventReader()
    assert reader.line(": keep-alive") is None
    assert reader.line("") is None
    for line in ("event: job", 'data: {"a":', "data: 1}", "id: r-7"):
        assert reader.line(line) is None
    event = reader.line("")
    assert event is not None
    assert (event.kind, event.data, event.event_id, reader.last_id) == ("job", {"a": 1}, "r-7", "r-7")
    reader.line("event: half")
    reader.cut()
    assert reader.line("") is None


# -- the example -----------------------------------------------------------------------------------------


def example() -> ModuleType:
    spec = importlib.util.spec_from_file_location("ten_targets", EXAMPLE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["ten_targets"] = module
    spec.loader.exec_module(module)
    return module


@pytest.mark.long
def test_the_example_runs_its_ten_targets_and_parks(service: Served, tmp_path: Path, client: Client) -> None:
    record = tmp_path / "night.jsonl"
    arguments = [service.url, "--telescope", "east", "--record", str(record), "--tolerance-arcsec", "30"]
    code = example().main(arguments)
    lines = [json.loads(line) for line in record.read_text().splitlines()]
    centered = [line for line in lines if line["outcome"] == "centered"]
    assert code == 0, lines
    assert len(centered) == 10
    assert all(line["error_arcsec"] <= 30.0 for line in centered)
    assert len({line["target"] for line in centered}) == 10
    # what was not observed has its reason
    assert all(line["problem"] for line in lines if line["outcome"] != "centered")
    assert client.telescope("east")["parked"] or client.jobs("east")[0]["kind"] == "park"
    assert client.lease_state("east")["held"] is False


def test_the_example_ends_when_somebody_else_holds_the_telescope(
    service: Served, tmp_path: Path, client: Client, capsys: pytest.CaptureFixture[str]
) -> None:
    with client.lease("east"):
        code = example().main([service.url, "--telescope", "east", "--record", str(tmp_path / "n.jsonl")])
    assert code == 2
    assert "leased" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("ours", "schema"),
    [
        (results.TelescopeState, "TelescopeView"),
        (results.Job, "JobView"),
        (results.Problem, "Problem"),
        (results.Stopped, "StopView"),
        (results.StopAll, "StopAllView"),
        (results.NextLimit, "LimitAheadView"),
        (results.SkyObject, "ObjectView"),
    ],
)
def test_the_clients_types_have_the_fields_that_are_described(ours: type, schema: str) -> None:
    described = json.loads(DESCRIPTION.read_text())["components"]["schemas"][schema]
    assert set(ours.__annotations__) == set(described["properties"])
