"""What may be believed: an offset too large for an honest mount is a mistake, and never a move.

One accepted wrong solution sent a simulated tube 3.1° off [POINTING §9].
"""

from __future__ import annotations

from mountnav.errors import BadSettings, OffsetTooLarge, SyncRefused
from mountnav.sky.sphere import Offset


class TooFarToSync(SyncRefused, OffsetTooLarge):
    """A sync refused above all for its size: nothing was sent."""

    slug: str = "offset-too-large"


def too_far(offset: Offset, max_arcsec: float) -> str | None:
    """Tell in words why an offset is longer than is believed; None if it is not.

    Raises
    ------
    BadSettings
        `max_arcsec` is not positive.
    """
    if not max_arcsec > 0.0:
        raise BadSettings(
            f"max_arcsec = {max_arcsec} is not positive", advice="set the cap in arcseconds, say 7200"
        )
    if offset.total_arcsec <= max_arcsec:
        return None
    return (
        f"solved {offset.total_arcsec / 60.0:.1f}′ from where the mount believes it is "
        f"({offset.east_arcsec:+.0f}″ east, {offset.north_arcsec:+.0f}″ north); "
        f"more than {max_arcsec / 60.0:.1f}′ is not believed"
    )
