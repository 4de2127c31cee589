"""Event streams: of a telescope, of a job, resumed, kept alive; 200 listeners lose nothing."""

from __future__ import annotations

import asyncio
import json
from typing import Any

import httpx
import pytest
from hypothesis import given
from hypothesis import strategies as st

from api.events import Events
from api.http.routes.events import EventStream
from api.orders.jobs import Jobs
from tests.api.conftest import Serve

EAST = "/v1/telescopes/east"


async def _chunks(stream: EventStream, count: int) -> list[bytes]:
    found: list[bytes] = []
    async for chunk in stream.body_iterator:
        assert isinstance(chunk, bytes)
        found.append(chunk)
        if len(found) == count:
            break
    return found


async def test_200_listeners_hear_everything_in_order() -> None:
    events = Events(1000)
    told = 400

    async def listen() -> list[int]:
        heard: list[int] = []
        reader = events.reader()
        while len(heard) < told:
            batch = await reader.next(60)
            assert batch, "nothing came for a minute"
            assert all(event.kind == "step" for event in batch)
            heard += [int(str(event.data["n"])) for event in batch]
        return heard

    listeners = [asyncio.create_task(listen()) for _ in range(200)]
    await asyncio.sleep(0)
    for number in range(told):
        events.publish("step", {"n": number})
        if number % 7 == 0:
            await asyncio.sleep(0)
    for heard in await asyncio.gather(*listeners):
        assert heard == list(range(told))


async def test_a_listener_about_one_thing_hears_that_alone() -> None:
    events = Events(100)
    reader = events.reader(about=lambda event: event.data.get("telescope") == "east")
    for number in range(20):
        events.publish("step", {"telescope": ("east", "west")[number % 2], "n": number})
    batch = await reader.next()
    assert [event.data["n"] for event in batch or []] == list(range(0, 20, 2))
    # what is not his doesn't wake him with nothing
    waiting = asyncio.create_task(reader.next(60))
    events.publish("step", {"telescope": "west"})
    await asyncio.sleep(0)
    assert not waiting.done()
    events.publish("step", {"telescope": "east", "n": 99})
    assert [event.data["n"] for event in await waiting or []] == [99]


async def test_silence_is_kept_alive_by_comments_and_the_end_ends_it() -> None:
    events = Events(10)
    stream = EventStream(events.reader(), keep_alive_s=0.01)
    hello, first, second = await _chunks(stream, 3)
    assert hello.startswith(b":")
    assert first == second == b": keep-alive\n\n"
    closing = EventStream(events.reader())
    events.publish("last", {})
    events.close()
    assert [chunk[:12] async for chunk in closing.body_iterator] == [b": mountnav\n\n", b"event: last\n"]


@pytest.mark.long
@given(st.dictionaries(st.text(max_size=8), st.one_of(st.text(max_size=20), st.floats(), st.none())))
def test_every_event_is_one_well_formed_message(data: dict[str, Any]) -> None:
    event = Events(5).publish("kind", data)
    text = event.wire.decode()
    assert text.endswith("\n\n")
    lines = text[:-2].split("\n")
    assert [line.partition(":")[0] for line in lines] == ["event", "data", "id"]

    def refuse(constant: str) -> Any:
        raise AssertionError(f"{constant} is not JSON")

    told = json.loads(lines[1].removeprefix("data: "), parse_constant=refuse)
    assert set(told) == {"utc", *data}


async def _read(client: httpx.AsyncClient, path: str, after: str | None = None) -> list[dict[str, Any]]:
    """A stream that ends by itself, whole. ASGI transports don't stream: only such ones can be read."""
    headers = {} if after is None else {"Last-Event-ID": after}
    answer = await asyncio.wait_for(client.get(path, headers=headers), 60)
    assert answer.headers["content-type"].startswith("text/event-stream")
    return _parsed(answer.text)


def _parsed(text: str) -> list[dict[str, Any]]:
    found = []
    for message in text.split("\n\n"):
        fields = dict(line.split(": ", 1) for line in message.split("\n") if ": " in line and line[0] != ":")
        if "data" in fields:
            found.append({**fields, "data": json.loads(fields["data"])})
    return found


@pytest.mark.long
async def test_a_jobs_stream_tells_it_to_its_end_and_can_be_resumed(client: httpx.AsyncClient) -> None:
    icrs = (await client.get(EAST)).json()["icrs"]
    place = {"ra_deg": icrs["ra_deg"], "dec_deg": icrs["dec_deg"] - 4.0}
    started = await client.post(f"{EAST}/slew", json=place)
    job_id = started.json()["id"]
    told = await _read(client, f"/v1/jobs/{job_id}/events")
    # from its beginning, though nobody listened then
    assert (told[0]["event"], told[0]["data"]["state"]) == ("job", "running")
    assert told[-1]["data"]["state"] == "succeeded"
    assert {one["data"]["job_id"] for one in told} == {job_id}
    assert {"slewing", "slewed"} <= {one["event"] for one in told}
    numbers = [int(one["id"].rpartition("-")[2]) for one in told]
    assert numbers == sorted(numbers)
    # once more, from the middle: the rest and nothing else
    middle = len(told) // 2
    assert await _read(client, f"/v1/jobs/{job_id}/events", told[middle]["id"]) == told[middle + 1 :]
    # after its end: all of it again, or the end alone
    assert await _read(client, f"/v1/jobs/{job_id}/events") == told
    (end,) = await _read(client, f"/v1/jobs/{job_id}/events", told[-1]["id"])
    assert end["data"]["state"] == "succeeded"
    assert (await client.get("/v1/jobs/nothing/events")).status_code == 404
    assert (await client.get("/v1/telescopes/nothing/events")).status_code == 404


async def test_a_telescopes_stream_is_about_it_alone(serving: Serve, observatory_toml: str) -> None:
    async with serving(observatory_toml) as client:
        app = client._transport.app  # type: ignore[attr-defined]
        events: Events = app.state.service.events
        jobs: Jobs = app.state.service.jobs
        before = f"{events.run}-{events.last}"
        jobs.heard("gone", "slewing", {"n": 1})
        jobs.heard("east", "slewing", {"n": 2})
        jobs.heard("gone", "slewed", {"n": 3})
        events.close()  # the stream goes on for ever otherwise
        told = await _read(client, "/v1/telescopes/gone/events", before)
        assert [one["data"]["n"] for one in told] == [1, 3]
