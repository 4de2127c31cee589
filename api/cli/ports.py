"""`mountnav ports`: the serial ports of this machine, and on request what answers on them."""

from __future__ import annotations

import re
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from api.cli.options import json_option
from api.cli.output import print_json
from mountnav.errors import BadRequest

if TYPE_CHECKING:
    from drivers.ports import Port, Probed


def ports(
    probe: Annotated[
        bool,
        typer.Option(
            "--probe",
            help="Ask on each what is there: nothing that moves. Some boards restart when opened.",
        ),
    ] = False,
    port: Annotated[
        list[str] | None,
        typer.Option(help="Only this one: a device path or socket://host:port; repeatable."),
    ] = None,
    alpaca: Annotated[
        bool,
        typer.Option("--alpaca", help="Instead: Alpaca servers that answer on the networks of this machine."),
    ] = False,
    as_json: Annotated[bool, json_option("As JSON.")] = False,
) -> None:
    """List serial ports by their stable names, who holds them and, on request, what answers there."""
    found = _print_alpaca(as_json) if alpaca else _print_ports(port or [], probe, as_json)
    raise typer.Exit(0 if found else 1)


def _print_ports(names: list[str], probes: bool, as_json: bool) -> bool:
    """Whether there is a port; when probing, whether a known mount answers on one."""
    import asyncio

    from drivers.ports import serial_ports

    listed = [_named(name) for name in names] if names else serial_ports()
    probed = asyncio.run(_probe_all(listed)) if probes else {}
    if as_json:
        rows = [asdict(port) | ({"probed": asdict(probed[port.device])} if probes else {}) for port in listed]
        print_json(rows, indent=2)
    else:
        for port in listed:
            typer.echo(_words(port, probed.get(port.device)))
        if not listed:
            typer.echo("there are no serial ports on this machine")
    return any(answer.family for answer in probed.values()) if probes else bool(listed)


def _print_alpaca(as_json: bool) -> bool:
    """Whether an Alpaca server answers; its devices are listed as URLs for the settings."""
    import asyncio

    from drivers.alpaca.discovery import servers

    found = asyncio.run(servers())
    if as_json:
        print_json([asdict(server) for server in found], indent=2)
        return bool(found)
    for server in found:
        typer.echo(server.address)
        for device in server.devices:
            typer.echo(f"    alpaca+http://{server.address}/{device}")
    if not found:
        typer.echo("no Alpaca server answers on the networks of this machine")
    return bool(found)


def _named(name: str) -> Port:
    """The port of a device path, a TCP address or a mount's URL."""
    from drivers.ports import Port, serial_ports
    from drivers.registry import read_url

    if "+" in name.partition("://")[0]:
        # of a mount's URL, only the line is probed
        name = read_url(name).line
    elif name.startswith("tcp://"):
        name = f"socket://{name.removeprefix('tcp://')}"
    if "://" in name and not re.fullmatch(r"socket://[^/?#]+:[0-9]{1,5}", name):
        raise BadRequest(
            f"{name!r} is not a port that can be listed",
            advice="give a device path, tcp://host:port, or a mount's URL with a serial port or tcp",
        )
    for port in serial_ports():
        if name in (port.device, *port.names):
            return port
    return Port(name)


async def _probe_all(ports: list[Port]) -> dict[str, Probed]:
    from drivers.ports import probe

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
