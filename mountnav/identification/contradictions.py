"""Hints that a solved frame disproves. They are reported; they never make a wrong answer."""

from __future__ import annotations

from mountnav.frames import Hint
from mountnav.identification.plate import Plate
from mountnav.sky.sphere import separation_arcsec
from mountnav.solution import Contradiction

SLACK = 0.001
"""Scales this close to a bound don't contradict it."""


def contradictions(hint: Hint, plate: Plate) -> tuple[Contradiction, ...]:
    """Compare what was hinted with what was found.

    Parameters
    ----------
    hint : Hint
        The main hint; its alternatives say nothing of their own.
    plate : Plate
        The final one.

    Returns
    -------
    tuple of Contradiction
        About the scale, the center, both or nothing.
    """
    found = []
    scale = plate.scale_arcsec_px()
    low, high = hint.scale_low_arcsec_px, hint.scale_high_arcsec_px
    below = low is not None and scale < low * (1 - SLACK)
    above = high is not None and scale > high * (1 + SLACK)
    if below or above:
        said = " to ".join(f"{bound:.3f}" for bound in (low, high) if bound is not None)
        found.append(Contradiction("scale", hint.scale_source, f"{said} ″/px", f"{scale:.3f} ″/px"))
    if hint.center is not None:
        away_deg = separation_arcsec(hint.center, plate.center()) / 3600.0
        if away_deg > hint.radius_deg:
            at = plate.center()
            found.append(
                Contradiction(
                    "center",
                    hint.center_source,
                    f"within {hint.radius_deg:g}° of RA {hint.center.ra_deg:.4f}°, "
                    f"Dec {hint.center.dec_deg:+.4f}°",
                    f"RA {at.ra_deg:.4f}°, Dec {at.dec_deg:+.4f}°, {away_deg:.2f}° away",
                )
            )
    return tuple(found)
