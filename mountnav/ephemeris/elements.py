"""Orbital elements of minor planets and comets, and the two-body motion that they mean.

Any eccentricity: the universal variable of [Danby 1988, §6.9], from the perihelion. Angles are of the
ecliptic and mean equinox J2000, as the MPC and JPL publish them; times are TDB, which the MPC's TT differs
from by 2 ms.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mountnav.errors import BadRequest

Vector = NDArray[np.float64]

GM_SUN_AU3_DAY2 = 2.9591220828411956e-04
"""Of DE440. Doubled, nothing stays where it is."""
OBLIQUITY_RAD = math.radians(84381.448 / 3600.0)
"""Of the ecliptic J2000 that orbits are published on [IAU 1976, as JPL and the MPC use it]."""
_LEAST_Q_AU = 0.003
"""Nearest perihelion that is taken; the Sun's surface is at 0.0047, and sungrazers pass it. Halved,
integrations that a stranger made up take twice as long."""
_MOST_Q_AU = 200.0
"""Farthest perihelion that is taken; Sedna's is 76 au."""
_MOST_ECCENTRICITY = 10.0
"""Largest eccentricity that is taken; 3I/ATLAS has 6.1."""
_FIRST_JD, _LAST_JD = 2378496.5, 2524593.5
"""Epochs and perihelions that are taken: 1800 to 2200."""
_KEPLER_STEPS = 200
"""Bisections and Newton's steps at most; five are usual. Doubled, nothing changes."""
_MOST_UNKNOWN = 5
"""The uncertainty parameter that is assumed where none is told."""

_RUNOFF_ARCSEC_DECADE = (1.0, 4.4, 19.6, 86.5, 382.0, 1692.0, 7488.0, 33121.0, 146502.0, 650000.0)
"""The MPC's uncertainty parameter U as the along-orbit error after ten years, upper end of each class [MPC,
"Uncertainty parameter U"]; the last is the next of the series."""
_SIGMA_NOW_ARCSEC = 0.3
"""What elements that are good are worth at their epoch: of rounding in the lists and of the last
observations."""
_COMET_SIGMA_ARCSEC = 1.0
"""The same of comets, whose light isn't centered on their nucleus."""
_COMET_RUNOFF_ARCSEC_YEAR = 20.0
"""How fast elements of a comet age that tell no uncertainty, as seen from 1 au: jets that nobody modeled.
Chosen by hand after the usual differences of the MPC's elements a year apart. Doubled, searches for comets
are twice as wide."""


@dataclass(frozen=True, slots=True)
class Covariance:
    """How well elements are known, as JPL's SBDB tells it.

    Attributes
    ----------
    matrix : tuple of tuple of float
        6 by 6, of e, q (au), perihelion time (days), node, argument of perihelion, inclination (degrees).
    elements : tuple of float
        The elements that it belongs to, in the same order; of an epoch of their own.

    Raises
    ------
    BadRequest
        They are no orbit.
    """

    matrix: tuple[tuple[float, ...], ...]
    elements: tuple[float, ...]

    def __post_init__(self) -> None:
        """Refuse what can't be varied."""
        e, q, tp, *angles = self.elements
        orbit = 0.0 <= e <= _MOST_ECCENTRICITY and _LEAST_Q_AU <= q <= _MOST_Q_AU
        if not (orbit and abs(tp) < 1e8 and all(abs(one) <= 720.0 for one in angles)):
            raise BadRequest(
                "the covariance belongs to elements that do not describe an orbit around the Sun"
            )


@dataclass(frozen=True, slots=True)
class OwnForces:
    """What moves a comet beside gravity, or a small minor planet that the Sun warms [Marsden et al. 1973].

    Attributes
    ----------
    a1, a2, a3 : float
        Away from the Sun, along the motion, and north of the orbit, au/day².
    scale, r0_au, m, n, k : float
        ``scale (r/r0)^-m (1 + (r/r0)^n)^-k``; by default that of water ice.
    lag_days : float
        So much later than the distance they follow.

    Raises
    ------
    BadRequest
        Numbers that belong to no body.
    """

    a1: float
    a2: float
    a3: float
    scale: float = 0.1112620426
    r0_au: float = 2.808
    m: float = 2.15
    n: float = 5.093
    k: float = 4.6142
    lag_days: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what would throw it out of the solar system."""
        strong = max(abs(self.a1), abs(self.a2), abs(self.a3)) < 1e-4
        law = 0.0 <= self.scale <= 10.0 and 0.1 <= self.r0_au <= 100.0
        powers = 0.0 <= self.m <= 6.0 and 0.0 <= self.n <= 60.0 and 0.0 <= self.k <= 10.0
        if not (strong and law and powers and abs(self.lag_days) <= 400.0):
            raise BadRequest("its nongravitational forces are not those of a comet")

    def strength(self, distance_au: float) -> float:
        """Of the law at a distance from the Sun."""
        part = distance_au / self.r0_au
        return float(self.scale * part**-self.m * (1.0 + part**self.n) ** -self.k)


@dataclass(frozen=True, slots=True)
class OrbitElements:
    """An orbit around the Sun at an epoch.

    Attributes
    ----------
    name : str
        As people call it: "433 Eros", "C/2023 A3 (Tsuchinshan-ATLAS)".
    epoch_jd : float
        TDB; the elements are those of the ellipse that touches the true way then.
    inclination_deg, node_deg, peri_deg : float
        Ecliptic J2000.
    perihelion_jd : float
        TDB, of the passage that is meant.
    aliases : tuple of str
        Number and designations.
    uncertainty : int or None
        The MPC's parameter U, or JPL's condition code, 0 to 9.
    comet : bool
        Whether it is one: its elements age faster.
    covariance : Covariance or None
        None: the source gives none.
    forces : OwnForces or None
        What moves it beside gravity.

    Raises
    ------
    BadRequest
        Numbers that belong to no orbit around the Sun.
    """

    name: str
    epoch_jd: float
    q_au: float
    eccentricity: float
    inclination_deg: float
    node_deg: float
    peri_deg: float
    perihelion_jd: float
    aliases: tuple[str, ...] = ()
    uncertainty: int | None = None
    comet: bool = False
    covariance: Covariance | None = None
    forces: OwnForces | None = None

    def __post_init__(self) -> None:
        """Refuse what is no orbit."""
        bounds = (
            ("perihelion distance", self.q_au, _LEAST_Q_AU, _MOST_Q_AU, " au"),
            ("eccentricity", self.eccentricity, 0.0, _MOST_ECCENTRICITY, ""),
            ("inclination", self.inclination_deg, 0.0, 180.0, "°"),
            ("node", self.node_deg, -360.0, 360.0, "°"),
            ("argument of perihelion", self.peri_deg, -360.0, 360.0, "°"),
            ("epoch", self.epoch_jd, _FIRST_JD, _LAST_JD, " (JD)"),
        )
        for what, value, low, high, unit in bounds:
            if not low <= value <= high:
                raise BadRequest(f"{self.name}: {what} {value:g}{unit} is outside {low:g} to {high:g}")
        if not abs(self.perihelion_jd - self.epoch_jd) < 400_000.0:
            raise BadRequest(
                f"{self.name}: the perihelion is {self.perihelion_jd:g} (JD), far from the epoch"
            )
        if self.uncertainty is not None and not 0 <= self.uncertainty <= 9:
            raise BadRequest(f"{self.name}: the uncertainty parameter is {self.uncertainty}, not 0 to 9")

    def heliocentric(self, jd: float) -> tuple[Vector, Vector]:
        """Place (au) and velocity (au/day) from the Sun by two-body motion, axes of the ICRS, shape (3,)."""
        return two_body(
            self.q_au,
            self.eccentricity,
            math.radians(self.inclination_deg),
            math.radians(self.node_deg),
            math.radians(self.peri_deg),
            jd - self.perihelion_jd,
        )

    def along_arcsec(self, years: float) -> float:
        """How far along its orbit it may be off, seen from the Sun, so many years from the epoch."""
        if self.comet and self.uncertainty is None:
            return math.hypot(_COMET_SIGMA_ARCSEC, _COMET_RUNOFF_ARCSEC_YEAR * abs(years))
        code = _MOST_UNKNOWN if self.uncertainty is None else self.uncertainty
        now = _COMET_SIGMA_ARCSEC if self.comet else _SIGMA_NOW_ARCSEC
        # a poorly known orbit is off at its epoch too: a tenth of a year's runoff
        return math.hypot(now, _RUNOFF_ARCSEC_DECADE[code] / 10.0 * (abs(years) + 0.1))


def by_mean_anomaly(
    a_au: float, eccentricity: float, mean_anomaly_deg: float, epoch_jd: float
) -> tuple[float, float]:
    """Perihelion distance and time (JD) of an ellipse, by its mean anomaly at the epoch.

    Raises
    ------
    BadRequest
        No ellipse.
    """
    if not (0.0 < a_au < 1e5 and 0.0 <= eccentricity < 1.0 and abs(mean_anomaly_deg) <= 1e6):
        raise BadRequest(
            f"a = {a_au:g} au, e = {eccentricity:g} is not an ellipse; give q and the perihelion's time"
        )
    motion_deg = math.degrees(math.sqrt(GM_SUN_AU3_DAY2 / a_au**3))
    anomaly = (mean_anomaly_deg + 180.0) % 360.0 - 180.0
    return a_au * (1.0 - eccentricity), epoch_jd - anomaly / motion_deg


def two_body(
    q_au: float, e: float, inclination: float, node: float, peri: float, since_days: float
) -> tuple[Vector, Vector]:
    """Place and velocity from the Sun so many days after the perihelion; angles in radians.

    Returns
    -------
    place_au, velocity_au_day : ndarray, shape (3,)
        Along the axes of the ICRS.
    """
    mu = GM_SUN_AU3_DAY2
    alpha = mu * (1.0 - e) / q_au
    since = since_days
    if alpha > 0.0:
        # whole turns are left out; of long periods there are none
        period = 2.0 * math.pi * mu / math.pow(alpha, 1.5)
        since = math.remainder(since, period)
    s = _universal(q_au, e, alpha, since)
    c1, c2, c3 = _stumpff(alpha * s * s)
    r = q_au + mu * e * s * s * c2
    speed = math.sqrt(mu * (1.0 + e) / q_au)
    x, y = q_au - mu * s * s * c2, speed * (since - mu * s**3 * c3)
    vx, vy = -mu * s * c1 / r, speed * (1.0 - mu * s * s * c2 / r)
    along, aside = _axes(inclination, node, peri)
    return x * along + y * aside, vx * along + vy * aside


def _universal(q: float, e: float, alpha: float, since: float) -> float:
    """Solve q s + mu e s³ c3(alpha s²) = since; the left side grows with s."""
    if since == 0.0:
        return 0.0
    mu = GM_SUN_AU3_DAY2
    sign, want = math.copysign(1.0, since), abs(since)
    # it is a lower bound of the time for any s, so that this is an upper bound of s
    low, high = 0.0, want / q
    if alpha > 0.0:
        high = min(high, 1.0001 * 2.0 * math.pi / math.sqrt(alpha))
    # of a hyperbola the hyperbolic sine: beyond some hundreds it would overflow
    if alpha < 0.0:
        high = min(high, 60.0 / math.sqrt(-alpha))
    s = min(high, math.cbrt(6.0 * want / (mu * max(e, 1e-3))))
    for _ in range(_KEPLER_STEPS):
        _, c2, c3 = _stumpff(alpha * s * s)
        missed = q * s + mu * e * s**3 * c3 - want
        if missed > 0.0:
            high = s
        else:
            low = s
        step = missed / (q + mu * e * s * s * c2)
        following = s - step
        if not low <= following <= high:
            following = (low + high) / 2.0
        if abs(following - s) <= 1e-15 * abs(s):
            return sign * following
        s = following
    return sign * s


def _stumpff(z: float) -> tuple[float, float, float]:
    """Stumpff's c1, c2, c3."""
    if abs(z) < 0.1:
        c2 = c3 = 0.0
        for k in range(8, -1, -1):
            c2 = (1.0 - z * c2) / ((2 * k + 1) * (2 * k + 2)) if k < 8 else 1.0 / ((2 * k + 1) * (2 * k + 2))
            c3 = (1.0 - z * c3) / ((2 * k + 2) * (2 * k + 3)) if k < 8 else 1.0 / ((2 * k + 2) * (2 * k + 3))
        return 1.0 - z * c3, c2, c3
    root = math.sqrt(abs(z))
    if z > 0.0:
        return math.sin(root) / root, (1.0 - math.cos(root)) / z, (root - math.sin(root)) / root**3
    return math.sinh(root) / root, (1.0 - math.cosh(root)) / z, (math.sinh(root) - root) / root**3


def _axes(inclination: float, node: float, peri: float) -> tuple[Vector, Vector]:
    """Toward the perihelion, and a right angle ahead of it in the orbit; axes of the ICRS."""
    cn, sn = math.cos(node), math.sin(node)
    cp, sp = math.cos(peri), math.sin(peri)
    ci, si = math.cos(inclination), math.sin(inclination)
    along = np.array([cp * cn - sp * sn * ci, cp * sn + sp * cn * ci, sp * si])
    aside = np.array([-sp * cn - cp * sn * ci, -sp * sn + cp * cn * ci, cp * si])
    ce, se = math.cos(OBLIQUITY_RAD), math.sin(OBLIQUITY_RAD)
    turn = np.array([[1.0, 0.0, 0.0], [0.0, ce, -se], [0.0, se, ce]])
    return turn @ along, turn @ aside
