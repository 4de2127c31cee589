"""https: a certificate of the service's own or the operator's, and clients that shake no hands."""

from __future__ import annotations

import asyncio
import logging
import ssl
import stat
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from api.listeners import certificate as room
from api.listeners.certificate import own_certificate
from mountnav.errors import BadSettings
from mountnav.settings.observatory import Settings
from tests.api.conftest import OBSERVATORY
from tests.api.nova.nova_service import HINT, drawn, standing

pytest.importorskip("cryptography", reason="the extra `tls` is not installed")


def test_it_is_made_once_and_is_its_owners_alone(tmp_path: Path) -> None:
    folder = tmp_path / "state"
    path, fingerprint = own_certificate(folder, "127.0.0.1")
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    public = (folder / "nova-tls.crt").read_text()
    assert "PRIVATE" not in public
    assert "PRIVATE" in path.read_text()
    assert len(fingerprint.split(":")) == 32
    path.chmod(0o644)
    assert own_certificate(folder, "127.0.0.1") == (path, fingerprint)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    # another name or address needs another one; so does damage
    _, other = own_certificate(folder, "192.168.1.7")
    assert other != fingerprint
    path.write_text("damaged")
    _, mended = own_certificate(folder, "192.168.1.7")
    assert mended != other
    assert own_certificate(folder, "192.168.1.7")[1] == mended


def test_it_is_made_anew_before_it_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _, first = own_certificate(tmp_path, "127.0.0.1")
    later = datetime.now(UTC) + timedelta(days=780)

    class Later(datetime):
        @classmethod
        def now(cls, tz: object = None) -> datetime:  # type: ignore[override]
            return later

    monkeypatch.setattr(room, "datetime", Later)
    assert own_certificate(tmp_path, "127.0.0.1")[1] != first


def test_what_can_not_be_written_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(BadSettings, match="certificate"):
        own_certificate(tmp_path / "file", "127.0.0.1")


@pytest.mark.parametrize(
    "nova",
    [
        'tls = "files"',
        'certificate = "/a"',
        'tls = "self"\ncertificate = "/a"\ncertificate_key = "/b"',
        'tls = "yes"',
    ],
)
def test_settings_that_contradict_each_other(nova: str) -> None:
    with pytest.raises(BadSettings, match="tls"):
        Settings.parse(f"{OBSERVATORY}\n[nova]\nenabled = true\n{nova}")


@pytest.mark.long
async def test_a_client_that_trusts_the_certificate(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """As Ekos' does once the file lies among the system's; the name in the address is checked too."""
    own_certificate(tmp_path, "127.0.0.1")
    context = ssl.create_default_context(cafile=str(tmp_path / "nova-tls.crt"))
    with caplog.at_level(logging.INFO, "api.listeners.tls"):
        async with standing('tls = "self"', verify=context) as nova:
            assert nova.url.startswith("https://")
            job = await nova.solved(drawn(), **HINT)
            assert "ra" in (await nova.get(f"/api/jobs/{job}/calibration/")).json()
            # one that speaks no TLS gets nothing, and harms nobody
            reader, writer = await asyncio.open_connection("127.0.0.1", int(nova.url.rpartition(":")[2]))
            writer.write(b"GET / HTTP/1.1\r\nHost: x\r\n\r\n")
            async with asyncio.timeout(60):
                assert b"HTTP" not in await reader.read()
            writer.close()
            assert (await nova.get("/")).status_code == 200
    assert own_certificate(tmp_path, "127.0.0.1")[1] in caplog.text


@pytest.mark.long
async def test_an_operators_own_certificate(tmp_path: Path) -> None:
    made, _ = own_certificate(tmp_path / "other", "127.0.0.1")
    context = ssl.create_default_context(cafile=str(tmp_path / "other" / "nova-tls.crt"))
    files = f'tls = "files"\ncertificate = "{made}"\ncertificate_key = "{made}"'
    async with standing(files, verify=context) as nova:
        assert await nova.login()


async def test_clients_that_never_shake_hands_make_room(tmp_path: Path) -> None:
    own_certificate(tmp_path, "127.0.0.1")
    context = ssl.create_default_context(cafile=str(tmp_path / "nova-tls.crt"))
    async with standing('tls = "self"', verify=context) as nova:
        port = int(nova.url.rpartition(":")[2])
        silent = [await asyncio.open_connection("127.0.0.1", port) for _ in range(60)]
        try:
            assert await nova.login()
            # the first of them had to go
            async with asyncio.timeout(60):
                assert await silent[0][0].read() == b""
        finally:
            for _, writer in silent:
                writer.close()


async def test_a_certificate_that_is_none_shuts_the_port_and_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "a.pem").write_text("none")
    files = f'tls = "files"\ncertificate = "{tmp_path}/a.pem"\ncertificate_key = "{tmp_path}/a.pem"'
    with pytest.raises(AssertionError, match="certificate can't be used"):
        async with standing(files):
            pass
