"""`mountnav serve`: from what was asked for to settings, and on to the server."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pydantic import ValidationError

from mountnav.errors import BadRequest
from mountnav.settings.demo import DemoSettings
from mountnav.settings.observatory import Settings


@dataclass(frozen=True, slots=True, kw_only=True)
class Serve:
    """What was asked for; see the options of the command."""

    config: Path | None = None
    demo: bool = False
    at: str | None = None
    speed: float | None = None
    seed: int | None = None
    mounting: Literal["german", "fork"] | None = None
    port: int | None = None


def run(asked: Serve) -> int:
    """Serve until interrupted; the exit code.

    Raises
    ------
    BadRequest
        Options that make no sense.
    BadSettings
        The settings can't be served.
    """
    settings = settings_of(asked)
    # only now: all of the service takes seconds to import, and wrong settings are told without it
    from api.http.serving import serve
    from api.observatory.observatory import require_devices

    # all of them before anything is opened: a wrong one is told in one line, and starting again won't help
    require_devices(settings, asked.config)
    return serve(settings)


def settings_of(asked: Serve) -> Settings:
    """The settings that options and file say together; an option goes before the file. Raises as `run`."""
    if asked.config is None:
        if not asked.demo:
            raise BadRequest(
                "there is nothing to serve",
                advice="give --config observatory.toml, or --demo for a virtual observatory",
            )
        from api.demo.observatory import demo_service_settings

        port = 8000 if asked.port is None else asked.port
        return demo_service_settings(_demo(asked, None), port, asked.mounting or "german")
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


def _refuse_virtual_options(asked: Serve) -> None:
    for name in ("at", "speed", "seed"):
        if getattr(asked, name) is not None:
            raise BadRequest(f"--{name} is for a virtual observatory", advice="add --demo")


def _demo(asked: Serve, file: DemoSettings | None) -> DemoSettings:
    given: dict[str, object] = {} if file is None else file.model_dump()
    for name in ("at", "speed", "seed"):
        if getattr(asked, name) is not None:
            given[name] = getattr(asked, name)
    try:
        return DemoSettings.model_validate(given)
    except ValidationError as error:
        raise BadRequest(f"the virtual time: {_first(error)}") from error


def _first(error: ValidationError) -> str:
    (detail, *_) = error.errors(include_url=False, include_input=False)
    fix = (detail.get("ctx") or {}).get("fix")
    where = ".".join(str(part) for part in detail["loc"])
    return f"{where}{': ' if where else ''}{detail['msg']}{f' [fix: {fix}]' if fix else ''}"
