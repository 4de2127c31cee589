"""Which mounts and cameras an INDI server has, as URLs for the settings."""

from __future__ import annotations

from dataclasses import dataclass
from urllib.parse import quote

from drivers.indi.client import IndiClient
from drivers.wire.wire_log import WireLog

_INTRODUCTION_S = 2.0
"""How long a server is listened to, s: it introduces all its devices within one. Doubled, a look for servers
takes as much longer."""
_TELESCOPE, _CCD = 1, 2
"""Bits of DRIVER_INTERFACE [INDI basedevice.h]."""


@dataclass(frozen=True, slots=True)
class IndiServer:
    """A server that answers.

    Attributes
    ----------
    address : str
        Host and port.
    mounts, cameras : tuple of str
        URLs of its devices.
    """

    address: str
    mounts: tuple[str, ...]
    cameras: tuple[str, ...]


async def server(host: str = "127.0.0.1", port: int = 7624) -> IndiServer:
    """Ask a server what it has. Connects no device.

    Raises
    ------
    DeviceMissing
        None answers there.
    """
    client = IndiClient(host, port, log=WireLog(kept=1))
    await client.open()
    try:
        await client.until(lambda: False, _INTRODUCTION_S)
        address = f"{host}:{port}"
        mounts, cameras = [], []
        for device in client.properties.devices():
            info = client.properties.get(device, "DRIVER_INFO")
            word = "" if info is None else (info.text("DRIVER_INTERFACE") or "")
            kinds = int(word) if word.isascii() and word.isdigit() and len(word) < 10 else 0
            url = f"indi://{address}/{quote(device)}"
            if kinds & _TELESCOPE:
                mounts.append(url)
            if kinds & _CCD:
                cameras.append(url)
        return IndiServer(address, tuple(mounts), tuple(cameras))
    finally:
        await client.close()
