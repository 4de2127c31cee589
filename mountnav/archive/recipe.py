"""What decides the results of a run, written down so that no other worker mixes something else in."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Mapping
from datetime import datetime
from enum import Enum
from pathlib import Path
from typing import Any

from mountnav.archive.folder import Folder, RunFolder, read_json, write_json
from mountnav.archive.work_list import Entry
from mountnav.catalog.catalog_set import CatalogSet
from mountnav.catalog.packed import PackedStore
from mountnav.errors import BadRequest, BadSettings
from mountnav.frames import Hint
from mountnav.solving.settings import SolveSettings
from mountnav.version import version

NAME_LENGTH = 12
"""Letters of the hash that name a run: two of a thousand runs are called the same once in 10^9 archives."""


@dataclasses.dataclass(frozen=True, slots=True)
class Recipe:
    """What decides the results.

    Attributes
    ----------
    decides : dict
        Of plain values: version, catalogs with the hashes of their stars, settings, hint, masters, deadline.
    options : dict
        What a worker needs to make the settings again: names of files, of catalogs. It decides nothing.
    hash : str
        SHA-256 of what decides; made once, as each frame's address needs it.
    """

    decides: dict[str, Any]
    options: dict[str, Any]
    hash: str = dataclasses.field(init=False)

    def __post_init__(self) -> None:
        """Hash what decides."""
        text = json.dumps(self.decides, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
        object.__setattr__(self, "hash", hashlib.sha256(text.encode()).hexdigest())

    @property
    def name(self) -> str:
        """Of its run."""
        return self.hash[:NAME_LENGTH]

    def address(self, entry: Entry, sha256: str) -> str:
        """What decides the result of a frame, in one hash.

        Parameters
        ----------
        sha256 : str
            Of the file's bytes: its pixels, and the header that tells where and when it was taken.
        """
        parts = [self.hash, sha256, entry.extension or "", json.dumps(plain(entry.hint), sort_keys=True)]
        return hashlib.sha256("\n".join(parts).encode()).hexdigest()

    def require_same(self, found: Recipe) -> None:
        """Check that this machine would make the same results.

        Raises
        ------
        BadSettings
            It wouldn't; tells what differs.
        """
        if self.hash == found.hash:
            return
        differing = "; ".join(_differences(self.decides, found.decides))
        raise BadSettings(
            f"this machine would give other results than the run {self.name}: {differing[:1000]}",
            advice="install the same, or begin a new run: mountnav archive again",
        )


def recipe_of(
    catalog: CatalogSet,
    settings: SolveSettings,
    hint: Hint | None,
    *,
    deadline_s: float,
    pairs: bool,
    index: str | None,
    masters: Mapping[str, str],
    learned: Mapping[str, Any],
    options: Mapping[str, Any],
) -> Recipe:
    """Write down what decides.

    Parameters
    ----------
    index : str or None
        Name of the index of the whole sky, which tells of what stars and in what format it is.
    masters : mapping
        Names and hashes of the files of calibration.
    learned : mapping
        From which chunks of which run the priors of the settings come.

    Raises
    ------
    BadRequest
        A catalog is online: what it answers may differ from day to day.
    """
    decides = {
        **of_catalogs(catalog),
        "index": index,
        "masters": dict(masters),
        "learned": dict(learned),
        "settings": plain(dataclasses.replace(settings, calibration=None, index=None)),
        "hint": plain(hint),
        "deadline_s": deadline_s,
        "pairs": pairs,
    }
    return Recipe(decides, dict(options))


def of_catalogs(catalog: CatalogSet) -> dict[str, Any]:
    """What catalogs, and the version of mountnav, decide of a result.

    Raises
    ------
    BadRequest
        A catalog is online: what it answers may differ from day to day.
    """
    if catalog.online or not all(isinstance(one, PackedStore) for one in catalog.stores):
        raise BadRequest(
            "the settings name an online catalog, whose answers may differ from day to day",
            advice="name catalogs on this machine with --catalog, or in [catalogs] use",
        )
    stores = [one for one in (*catalog.stores, catalog.indexed) if isinstance(one, PackedStore)]
    magnitudes = catalog.magnitudes
    if magnitudes is not None and not isinstance(magnitudes, PackedStore):
        raise BadRequest(
            "magnitudes are taken from an online catalog", advice="take them from one on this machine"
        )
    return {
        "mountnav": version(),
        "catalogs": {one.name: one.header.sections_sha256 for one in stores},
        "usable": [one.name for one in catalog.usable],
        "magnitudes": None if magnitudes is None else magnitudes.header.sections_sha256,
    }


def begin_run(folder: Folder, recipe: Recipe) -> tuple[RunFolder, bool]:
    """Make a run; whether it is new. One of the same recipe is the same run. Raises `OSError`."""
    run = RunFolder(folder.path / "runs" / recipe.name)
    if (run.path / "recipe.json").exists():
        return run, False
    run.make()
    told = {
        "order": len(folder.runs()),
        "hash": recipe.hash,
        "decides": recipe.decides,
        "options": recipe.options,
    }
    write_json(run.path / "recipe.json", told)
    return run, True


def recipe_in(run: RunFolder) -> Recipe:
    """The recipe of a run.

    Raises
    ------
    BadRequest
        It is damaged, or was changed by hand.
    """
    told = read_json(run.path / "recipe.json")
    try:
        recipe = Recipe(dict(told["decides"]), dict(told["options"]))
    except (KeyError, TypeError, ValueError) as fault:
        raise BadRequest(f"{run.path}/recipe.json is damaged", advice="restore it") from fault
    if recipe.hash != told.get("hash") or recipe.name != run.name:
        raise BadRequest(
            f"{run.path}/recipe.json was changed: its hash is different",
            advice="restore it; other settings need another run: mountnav archive again",
        )
    return recipe


def plain(value: object) -> Any:
    """Settings in JSON's own kinds: the same for the same settings."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {one.name: plain(getattr(value, one.name)) for one in dataclasses.fields(value)}
    if isinstance(value, Enum):
        return value.name
    if isinstance(value, datetime):
        return value.isoformat()
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, Mapping):
        return {str(key): plain(one) for key, one in value.items()}
    if isinstance(value, tuple | list):
        return [plain(one) for one in value]
    if value is None or isinstance(value, str | int | float | bool):
        return value
    raise TypeError(f"{type(value).__name__} can't be part of a recipe")


def _differences(one: Any, other: Any, where: str = "") -> list[str]:
    if isinstance(one, dict) and isinstance(other, dict):
        found: list[str] = []
        for key in sorted({*one, *other}):
            found += _differences(one.get(key), other.get(key), f"{where}.{key}" if where else key)
        return found
    return [] if one == other else [f"{where} is {_short(other)} here, {_short(one)} there"]


def _short(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 60 else f"{text[:60]}…"
