"""https on the service's own port: its certificate, its renewal, clients that never shake hands."""

from __future__ import annotations

import asyncio
import hashlib
import os
import ssl
import stat
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import httpx
import pytest

from api.http.app import create_app
from api.http.serving import ObservatoryServer, bind, make_server
from mountnav.errors import BadSettings
from mountnav.settings.observatory import Settings


@asynccontextmanager
async def standing(toml: str) -> AsyncIterator[tuple[ObservatoryServer, int]]:
    app = create_app(Settings.parse(toml))
    server = make_server(app, log_level="warning")
    with bind("127.0.0.1", 0) as listener:
        task = asyncio.create_task(server._serve([listener]))
        async with asyncio.timeout(60):
            while not server.started:
                await asyncio.sleep(0.01)
        try:
            yield server, listener.getsockname()[1]
        finally:
            server.should_exit = True
            await task


async def served_fingerprint(port: int, trusted: Path) -> str:
    context = ssl.create_default_context(cafile=str(trusted))
    _, writer = await asyncio.open_connection("127.0.0.1", port, ssl=context)
    found = writer.get_extra_info("ssl_object").getpeercert(binary_form=True)
    writer.close()
    return hashlib.sha256(found).hexdigest()


@pytest.mark.long
async def test_the_service_speaks_https_with_a_certificate_of_its_own(
    observatory_toml: str, tmp_path: Path
) -> None:
    toml = observatory_toml.replace("[service]", '[service]\ntls = "self"')
    secret, public = tmp_path / "service-tls.pem", tmp_path / "service-tls.crt"
    async with standing(toml) as (server, port):
        assert stat.S_IMODE(secret.stat().st_mode) == 0o600
        assert b"PRIVATE" not in public.read_bytes()
        assert server.certificate is not None
        told = server.certificate.fingerprint.replace(":", "").lower()
        assert await served_fingerprint(port, public) == told
        silent = [await asyncio.open_connection("127.0.0.1", port) for _ in range(60)]
        context = ssl.create_default_context(cafile=str(public))
        async with httpx.AsyncClient(verify=context, trust_env=False, timeout=60) as client:
            url = f"https://127.0.0.1:{port}"
            assert (await client.post(f"{url}/v1/telescopes/east/stop")).status_code in (200, 202)
            # what stands before all routes knows it by its own name
            same = {"Origin": f"https://127.0.0.1:{port}"}
            assert (await client.get(f"{url}/v1/telescopes", headers=same)).status_code == 200
            async with client.stream("GET", f"{url}/v1/events") as events:
                assert await anext(events.aiter_lines()) == ": mountnav"
        async with asyncio.timeout(60):
            # the first of those that never shook hands had to go
            assert await silent[0][0].read() == b""
        for _, writer in silent:
            writer.close()
        # one that speaks plain HTTP is told nothing, and harms nobody
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(b"GET /v1/health HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
        async with asyncio.timeout(60):
            assert b"HTTP" not in await reader.read()
        writer.close()
        # renewed while it serves: who shakes hands from now on gets the new one
        os.unlink(secret)
        assert await asyncio.to_thread(server.certificate.refresh)
        anew = server.certificate.fingerprint.replace(":", "").lower()
        assert (anew != told, await served_fingerprint(port, public)) == (True, anew)
        assert not await asyncio.to_thread(server.certificate.refresh)
        # one that is broken leaves the one in force
        secret.unlink()
        secret.mkdir()
        with pytest.raises(BadSettings):
            await asyncio.to_thread(server.certificate.refresh)
        assert await served_fingerprint(port, public) == anew


@pytest.mark.parametrize("service", ['tls = "files"', 'certificate = "/a"', 'tls = "yes"'])
def test_settings_that_contradict_each_other(observatory_toml: str, service: str) -> None:
    with pytest.raises(BadSettings, match="tls"):
        Settings.parse(observatory_toml.replace("[service]", f"[service]\n{service}"))
