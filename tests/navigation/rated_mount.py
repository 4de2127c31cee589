"""A mount without a wire that takes rates beside the sidereal one, as wrongly as its mechanics do."""

from __future__ import annotations

from drivers.simulated.mount import SimulatedMount
from mountnav.devices import OffsetRates, Skill
from mountnav.simulation.mechanics import Mechanics


class RatedMount(SimulatedMount):
    """Takes rates.

    Attributes
    ----------
    most : OffsetRates or None
        The largest that it takes.
    ordered : list of OffsetRates
        All that it was sent.
    """

    most: OffsetRates | None = None
    takes = True

    def __init__(self, *args: object, **given: object) -> None:
        super().__init__(*args, **given)  # type: ignore[arg-type]
        self.ordered: list[OffsetRates] = []

    @property
    def skills(self) -> frozenset[Skill]:
        """With rates."""
        return super().skills | ({Skill.OFFSET_RATES} if self.takes else set())

    @property
    def most_offset_arcsec_s(self) -> OffsetRates | None:
        """As set."""
        return self.most

    async def set_offset_rates(self, rates: OffsetRates) -> None:
        """Take them."""
        await self._order("rates", lambda: self.mechanics.track_beside(rates.ra_arcsec_s, rates.dec_arcsec_s))
        self.ordered.append(rates)

    async def offset_rates(self) -> OffsetRates | None:
        """As its mechanics say."""
        await self.cable.ask()
        return OffsetRates(*self.mechanics.beside_arcsec_s)


def truly_beside(mechanics: Mechanics) -> tuple[float, float]:
    """Rates of the axes beside the sidereal one, as they are."""
    return mechanics.beside_arcsec_s
