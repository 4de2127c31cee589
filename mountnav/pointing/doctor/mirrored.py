"""Parity: an image is mirrored or it isn't; no motion of a mount changes that [POINTING §9]."""

from __future__ import annotations

from collections.abc import Sequence

from mountnav.pointing.doctor.findings import CERTAIN, Finding, Illness, Measured
from mountnav.pointing.doctor.priors import FALSE_SOLVE, MIRRORED
from mountnav.pointing.observation import PointingObservation

_WORDS = {1: "as the sky is seen", -1: "mirrored"}


def mirror_findings(observations: Sequence[PointingObservation], expected: int | None) -> list[Finding]:
    """Compare parities with the expected one, or with the first if none is.

    Parameters
    ----------
    observations : sequence of PointingObservation
        In order of time.
    expected : int or None
    """
    told = [one for one in observations if one.parity is not None]
    if not told:
        return []
    assert told[0].parity is not None
    usual = expected if expected is not None else told[0].parity
    others = [one for one in told if one.parity != usual]
    if not others:
        return []
    tail = 0
    while tail < len(told) and told[-1 - tail].parity != usual:
        tail += 1
    numbers = {
        "mirrored_looks": Measured(float(len(others)), None, "looks"),
        "looks": Measured(float(len(told)), None, "looks"),
    }
    ids = tuple(one.look_id for one in others)
    words = f"{len(others)} of {len(told)} looks are {_WORDS[-usual]}"
    if tail == 0:
        advice = "a false solution, or another camera's frame: don't use it"
        return [
            Finding(Illness.WRONG_LOOK, 0.99, CERTAIN, numbers, f"{words}, the last is not.", advice, (), ids)
        ]
    # one that stands alone may be a false solution, until the next look says the same
    against = min(1.0, FALSE_SOLVE**tail / MIRRORED)
    return [
        Finding(
            Illness.MIRRORED,
            1.0 / (1.0 + against),
            min(1.0 / max(against, 1e-300), CERTAIN),
            numbers,
            f"{words}; they should be {_WORDS[usual]}: the image is mirrored.",
            "a diagonal, a flipped readout or another program's mirroring: undo it, or set the parity; until "
            "then directions taken from the image are reversed",
            (Illness.WRONG_LOOK,) if tail == 1 else (),
            ids,
        )
    ]
