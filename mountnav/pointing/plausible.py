"""What may be believed: an offset too large for an honest mount is a mistake, and never a move.

One accepted wrong solution sent a simulated tube 3.1° off [POINTING §9].
"""

from __future__ import annotations

from mountnav.errors import BadSettings, OffsetImplausible
from mountnav.sky.sphere import Offset


def check_offset(offset: Offset, max_arcsec: float) -> None:
    """Refuse an offset longer than the mount can plausibly be wrong.

    Parameters
    ----------
    offset : Offset
        Seen minus believed.
    max_arcsec : float
        Longest offset that is believed; that length itself still is.

    Raises
    ------
    OffsetImplausible
        The offset is longer, or no number.
    BadSettings
        `max_arcsec` is not positive.
    """
    if not max_arcsec > 0.0:
        raise BadSettings(
            f"max_arcsec = {max_arcsec} is not positive", advice="set the cap in arcseconds, say 7200"
        )
    if offset.total_arcsec <= max_arcsec:
        return
    raise OffsetImplausible(
        f"solved {offset.total_arcsec / 60.0:.1f}′ from where the mount believes to be "
        f"({offset.east_arcsec:+.0f}″ east, {offset.north_arcsec:+.0f}″ north); "
        f"more than {max_arcsec / 60.0:.1f}′ is not believed",
        advice="check the mount's alignment, date, time zone, longitude and epoch; "
        "if it is really that far off, order a recovery, or align it roughly by hand",
    )
