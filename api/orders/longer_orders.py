"""The orders that need more than a navigator: solve, series, model-run."""

from __future__ import annotations

from collections.abc import Callable

from api.observatory import Observatory
from api.orders.carrying_out import Work
from api.orders.order_series import run_series
from api.orders.order_solve import solve_frame
from api.orders.orders import LongerOrder, ModelRunOrder, SeriesOrder, SolveOrder
from api.solver.solver import Solver
from mountnav.navigation.navigator import Navigator
from mountnav.settings.observatory import Settings

Heard = Callable[[str, str, dict[str, object]], None]


class LongerOrders:
    """Makes work of them.

    Parameters
    ----------
    settings : Settings
    observatory : Observatory
    solver : Solver
    heard : callable
        ``heard(telescope_id, kind, data)``: told of each attempt.
    """

    def __init__(self, settings: Settings, observatory: Observatory, solver: Solver, heard: Heard) -> None:
        self._telescopes = {one.id: one for one in settings.telescope}
        self._settings = settings
        self._observatory = observatory
        self._solver = solver
        self._heard = heard

    def work_of(self, telescope_id: str, order: LongerOrder) -> Work:
        """An order as something to do with a navigator."""
        one = self._telescopes[telescope_id]

        def tell(attempt: dict[str, object]) -> None:
            self._heard(telescope_id, "attempt", attempt)

        async def work(navigator: Navigator) -> object:
            match order:
                case SolveOrder():
                    return await solve_frame(navigator, order, solver=self._solver, folders=one.night.folders)
                case SeriesOrder():
                    return await run_series(navigator, order, tell)
                case ModelRunOrder():
                    # fitting is dear to import, and few need it
                    from api.orders.order_model_run import run_model

                    return await run_model(
                        navigator,
                        order,
                        tell,
                        settings=self._settings,
                        one=one,
                        journal=self._observatory.telescope(telescope_id).journal,
                    )

        return work

    @staticmethod
    def needs_devices(order: LongerOrder) -> bool:
        """Whether the telescope must be open for it: a file is solved without."""
        return not (isinstance(order, SolveOrder) and order.path is not None)


__all__ = ["LongerOrders"]
