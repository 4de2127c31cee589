"""JPL's development ephemerides: the shipped excerpt of DE440, and SPK files that an operator imported.

Segments of the types 2, 3 and 9 are read, by `jplephem`. Instants are barycentric dynamical time as two-part
Julian dates, places are kilometers from the barycenter of the solar system along the axes of the ICRS.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from jplephem.daf import DAF
from jplephem.spk import SPK, T0
from numpy.typing import NDArray

from mountnav.errors import BadRequest, BadSettings
from mountnav.files import open_buffered
from mountnav.units import SECONDS_PER_DAY

Vector = NDArray[np.float64]

SHIPPED_PATH: Final = Path(__file__).parent / "data" / "de440_excerpt.bsp"
"""What is there without an import; `data/DE440-NOTICE.txt` says where it is from."""
_READ_TYPES: Final = (2, 3, 9)
"""Kinds of segments that jplephem reads; those of small bodies by Horizons are of type 21."""
_MOST_SEGMENTS: Final = 2000
"""Segments of a file; those of all of Jupiter's satellites have a hundred. Doubled, a file that was made for
it takes twice as long to open."""
_J2000_FRAME: Final = 1
"""SPICE's number of the axes of the ICRS; others are refused."""
NAIF_IDS: Final = {
    "sun": 10,
    "moon": 301,
    "mercury": 199,
    "venus": 299,
    "earth": 399,
    "mars": 499,
    "jupiter": 599,
    "saturn": 699,
    "uranus": 799,
    "neptune": 899,
    "pluto": 999,
    "phobos": 401,
    "deimos": 402,
    "io": 501,
    "europa": 502,
    "ganymede": 503,
    "callisto": 504,
    "amalthea": 505,
    "himalia": 506,
    "thebe": 514,
    "mimas": 601,
    "enceladus": 602,
    "tethys": 603,
    "dione": 604,
    "rhea": 605,
    "titan": 606,
    "hyperion": 607,
    "iapetus": 608,
    "phoebe": 609,
    "ariel": 701,
    "umbriel": 702,
    "titania": 703,
    "oberon": 704,
    "miranda": 705,
    "triton": 801,
    "nereid": 802,
    "charon": 901,
}
"""NAIF's number of each body that has a name here."""


@dataclass(frozen=True, slots=True)
class Segment:
    """One body's way relative to another's in one file.

    Attributes
    ----------
    target, center : int
        NAIF's numbers.
    first_jd, last_jd : float
        TDB.
    source : str
        What the file calls it: "DE-0440LE-0440".
    """

    target: int
    center: int
    first_jd: float
    last_jd: float
    source: str
    table: ChebyshevTable | Any

    def state(self, jd1: float, jd2: float) -> tuple[Vector, Vector]:
        """Place, km, and velocity, km/day, from the center."""
        if not isinstance(self.table, ChebyshevTable):
            both = np.asarray(self.table.compute_and_differentiate(jd1, jd2))
            return both[:3], both[3:] * SECONDS_PER_DAY
        # jplephem's own sum takes 0.2 ms: it is made for many instants at once
        since = (jd1 - self.table.first_jd) + jd2
        length = self.table.days
        row = min(max(int(since // length), 0), self.table.coefficients.shape[0] - 1)
        s = 2.0 * (since - row * length) / length - 1.0
        found = self.table.coefficients[row] @ _polynomials(s, self.table.coefficients.shape[2])
        velocity = found[3:, 0] * SECONDS_PER_DAY if found.shape[0] == 6 else found[:, 1] * (2.0 / length)
        return found[:3, 0], velocity


@dataclass(frozen=True, slots=True, eq=False)
class ChebyshevTable:
    """A segment of the types 2 and 3: rows of coefficients, each for as many days.

    Attributes
    ----------
    first_jd, days : float
        Where the first row begins, and how long each is.
    coefficients : ndarray, shape (rows, components, order)
        Of x, y, z in km; and of their rates in km/s in type 3. Mapped, not read.
    """

    first_jd: float
    days: float
    coefficients: Any


def _mapped(segment: Any) -> ChebyshevTable | Any:
    """A segment's numbers. Raises what jplephem raises of a broken file."""
    if segment.data_type == 9:
        segment._data  # noqa: B018 - mapped by being asked for
        return segment
    first_jd, days, coefficients = segment.load_array()
    rows = coefficients.transpose(1, 0, 2)
    if rows.shape[0] < 1 or rows.shape[2] < 2 or not 0.0 < days < 1e6:
        raise ValueError("a segment has no rows")
    return ChebyshevTable(float(first_jd), float(days), rows)


def _polynomials(s: float, count: int) -> Any:
    """Chebyshev's polynomials and their derivatives at s, shape (count, 2)."""
    value, slope = [1.0, s], [0.0, 1.0]
    for _ in range(2, count):
        slope.append(2.0 * value[-1] + 2.0 * s * slope[-1] - slope[-2])
        value.append(2.0 * s * value[-1] - value[-2])
    return np.array((value[:count], slope[:count])).T


class Kernel:
    """An SPK file, opened and held open: coefficients are mapped, not read.

    Raises
    ------
    BadRequest
        It can't be read, or is none.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            with open_buffered(path) as file:
                spk = SPK(DAF(file))
                self._take(spk, path.stat().st_size)
        except BadRequest:
            raise
        except OSError as refused:
            raise BadRequest(f"{path.name} can't be read: {refused.strerror or refused}") from refused
        except Exception as wrong:  # jplephem raises what its arithmetic happens to raise
            raise BadRequest(
                f"{path.name} is not an SPK file ({wrong or type(wrong).__name__})",
                advice="JPL's ephemerides end in .bsp; text and .tsp files are not supported",
            ) from wrong

    def _take(self, spk: Any, size: int) -> None:
        """Map the segments that can be read; the file itself isn't needed after that."""
        name = self.path.name
        if len(spk.segments) > _MOST_SEGMENTS:
            raise BadRequest(f"{name} has {len(spk.segments)} segments; {_MOST_SEGMENTS} are the most")
        if any(not 0 < one.start_i <= one.end_i <= size // 8 for one in spk.segments):
            raise BadRequest(f"{name} is cut off", advice="get it again")
        readable = [one for one in spk.segments if one.data_type in _READ_TYPES and one.frame == _J2000_FRAME]
        self.segments = tuple(
            Segment(
                one.target,
                one.center,
                one.start_jd,
                one.end_jd,
                one.source.decode("ascii", "replace").strip(),
                _mapped(one),
            )
            for one in readable
        )
        if not self.segments:
            others = ", ".join(f"{one.target} of type {one.data_type}" for one in spk.segments[:5])
            raise BadRequest(
                f"{name} has no segment that can be read: {others or 'it is empty'}",
                advice="segments of the types 2, 3 and 9 on the axes of the ICRS are, as in DE440",
            )


class _Chosen:
    """Which files count beside the shipped one; those that come first go before."""

    kernels: tuple[Kernel, ...] = ()
    lock = threading.Lock()


@cache
def shipped() -> Kernel:
    """The excerpt that is always there."""
    try:
        return Kernel(SHIPPED_PATH)
    except BadRequest as broken:
        raise BadSettings(
            f"the shipped ephemeris is damaged: {broken.what}", advice="reinstall mountnav"
        ) from broken


def use_kernels(kernels: Iterable[Kernel]) -> None:
    """Let imported files go before the shipped excerpt, the first of them before the others."""
    with _Chosen.lock:
        _Chosen.kernels = tuple(kernels)
        _segments_of.cache_clear()


def kernels_in_use() -> tuple[Kernel, ...]:
    """All files that count, the shipped one last."""
    return (*_Chosen.kernels, shipped())


@lru_cache(maxsize=1024)
def _segments_of(target: int) -> tuple[Segment, ...]:
    """All segments of a body, those that go before first: of a file its last counts, as SPICE has it."""
    return tuple(
        one for kernel in kernels_in_use() for one in reversed(kernel.segments) if one.target == target
    )


def _way(target: int, jd: float, whole_system: bool = True) -> tuple[Segment, ...] | None:
    """Segments from the barycenter to a body that cover an instant, TDB; None: no way.

    With `whole_system` the barycenter of a planet's system will do where the planet itself is in no file.
    """
    found: list[Segment] = []
    body = target
    while body != 0:
        step = next((one for one in _segments_of(body) if one.first_jd <= jd <= one.last_jd), None)
        if step is None or len(found) > 8:  # a file may lead in a circle
            # of the outer planets DE440 has the barycenters of their systems alone
            if whole_system and body % 100 == 99 and 400 <= body < 1000 and not found:
                body //= 100
                continue
            return None
        found.append(step)
        body = step.center
    return tuple(found)


def span_jd(target: int) -> tuple[float, float]:
    """From when to when the files in use have a body, TDB; NaN if none has it."""
    segments = _segments_of(target)
    if not segments:
        return float("nan"), float("nan")
    return min(one.first_jd for one in segments), max(one.last_jd for one in segments)


def has_body(target: int, jd: float) -> bool:
    """Whether a file in use covers a body at an instant, TDB as a Julian date."""
    return _way(target, jd) is not None


def barycentric_state_km(target: int, jd1: float, jd2: float) -> tuple[Vector, Vector] | None:
    """Place and velocity of a body from the barycenter of the solar system.

    Parameters
    ----------
    target : int
        NAIF's number. 499 to 999 mean the barycenter of the planet's system where no file has the planet
        itself.
    jd1, jd2 : float
        TDB.

    Returns
    -------
    place_km, velocity_km_day : ndarray, shape (3,)
        None if no file in use covers it.
    """
    way = _way(target, jd1 + jd2)
    if way is None:
        return None
    place, velocity = np.zeros(3), np.zeros(3)
    for segment in way:
        step, change = segment.state(jd1, jd2)
        place = place + step
        velocity = velocity + change
    return place, velocity


def source_of(target: int, jd: float, *, whole_system: bool = True) -> str | None:
    """What the segment is called that has a body, or its system's barycenter; None: none has."""
    way = _way(target, jd, whole_system)
    return None if way is None else way[0].source


__all__ = [
    "NAIF_IDS",
    "SHIPPED_PATH",
    "T0",
    "Kernel",
    "Segment",
    "barycentric_state_km",
    "has_body",
    "kernels_in_use",
    "shipped",
    "source_of",
    "span_jd",
    "use_kernels",
]
