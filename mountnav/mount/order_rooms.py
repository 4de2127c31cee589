"""What all orders to one mount go through, handed on as one value, and the base of those who order."""

from __future__ import annotations

from dataclasses import dataclass

from mountnav.clock import Clock
from mountnav.devices import Mount
from mountnav.mount.dead_man import Armed
from mountnav.mount.following_policy import FollowingPolicy
from mountnav.mount.limits_guard import LimitsGuard
from mountnav.mount.mount_state import MountState
from mountnav.mount.order_book import OrderBook
from mountnav.mount.sending import Admission, Sender
from mountnav.mount.tracking_watch import TrackingWatch


@dataclass(frozen=True, slots=True)
class OrderRooms:
    """The rooms of one mount, built once, by `CheckedMount`.

    Attributes
    ----------
    mount : Mount
        The driver.
    guard : LimitsGuard
        Judges where an order would lead.
    state : MountState
        What is known of the mount.
    sender : Sender
        Writes an order, sends it, and writes what came of it.
    book : OrderBook
        The journal of this mount.
    admission : Admission
        One order to move at a time, and none to a mount that isn't ready.
    watch : TrackingWatch
        Follows each motion, and ends it where it leaves the limits.
    policy : FollowingPolicy
        Bounds of rates beside the stars' and of axes moved by hand.
    armed : Armed
        The guard that ends them when the service is dead.
    """

    mount: Mount
    guard: LimitsGuard
    state: MountState
    sender: Sender
    book: OrderBook
    admission: Admission
    watch: TrackingWatch
    clock: Clock
    policy: FollowingPolicy
    armed: Armed


class Orders:
    """One kind of orders to one mount."""

    def __init__(self, rooms: OrderRooms) -> None:
        self._mount, self._guard, self._state = rooms.mount, rooms.guard, rooms.state
        self._sender, self._book, self._admission = rooms.sender, rooms.book, rooms.admission
        self._watch, self._clock, self._policy = rooms.watch, rooms.clock, rooms.policy
        self._armed = rooms.armed
