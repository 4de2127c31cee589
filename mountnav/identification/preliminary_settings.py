"""Every number preliminary identification goes by [S23 app. A]."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class PreliminarySettings:
    """Parameters of preliminary identification; the defaults are those of [S23 app. A].

    `PreliminarySettings.measured()` is the profile that the series uses; docs/series.md says what it gains.

    Attributes
    ----------
    r_rej_px : float
        Radius of a strobe (R_rej).
    n_min_ack : float
        Least share of the strobes that must hold a measurement (N_min_ack).
    m_reg, n_mea_reg : int
        The frame is cut in m_reg × m_reg regions, the n_mea_reg brightest of each are selected.
    tries : int
        Selected measurements of the first list that are tried; needing one more is failure.
    first_wins : bool
        The first hypothesis with enough acknowledgements is taken or refused. Else the most acknowledged
        goes first, and a refused one makes room for the next.
    overlap_only : bool
        Only strobes that fall in the other frame count, so that large shifts can be found.
    chance_most : float
        The strobe is made so narrow that chance fills at most this share of the strobes; 1: not at all.
    confirm_factor : int
        A strobe may be filled by the confirm_factor · n_mea_reg brightest of each region; 0: by any. The
        paper names no such set here; 2 is its k_blob, confirming over proposing set (docs/series.md).
    use_flags : bool
        Leave out measurements with NO_PEAK, TRAIL and BLEED where enough others are there.
    narrowing : bool
        Pair again with narrower strobes; the shift is then a weighted mean with outliers cut, over mutual
        nearest pairs of all bright measurements, instead of the plain mean of (3, 4).
    still_share : float
        Least share for a shift of less than a pixel, which hot pixels show as well.
    false_probability_max : float
        A shift whose odds of being chance exceed this is refused.
    """

    r_rej_px: float = 20.0
    n_min_ack: float = 0.7
    m_reg: int = 4
    n_mea_reg: int = 3
    tries: int = 3
    first_wins: bool = True
    overlap_only: bool = False
    chance_most: float = 1.0
    confirm_factor: int = 2
    use_flags: bool = False
    narrowing: bool = False
    still_share: float = 0.7
    false_probability_max: float = 1e-9

    @classmethod
    def measured(cls) -> PreliminarySettings:
        """The profile of the series: narrowing strobes, odds instead of a high share, any overlap."""
        return cls(
            n_min_ack=0.2,
            tries=48,
            first_wins=False,
            overlap_only=True,
            chance_most=0.15,
            use_flags=True,
            narrowing=True,
        )
