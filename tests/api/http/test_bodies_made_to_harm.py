"""Bodies that are nested 100,000 deep, or hold numbers of 5,000 digits, are problems of the caller's."""

from __future__ import annotations

import httpx
import pytest

BODIES = {
    "brackets": b"[" * 100_000,
    "objects": b'{"a":' * 40_000 + b"1" + b"}" * 40_000,
    "digits": b'{"exposure_s": ' + b"1" * 5000 + b"}",
    "nan": b'{"exposure_s": NaN}',
    "surrogate": b'{"exposure_s": "\xed\xa0\x80"}',
}


@pytest.mark.long
@pytest.mark.parametrize("body", BODIES.values(), ids=BODIES)
async def test_a_harmful_body_is_a_problem(client: httpx.AsyncClient, body: bytes) -> None:
    for path in ("/v1/telescopes/east/look", "/v1/telescopes/east/center"):
        answer = await client.post(path, content=body, headers={"content-type": "application/json"})
        assert 400 <= answer.status_code < 500, answer.text[:300]
        assert answer.headers["content-type"] == "application/problem+json"
        assert len(answer.content) < 5000
    assert (await client.get("/v1/health")).status_code == 200
