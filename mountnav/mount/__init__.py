"""The one way to a mount: whatever is ordered is checked against the limits, written down, sent, and closed.

Nobody else holds the driver: navigation, nights, and the faces for other programs are given this.

::

    busy? parked? trusted? allowed? -> written -> sent -> outcome -> closed
        no: a refusal is written, nothing is sent

A stop goes past all of it: it is noted without waiting, sent, and closed afterwards. An order that a stop has
overtaken before it was sent isn't sent any more.

``mount`` is the face. ``admission`` asks what stands before an order, ``slew_plans`` how a slew may go;
``motions`` (watched on their way), ``syncs`` and ``brief_orders`` are the orders; ``sending`` sends each one,
with its row (``written_orders``). ``standing`` and ``segments`` hold what is known of the mount.
``tracking_watch`` looks at it by the limits (``guarding``) now and then, and ``halting`` stops it there.
"""

from mountnav.mount.mount import CheckedMount
from mountnav.mount.mount_state import Listener
from mountnav.mount.tracking_watch import WentAnotherWay

__all__ = ["CheckedMount", "Listener", "WentAnotherWay"]
