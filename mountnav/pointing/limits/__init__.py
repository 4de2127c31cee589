"""Where a telescope may point and by which way: checked before anything moves, and while it tracks."""

from mountnav.pointing.limits.bounds import Limits
from mountnav.pointing.limits.horizon import Horizon
from mountnav.pointing.limits.postures import Mounting
from mountnav.pointing.limits.slews import SlewCheck
from mountnav.pointing.limits.tracked import Reached

__all__ = ["Horizon", "Limits", "Mounting", "Reached", "SlewCheck"]
