"""Minor planets and comets by their elements, integrated with the pull of Sun, planets and Moon.

The way is integrated numerically (scipy's DOP853) from the elements' epoch, with the places of the perturbing
bodies from the ephemeris in use, and Einstein's first correction for the Sun. Own forces count where the
elements tell them: jets of comets, warmth of small minor planets. The pull of other minor planets is
left out: Ceres, Pallas and Vesta move a main-belt orbit by some 0.02″ in a year.

What was integrated is kept: a second question within the same days costs 0.3 ms.
"""

from __future__ import annotations

import math
import threading
from bisect import bisect_left
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mountnav.ephemeris.elements import GM_SUN_AU3_DAY2, Covariance, OrbitElements, two_body
from mountnav.ephemeris.ephemeris import require_aware, require_within
from mountnav.errors import BadRequest
from mountnav.sky.coordinates import Icrs, Site
from mountnav.sky.kernel import barycentric_state_km, span_jd
from mountnav.sky.observer import direction, earth_barycentric_km, instant, seen_from
from mountnav.units import AU_KM, J2000_JD, J2000_UTC, JULIAN_YEAR_DAYS

Vector = NDArray[np.float64]

_GM: Final = {
    10: GM_SUN_AU3_DAY2,
    1: 4.9125001948893182e-11,
    2: 7.2434523326441187e-10,
    399: 8.8876924467071022e-10,
    301: 1.0931894624024351e-11,
    4: 9.5495488297258119e-11,
    5: 2.8253458252257917e-07,
    6: 8.4597059933762903e-08,
    7: 1.2920265649682399e-08,
    8: 1.5243573478851939e-08,
    9: 2.1750964648933581e-12,
}
"""Mass parameters of DE440, au³/day², by NAIF's number; the planets from Mars on with their satellites."""
_LIGHT_AU_DAY: Final = 173.14463267424034
"""Speed of light, au/day."""
_TOLERANCE: Final = 1e-11
"""Relative error of a step. Doubled, the places of a year are within 0.001″ still."""
_STEPS_A_CALL: Final = 800
"""Steps of one question at most: 1.5 s of a slow core. An orbit of the main belt takes 25 a year; who asks
for more gets a refusal, not a service that doesn't answer."""
_EDGE_DAYS: Final = 60.0
"""So far from the end of the planets' places a way ends: a step of the integration may reach beyond its
instant. Doubled, two months more are missing."""
_LONGEST_YEARS: Final = 15.0
"""So far from the epoch elements are used. Doubled, sums of unmodeled pulls grow by four, and an answer takes
longer."""
_MOST_SIGMA_DEG: Final = 5.0
"""A place that is less certain than this is refused: no search finds it. Doubled, twice the sky is offered
for nothing."""


def _barycentric_au(number: int, jd: float) -> Vector:
    # two parts, so that the day is exact
    whole = math.floor(jd)
    state = barycentric_state_km(number, whole, jd - whole)
    if state is None:
        raise BadRequest(
            "the planets' pull is needed for a time that no ephemeris on this machine covers",
            advice="the shipped one is from 2015 to 2054; import another: mountnav ephemeris import FILE.bsp",
        )
    return state[0] / AU_KM


class _Way:
    """The integrated way to one side of the epoch, extended as it is asked for."""

    def __init__(self, elements: OrbitElements, forward: bool) -> None:
        self._elements = elements
        self._sign = 1.0 if forward else -1.0
        place, velocity = elements.heliocentric(elements.epoch_jd)
        whole = math.floor(elements.epoch_jd)
        sun = barycentric_state_km(10, whole, elements.epoch_jd - whole)
        if sun is None:
            raise BadRequest(
                f"the elements of {elements.name} are of {_day(elements.epoch_jd)}: no "
                "ephemeris on this machine covers that date",
                advice="get elements of today, or import an ephemeris: mountnav ephemeris import FILE.bsp",
            )
        self._begin = np.concatenate((place + sun[0] / AU_KM, velocity + sun[1] / AU_KM))
        # the integrators of scipy take longer to load than all the rest of this room
        from scipy.integrate import DOP853

        self._solver = DOP853(
            self._pull, 0.0, self._begin, self._sign * 1e6, rtol=_TOLERANCE, atol=1e-13, max_step=50.0
        )
        self._ends: list[float] = []
        self._pieces: list[Any] = []

    def state(self, since_days: float) -> Vector:
        """Place and velocity from the barycenter so many days from the epoch, shape (6,), au and au/day."""
        if since_days == 0.0:
            return self._begin
        steps = 0
        while not self._ends or self._ends[-1] < abs(since_days):
            if steps >= _STEPS_A_CALL or self._solver.status != "running":
                raise BadRequest(
                    f"the orbit of {self._elements.name} is too curved to integrate "
                    f"over {abs(since_days):.0f} days",
                    advice="get elements of today",
                )
            steps += 1
            self._solver.step()
            self._pieces.append(self._solver.dense_output())
            self._ends.append(abs(self._solver.t))
        found = self._pieces[bisect_left(self._ends, abs(since_days))](since_days)
        if not np.all(np.isfinite(found)):
            raise BadRequest(f"the orbit of {self._elements.name} leads into a planet or the Sun")
        return np.asarray(found)

    def _pull(self, since_days: float, state: Vector) -> Vector:
        jd = self._elements.epoch_jd + since_days
        place, velocity = state[:3], state[3:]
        total = np.zeros(3)
        whole = math.floor(jd)
        for number, gm in _GM.items():
            body = barycentric_state_km(number, whole, jd - whole)
            if body is None:
                _barycentric_au(number, jd)
                continue
            apart = body[0] / AU_KM - place
            pull = apart * (gm / float(apart @ apart) ** 1.5)
            total = total + pull
            if number == 10:
                total = total + self._beside_newton(jd, -apart, velocity - body[1] / AU_KM)
        return np.concatenate((velocity, total))

    def _beside_newton(self, jd: float, r: Vector, v: Vector) -> Vector:
        """What the Sun does beside Newton's law [Will 1981, eq. 7.26], and the body's own forces."""
        distance = float(np.linalg.norm(r))
        gm = GM_SUN_AU3_DAY2
        einstein: Vector = (
            gm
            / (_LIGHT_AU_DAY**2 * distance**3)
            * ((4.0 * gm / distance - float(v @ v)) * r + 4.0 * float(r @ v) * v)
        )
        forces = self._elements.forces
        if forces is None:
            return einstein
        if forces.lag_days:
            # the distance of then by two-body motion: the law is smooth
            past = self._elements.heliocentric(jd - forces.lag_days)[0]
            g = forces.strength(float(np.linalg.norm(past)))
        else:
            g = forces.strength(distance)
        radial = r / distance
        normal = np.cross(r, v)
        normal = normal / float(np.linalg.norm(normal))
        along = np.cross(normal, radial)
        return einstein + g * (forces.a1 * radial + forces.a2 * along + forces.a3 * normal)


@dataclass(frozen=True, slots=True)
class SmallBody:
    """A minor planet or a comet, as an `Ephemeris`.

    Raises
    ------
    BadRequest
        Its epoch lies outside of all ephemerides of the planets here.
    """

    elements: OrbitElements
    _ways: dict[bool, _Way] = field(init=False, repr=False, compare=False, default_factory=dict)
    _lock: threading.Lock = field(init=False, repr=False, compare=False, default_factory=threading.Lock)

    def __post_init__(self) -> None:
        """Refuse elements without planets."""
        self._ways[True] = _Way(self.elements, forward=True)

    @property
    def name(self) -> str:
        """As its elements call it."""
        return self.elements.name

    @property
    def begins_utc(self) -> datetime | None:
        """15 years before the epoch, or where the planets' places begin."""
        return _utc(
            max(self.elements.epoch_jd - _LONGEST_YEARS * JULIAN_YEAR_DAYS, span_jd(10)[0] + _EDGE_DAYS)
        )

    @property
    def ends_utc(self) -> datetime | None:
        """15 years after the epoch, or where the planets' places end."""
        return _utc(
            min(self.elements.epoch_jd + _LONGEST_YEARS * JULIAN_YEAR_DAYS, span_jd(10)[1] - _EDGE_DAYS)
        )

    def icrs(self, utc: datetime, site: Site) -> Icrs:
        """Where it stands: topocentric, light time taken off.

        Raises
        ------
        BadRequest
            Too far from the epoch, outside of all ephemerides of the planets, or too uncertain to be found.
        """
        self._require_near(utc)
        vector, _ = seen_from(lambda jd1, jd2: self._barycentric(jd1, jd2)[:3] * AU_KM, utc, site)
        return direction(vector)

    def sigma_arcsec(self, utc: datetime) -> float:
        """How uncertain it is, by its covariance if that is told, else by U and the elements' age."""
        self._require_near(utc, certain=False)
        now = instant(utc)
        earth = earth_barycentric_km(utc)[0] / AU_KM
        state = self._barycentric(now.jd1, now.tdb2)
        distance = float(np.linalg.norm(state[:3] - earth))
        if self.elements.covariance is not None:
            told = self._of_covariance(self.elements.covariance, now.jd1 + now.tdb2, state[:3] - earth)
            return math.hypot(_OWN_SIGMA_ARCSEC, told)
        sun = _barycentric_au(10, now.jd1 + now.tdb2)
        from_sun = float(np.linalg.norm(state[:3] - sun))
        years = (now.jd1 + now.tdb2 - self.elements.epoch_jd) / JULIAN_YEAR_DAYS
        # told at the Sun, seen from the Earth
        return math.hypot(
            _OWN_SIGMA_ARCSEC, self.elements.along_arcsec(years) * from_sun / max(distance, 1e-4)
        )

    def _of_covariance(self, told: Covariance, jd: float, seen: Vector) -> float:
        """The larger half-axis of the ellipse on the sky: two-body motion varied by each element."""
        matrix = np.asarray(told.matrix, dtype=np.float64)
        start = np.asarray(told.elements, dtype=np.float64)

        def place(values: Vector) -> Vector:
            e, q, tp, node, peri, incl = (float(value) for value in values)
            angles = (math.radians(incl), math.radians(node), math.radians(peri))
            return two_body(q, max(e, 0.0), *angles, jd - tp)[0]

        # each element by its own sigma, or less: two-body motion is straight over that
        steps = np.clip(np.sqrt(np.maximum(np.diag(matrix), 0.0)), 1e-12, 1e-4)
        partials = np.empty((3, 6))
        for column in range(6):
            aside = np.zeros(6)
            aside[column] = steps[column]
            partials[:, column] = (place(start + aside) - place(start - aside)) / (2.0 * steps[column])
        distance = float(np.linalg.norm(seen))
        toward = seen / distance
        on_sky = (np.eye(3) - np.outer(toward, toward)) @ partials / distance
        spread = on_sky @ matrix @ on_sky.T
        return math.degrees(math.sqrt(max(float(np.linalg.eigvalsh(spread)[-1]), 0.0))) * 3600.0

    def _barycentric(self, jd1: float, jd2: float) -> Vector:
        since = (jd1 - self.elements.epoch_jd) + jd2
        with self._lock:
            way = self._ways.get(since >= 0.0)
            if way is None:
                way = self._ways[since >= 0.0] = _Way(self.elements, forward=since >= 0.0)
            return way.state(since)

    def _require_near(self, utc: datetime, *, certain: bool = True) -> None:
        require_aware(utc)
        now = instant(utc)
        years = (now.jd1 + now.tdb2 - self.elements.epoch_jd) / JULIAN_YEAR_DAYS
        if abs(years) > _LONGEST_YEARS:
            raise BadRequest(
                f"the elements of {self.name} are of {_day(self.elements.epoch_jd)}, {abs(years):.1f} years "
                f"away; {_LONGEST_YEARS:g} are the most",
                advice="get elements of today",
            )
        begins, ends = self.begins_utc, self.ends_utc
        require_within(self.name, utc, begins, ends, " (there the planets' places end: import an ephemeris)")
        if certain and (sigma := self.sigma_arcsec(utc)) > _MOST_SIGMA_DEG * 3600.0:
            raise BadRequest(
                f"{self.name} may be {sigma / 3600.0:.1f}° off by elements of {_day(self.elements.epoch_jd)} "
                f"(U = {'unknown' if self.elements.uncertainty is None else self.elements.uncertainty}); "
                f"beyond {_MOST_SIGMA_DEG:g}° it is not searched for",
                advice="get newer elements, or an ephemeris table",
            )


_OWN_SIGMA_ARCSEC: Final = 0.05
"""Of the integration, and of the minor planets whose pull is left out. Doubled, well-known ones are searched
a little wider."""


def _utc(jd: float) -> datetime | None:
    try:
        return J2000_UTC + timedelta(days=jd - J2000_JD)
    except OverflowError:
        return None


def _day(jd: float) -> str:
    found = _utc(jd)
    return "long ago" if found is None else f"{found:%Y-%m-%d}"
