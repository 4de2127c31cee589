"""Solving for a command in its own process: nothing is left running, each command pays for the imports."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

from api.solver_commands.host import Asked
from mountnav.errors import BadSettings, Cancelled

if TYPE_CHECKING:
    from mountnav.catalog.catalog_set import CatalogSet
    from mountnav.frames import Frame
    from mountnav.identification.blind.index import BlindIndex
    from mountnav.solution import Verdict


class SolverInProcess:
    """Opens catalog and index when the first frame needs them. Implements `api.solver_commands.host.Solver`.

    Parameters
    ----------
    build : callable, optional
        Builds the index of the whole sky where there is none yet; without it none is searched then.
    """

    def __init__(self, build: Callable[[CatalogSet], BlindIndex] | None = None) -> None:
        self._catalog: CatalogSet | None = None
        self._build = build

    def solve(self, asked: Asked, *, cancelled: Callable[[], bool] | None = None) -> Verdict:
        """As `Solver.solve`; `cancelled` is asked once, before the work begins."""
        from mountnav.solving.settings import SolveSettings
        from mountnav.solving.solve import solve_source

        if cancelled is not None and cancelled():
            raise Cancelled(f"{asked.name} was given up", advice="call it again")
        catalog = self._opened()
        settings = SolveSettings(blind=asked.blind)
        if asked.cpu_limit_s is not None:
            settings = replace(settings, budget_s=min(settings.budget_s, asked.cpu_limit_s))
        if asked.blind != "never":
            settings = replace(settings, index=self._index(catalog))
        path = Path(f"/proc/self/fd/{asked.file.fileno()}")
        return solve_source(path, catalog, asked.hint, name=asked.name, settings=settings, stars=asked.stars)

    def read(self, file: BinaryIO, name: str) -> Frame:
        """As `Solver.read`."""
        from mountnav.reading import read_frame

        return read_frame(Path(f"/proc/self/fd/{file.fileno()}"), name=name)

    def _opened(self) -> CatalogSet:
        if self._catalog is None:
            from mountnav.catalog.catalog_set import open_catalogs

            self._catalog = open_catalogs()
        return self._catalog

    def _index(self, catalog: CatalogSet) -> BlindIndex | None:
        from mountnav.identification.blind.cache import installed_index

        found = installed_index(catalog.indexed)
        if found is None and self._build is not None:
            try:
                found = self._build(catalog)
            except BadSettings:
                return None  # no room for it: what a hint finds is found all the same
        return found
