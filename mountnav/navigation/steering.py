"""Where to send a mount that looks beside its target: on the sphere, and near the pole by its geometry."""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum

import numpy as np

from mountnav.devices import PierSide
from mountnav.sky.chain import (
    apparent_to_hour_angle,
    apparent_to_icrs,
    hour_angle_to_apparent,
    icrs_to_apparent,
)
from mountnav.sky.coordinates import GeometricHourAngle, Icrs, Site
from mountnav.sky.sphere import displaced, half_turn_deg, offset_arcsec, separation_arcsec

__all__ = [
    "POLAR_DEC_DEG",
    "Followed",
    "Hole",
    "PolarSteering",
    "Sighting",
    "Steering",
    "sent_as_believed",
    "steering_for",
]


Vector = tuple[float, float]


class Followed(StrEnum):
    """Whether the tube did what the last correction asked."""

    FIRST = "nothing was corrected before"
    YES = "followed"
    UNTOLD = "the correction was too small to tell"
    POLAR = "near the pole steps are learned from, not judged"
    STUCK = "did not follow"
    """The mount says that it moved; the tube hardly did: backlash, a clutch, a blocked axis."""
    ELSEWHERE = "went elsewhere"
    """It moved, and not where it was sent: a slip, a late sync, a belief that jumped."""


@dataclass(frozen=True, slots=True)
class Sighting:
    """One look, as far as steering needs it.

    Attributes
    ----------
    sent : Icrs
        Where the mount was sent, in what it believed when it was seen: where it says it points, if a sync or
        a jump came between.
    seen : Icrs
        Where the tube looked.
    side : PierSide
        On which the tube hung.
    """

    sent: Icrs
    seen: Icrs
    side: PierSide = PierSide.UNKNOWN


class Steering:
    """The corrections of one centering: the tube moves as the mount is sent.

    Parameters
    ----------
    noise_arcsec : float
        Below this a step shows nothing: the mount's resolution, and what looks scatter.
    """

    polar = False

    def __init__(self, target: Icrs, noise_arcsec: float) -> None:
        self.target = target
        self._noise_arcsec = noise_arcsec
        self._last: Sighting | None = None

    def sighted(self, sighting: Sighting, utc: datetime) -> Followed:
        """Take in a look of that instant; whether the tube followed the correction before it."""
        before, self._last = self._last, sighting
        if before is None:
            return Followed.FIRST
        asked = _minus(self._arc(sighting.sent), self._arc(before.sent))
        moved = _minus(self._arc(sighting.seen), self._arc(before.seen))
        length = math.hypot(*asked)
        if length <= 2.0 * self._noise_arcsec:
            return Followed.UNTOLD
        if math.hypot(*_minus(moved, asked)) <= 0.5 * length + self._noise_arcsec:
            return Followed.YES
        if math.hypot(*moved) <= 0.3 * length + self._noise_arcsec:
            return Followed.STUCK
        return Followed.ELSEWHERE

    def forget(self) -> None:
        """What was sent before counts no more: a flip, a new segment."""
        self._last = None

    def believed(self, place: Icrs) -> None:
        """A sync was seen: what the mount believes is what was seen."""
        self._last = Sighting(place, place)

    def disbelieve(self) -> None:
        """The last look was wrong."""
        self._last = None

    def next_aim(self, utc: datetime, side: PierSide = PierSide.UNKNOWN) -> Icrs:
        """Where to send the mount next, after a look."""
        if self._last is None:
            return self.target
        sent, seen = self._arc(self._last.sent), self._arc(self._last.seen)
        return displaced(self.target, sent[0] - seen[0], sent[1] - seen[1])

    def _arc(self, place: Icrs) -> Vector:
        offset = offset_arcsec(place, self.target)
        return offset.east_arcsec, offset.north_arcsec


def sent_as_believed(aim: Icrs, believed: Icrs, bound_arcsec: float) -> Icrs:
    """What a look's steps are counted from: the aim, unless the mount says it points elsewhere.

    Parameters
    ----------
    aim : Icrs
        Where it was sent.
    believed : Icrs
        Its reading at mid-exposure.
    bound_arcsec : float
        Misses of arriving up to this belong to the mount: it will miss again by as much. A reading further
        off has jumped since: a sync that took hold late.
    """
    return aim if separation_arcsec(aim, believed) <= bound_arcsec else believed


def _minus(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1]


POLAR_DEC_DEG = 87.0
"""From here on steps are taken in the plane about the pole, °. Chosen by hand: at 3° from the pole a cone
error of 3′ turns a step by 1°. Doubled distance (84°), the plane's curvature begins to count."""

ENOUGH_LOOKS = 3
"""So many looks determine the geometry. Two components each, for five unknowns with a prior. Doubled, a
centering at the pole needs three more exposures before it says that there is a hole."""
_LIKELY_ARCSEC = 900.0
"""How large pole errors, zero points and cone errors are before anything is seen, ″, one sigma: the prior of
the fit, weak beside looks that are good to some seconds. Chosen by hand. Doubled, it is weaker still."""
_AT_THE_POLE_ARCSEC = 15.0
"""At the pole itself there is no hour angle any more to turn to: so far beside it the mount is sent, ″."""
_LIKELY_TURN_RAD = math.radians(3.0)
"""How far the hour angle's zero is off before anything is seen, one sigma: 3° are 12 min of a wrong clock.
Chosen by hand; doubled, it says less."""


@dataclass(frozen=True, slots=True)
class Hole:
    """Where the mount can't point: round its own pole.

    Attributes
    ----------
    short_arcsec : float
        How far the target is from the nearest place that it can point to.
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
    noise_arcsec : float
        How well looks fit the geometry: the mount's steps, and what is left out.
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
            rows += [tuple(column.real for column in columns), tuple(column.imag for column in columns)]
            values += [rest.real, rest.imag]
        weights = np.array([1.0 / _LIKELY_ARCSEC] * 4 + [1.0 / _LIKELY_TURN_RAD])
        design = np.vstack([np.array(rows) / self._noise_arcsec, np.diag(weights)])
        wanted = np.concatenate([np.array(values) / self._noise_arcsec, np.zeros(5)])
        x, y, zero, cone, turn = (float(value) for value in np.linalg.lstsq(design, wanted, rcond=None)[0])
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
