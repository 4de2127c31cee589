"""The stars of several tiles in one answer."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.stars import Stars


def joined(parts: Sequence[Stars], source: str) -> Stars | None:
    """Put the stars of all tiles together, brightest first.

    Parameters
    ----------
    parts : sequence of Stars
        At one epoch, none empty; no star lies in two of them.
    source : str
        Name of the catalog.

    Returns
    -------
    Stars or None
        None if there are no parts.
    """
    if not parts:
        return None

    def all_of(what: str) -> NDArray[Any]:
        return np.concatenate([getattr(part, what) for part in parts])

    first = parts[0]
    whole = Stars(
        ra_deg=all_of("ra_deg"),
        dec_deg=all_of("dec_deg"),
        sigma_arcsec=all_of("sigma_arcsec"),
        mag=all_of("mag"),
        pm_ra_cosdec_mas_yr=all_of("pm_ra_cosdec_mas_yr"),
        pm_dec_mas_yr=all_of("pm_dec_mas_yr"),
        epoch_yr=first.epoch_yr,
        band=first.band,
        source=source,
        color_mag=all_of("color_mag"),
        flags=all_of("flags"),
        color_name=first.color_name,
    )
    return whole.only(np.argsort(whole.mag, kind="stable"))
