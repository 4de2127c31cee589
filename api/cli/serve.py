"""`mountnav serve`: serves an observatory, the one of the settings or a virtual one."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from api.cli.options import config_option, takes_options
from mountnav.errors import BadRequest
from mountnav.start_up import no_garbage_sought

if TYPE_CHECKING:
    from pydantic import ValidationError

    from mountnav.settings.demo import DemoSettings
    from mountnav.settings.observatory import Settings

DEMO_PORT = 8000
"""Where a virtual observatory without settings listens if --port is not given: the settings' own default."""


class VirtualMounting(StrEnum):
    """How a virtual mount is built.

    An enumeration, since help lists its members in this order: for `typing` two Literals of the same values
    are the same in whichever order, and `mountnav bench` has them in the other one.
    """

    GERMAN = "german"
    FORK = "fork"


class Tls(StrEnum):
    """How the port speaks."""

    OFF = "off"
    SELF = "self"


class LogForms(StrEnum):
    """How lines of the log are written."""

    AUTO = "auto"
    TEXT = "text"
    JSON = "json"
    JOURNALD = "journald"


@dataclass(frozen=True, slots=True, kw_only=True)
class ServeOptions:
    """The options of the command."""

    config: Annotated[Path | None, config_option("The settings (TOML).")] = None
    demo: Annotated[
        bool, typer.Option("--demo", help="A virtual observatory: a fake mount under the true sky.")
    ] = False
    at: Annotated[
        str | None,
        typer.Option(
            metavar="UTC|night",
            help="When the virtual time begins: 2026-12-01T22:00:00Z, or night: now if it is dark, else "
            "the beginning of the next night. Now if left out.",
        ),
    ] = None
    speed: Annotated[float | None, typer.Option(help="Virtual seconds in a second, 0.1 to 60.")] = None
    seed: Annotated[
        int | None, typer.Option(help="Seed of the mount's errors; the same seed gives the same mount.")
    ] = None
    mounting: Annotated[VirtualMounting | None, typer.Option(help="Of the virtual mount.")] = None
    port: Annotated[
        int | None, typer.Option(min=0, max=65535, help="Instead of the settings'; 0: any that is free.")
    ] = None

    tls: Annotated[
        Tls | None,
        typer.Option(help="https: self, with a certificate that it makes itself. Instead of the settings'."),
    ] = None
    log_form: Annotated[
        LogForms | None,
        typer.Option(help="Lines of the log: text, json, or journald. Instead of the settings'."),
    ] = None

    @property
    def virtual(self) -> dict[str, object]:
        """Those of the virtual time and mount that were given, as the [demo] table names them."""
        given = {"at": self.at, "speed": self.speed, "seed": self.seed}
        return {name: value for name, value in given.items() if value is not None}


def serve_observatory(asked: ServeOptions) -> int:
    """Serve an observatory: the page at /, REST under /v1, its description at /docs, Alpaca under /api/v1."""
    settings = _served(settings_of(asked), asked)
    # only now: all of the service takes seconds to import, and wrong settings are refused without it
    with no_garbage_sought():
        from api.http.serving import serve as serve_settings
        from api.observatory.observatory import require_devices

    # all devices before anything is opened: a wrong one is one line, and starting again won't help
    require_devices(settings, asked.config)

    def read_again() -> Settings:
        again = _served(settings_of(asked), asked)
        require_devices(again, asked.config)
        return again

    return serve_settings(settings, read_again=None if asked.config is None else read_again)


serve = takes_options(ServeOptions)(serve_observatory)


def _served(settings: Settings, asked: ServeOptions) -> Settings:
    """The settings with how the port speaks, as the options say it."""
    changes: dict[str, object] = {}
    if asked.tls is not None:
        changes |= {"tls": asked.tls.value, "certificate": None, "certificate_key": None}
    if asked.log_form is not None:
        changes["log_form"] = asked.log_form.value
    if not changes:
        return settings
    return settings.model_copy(update={"service": settings.service.model_copy(update=changes)})


def settings_of(asked: ServeOptions) -> Settings:
    """The settings that options and file say together; an option goes before the file.

    Raises
    ------
    BadRequest
        Options that make no sense.
    BadSettings
        The settings can't be served.
    """
    from pydantic import ValidationError

    from mountnav.settings.observatory import Settings

    if asked.config is None:
        if not asked.demo:
            raise BadRequest(
                "there is nothing to serve",
                advice="give --config observatory.toml, or --demo for a virtual observatory",
            )
        from api.demo.observatory import demo_service_settings

        port = DEMO_PORT if asked.port is None else asked.port
        return demo_service_settings(
            _demo(asked, None), port, "fork" if asked.mounting is VirtualMounting.FORK else "german"
        )
    settings = Settings.load(asked.config)
    changes: dict[str, object] = {}
    if asked.mounting is not None:
        raise BadRequest(
            "--mounting is for --demo without --config", advice="set telescope.mount.mounting in the file"
        )
    if asked.demo or settings.demo is not None:
        changes["demo"] = _demo(asked, settings.demo)
    else:
        _refuse_virtual_options(asked)
    if asked.port is not None:
        changes["service"] = settings.service.model_copy(update={"port": asked.port})
    if not changes:
        return settings
    try:
        # copies are not checked by themselves: a virtual time may not meet a real mount
        return Settings.model_validate(settings.model_copy(update=changes).model_dump())
    except ValidationError as error:
        raise BadRequest(_first(error), device=str(asked.config)) from error


def _refuse_virtual_options(asked: ServeOptions) -> None:
    for name in asked.virtual:
        raise BadRequest(f"--{name} is for a virtual observatory", advice="add --demo")


def _demo(asked: ServeOptions, file: DemoSettings | None) -> DemoSettings:
    """The [demo] table of the file, with the options in its place. Raises `BadRequest`."""
    from pydantic import ValidationError

    from mountnav.settings.demo import DemoSettings

    given: dict[str, object] = {} if file is None else file.model_dump()
    try:
        return DemoSettings.model_validate(given | asked.virtual)
    except ValidationError as error:
        raise BadRequest(f"the virtual time: {_first(error)}") from error


def _first(error: ValidationError) -> str:
    """The first of its problems, in one line."""
    (detail, *_) = error.errors(include_url=False, include_input=False)
    fix = (detail.get("ctx") or {}).get("fix")
    where = ".".join(str(part) for part in detail["loc"])
    return f"{where}{': ' if where else ''}{detail['msg']}{f' [fix: {fix}]' if fix else ''}"
