"""`mountnav fake-mount`: a fake on a pseudo-terminal or a TCP port, until interrupted."""

from __future__ import annotations

import signal
from pathlib import Path

from drivers.bench import FakeOnPty, FakeOnTcp
from drivers.lx200.fake import FakeLx200
from mountnav.errors import BadRequest, DeviceMissing
from mountnav.simulation.mechanics import Mechanics
from mountnav.simulation.pointing_errors import PointingErrors
from mountnav.sky.coordinates import Air, Site
from mountnav.sky.iers import prepare

_PROTOCOLS = ("lx200",)


def run(
    protocol: str,
    *,
    link: Path | None,
    tcp: str | None,
    errors: Path | None,
    latitude_deg: float,
    longitude_deg: float,
) -> int:
    """Serve until SIGINT or SIGTERM; the symlink is taken away again.

    Raises
    ------
    BadRequest
        Options that make no sense.
    DeviceMissing
        The link or the port can't be had.
    """
    if protocol not in _PROTOCOLS:
        raise BadRequest(
            f"there is no fake that speaks {protocol}", advice=f"there is: {', '.join(_PROTOCOLS)}"
        )
    if link is not None and tcp is not None:
        raise BadRequest("--link and --tcp together", advice="give one of them")
    if link is not None and link.exists() and not link.is_symlink():
        raise BadRequest(f"{link} exists and is no symlink", advice="give a path that is free")
    address = None if tcp is None else _host_and_port(tcp)
    stop_signals = {signal.SIGINT, signal.SIGTERM}
    # Blocked before the fake's thread starts, which inherits it: the signal then waits for sigwait below,
    # and the symlink is taken away whenever it comes.
    signal.pthread_sigmask(signal.SIG_BLOCK, stop_signals)
    prepare()
    pointing = PointingErrors() if errors is None else PointingErrors.from_toml(errors)
    mechanics = Mechanics(Site(latitude_deg, longitude_deg), Air(pressure_hpa=1010.0), pointing)
    fake = FakeLx200(mechanics)
    bench = FakeOnPty(fake, link) if address is None else FakeOnTcp(fake, *address)
    try:
        bench.start()
    except OSError as error:
        raise DeviceMissing(
            f"can't be served: {error.strerror or error}",
            device=tcp or str(link),
            advice="give another address",
        ) from error
    try:
        print(bench.address, flush=True)
        signal.sigwait(stop_signals)
    finally:
        bench.stop()
    return 0


def _host_and_port(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    if not host or not (port.isascii() and port.isdigit() and int(port) <= 65535):
        raise BadRequest(f"--tcp {text} is no HOST:PORT", advice="for example --tcp 127.0.0.1:4030")
    return host.strip("[]"), int(port)
