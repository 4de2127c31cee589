"""A mount without a wire whose orders of rates are written down; and one that takes few of them, or none."""

from __future__ import annotations

from drivers.simulated.mount import SimulatedMount
from mountnav.devices import OffsetRates, Skill


class RatedMount(SimulatedMount):
    """Takes rates.

    Attributes
    ----------
    most : OffsetRates or None
        The largest that it takes; None: as its behavior says.
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
        """With rates, or without."""
        return super().skills if self.takes else super().skills - {Skill.OFFSET_RATES}

    @property
    def most_offset_arcsec_s(self) -> OffsetRates | None:
        """As set."""
        return super().most_offset_arcsec_s if self.most is None else self.most

    async def set_offset_rates(self, rates: OffsetRates) -> None:
        """Take them, and write them down."""
        await super().set_offset_rates(rates)
        self.ordered.append(rates)
