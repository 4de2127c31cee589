"""TPV cards in place of SIP cards: the same plate in the words of SCAMP, SWarp and others.

SIP bends pixels: (ξ, η) = CD · (u + A(u, v), v + B(u, v)). TPV bends what CD makes of them: with
(x, y) = CD · (u, v), ξ = P1(x, y) and η = P2(y, x) [Calabretta, Greisen 2004; SCAMP manual]. Since
(u, v) = CD⁻¹ · (x, y) is linear, a SIP polynomial becomes a TPV polynomial of the same degree, exactly.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from mountnav.errors import BadRequest

Array = NDArray[np.float64]
Cards = dict[str, str | int | float]

MOST_DEGREE = 7
"""TPV knows no higher one."""

_SIP = re.compile(r"(?:A|B|AP|BP)_(?:ORDER|DMAX|\d+_\d+)")


def tpv_cards(cards: Mapping[str, str | int | float]) -> Cards:
    """Write a plate's cards with TPV.

    Parameters
    ----------
    cards : mapping
        TAN or TAN-SIP, as `mountnav.identification.wcs.wcs_cards` makes them.

    Returns
    -------
    dict
        The same but for CTYPE, PV in place of A and B, and without AP and BP, which TPV has no place for.

    Raises
    ------
    BadRequest
        The degree is above `MOST_DEGREE`, or the projection is another one.
    """
    if not str(cards.get("CTYPE1", "")).startswith("RA---TAN"):
        raise BadRequest(f"TPV is a bent TAN, and not {cards.get('CTYPE1')}", advice="keep it as it is")
    degree = int(max(cards.get("A_ORDER", 1), cards.get("B_ORDER", 1)))
    if degree > MOST_DEGREE:
        raise BadRequest(f"TPV has no degree {degree}", advice="keep SIP")
    kept = {name: value for name, value in cards.items() if not _SIP.fullmatch(name)}
    kept |= {"CTYPE1": "RA---TPV", "CTYPE2": "DEC--TPV"}
    matrix = np.array([[cards[f"CD{i}_{j}"] for j in (1, 2)] for i in (1, 2)], dtype=np.float64)
    inverse = np.linalg.inv(matrix)
    # u, v as polynomials of x, y: [power of x, power of y]
    u, v = (_linear(inverse[0], degree), _linear(inverse[1], degree))
    bent = [_composed(_coefficients(cards, name, degree), u, v, degree) for name in ("A", "B")]
    bent[0] += u
    bent[1] += v
    for axis in (1, 2):
        together = matrix[axis - 1, 0] * bent[0] + matrix[axis - 1, 1] * bent[1]
        for number, (along, across) in _TERMS.items():
            if along + across > degree:
                continue
            # the second axis has its own coordinate first
            value = float(together[along, across] if axis == 1 else together[across, along])
            if value != 0.0 or number == 1:
                kept[f"PV{axis}_{number}"] = value
    return kept


def _terms() -> dict[int, tuple[int, int]]:
    """PV numbers and the powers of the axis' own and of the other coordinate; those of r are left out."""
    terms, number = {}, 0
    for degree in range(MOST_DEGREE + 1):
        for across in range(degree + 1):
            terms[number] = degree - across, across
            number += 1
        number += degree % 2  # an odd power of r follows each odd degree
    return terms


_TERMS = _terms()


def _linear(row: Array, degree: int) -> Array:
    found = np.zeros((degree + 1, degree + 1))
    found[1, 0], found[0, 1] = row
    return found


def _coefficients(cards: Mapping[str, str | int | float], name: str, degree: int) -> Array:
    found = np.zeros((degree + 1, degree + 1))
    for i in range(degree + 1):
        for j in range(degree + 1 - i):
            found[i, j] = float(cards.get(f"{name}_{i}_{j}", 0.0))
    return found


def _times(one: Array, other: Array, degree: int) -> Array:
    found = np.zeros((degree + 1, degree + 1))
    for i, j in np.argwhere(one):
        for k, m in np.argwhere(other):
            if i + j + k + m <= degree:
                found[i + k, j + m] += one[i, j] * other[k, m]
    return found


def _composed(coefficients: Array, u: Array, v: Array, degree: int) -> Array:
    """The polynomial of u and v as one of x and y."""
    unit = np.zeros((degree + 1, degree + 1))
    unit[0, 0] = 1.0
    powers_u, powers_v = [unit], [unit]
    for _ in range(degree):
        powers_u.append(_times(powers_u[-1], u, degree))
        powers_v.append(_times(powers_v[-1], v, degree))
    found = np.zeros_like(unit)
    for i, j in np.argwhere(coefficients):
        found += coefficients[i, j] * _times(powers_u[i], powers_v[j], degree)
    return found
