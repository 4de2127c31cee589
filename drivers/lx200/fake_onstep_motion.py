"""What an OnStep allows and refuses, and where it goes then: gotos, syncs, flips, park and home [ONSTEP].

Orders return the code of what forbids them, as `:GE#` tells it; 0 is nothing.
"""

from __future__ import annotations

from collections.abc import Callable

from drivers.lx200.fake_onstep_settings import Settings
from drivers.lx200.onstep_codec import Status
from mountnav.devices import PierSide
from mountnav.errors import Refusal
from mountnav.simulation.mechanics import Mechanics
from mountnav.sky.coordinates import Apparent, utc_now

LOWEST_DEG = -10.0
"""Its horizon limit where the machine has none [ONSTEP LIMIT_ALTITUDE_MIN]."""
OK, IS_PARKED, PARK_FAILED, NOT_PARKED = 0, 9, 10, 11
SLEW_ERROR = 14
"""The codes after it are the digits of `:MS#` [ONSTEP CommandError]."""
_BELOW, _PARKED, _IN_GOTO, _LIMIT, _IN_MOTION, _UNSPECIFIED = (
    SLEW_ERROR + digit for digit in (1, 4, 5, 6, 8, 9)
)


class OnStepMotion:
    """Its orders to move, and its state.

    Parameters
    ----------
    mechanics : Mechanics
    settings : Settings

    Attributes
    ----------
    target_ra_deg, target_dec_deg : float
    going : bool
        A goto runs, also to park or home.
    moved : bool
        A key was pressed or a stop ordered, and the axes don't rest yet; tracking that begins is no motion.
    """

    def __init__(self, mechanics: Mechanics, settings: Settings) -> None:
        self._mechanics = mechanics
        self._settings = settings
        self.forget()

    def forget(self) -> None:
        """Forget what a reboot forgets."""
        self.target_ra_deg = self.target_dec_deg = 0.0
        self.going = self.moved = self._tracked = False
        self._first_goto = True

    # -- state -----------------------------------------------------------------------------------

    def arrive(self) -> None:
        """Notice that a goto has come to its end."""
        if (self.going or self.moved) and not self._mechanics.slewing():
            if self.going and self._mechanics.at_home:
                self._first_goto = True
            self.going = self.moved = False

    def status(self) -> Status:
        """Look at it, as `:GU#` would tell."""
        mechanics = self._mechanics
        side = mechanics.pier_side()
        # at home there is no side, and a fork's is east [ONSTEP Mount::update]
        if mechanics.at_home:
            side = PierSide.UNKNOWN
        elif side is PierSide.UNKNOWN:
            side = PierSide.EAST
        return Status(
            tracking=mechanics.tracking,
            slewing=self.going,
            parked=mechanics.parked,
            parking=mechanics.parking,
            park_failed=False,
            at_home=mechanics.at_home and not self.going,
            homing=mechanics.homing and self.going,
            guiding=mechanics.guiding(),
            pier_side=side,
            rate=mechanics.rate,
            error=self._error(),
        )

    def _error(self) -> int:
        mechanics = self._mechanics
        if not mechanics.at_limit:
            return 0
        below = mechanics.believed_altitude_deg(mechanics.reported()) < self._lowest_deg() + 0.1
        return 2 if below else 7

    def _lowest_deg(self) -> float:
        lowest_deg = self._mechanics.machine.lowest_altitude_deg
        return LOWEST_DEG if lowest_deg is None else lowest_deg

    # -- goto, flip, sync ------------------------------------------------------------------------

    def _target(self) -> Apparent:
        return Apparent(self.target_ra_deg, self.target_dec_deg, utc_now())

    def _busy(self) -> int:
        """What forbids a goto or a sync whatever the place [ONSTEP Goto::validate]."""
        if self._mechanics.parked:
            return _PARKED
        if self.going:
            return _IN_GOTO
        if self.moved or self._mechanics.guiding():
            return _IN_MOTION
        return OK if self._settings.ready else _LIMIT

    def _unreachable(self, side: PierSide | None = None) -> int:
        target = self._target()
        if self._mechanics.believed_altitude_deg(target) < self._lowest_deg():
            return _BELOW
        refusal = self._mechanics.refusal(target, side)
        return {None: OK, Refusal.BELOW_HORIZON: _BELOW, Refusal.LIMIT: _LIMIT}.get(refusal, _UNSPECIFIED)

    def slew(self, side: PierSide | None = None) -> int:
        """Set out for the target."""
        busy = self._busy()
        if busy == _IN_GOTO:
            # refused, and the goto that runs ends [ONSTEP Goto::request]
            self.stop()
        error = busy or self._unreachable(side)
        if error == OK:
            tracked = self._mechanics.tracking
            self._mechanics.slew(self._target(), side)
            if not (tracked or self._first_goto):
                self._mechanics.tracking = False
            self._first_goto, self.going = False, True
        return error

    def flip(self, side: PierSide | None) -> int:
        """Set out for the present place on a side, the other one if None."""
        here, present = self._mechanics.reported(), self._mechanics.pier_side()
        if present is PierSide.UNKNOWN:
            return _UNSPECIFIED
        self.target_ra_deg, self.target_dec_deg = here.ra_deg, here.dec_deg
        return self.slew(side or (PierSide.WEST if present is PierSide.EAST else PierSide.EAST))

    def destination(self) -> PierSide:
        """Side on which it would look at the target, unknown if it would not."""
        if self._unreachable() != OK:
            return PierSide.UNKNOWN
        side = self._mechanics.destination_side(self._target())
        return PierSide.EAST if side is PierSide.UNKNOWN else side

    def sync(self) -> int:
        """Take the target for where it points: on the present side, except at home."""
        mechanics = self._mechanics
        at_home, side = mechanics.at_home, mechanics.pier_side()
        error = self._busy() or self._unreachable(None if at_home or side is PierSide.UNKNOWN else side)
        if error != OK:
            return error
        if mechanics.sync(self._target()) is not None:
            return _UNSPECIFIED
        if at_home:
            mechanics.tracking = True
        return OK

    def stop(self) -> None:
        """End all motion."""
        station = self._mechanics.parking or self._mechanics.homing
        self._mechanics.stop()
        if station and self.going:
            # an ended park or home tracks again if it did before [ONSTEP requestAborted]
            self._mechanics.tracking = self._tracked
        self.going, self.moved = False, True

    # -- park and home ---------------------------------------------------------------------------

    def park(self) -> int:
        """Set out for the park position."""
        if self._mechanics.parked:
            return OK
        error = PARK_FAILED if self._mechanics.parking else self._busy()
        if error == OK:
            self._go(self._mechanics.park)
        return error

    def unpark(self) -> int:
        """Track again; at home it may, too."""
        if not self._mechanics.parked and not self._mechanics.at_home:
            return NOT_PARKED
        if not self._settings.ready:
            return IS_PARKED
        self._mechanics.unpark()
        self._mechanics.tracking = True
        self._first_goto = False
        return OK

    def home(self) -> None:
        """Set out for home."""
        if self._busy() == OK:
            self._go(self._mechanics.home)

    def set_park(self) -> int:
        """Take the present place for the park position."""
        busy = self._busy()
        if busy == _PARKED:
            return IS_PARKED
        if busy in (_IN_GOTO, _IN_MOTION):
            return busy
        self._mechanics.set_park()
        return OK

    def _go(self, to_station: Callable[[], object]) -> None:
        self._tracked = self._mechanics.tracking
        to_station()
        self.going = True
