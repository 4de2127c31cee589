"""Orders that last: tracking and its rates, park, home, and what the mount is told of time and place."""

from __future__ import annotations

import math
from dataclasses import replace
from datetime import datetime

from mountnav.devices import TrackingRate
from mountnav.errors import BadSettings, Refusal
from mountnav.simulation.belief import with_future
from mountnav.simulation.machine import AxisAngles
from mountnav.simulation.mechanics_motors import MechanicsMotors, Order
from mountnav.simulation.motion import AxisName, Goal
from mountnav.simulation.posture import turned_near
from mountnav.sky.coordinates import SIDEREAL_DEG_S, Site


class MechanicsStations(MechanicsMotors):
    """Tracking, stations, clock and site of a simulated mount; see `Mechanics`."""

    # -- tracking --------------------------------------------------------------------------------

    @property
    def tracking(self) -> bool:
        """Whether the hour angle axis follows the sky when nothing else is ordered."""
        return self._tracking()

    @tracking.setter
    def tracking(self, on: bool) -> None:
        with self._order(moves=False) as order:
            if not order.parked and order.motion.bound_for != "park":
                self._track(order, on)

    @property
    def rate(self) -> TrackingRate:
        """How fast it tracks; `CUSTOM` takes what `track_at` set last."""
        return self._motion.rate

    @rate.setter
    def rate(self, rate: TrackingRate) -> None:
        with self._order(moves=False) as order:
            order.motion = replace(order.motion, rate=rate).with_rates_kept()
            if not order.parked and order.motion.bound_for != "park":
                self._track(order, order.motion.now.tracking)

    def track_at(self, ha_deg_s: float, dec_deg_s: float = 0.0) -> None:
        """Set the custom rates (hour angle axis; declination, north positive), and take up that rate.

        Each is at most the axis' slew rate. They hold until another rate is set or the mount is rebooted:
        slews, stops, pulses, parking and a change of sides leave them as they are.
        """
        self._check_rates(ha_deg_s, dec_deg_s)
        ha_most, dec_most = self._rates_deg_s["ha"], self._rates_deg_s["dec"]
        custom = max(-ha_most, min(ha_most, ha_deg_s)), max(-dec_most, min(dec_most, dec_deg_s))
        with self._order(moves=False) as order:
            motion = replace(order.motion, rate=TrackingRate.CUSTOM, custom_deg_s=custom)
            order.motion = motion.with_rates_kept()
            if not order.parked and order.motion.bound_for != "park":
                self._track(order, order.motion.now.tracking)

    def track_beside(self, ra_arcsec_s: float, dec_arcsec_s: float) -> None:
        """Track at rates beside the sidereal one: ″/s of right ascension (not times cos δ) and declination.

        East and north are positive. Two zeros are the sidereal rate again.
        """
        self._check_rates(ra_arcsec_s, dec_arcsec_s)
        if ra_arcsec_s == 0.0 and dec_arcsec_s == 0.0:
            self.rate = TrackingRate.SIDEREAL
        else:
            self.track_at(SIDEREAL_DEG_S - ra_arcsec_s / 3600.0, dec_arcsec_s / 3600.0)

    @property
    def beside_arcsec_s(self) -> tuple[float, float]:
        """The rates beside the sidereal one that it takes itself to track at: what a firmware reads back.

        Those that were ordered, whatever a fault keeps of them, unless the fault shows in them.
        """
        _, _, motion = self._asked(None)
        if motion.rate is not TrackingRate.CUSTOM or any(one.reads_zero for one in motion.rate_faults):
            return 0.0, 0.0
        ha_deg_s, dec_deg_s = motion.custom_deg_s
        return (SIDEREAL_DEG_S - ha_deg_s) * 3600.0, dec_deg_s * 3600.0

    # -- stations --------------------------------------------------------------------------------

    def park(self) -> None:
        """Set out for the park position, to rest there parked. Harmless when it is parked."""
        with self._order() as order:
            if not order.parked:
                self._go_to(order, *order.motion.park_axes)
                order.motion = replace(order.motion, bound_for="park")

    def unpark(self) -> None:
        """Be ready to move again; parking that is under way ends. Harmless when it is not parked."""
        with self._order(moves=False) as order:
            if order.motion.bound_for != "park":
                return
            was_parked = order.parked
            order.motion = replace(order.motion, bound_for="")
            if not was_parked:
                self._still(order, "ha")
                self._still(order, "dec")
            elif self.machine.tracks_after_unpark:
                self._track(order, True)

    def set_park(self, axes_deg: AxisAngles | None = None) -> None:
        """Set the park position: axis angles as `posture.axes_at` gives them; None: the present ones.

        Where it is parked already it stays parked.
        """
        with self._order(moves=False) as order:
            belief = order.motion.belief_at(order.t_s)
            axes = axes_deg or self._believed_axes(order.motion, belief, order.t_s)
            order.motion = replace(order.motion, park_axes=axes)

    def home(self) -> Refusal | None:
        """Set out for home, to rest there; with a home sensor the position is right from then on."""
        with self._order() as order:
            if order.parked:
                return Refusal.PARKED
            home = self.machine.home_at(self.site.latitude_deg)
            t_s, belief = order.t_s, order.motion.belief_at(order.t_s)
            if self.machine.home_sensor:  # where home truly is, whatever it believes
                self._go_to(order, home[0] + belief.ha_shift_deg, home[1] + belief.dec_shift_deg)
                arrival_s = max(order.motion.now.ha.arrives_s, order.motion.now.dec.arrives_s)
                found = replace(
                    belief, start_s=max(arrival_s, t_s), by_homing=True, ha_counts_deg=0.0,
                    dec_counts_deg=0.0, ha_sync_deg=0.0, dec_sync_deg=0.0,
                )  # fmt: skip
                if arrival_s < math.inf:
                    order.motion = replace(order.motion, beliefs=with_future(order.motion.beliefs, found))
            else:
                self._go_to(order, *home)
            order.motion = replace(order.motion, bound_for="home")
        return None

    # -- its clock and site ----------------------------------------------------------------------

    def set_believed_utc(self, utc: datetime) -> None:
        """Set the mount's own clock (aware UTC); it drifts on from there."""
        with self._order(moves=False) as order:
            off_s = (utc - order.utc).total_seconds()
            t_s = order.t_s
            self._believe(order, lambda belief: replace(belief, clock_off_s=off_s, clock_since_s=t_s))

    def set_believed_site(self, site: Site) -> None:
        """Tell the mount where it stands."""
        with self._order(moves=False) as order:
            self._believe(order, lambda belief: replace(belief, site=site))

    # -- inside ----------------------------------------------------------------------------------

    @staticmethod
    def _check_rates(*rates: float) -> None:
        if not all(math.isfinite(rate) for rate in rates):
            raise BadSettings(f"{rates} are not rates to track at", advice="finite numbers")

    def _still(self, order: Order, name: AxisName) -> None:
        """Heed a stop on one axis, unless it does nothing to be stopped."""
        axis = order.motion.axis(name)
        if not axis.path.steady_at(order.t_s):
            rests = order.motion.tracking_deg_s(order.motion.now.tracking, self._north_here(order))
            goal = Goal(order.t_s, rests[0 if name == "ha" else 1], self._limits(name))
            order.motion = order.motion.with_axis(name, axis.stopped(order.t_s, goal))

    def _go_to(self, order: Order, ha_deg: float, dec_deg: float) -> None:
        """Set out for believed axis angles, to rest there."""
        belief = order.motion.belief_at(order.t_s)
        near = (
            order.motion.now.ha.path.angle_at(order.t_s),
            order.motion.now.dec.path.angle_at(order.t_s),
        )
        aim = turned_near(
            (ha_deg - belief.ha_shift_deg, dec_deg - belief.dec_shift_deg),
            near,
            self.machine,
            belief.ha_shift_deg,
        )
        self._send(order, "ha", Goal(order.t_s, 0.0, self._limits("ha"), aim[0]))
        self._send(order, "dec", Goal(order.t_s, 0.0, self._limits("dec"), aim[1]))
        order.motion = replace(order.motion, now=replace(order.motion.now, tracking=False))
