"""How often, how large, from which page: who asks too much waits or is refused; a stop always passes."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import httpx
import pytest
from hypothesis import given
from hypothesis import strategies as st

from api.access.callers import Role
from api.access.keys import KeyStore
from api.access.rate_limits import TokenBuckets, is_stop
from api.http.app import create_app
from mountnav.errors import BadSettings
from mountnav.settings.observatory import Settings
from tests.api.conftest import Serve
from tests.api.http.stop_answers import stopped

PAGE = "https://page.example:8443"


@asynccontextmanager
async def bare(toml: str) -> AsyncIterator[httpx.AsyncClient]:
    """Open an application that has no service behind it: what stands before the routes is there."""
    transport = httpx.ASGITransport(app=create_app(Settings.parse(toml)), raise_app_exceptions=False)
    async with httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1", timeout=60) as client:
        yield client


class Clock:
    """Stands still until it is told."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


@given(
    rate_per_s=st.floats(0.1, 1000.0),
    burst=st.integers(1, 100),
    pauses_s=st.lists(st.floats(0.0, 10.0), min_size=1, max_size=60),
)
def test_never_more_pass_than_burst_and_rate_allow(
    rate_per_s: float, burst: int, pauses_s: list[float]
) -> None:
    clock = Clock()
    buckets = TokenBuckets(rate_per_s, burst, clock_s=clock)
    starts_s = []
    for pause_s in pauses_s:
        clock.now_s += pause_s
        passes, wait_s = buckets.wait_s("one", most_s=0.25)
        assert wait_s >= 0.0
        assert passes == (wait_s <= 0.25)
        if passes:
            starts_s.append(clock.now_s + wait_s)
    for first in range(len(starts_s)):
        for last in range(first, len(starts_s)):
            allowed = burst + (starts_s[last] - starts_s[first]) * rate_per_s
            assert last - first + 1 <= allowed + 1e-6 * (1 + allowed)


def test_one_callers_haste_is_not_anothers() -> None:
    clock = Clock()
    buckets = TokenBuckets(1.0, 2, clock_s=clock)
    assert [buckets.wait_s("hasty", most_s=0.0)[0] for _ in range(3)] == [True, True, False]
    assert buckets.wait_s("calm", most_s=0.0) == (True, 0.0)
    assert buckets.wait_s("hasty", most_s=0.0) == (False, 1.0)
    clock.now_s = 1.0
    assert buckets.wait_s("hasty", most_s=0.0) == (True, 0.0)


@pytest.mark.parametrize(
    ("method", "path", "stops"),
    [
        ("POST", "/v1/stop", True),
        ("POST", "/v1/telescopes/east/stop", True),
        ("POST", "/v1/telescopes/east/night/stop", True),
        ("DELETE", "/v1/jobs/abc", True),
        ("POST", "/v1/jobs/abc/cancel", True),
        ("POST", "/v1/stop/", True),  # answered by where it is, also to whoever asks too much
        ("POST", "/v1/stop/x", False),
        ("PUT", "/api/v1/telescope/0/abortslew", True),
        ("GET", "/v1/telescopes/east/stop", False),
        ("POST", "/v1/telescopes/east/slew", False),
        ("POST", "/v1/solve/stop", False),
    ],
)
def test_which_requests_stop_something(method: str, path: str, stops: bool) -> None:
    assert is_stop(method, path) is stops


async def test_too_many_are_told_when_to_come_again_and_a_stop_passes(
    serving: Serve, observatory_toml: str
) -> None:
    toml = observatory_toml.replace("[service]", "[service]\nrate_limit_per_s = 0.1\nrate_burst = 3")
    async with serving(toml) as client:
        statuses = [(await client.get("/v1/version")).status_code for _ in range(5)]
        assert statuses == [200, 200, 200, 429, 429]
        refused = await client.get("/v1/version")
        assert refused.json()["type"] == "urn:mountnav:problem:too-many-requests"
        assert refused.json()["retryable"] is True
        assert 1 <= int(refused.headers["Retry-After"]) <= 10
        for _ in range(2):
            assert (await stopped(client, "/v1/telescopes/east/stop")).status_code == 200
        slew = await client.post("/v1/telescopes/east/slew", json={"ra_deg": 1.0, "dec_deg": 80.0})
        assert slew.status_code == 429


async def test_alpacas_programs_may_ask_as_often_as_they_like_and_are_refused_in_plain_words(
    observatory_toml: str,
) -> None:
    """They have no events to follow; and their protocol knows no problem+json."""
    toml = observatory_toml.replace(
        "[service]", "[service]\nrate_limit_per_s = 0.1\nrate_burst = 1\nmax_body_kb = 1"
    )
    async with bare(toml) as client:
        device = "/api/v1/telescope/0"
        asked = [(await client.get(f"{device}/rightascension")).status_code for _ in range(20)]
        assert 429 not in asked
        large = await client.put(f"{device}/tracking", content=b"x" * 2000)
        slow = await client.put(f"{device}/tracking", content=b"Tracking=True")
        shut = await client.get(f"{device}/rightascension", headers={"Host": "evil.example"})
        for answer, status in ((large, 413), (slow, 429), (shut, 403)):
            assert answer.status_code == status
            assert answer.headers["content-type"].startswith("text/plain")
            assert "{" not in answer.text
        assert int(slow.headers["Retry-After"]) >= 1
        assert (await client.get("/v1/version")).headers["content-type"] == "application/problem+json"


async def test_a_caller_in_turn_is_slowed_down_and_not_refused(observatory_toml: str) -> None:
    toml = observatory_toml.replace("[service]", "[service]\nrate_limit_per_s = 50\nrate_burst = 1")
    async with bare(toml) as client:
        began_s = asyncio.get_running_loop().time()
        statuses = {(await client.get("/v1/version")).status_code for _ in range(11)}
        assert statuses == {200}
        assert asyncio.get_running_loop().time() - began_s > 0.18


async def test_each_key_has_its_own_bucket(observatory_toml: str, tmp_path: Path) -> None:
    store = KeyStore(tmp_path / "keys.json")
    one, two = (store.new(name, Role.VIEW)[1] for name in ("one", "two"))
    toml = observatory_toml.replace("[service]", "[service]\nrate_limit_per_s = 0.1\nrate_burst = 1")
    async with bare(toml) as client:

        async def ask(secret: str) -> int:
            return (await client.get("/v1/version", headers={"X-API-Key": secret})).status_code

        assert [await ask(one), await ask(one), await ask(two), await ask(two)] == [200, 429, 200, 429]
        # whoever guesses keys takes from one bucket, whatever he guesses
        assert [await ask(f"guess {number}") for number in range(3)] == [200, 429, 429]


async def test_each_address_has_its_own_bucket_whatever_keys_it_shows(
    observatory_toml: str, tmp_path: Path
) -> None:
    store = KeyStore(tmp_path / "keys.json")
    keys = [store.new(f"number {number}", Role.VIEW)[1] for number in range(4)]
    toml = observatory_toml.replace(
        "[service]", "[service]\naddress_limit_per_s = 0.5\nrate_limit_per_s = 0\nkeys_file = 'keys.json'"
    )
    app = create_app(Settings.parse(toml))

    def of(address: str) -> httpx.AsyncClient:
        transport = httpx.ASGITransport(app=app, client=(address, 4000), raise_app_exceptions=False)
        return httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1", timeout=60)

    async with of("127.0.0.1") as one, of("127.0.0.2") as other:
        # at once twice what a second brings and one more: two, and never by a new key, a guess or Alpaca more
        statuses = [
            (await one.get("/v1/version", headers={"X-API-Key": key})).status_code for key in keys[:3]
        ]
        assert statuses == [200, 200, 429]
        refused = await one.get("/v1/version", headers={"X-API-Key": "a guess"})
        assert refused.json()["type"] == "urn:mountnav:problem:too-many-requests"
        assert 1 <= int(refused.headers["Retry-After"]) <= 2
        assert (await one.get("/api/v1/telescope/0/rightascension")).status_code == 429
        assert (await one.post("/v1/telescopes/east/slew", json={"ra_deg": 1.0})).status_code == 429
        # a stop passes it, to whatever answers there
        assert (await one.post("/v1/telescopes/east/stop")).status_code != 429
        # what one address does costs another nothing, by the same key
        assert (await other.get("/v1/version", headers={"X-API-Key": keys[0]})).status_code == 200


async def test_no_limit_of_an_address_where_it_is_zero(observatory_toml: str) -> None:
    toml = observatory_toml.replace("[service]", "[service]\naddress_limit_per_s = 0\nrate_limit_per_s = 0")
    async with bare(toml) as client:
        assert {(await client.get("/v1/version")).status_code for _ in range(40)} == {200}


async def test_a_body_that_is_too_large_is_refused_wherever_it_is_read(
    serving: Serve, observatory_toml: str
) -> None:
    toml = observatory_toml.replace("[service]", "[service]\nmax_body_kb = 10\nmax_upload_mb = 1")
    async with serving(toml) as client:
        large = b'{"ra_deg": 1.0, "dec_deg": 80.0, "x": "' + b"x" * 20_000 + b'"}'

        async def stream() -> AsyncIterator[bytes]:
            for at in range(0, len(large), 1000):
                yield large[at : at + 1000]

        for path in ("slew", "center", "tracking", "lease", "night/busy"):
            url = f"/v1/telescopes/east/{path}"
            refused = await client.post(url, content=large, headers={"Content-Type": "application/json"})
            assert (path, refused.status_code) == (path, 413)
            assert refused.json()["type"] == "urn:mountnav:problem:too-large"

            unmeasured = await client.post(
                url, content=stream(), headers={"Content-Type": "application/json"}
            )
            assert (path, unmeasured.status_code) == (path, 413)
        # an order that needs no body is not carried out either
        for path in ("look", "sync", "home", "park"):
            refused = await client.post(f"/v1/telescopes/east/{path}", content=b"x" * 20_000)
            assert (path, refused.status_code) == (path, 413)
        assert (await client.get("/v1/jobs")).json() == []
        # nobody reads a stop's body, so it is no reason to refuse a stop
        assert (await stopped(client, "/v1/telescopes/east/stop", content=large)).status_code == 200
        # frames may be larger, up to their own bound
        frame = await client.post("/v1/solve", content=b"SIMPLE" + b" " * 500_000)
        assert frame.json()["type"] == "urn:mountnav:problem:bad-frame"
        huge = await client.post("/v1/solve", content=b"SIMPLE" + b" " * 3_000_000)
        assert (huge.status_code, huge.json()["type"]) == (413, "urn:mountnav:problem:too-large")


async def test_no_other_page_may_ask_unless_it_is_named(observatory_toml: str) -> None:
    preflight = {
        "Origin": PAGE,
        "Access-Control-Request-Method": "POST",
        "Access-Control-Request-Headers": "authorization,mountnav-lease,idempotency-key",
    }
    async with bare(observatory_toml) as client:
        asked = await client.options("/v1/telescopes/east/slew", headers=preflight)
        assert asked.status_code == 403
        assert not [name for name in asked.headers if name.startswith("access-control")]
    toml = observatory_toml.replace("[service]", f'[service]\ncors_origins = ["{PAGE}"]')
    async with bare(toml) as client:
        allowed = await client.options("/v1/telescopes/east/slew", headers=preflight)
        assert allowed.headers["Access-Control-Allow-Origin"] == PAGE
        assert "mountnav-lease" in allowed.headers["Access-Control-Allow-Headers"].lower()
        # keys come in headers alone: no cookie or password of a browser goes along
        assert "Access-Control-Allow-Credentials" not in allowed.headers
        answer = await client.get("/v1/version", headers={"Origin": PAGE})
        assert (answer.status_code, answer.headers["Access-Control-Allow-Origin"]) == (200, PAGE)
        for origin in ("https://evil.example", "http://[", "http://[" + "a" * 60_000, "null", "//", ""):
            nowhere = await client.get("/v1/version", headers={"Origin": origin})
            assert nowhere.status_code == 403, (origin[:20], nowhere.text)
        foreign = await client.get("/v1/version", headers={"Origin": "https://evil.example"})
        assert foreign.status_code == 403
        assert "Access-Control-Allow-Origin" not in foreign.headers


@pytest.mark.parametrize(
    "line",
    [
        'cors_origins = ["*"]',
        'cors_origins = ["page.example"]',
        'cors_origins = ["https://page.example/"]',
        'cors_origins = ["null"]',
        "rate_limit_per_s = -1",
        "rate_burst = 0",
        "max_body_kb = 0",
        "state_poll_s = 0",
    ],
)
def test_settings_that_make_no_sense_are_told(observatory_toml: str, line: str) -> None:
    with pytest.raises(BadSettings, match=line.partition(" ")[0]):
        Settings.parse(observatory_toml.replace("[service]", f"[service]\n{line}"))
