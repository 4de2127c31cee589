"""`mountnav init`: writes the first settings file from a few answers, or from flags alone."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer

from api.cli.options import takes_options
from mountnav.errors import BadRequest, BadSettings, MountnavError

Answer = TypeVar("Answer")

FAKE = "fake+lx200://"
"""A mount that the service runs itself: everything can be tried by day."""
_MOUNTINGS = ("german", "fork", "altaz")
"""As the settings know them."""
_HEIGHTS_M = (-500.0, 9000.0)
"""Least and greatest height of a site, m, as the settings allow. Doubled, the file would be refused
afterwards."""
_MOST_SCALE_ARCSEC_PX = 600.0
"""Greatest scale of a camera, arcsec per pixel, as the settings allow. Doubled, the file would be refused
afterwards."""


@dataclass(frozen=True, slots=True, kw_only=True)
class InitOptions:
    """The options of the command: each is a question that isn't asked then."""

    out: Annotated[Path, typer.Option("--out", "-o", help="The file to write.")] = Path("observatory.toml")
    force: Annotated[bool, typer.Option("--force", help="Overwrite an existing file.")] = False
    latitude: Annotated[str | None, typer.Option(help="Degrees, north positive: 47.269 or 47:16:09.")] = None
    longitude: Annotated[str | None, typer.Option(help="Degrees, EAST positive: 11.404, -70.4.")] = None
    height: Annotated[float | None, typer.Option(help="Above the sea, m.")] = None
    mount: Annotated[
        str | None,
        typer.Option(help="Its URL, as `mountnav ports --probe` shows it; fake: one without hardware."),
    ] = None
    mounting: Annotated[str | None, typer.Option(help="german, fork or altaz.")] = None
    camera: Annotated[
        str | None,
        typer.Option(
            help="The folder in which a program writes frames, or the URL of an INDI or Alpaca camera; "
            "simulated: on a fake mount."
        ),
    ] = None
    scale: Annotated[
        float | None, typer.Option(help="Of the camera, arcseconds per pixel; 0: the frames tell.")
    ] = None
    name: Annotated[str, typer.Option(help="The telescope's id in the API.")] = "main"
    look: Annotated[
        bool,
        typer.Option("--look/--no-look", help="Look for serial ports, INDI and Alpaca servers to choose of."),
    ] = True


def write_first_settings(asked: InitOptions) -> int:
    """Write a settings file from a few answers; flags answer without being asked.

    Without a terminal nothing is asked: what has no flag is an error, or its usual value.
    """
    if asked.out.exists() and not asked.force:
        raise BadRequest(f"{asked.out} is there already", advice="name another file, or give --force")
    answers = _answers(asked, _Asker(sys.stdin.isatty() and sys.stdout.isatty()))
    text = _settings(answers)
    from mountnav.files import replace_bytes
    from mountnav.settings.observatory import Settings

    Settings.parse(text, name=str(asked.out))
    replace_bytes(asked.out, text.encode())
    typer.echo(f"{asked.out} is written. Next:")
    typer.echo(f"    mountnav check --connect --config {asked.out}")
    typer.echo(f"    mountnav serve --config {asked.out}")
    return 0


init = takes_options(InitOptions)(write_first_settings)


class _Asker:
    """Asks on a terminal; without one each question has to be answered by a flag or its usual answer."""

    def __init__(self, terminal: bool) -> None:
        self.terminal = terminal

    def ask(self, question: str, flag: str, usual: str | None = None) -> str:
        """The answer in words."""
        if not self.terminal:
            if usual is None:
                raise BadRequest(f"{question} isn't known", advice=f"give {flag}, or run it in a terminal")
            return usual
        return str(typer.prompt(question, default=usual))

    def read(
        self,
        given: str | float | None,
        question: str,
        flag: str,
        reader: Callable[[str], Answer],
        usual: str | None = None,
        *,
        offers: list[tuple[str, str]] | None = None,
    ) -> Answer:
        """What a flag says, or an answer; one that makes no sense is asked for again on a terminal.

        Parameters
        ----------
        reader : callable
            Makes the value of the words, or raises a `MountnavError`.
        offers : list of (str, str), optional
            As of `choose`.
        """
        if given is not None:
            return reader(str(given))
        while True:
            try:
                if offers is None:
                    return reader(self.ask(question, flag, usual))
                return reader(self.choose(question, flag, offers, usual or ""))
            except MountnavError as wrong:
                if not self.terminal:
                    raise
                typer.echo(f"  {wrong}", err=True)

    def choose(self, question: str, flag: str, offers: list[tuple[str, str]], usual: str) -> str:
        """One of some offers by its number, or anything that is typed.

        Parameters
        ----------
        offers : list of (str, str)
            Each: what it stands for in the settings, and words.
        """
        if not self.terminal:
            return usual
        for number, (value, words) in enumerate(offers, start=1):
            typer.echo(f"  {number}  {value}  {words}".rstrip())
        typed = self.ask(f"{question} (a number, or type it)", flag, usual).strip()
        if typed.isdecimal() and 1 <= int(typed) <= len(offers):
            return offers[int(typed) - 1][0]
        return typed


def _answers(asked: InitOptions, asker: _Asker) -> dict[str, Any]:
    """What the file is to say."""
    latitude = asker.read(
        asked.latitude, "Latitude, north positive", "--latitude", lambda text: _angle(text, 90.0, "latitude")
    )
    longitude = asker.read(
        asked.longitude,
        "Longitude, EAST positive",
        "--longitude",
        lambda text: _angle(text, 360.0, "longitude"),
    )
    height = asker.read(
        asked.height, "Height, m", "--height", lambda text: _number(text, *_HEIGHTS_M, "height in m"), "0"
    )
    mounts, cameras = _around(asker, asked)
    usual = mounts[0][0] if mounts else FAKE
    mount = asker.read(
        asked.mount,
        "Mount",
        "--mount",
        _mount_url,
        usual,
        offers=[*mounts, (FAKE, "no hardware: a fake")],
    )
    fake = mount.startswith("fake+")
    mounting = asker.read(
        asked.mounting, "Mounting: german, fork or altaz", "--mounting", _mounting, "german"
    )
    camera = asked.camera
    if camera is None:
        usual = "simulated" if fake else cameras[0][0] if cameras else "frames"
        offers = [*cameras, *([("simulated", "draws the sky")] if fake else [])]
        camera = asker.choose("Camera: a folder of frames, or", "--camera", offers, usual)
    scale = asker.read(
        asked.scale,
        "Camera's scale, arcseconds per pixel (0: the frames tell)",
        "--scale",
        lambda text: _number(text, 0.0, _MOST_SCALE_ARCSEC_PX, "scale in arcseconds per pixel"),
        "0",
    )
    return {
        "latitude": latitude,
        "longitude": longitude,
        "height": height,
        "mount": mount,
        "mounting": mounting,
        "camera": camera,
        "scale": scale,
        "name": asked.name,
    }


def _angle(text: str, most: float, what: str) -> float:
    """Degrees, as people write them."""
    try:
        value = float(text)
    except ValueError:
        value = _degrees(text, what)
    if not -most <= value <= most:
        raise BadRequest(f"a {what} of {value:g}°", advice=f"between {-most:g} and {most:g}")
    return value


def _number(text: str, least: float, most: float, what: str) -> float:
    """A plain number."""
    try:
        value = float(text)
    except ValueError as wrong:
        raise BadRequest(f"{text!r} is not a {what}", advice="a plain number, such as 600") from wrong
    if not least <= value <= most:
        raise BadRequest(f"a {what} of {value:g}", advice=f"between {least:g} and {most:g}")
    return value


def _mounting(text: str) -> str:
    """How its axes turn."""
    if text not in _MOUNTINGS:
        raise BadRequest(f"{text!r} is no mounting", advice=f"one of {', '.join(_MOUNTINGS)}")
    return text


def _mount_url(text: str) -> str:
    """A mount's URL, as far as it can be judged without opening anything."""
    from drivers.registry import fake_protocols, read_url

    url = FAKE if text == "fake" else text
    if not url.startswith("fake+"):
        read_url(url)
    elif (protocol := url.removeprefix("fake+").partition(":")[0]) not in (known := fake_protocols()):
        raise BadRequest(f"there is no fake mount of {protocol!r}", advice=f"there is: {', '.join(known)}")
    return url


_NUMBER = r"(\d+(?:\.\d*)?)"
"""One number of a typed angle."""
_TYPED_ANGLE = re.compile(
    rf"([+\-−]?)\s*{_NUMBER}(?:(?:\s*[°d:]\s*|\s+){_NUMBER}(?:(?:\s*[′'m:]\s*|\s+){_NUMBER}\s*[″\"s]?)?"
    r"\s*[′'m]?)?\s*[°d]?\s*([NSEW]?)",
    re.ASCII,
)
"""Degrees, minutes and seconds with any usual marks or none, then the half of the Earth."""
_HALVES = {"latitude": "NS", "longitude": "EW"}
"""The positive half of the Earth, then the negative one."""


def _degrees(text: str, what: str) -> float:
    """An angle in degrees, minutes and seconds, with a sign or the half of the Earth: ``33 51 35 S``."""
    told = _TYPED_ANGLE.fullmatch(text.strip())
    halves = _HALVES[what]
    numbers = [float(one) for one in told.groups()[1:4] if one] if told else []
    sign, half = (told[1], told[5]) if told else ("", "")
    if not numbers or any(one >= 60.0 for one in numbers[1:]) or (half and (sign or half not in halves)):
        example = f"such as 11.404, 11:24:15 or 11 24 15 {halves[0]}"
        raise BadRequest(f"{text!r} is not a {what}", advice=example)
    size = sum(number / 60.0**power for power, number in enumerate(numbers))
    return -size if sign in ("-", "−") or half == halves[1] else size


def _around(asker: _Asker, asked: InitOptions) -> tuple[list[tuple[str, str]], list[tuple[str, str]]]:
    """Mounts and cameras that are there to choose of: URLs with words. Nothing is opened."""
    if not asked.look or not asker.terminal or (asked.mount and asked.camera):
        return [], []
    import asyncio

    from drivers.alpaca.discovery import servers
    from drivers.indi.discovery import server
    from drivers.ports import serial_ports
    from mountnav.errors import DeviceError

    mounts, cameras = list[tuple[str, str]](), list[tuple[str, str]]()

    async def networks() -> None:
        try:
            indi = await server()
            mounts.extend((url, "on this machine's INDI server") for url in indi.mounts)
            cameras.extend((url, "on this machine's INDI server") for url in indi.cameras)
        except DeviceError:
            pass  # none runs here
        for alpaca in await servers():
            for device in alpaca.devices:
                url = f"alpaca+http://{alpaca.address}/{device}"
                if device.startswith("telescope"):
                    mounts.append((url, "Alpaca"))
                elif device.startswith("camera"):
                    cameras.append((url, "Alpaca"))

    typer.echo("Looking for INDI and Alpaca servers and serial ports ...", err=True)
    asyncio.run(networks())
    for port in serial_ports():
        name = port.names[0] if port.names else port.device
        words = " ".join(filter(None, (port.manufacturer, port.product)))
        mounts.append((f"lx200+serial://{name}?baud=9600", f"{words} (which family: mountnav ports --probe)"))
    return mounts, cameras


def _quoted(text: str) -> str:
    """A TOML string."""
    if any(ord(letter) < 32 for letter in text):
        raise BadSettings("a control character in an answer", advice="type it again")
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


def _settings(answers: dict[str, Any]) -> str:
    """The file's text."""
    scale = answers["scale"]
    camera = _camera(answers["camera"])
    scale_line = (
        f"scale_arcsec_px = {scale:g}            # of the camera\n"
        if scale and answers["camera"] != "simulated"
        else "# scale_arcsec_px = 1.37        # of the camera; as it is the frames' headers tell\n"
    )
    mounting = f"mounting = {_quoted(answers['mounting'])}             # how its axes turn, for the limits"
    return f"""\
# mountnav: an observatory's settings, written by mountnav init.
# Check them:  mountnav check --connect      Serve them:  mountnav serve --config THIS_FILE
# Every unit stands in the name. Unknown names are refused. All settings: mountnav docs configuration

[service]
host = "127.0.0.1"              # only this machine. Anything wider needs keys: mountnav key new NAME
port = 8000                     # the page at /, REST at /v1, Alpaca at /api/v1

[site]
latitude_deg = {answers["latitude"]:.6f}          # north positive
longitude_deg = {answers["longitude"]:.6f}         # EAST positive: west of Greenwich is negative
height_m = {answers["height"]:.1f}

[air]                           # for refraction
pressure_hpa = {_pressure_hpa(answers["height"]):.0f}              # of the station, not reduced to sea level
temperature_c = 10.0

[[telescope]]
id = {_quoted(answers["name"])}                     # its name in the API: /v1/telescopes/{answers["name"]}
exposure_s = 2.0                # of a look
{scale_line}
[telescope.mount]
url = {_quoted(answers["mount"])}
{mounting}

[telescope.camera]
{camera}
[telescope.limits]              # `mountnav docs limits` has them all: set them before the first slew
min_altitude_deg = 15.0         # nothing is slewed to, passed or tracked below this
sun_cone_deg = 20.0             # the tube stays at least this far from the Sun
# past_meridian_east_deg = 10.0 # German mounts: how far past the meridian, on each side of the pier
# past_meridian_west_deg = 10.0
# horizon_file = "horizon.txt"  # azimuth and altitude, a pair a line

[telescope.centering]
tolerance_arcsec = 30.0         # this near counts as centered

[telescope.sync]                # `mountnav docs syncing`
rule = "when-off-by"            # or never, first-of-night, per-target, always
off_by_arcsec = 10.0
"""


def _pressure_hpa(height_m: float) -> float:
    """The usual pressure at a height, by the ICAO standard atmosphere."""
    return float(1013.25 * (1.0 - 2.25577e-5 * min(max(height_m, -500.0), 9000.0)) ** 5.2559)


def _camera(told: str) -> str:
    """The lines of the camera's table."""
    if told == "simulated":
        return 'kind = "simulated"             # draws the true sky where the fake really points\n'
    if told.startswith("indi://"):
        return f'kind = "indi"\nurl = {_quoted(told)}\n'
    if told.startswith("alpaca+"):
        return f'kind = "alpaca"\nurl = {_quoted(told)}\n'
    return (
        'kind = "folder"                # a program that writes FITS files with DATE-OBS and EXPTIME\n'
        f"path = {_quoted(told)}\n"
    )
