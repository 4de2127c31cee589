"""The demo observatory: its settings, the mount that it has, and a journal of its own."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.resources import files
from pathlib import Path
from typing import Literal

import numpy as np

from mountnav.errors import BadSettings
from mountnav.journal.database import database_url
from mountnav.journal.runs import settings_of_runs
from mountnav.settings.demo import DemoSettings
from mountnav.settings.faces import IndiServerSettings, Lx200ServerSettings, StellariumSettings
from mountnav.settings.journal import JournalSettings
from mountnav.settings.night import NightSettings
from mountnav.settings.observatory import Settings
from mountnav.settings.telescope import MountErrorSettings

TELESCOPE = "demo"
Mounting = Literal["fork", "german"]

_WRONG_BY_ARCSEC = {
    "ih_arcsec": 900.0,
    "id_arcsec": 900.0,
    "me_arcsec": 1500.0,
    "ma_arcsec": 1500.0,
    "ch_arcsec": 600.0,
    "np_arcsec": 100.0,
    "tf_arcsec": 60.0,
}
"""How wrong a mount made of a seed points at most, by the terms of a pointing model. chosen: like a mount
that was set up by eye, a quarter of a degree off, its polar axis half a degree. They set how far off a demo
begins."""


def demo_settings(host: str, port: int) -> Settings:
    """The demo observatory's settings, listening at `host` and `port`."""
    text = files("api.demo").joinpath("demo.toml").read_text(encoding="utf-8")
    text = text.replace('host = "127.0.0.1"', f'host = "{host}"').replace("port = 8000", f"port = {port}")
    return Settings.parse(text, name="demo.toml")


def demo_settings_with_rates(settings: Settings) -> Settings:
    """The same observatory with a mount that takes rates beside the sidereal one."""
    (telescope,) = settings.telescope
    mount = telescope.mount.model_copy(update={"url": "fake+lx200://?dialect=onstep"})
    made = settings.model_copy(update={"telescope": (telescope.model_copy(update={"mount": mount}),)})
    # copies are not checked by themselves
    return Settings.model_validate(made.model_dump())


def demo_service_settings(demo: DemoSettings, port: int, mounting: Mounting = "fork") -> Settings:
    """The demo observatory as `mountnav serve --demo` has it: a mount that can do all, and every face.

    Parameters
    ----------
    demo : DemoSettings
        Its seed makes another mount, which points wrongly in another way.
    port : int
        0: any that is free, and so for the other faces.
    """
    settings = demo_settings("127.0.0.1", port)
    (telescope,) = settings.telescope
    errors = telescope.mount.errors if demo.seed is None else mount_errors_of_seed(demo.seed)
    mount = telescope.mount.model_copy(
        # the usual LX200 can neither unpark nor tell its side of the pier
        update={"url": "fake+lx200://?dialect=onstep", "mounting": mounting, "errors": errors}
    )
    night = NightSettings(enabled=True)
    made = settings.model_copy(
        update={
            "demo": demo,
            "telescope": (telescope.model_copy(update={"mount": mount, "night": night}),),
            "indi_server": IndiServerSettings(enabled=True, port=7624 if port else 0),
            "lx200_server": Lx200ServerSettings(enabled=True, port=4030 if port else 0),
            "stellarium": StellariumSettings(enabled=True, port=10001 if port else 0),
        }
    )
    # copies are not checked by themselves
    return Settings.model_validate(made.model_dump())


def mount_errors_of_seed(seed: int) -> MountErrorSettings:
    """How wrong the mount of a seed points: the same each time."""
    chance = np.random.default_rng(seed)
    terms = {name: round(float(chance.uniform(-most, most)), 1) for name, most in _WRONG_BY_ARCSEC.items()}
    return MountErrorSettings(
        **terms, backlash_arcsec=20.0, periodic_amplitude_arcsec=8.0, periodic_period_s=480.0
    )


@contextmanager
def demo_journal(settings: Settings) -> Iterator[Settings]:
    """A journal for this demo alone, unless the settings name one: the observatory's own is not for it.

    Raises
    ------
    BadSettings
        The one that is named tells of nights under the real sky.
    JournalFailed
        It can't be read.
    """
    if settings.journal.url:
        _require_virtual(settings.journal.url)
        yield settings
        return
    with tempfile.TemporaryDirectory(prefix="mountnav-demo-") as folder:
        journal = JournalSettings(url=str(Path(folder) / "journal.sqlite"))
        yield settings.model_copy(update={"journal": journal})


def _require_virtual(url: str) -> None:
    if "://" not in url and not Path(url).exists():
        return
    # also one of an older version, which the service brings up to date at its start
    for started_utc, text in settings_of_runs(database_url(url)):
        if json.loads(text or "{}").get("demo") is None:
            raise BadSettings(
                f"the journal is of a real observatory ({started_utc:%Y-%m-%d %H:%M} UTC)",
                device=url,
                advice="give the virtual one a [journal] url of its own, or none: then it is not kept",
            )
