"""The one way to a mount: whatever is ordered is checked against the limits, written down, sent, and closed.

Nobody else holds the driver: navigation, nights, and the faces for other programs are given this.

::

    busy? parked? trusted? allowed? -> written -> sent -> outcome -> closed
        no: a refusal is written, nothing is sent

A stop goes past all of it: it is noted without waiting, sent, and closed afterwards. An order that a stop has
overtaken before it was sent isn't sent any more.

``mount`` is the face, `CheckedMount`. ``orders`` has the orders, ``sending`` what all of them go through:
`Admission` asks what stands before an order, `Sender` sends it with its row (``order_book``). ``mount_state``
holds what is known of the mount, ``trust`` whether its position counts. ``tracking_watch`` holds it against
its limits (``limits_guard``, ``pier_side``, ``axis_rates``) now and then, and stops it there.

What goes on by itself has an end: rates for targets that move (``offset_rates``, held against the limits
along ``path_ahead``) and axes moved by hand (``moved_axes``). ``ending`` ends them, and ``dead_man`` is the
protocol of who does it when the service is dead.
"""

from mountnav.mount.dead_man import Deadman, LeftGoing, SelfActing, left_going
from mountnav.mount.following_policy import FollowingPolicy, OnLoss
from mountnav.mount.mount import CheckedMount
from mountnav.mount.mount_state import Listener
from mountnav.mount.offset_rates import RatesInForce
from mountnav.mount.tracking_watch import WentAnotherWay

__all__ = [
    "CheckedMount",
    "Deadman",
    "FollowingPolicy",
    "LeftGoing",
    "Listener",
    "OnLoss",
    "RatesInForce",
    "SelfActing",
    "WentAnotherWay",
    "left_going",
]
