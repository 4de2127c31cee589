"""Where a simulated telescope really looks and how its tube really stands: what judges, never what steers."""

from __future__ import annotations

import math
from datetime import datetime

from mountnav.simulation.geometry import true_direction
from mountnav.simulation.machine import AxisAngles
from mountnav.simulation.mechanics_readings import MechanicsReadings
from mountnav.simulation.motion import Motion
from mountnav.sky.chain import hour_angle_to_icrs, hour_angle_to_observed
from mountnav.sky.coordinates import SIDEREAL_DEG_S, HourAngle, Icrs, Observed
from mountnav.sky.sphere import position_angle_deg

# How far the declination axis is raised to see where the tube's north is, degrees. Only the direction is
# used.
_NUDGE_DEG = 0.01


class MechanicsTruth(MechanicsReadings):
    """The truth of a simulated mount, at any instant; see `Mechanics`."""

    def truth(self, utc: datetime | None = None) -> Icrs:
        """Where the optical axis really looks, errors and refraction included."""
        return hour_angle_to_icrs(self.true_hour_angle(utc), self.site, self.air)

    def true_hour_angle(self, utc: datetime | None = None) -> HourAngle:
        """Observed hour angle and declination at which the optical axis really looks; costs microseconds."""
        utc, t_s, motion = self._asked(utc)
        return self._looks_at(self._driven(motion, t_s), utc)

    def true_observed(self, utc: datetime | None = None) -> Observed:
        """Azimuth and altitude at which the optical axis really looks; costs microseconds."""
        return hour_angle_to_observed(self.true_hour_angle(utc), self.site)

    def true_axes(self, utc: datetime | None = None) -> AxisAngles:
        """How the axes really stand, zero points and backlash included, deg over all turns.

        The angles are those of `posture.axes_at`: what tells whether the tube is near the pier. No sync, no
        reboot and no label of an encoder changes them.
        """
        _, t_s, motion = self._asked(utc)
        ha_deg, dec_deg = self._driven(motion, t_s)
        return ha_deg + self.errors.ih_arcsec / 3600.0, dec_deg + self.errors.id_arcsec / 3600.0

    def tube_angle_deg(self, utc: datetime | None = None) -> float:
        """Position angle (north through east, [0, 360)) of the tube's own north: where its δ axis raises it.

        About 0 in the normal posture, about 180 beyond the pole; near the pole the errors turn it. A camera
        that is turned by an angle in the tube shows this angle more.
        """
        utc, t_s, motion = self._asked(utc)
        ha_deg, dec_deg = self._driven(motion, t_s)
        here = self._looks_at((ha_deg, dec_deg), utc)
        there = self._looks_at((ha_deg, dec_deg + _NUDGE_DEG), utc)
        return position_angle_deg(
            hour_angle_to_icrs(here, self.site, self.air), hour_angle_to_icrs(there, self.site, self.air)
        )

    # -- inside ----------------------------------------------------------------------------------

    def _driven(self, motion: Motion, t_s: float) -> AxisAngles:
        """Axis angles behind the play, with the worm's error."""
        ha, dec = motion.last.ha.path, motion.last.dec.path
        worm_turn_deg = SIDEREAL_DEG_S * self.errors.periodic_period_s
        periodic_deg = (self.errors.periodic_amplitude_arcsec / 3600.0) * math.sin(
            math.tau * ha.angle_at(t_s) / worm_turn_deg
        )
        return ha.driven_at(t_s) + periodic_deg, dec.driven_at(t_s)

    def _looks_at(self, axes: AxisAngles, utc: datetime) -> HourAngle:
        return HourAngle(*true_direction(*axes, self.errors, self.site.latitude_deg), utc)
