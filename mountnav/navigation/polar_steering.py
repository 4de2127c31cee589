"""Corrections near the pole, where a cone error or a wrong zero point turns each step round.

In the plane about the pole, with hour angle θ and polar distance r as the mount believes them, the tube looks
at

    S = P + e^{iθ} (1 + iα) (r + w)        w = (zero point of the declination) + i (cone error)

with the mount's own pole at P and a wrong zero point α of the hour angle: the rigorous geometry to the first
order in the errors [POINTING §5: ME MA, ID CH, IH], at any distance from the pole, however small. All of it
is linear in P, w and α, and so each look gives two equations more; what a decent mount's errors may be fills
in the rest. What is left out (flexure, refraction) changes little over a degree and goes into P.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass
from datetime import datetime

import numpy as np

from mountnav.devices import PierSide
from mountnav.navigation.steering import Followed, Sighting, Steering
from mountnav.sky.chain import (
    apparent_to_hour_angle,
    apparent_to_icrs,
    hour_angle_to_apparent,
    icrs_to_apparent,
)
from mountnav.sky.coordinates import GeometricHourAngle, Icrs, Site
from mountnav.sky.sphere import half_turn_deg

POLAR_DEC_DEG = 87.0
"""From here on steps are taken in the plane about the pole."""

ENOUGH_LOOKS = 3
"""So many looks tell the geometry."""
_LIKELY_ARCSEC = 900.0
_AT_THE_POLE_ARCSEC = 15.0
"""At the pole itself there is no hour angle any more to turn to."""
_LIKELY_TURN_RAD = math.radians(3.0)


@dataclass(frozen=True, slots=True)
class Hole:
    """Where the mount can't point: round its own pole.

    Attributes
    ----------
    short_arcsec : float
        How far the target is from the nearest place that it can point to.
    words : str
    advice : str
    """

    short_arcsec: float
    words: str
    advice: str = "square the tube to the declination axis, or choose a target further from the pole"


@dataclass(frozen=True, slots=True)
class _Look:
    """Where it was sent and where it looked, in the plane; -1 for a tube that looks through the pole."""

    sent: complex
    seen: complex
    posture: float


class PolarSteering:
    """The corrections of one centering near a pole. Used as `Steering`.

    Parameters
    ----------
    target : Icrs
    noise_arcsec : float
        How well looks fit the geometry: the mount's steps, and what is left out.
    site : Site
    """

    polar = True

    def __init__(self, target: Icrs, noise_arcsec: float, site: Site) -> None:
        self.target = target
        self._noise_arcsec = noise_arcsec
        self._site = site
        self._sign = 1.0 if target.dec_deg >= 0.0 else -1.0
        self._looks: list[_Look] = []

    @property
    def looks(self) -> int:
        """How many looks it knows of."""
        return len(self._looks)

    def sighted(self, sighting: Sighting, utc: datetime) -> Followed:
        """Take in a look of that instant."""
        first = not self._looks
        self._looks.append(
            _Look(self._plane(sighting.sent, utc), self._plane(sighting.seen, utc), _posture(sighting.side))
        )
        return Followed.FIRST if first else Followed.POLAR

    def forget(self) -> None:
        """What was sent before counts no more."""
        self._looks = []

    def believed(self, place: Icrs) -> None:
        """A sync was seen: all that was known before is of another geometry."""
        self.forget()

    def disbelieve(self) -> None:
        """The last look was wrong."""
        self._looks = self._looks[:-1]

    def next_aim(self, utc: datetime, side: PierSide = PierSide.UNKNOWN) -> Icrs:
        """Where to send the mount next, if the tube will hang on that side.

        The nearest that it can point to, if the target is in its hole.
        """
        return self._solved(utc, side)[0]

    def hole(self, utc: datetime, side: PierSide = PierSide.UNKNOWN) -> Hole | None:
        """Whether the target can't be pointed to, by what three looks or more have shown."""
        _, short, off_arcsec = self._solved(utc, side)
        if self.looks < ENOUGH_LOOKS or short <= 0.0:
            return None
        if off_arcsec:
            return Hole(
                short,
                f"by its own count, {off_arcsec:.0f}″ off in declination, the target lies beyond the pole; "
                f"it stays {short:.0f}″ short",
                "sync it further from the pole, or order first light, and then again; if it takes no syncs, "
                "choose a target further from the pole",
            )
        return Hole(short, f"at its own pole the mount can't point; it stays {short:.0f}″ short")

    # -- the geometry --------------------------------------------------------------------------------

    def _solved(self, utc: datetime, side: PierSide) -> tuple[Icrs, float, float]:
        """Where to send it, how far it stays short, and the zero point by which it does (arcsec; else 0)."""
        if not self._looks:
            return self.target, 0.0, 0.0
        posture = _posture(side)
        pole, tube, turn = self._fitted()
        # what the geometry doesn't explain of the latest look will be the same near it
        last = self._looks[-1]
        turned = 1.0 + 1j * turn
        explained = pole + turned * (last.sent + last.posture * tube * _direction(last.sent))
        # turned back as it was turned: by an angle alone 4° would leave 0.25 % of the way, 20″ at 2.4°
        way = (self._plane(self.target, utc) - pole - (last.seen - explained)) / turned
        zero, cone = posture * tube.real, posture * tube.imag
        along = math.sqrt(max(0.0, abs(way) ** 2 - cone**2))
        short = max(0.0, abs(cone) - abs(way))
        distance, off_arcsec = along - zero, 0.0
        if distance < 0.0:
            off_arcsec = abs(zero)
            # beyond the pole by its own count: no mount is sent there, so stop at the pole itself
            short, along = max(short, abs(tube) - abs(way)), zero
            distance = _AT_THE_POLE_ARCSEC
        angle = cmath.phase(way) - math.atan2(cone, along)
        return self._place(cmath.rect(distance, angle), utc), short, off_arcsec

    def _fitted(self) -> tuple[complex, complex, float]:
        """Pole, tube (zero point and cone; arcsec) and turn (radians): the likeliest by all looks so far."""
        rows: list[tuple[float, ...]] = []
        values: list[float] = []
        for look in self._looks:
            way = look.posture * _direction(look.sent)
            columns = (1.0 + 0.0j, 1j, way, 1j * way, 1j * look.sent)
            rest = look.seen - look.sent
            rows += [tuple(one.real for one in columns), tuple(one.imag for one in columns)]
            values += [rest.real, rest.imag]
        weights = np.array([1.0 / _LIKELY_ARCSEC] * 4 + [1.0 / _LIKELY_TURN_RAD])
        design = np.vstack([np.array(rows) / self._noise_arcsec, np.diag(weights)])
        wanted = np.concatenate([np.array(values) / self._noise_arcsec, np.zeros(5)])
        x, y, zero, cone, turn = (float(one) for one in np.linalg.lstsq(design, wanted, rcond=None)[0])
        return complex(x, y), complex(zero, cone), turn

    def _plane(self, place: Icrs, utc: datetime) -> complex:
        """Arcseconds from the pole, in the direction of the hour angle."""
        here = apparent_to_hour_angle(icrs_to_apparent(place, utc), self._site)
        distance = (90.0 - self._sign * here.dec_deg) * 3600.0
        return cmath.rect(distance, math.radians(here.ha_deg))

    def _place(self, plane: complex, utc: datetime) -> Icrs:
        dec_deg = self._sign * (90.0 - abs(plane) / 3600.0)
        ha_deg = half_turn_deg(math.degrees(cmath.phase(plane)))
        return apparent_to_icrs(hour_angle_to_apparent(GeometricHourAngle(ha_deg, dec_deg, utc), self._site))


def steering_for(target: Icrs, resolution_arcsec: float, site: Site) -> Steering | PolarSteering:
    """The steering that a target asks for."""
    if abs(target.dec_deg) >= POLAR_DEC_DEG:
        return PolarSteering(target, max(3.0, 0.5 * resolution_arcsec), site)
    return Steering(target, max(5.0, resolution_arcsec))


def _posture(side: PierSide) -> float:
    """Through the pole a zero point and a cone error count the other way round."""
    return -1.0 if side is PierSide.WEST else 1.0


def _direction(plane: complex) -> complex:
    return plane / abs(plane) if plane else 1.0 + 0.0j


__all__ = ["POLAR_DEC_DEG", "Hole", "PolarSteering", "steering_for"]
