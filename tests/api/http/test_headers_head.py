"""HEAD, as watchdogs and load balancers send it: what GET would answer, without the body."""

from __future__ import annotations

import httpx
import pytest

EAST = "/v1/telescopes/east"


@pytest.mark.long
@pytest.mark.parametrize("path", ["/v1/health", "/v1/capabilities", "/", "/v1/jobs/nothing"])
async def test_head_tells_what_get_would(client: httpx.AsyncClient, path: str) -> None:
    got = await client.get(path)
    head = await client.head(path)
    assert (head.status_code, head.content) == (got.status_code, b"")
    assert head.headers["content-type"] == got.headers["content-type"]
    assert int(head.headers["content-length"]) > 0


async def test_head_of_a_state_has_its_tag(client: httpx.AsyncClient) -> None:
    tag = (await client.head(EAST)).headers["etag"]
    assert (await client.head(EAST, headers={"If-None-Match": tag})).status_code in {200, 304}


async def test_head_of_a_stream_ends(client: httpx.AsyncClient) -> None:
    head = await client.head("/v1/events")
    assert (head.status_code, head.content) == (200, b"")
    assert head.headers["content-type"].startswith("text/event-stream")


async def test_what_only_acts_has_no_head(client: httpx.AsyncClient) -> None:
    head = await client.head(f"{EAST}/stop")
    assert (head.status_code, head.headers["allow"]) == (405, "POST")
    assert (await client.put(EAST)).headers["allow"] == "GET, HEAD"
