"""What several commands share: options, commands whose options are a dataclass, options of many values.

Each command file declares an option once, in the parameters of the command or in the dataclass that it takes.
All of these files are imported for `mountnav --help`, so they import at the top only what is quick; what a
command needs for its work is imported when it runs.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from dataclasses import MISSING, asdict, dataclass, fields
from pathlib import Path
from typing import Annotated, Any, ClassVar, TypeVar, get_type_hints

import typer
from typer.core import TyperCommand

from mountnav.sky.typed_coordinates import read_dec_deg, read_ra_deg

Options = TypeVar("Options")

LOCAL_SERVICE = "http://127.0.0.1:8000"
"""Where `mountnav serve` listens by default: [service] host and port of the settings."""


def config_option(text: str) -> Any:
    """The option --config, -c of a settings file; `text` says what of the file is used."""
    # whether it can be read is told in one line by who reads it
    return typer.Option("--config", "-c", help=text, readable=False)


def json_option(text: str = "JSON, for programs.") -> Any:
    """The option --json."""
    return typer.Option("--json", help=text)


Json = Annotated[bool, json_option()]

# where a frame lies, and how it is solved
RA_OPTION = typer.Option(parser=read_ra_deg, metavar="RA", help="Center (ICRS): degrees, or 12h30m45s.")
DEC_OPTION = typer.Option(parser=read_dec_deg, metavar="DEC", help="Center (ICRS): degrees, or +10:20:30.")
Ra = Annotated[float | None, RA_OPTION]
Dec = Annotated[float | None, DEC_OPTION]
Radius = Annotated[float | None, typer.Option(help="How far the true center may be from it, degrees.")]
Scale = Annotated[float | None, typer.Option(help="Arcseconds per pixel, good to 5 %.")]
Calibration = Annotated[Path | None, typer.Option(help="Folder of masters to calibrate with.")]
Profile = Annotated[str | None, typer.Option(help="Parameters: measured or paper.")]
Budget = Annotated[
    float | None,
    typer.Option(min=0.01, max=3600, help="Seconds for identifying a frame; 30 if not given."),
]
Config = Annotated[Path | None, config_option("Settings file: its solving and catalogs tables are used.")]
Catalog = Annotated[
    str | None,
    typer.Option(
        help="Use this star catalog alone (see `mountnav catalog list`); else the one that suits the frame."
    ),
]

# a running service, and a telescope of it
Service = Annotated[str, typer.Option(envvar="MOUNTNAV_SERVICE", help="Address of the service.")]
Token = Annotated[str | None, typer.Option(envvar="MOUNTNAV_TOKEN", help="API token of the service.")]
ChosenTelescope = Annotated[
    str | None,
    typer.Option("--telescope", "-t", help="Which telescope; needed only where there are several."),
]


@dataclass(frozen=True, kw_only=True)
class ServiceOptions:
    """Options of a command to a running service."""

    service: Service = LOCAL_SERVICE
    token: Token = None
    as_json: Json = False


@dataclass(frozen=True, kw_only=True)
class TelescopeOptions(ServiceOptions):
    """Options of a command to a running service about one of its telescopes."""

    telescope: Annotated[str, typer.Argument(help="Id of the telescope.")]


_WHERE = ("source", "config", "telescope", "since", "until", "latitude", "longitude")


@dataclass(frozen=True, kw_only=True)
class LooksOptions:
    """Options of a command that judges a mount by its looks."""

    source: Annotated[
        str | None,
        typer.Argument(
            metavar="[SOURCE]",
            help="Observations (.jsonl), or a journal's file or URL; the service's journal if not given.",
            show_default=False,
        ),
    ] = None
    config: Annotated[
        Path | None, config_option("Settings file: site, journal and the telescope are taken from it.")
    ] = None
    telescope: Annotated[str | None, typer.Option("--telescope", "-t", help="Which one of the journal.")] = (
        None
    )
    since: Annotated[
        str | None, typer.Option(help="From this time on: 2026-11-21T20:00 (UTC), or 12h ago.")
    ] = None
    until: Annotated[str | None, typer.Option(help="Up to this time.")] = None
    latitude: Annotated[
        float | None, typer.Option(help="Of the site, degrees, instead of the settings'.")
    ] = None
    longitude: Annotated[float | None, typer.Option(help="Of the site, degrees, EAST positive.")] = None
    model: Annotated[
        Path | None, typer.Option(help="A pointing model's file: what is known of the mount.")
    ] = None
    as_json: Json = False

    def where(self) -> dict[str, Any]:
        """Which looks are meant: the arguments of `api.pointing.looks.read_looks`."""
        given = asdict(self)
        return {name: given[name] for name in _WHERE}


def takes_options(options: type[Options]) -> Callable[[Callable[[Options], int | None]], Callable[..., None]]:
    """Make a command of a function that takes a dataclass and returns an exit code, or None for 0.

    The fields of the dataclass are the options of the command: ``speed: Annotated[float,
    typer.Option(...)]``. So a command of many options declares each once, and hands them on as one value.
    What several commands share is a base class, whose options come after the command's own.
    """

    def command_of(work: Callable[[Options], int | None]) -> Callable[..., None]:
        @functools.wraps(work)
        def command(**values: Any) -> None:
            raise typer.Exit(work(options(**values)) or 0)

        hints = get_type_hints(options, include_extras=True)
        own_first = {name: None for one in options.__mro__ for name in vars(one).get("__annotations__", ())}
        known = {field.name: field for field in fields(options)}  # type: ignore[arg-type]
        parameters = [
            inspect.Parameter(
                field.name,
                inspect.Parameter.KEYWORD_ONLY,
                default=inspect.Parameter.empty if field.default is MISSING else field.default,
                annotation=hints[field.name],
            )
            for field in (known[name] for name in own_first if name in known)
        ]
        # typer reads the options from these two
        command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        command.__annotations__ = hints
        return command

    return command_of


class ManyValues(TyperCommand):
    """A command whose options named in `many` may be followed by several values: ``--dark a.fits b.fits``.

    A shell gives `*.fits` as several words; typer's own lists want the option's name before each of them.
    """

    many: ClassVar[frozenset[str]] = frozenset({"--bias", "--dark", "--flat", "--flat-from-lights"})

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Repeat the option's name before each of its values, then parse as usual."""
        spread: list[str] = []
        name, values = "", 0
        for word in args:
            if word.startswith("-") and len(word) > 1:
                name, values = (word if word in self.many else ""), 0
            elif name:
                if values:
                    spread.append(name)
                values += 1
            spread.append(word)
        return super().parse_args(ctx, spread)
