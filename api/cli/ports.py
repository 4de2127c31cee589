"""`mountnav ports`: the serial ports of this machine, and on request what answers on them."""

from __future__ import annotations

import asyncio
import json
import re
from dataclasses import asdict

import typer

from drivers.ports import Port, Probed, probe, serial_ports
from drivers.registry import read_url
from mountnav.errors import BadRequest


def run(*, asks: bool, ports: tuple[str, ...], as_json: bool) -> int:
    """List the ports, or those named, and probe them if asked to.

    Parameters
    ----------
    asks : bool
        Whether to probe.
    ports : tuple of str
        Device paths, ``tcp://host:port`` or mounts' URLs; all serial ports if empty.
    as_json : bool

    Returns
    -------
    int
        0, or 1 if nothing is there or, when probing, nothing known answers.
    """
    there = [_named(port) for port in ports] if ports else serial_ports()
    probed = asyncio.run(_probe_all(there)) if asks else {}
    if as_json:
        rows = [asdict(port) | ({"probed": asdict(probed[port.device])} if asks else {}) for port in there]
        typer.echo(json.dumps(rows, indent=2))
    else:
        for port in there:
            typer.echo(_words(port, probed.get(port.device)))
        if not there:
            typer.echo("there are no serial ports on this machine")
    if asks:
        return 0 if any(one.family for one in probed.values()) else 1
    return 0 if there else 1


def run_alpaca(*, as_json: bool) -> int:
    """List the Alpaca servers that answer, with URLs for the settings; 1 if none does."""
    from drivers.alpaca.discovery import servers

    found = asyncio.run(servers())
    if as_json:
        typer.echo(json.dumps([asdict(one) for one in found], indent=2))
        return 0 if found else 1
    for one in found:
        typer.echo(one.address)
        for device in one.devices:
            typer.echo(f"    alpaca+http://{one.address}/{device}")
    if not found:
        typer.echo("no Alpaca server answers on the networks of this machine")
    return 0 if found else 1


def _named(name: str) -> Port:
    if "+" in name.partition("://")[0]:
        # a mount's URL: its line alone is asked
        name = read_url(name).line
    elif name.startswith("tcp://"):
        name = f"socket://{name.removeprefix('tcp://')}"
    if "://" in name and not re.fullmatch(r"socket://[^/?#]+:[0-9]{1,5}", name):
        raise BadRequest(
            f"{name!r} is no port that can be listed",
            advice="give a device path, tcp://host:port, or a mount's URL with a serial port or tcp",
        )
    for port in serial_ports():
        if name in (port.device, *port.names):
            return port
    return Port(name)


async def _probe_all(ports: list[Port]) -> dict[str, Probed]:
    return {port.device: await probe(port.device) for port in ports}


def _words(port: Port, probed: Probed | None) -> str:
    """One port on a line, what belongs to it indented below."""
    known = [part for part in (port.manufacturer, port.product) if part]
    if port.serial_number:
        known.append(f"serial number {port.serial_number}")
    lines = [port.device + (f"  {', '.join(known)}" if known else "")]
    lines += [f"    {name}" for name in port.names]
    if port.held_by:
        lines.append(f"    held by {', '.join(port.held_by)}")
    if probed is not None and probed.family:
        speed = f" at {probed.baud} baud" if probed.baud else ""
        lines.append(f"    {probed.family}{speed}: {probed.answer}")
        lines.append(f"    {_url(port, probed)}")
    elif probed is not None:
        lines.append(f"    {probed.answer}")
    return "\n".join(lines)


def _url(port: Port, probed: Probed) -> str:
    """Address for the settings, by the stable name."""
    if "://" in port.device:
        return f"{probed.family}+tcp://{port.device.partition('://')[2]}"
    name = port.names[0] if port.names else port.device
    return f"{probed.family}+serial://{name}?baud={probed.baud}"
