"""What a run of an archive solves with: made of the options once, and again by each worker, and compared."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from api.solver.hints import asked_hint
from api.solver.shelf import chosen_shelf
from api.solver.solve_settings import Blind, chosen_settings
from api.solver.worker import MARGIN_S
from mountnav.archive.folder import Folder, RunFolder
from mountnav.archive.learning import Learned, learned
from mountnav.archive.recipe import Recipe, begin_run, recipe_in, recipe_of
from mountnav.archive.tables import sha256_of
from mountnav.catalog.catalog_set import CatalogSet
from mountnav.errors import BadRequest
from mountnav.frames import Hint
from mountnav.identification.budget import wall_limit_s
from mountnav.solving.priors import CameraPrior
from mountnav.solving.settings import MOST_EXPOSURES, SolveSettings

ARCHIVE_PROFILES: dict[str, dict[str, Any]] = {
    "plate": {"exposures": MOST_EXPOSURES},
}
"""What profiles of archives alone set, over those of the settings: photographic plates."""

LEAST_DEADLINE_S = 1.0
"""A frame that is ended sooner is ended for the computer's load."""


@dataclass(frozen=True, slots=True)
class RunOptions:
    """What was asked of a run, as texts and numbers that a worker on another computer understands.

    Attributes
    ----------
    deadline_s : float or None
        Wall time of a try, after which its process is killed; None: what the budget allows a search at most,
        and reading and measuring besides.
    undated_utc : str
        ISO date that frames without one are taken for.
    priors : tuple of CameraPrior
        Scales of cameras that were learned.
    learned_run, learned_chunks : str, tuple of int
        From which finished chunks of which recipe (its hash).
    """

    config: str | None = None
    catalog: str | None = None
    profile: str | None = None
    budget_s: float | None = None
    calibration: str | None = None
    blind: Blind | None = None
    ra_deg: float | None = None
    dec_deg: float | None = None
    radius_deg: float | None = None
    scale_arcsec_px: float | None = None
    scale_low_arcsec_px: float | None = None
    scale_high_arcsec_px: float | None = None
    deadline_s: float | None = None
    undated_utc: str = ""
    pairs: bool = False
    priors: tuple[CameraPrior, ...] = ()
    learned_run: str = ""
    learned_chunks: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Prepared:
    """All that solving needs."""

    catalog: CatalogSet
    settings: SolveSettings
    hint: Hint | None
    deadline_s: float
    recipe: Recipe

    def index(self) -> Path | None:
        """Where the index of the whole sky lies, built on first need; None where nothing is searched blind.

        Raises
        ------
        BadSettings
            It can't be built.
        """
        if self.settings.blind == "never":
            return None
        from mountnav.identification.blind.cache import cached_index

        return cached_index(self.catalog.indexed).path


def prepared(options: RunOptions) -> Prepared:
    """Make of the options what solving needs.

    Raises
    ------
    BadSettings, BadRequest, BadFrame
        They make no sense, or name what isn't there.
    """
    config = None if options.config is None else Path(options.config)
    masters = None if options.calibration is None else Path(options.calibration)
    archived = ARCHIVE_PROFILES.get(options.profile or "", {})
    settings = chosen_settings(
        config=config,
        profile=None if archived else options.profile,
        budget_s=options.budget_s,
        calibration=masters,
        blind=options.blind,
    )
    settings = replace(settings, **archived)
    settings = replace(settings, undated_utc=_date(options.undated_utc), priors=options.priors)
    catalog = chosen_shelf(config, options.catalog)
    hint = asked_hint(
        options.ra_deg,
        options.dec_deg,
        options.radius_deg,
        options.scale_arcsec_px,
        options.scale_low_arcsec_px,
        options.scale_high_arcsec_px,
    )
    deadline_s = options.deadline_s or wall_limit_s(settings.budget_s) + MARGIN_S
    if deadline_s < LEAST_DEADLINE_S:
        raise BadRequest(f"--deadline {deadline_s:g} s is too short", advice=f"at least {LEAST_DEADLINE_S:g}")
    index = None
    if settings.blind != "never":
        from mountnav.identification.blind.cache import index_path

        index = index_path(catalog.indexed).name
    recipe = recipe_of(
        catalog,
        settings,
        hint,
        deadline_s=deadline_s,
        pairs=options.pairs,
        index=index,
        masters={} if masters is None else _hashes(masters),
        learned={"run": options.learned_run, "chunks": list(options.learned_chunks)},
        options=asdict(options),
    )
    return Prepared(catalog, settings, hint, deadline_s, recipe)


def prepared_for(run: RunFolder) -> Prepared:
    """Make again what a run was begun with.

    Raises
    ------
    BadSettings
        This machine has another mountnav, other catalogs or other settings.
    BadRequest
        The recipe is damaged.
    """
    recipe = recipe_in(run)
    ready = prepared(options_of(recipe))
    recipe.require_same(ready.recipe)
    return replace(ready, recipe=recipe)


def options_of(recipe: Recipe) -> RunOptions:
    """The options that a recipe was made of. Raises `BadRequest`."""
    try:
        told = RunOptions(**recipe.options)
        priors = tuple(CameraPrior(**one) for one in recipe.options.get("priors", ()))
        return replace(told, priors=priors, learned_chunks=tuple(told.learned_chunks))
    except TypeError as fault:
        raise BadRequest(f"the recipe's options are of another version of mountnav: {fault}") from fault


def taught(folder: Folder, run: RunFolder) -> tuple[RunFolder | None, list[Learned]]:
    """Begin a run like another one, with what the finished chunks of that one teach of cameras.

    Returns
    -------
    run : RunFolder or None
        None where nothing was learned.
    learned : list of Learned
        All cameras, those that taught nothing too.

    Raises
    ------
    BadSettings, BadRequest, OSError
    """
    chunks = sorted(run.done())
    found = learned(run, chunks)
    priors = tuple(one.prior for one in found if one.prior is not None)
    if not priors:
        return None, found
    recipe = recipe_in(run)
    options = replace(
        options_of(recipe), priors=priors, learned_run=recipe.hash, learned_chunks=tuple(chunks)
    )
    return begin_run(folder, prepared(options).recipe)[0], found


def _date(text: str) -> datetime | None:
    if not text:
        return None
    try:
        found = datetime.fromisoformat(text)
    except ValueError as fault:
        raise BadRequest(f"--undated {text!r} is not a date", advice="write it as 1958-07-01") from fault
    return found if found.tzinfo is not None else found.replace(tzinfo=UTC)


def _hashes(folder: Path) -> dict[str, Any]:
    return {
        str(path.relative_to(folder)): sha256_of(path) for path in sorted(folder.rglob("*")) if path.is_file()
    }
