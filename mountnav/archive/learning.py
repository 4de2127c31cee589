"""What finished chunks teach of cameras: their scales, frozen into the recipe of the next run.

Nothing is learned while frames are solved: what had been finished by then would decide, and with it the
order. So it is a step of its own; what it found is a part of the recipe, and so is what it was learned from.
"""

from __future__ import annotations

import statistics
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field

from mountnav.archive.folder import RunFolder
from mountnav.archive.tables import read_rows
from mountnav.solving.priors import CameraPrior

LEAST_FRAMES = 8
"""Frames of a camera that teach its scale. With fewer, two of them that are odd would make it; doubled, rare
cameras stay unknown."""

ALIKE = 0.02
"""Scales within this share of their median are those of the same optics: focus and temperature change a scale
by a tenth of that. Doubled, a reducer that was moved goes unnoticed; halved, a zoom at rest has no prior."""

LEAST_ALIKE = 0.9
"""Share of a camera's frames whose scales have to be alike. With less, a camera on two telescopes that the
header doesn't tell apart would get the scale of one of them, and frames of the other be searched twice."""

ROOM = 0.002
"""Share of the scale that the bounds are wider than what was seen, to each side: bounds of 0.3 % and of 5 %
cost the same, so that nothing is gained by less."""

MOST_FALSE = 1e-9
"""False probability of the frames that teach, at most: a wrong one has no say."""


MOST_FRAMES = 10_000
"""Frames of a camera that teach, the first ones of the list: more tell nothing new, and take memory."""

MOST_CAMERAS = 1000
"""Cameras whose scales are kept, those with most frames: each frame looks through all of them, and lists of
stars that tell no size make a camera each."""


@dataclass(frozen=True, slots=True)
class Learned:
    """What is known of a camera.

    Attributes
    ----------
    instrument, telescope, width_px, height_px
        Which camera.
    frames : int
        Solved frames of it that are sure.
    prior : CameraPrior or None
        None where too few frames, or too different ones, were there: `why` says which.
    parities : set of int
        All that were seen.
    rotation_low_deg, rotation_high_deg : float
        The shortest arc that has all rotations; the first is more than the other where it goes over 0.
    """

    instrument: str
    telescope: str
    width_px: int
    height_px: int
    frames: int
    prior: CameraPrior | None
    why: str
    parities: tuple[int, ...]
    rotation_low_deg: float
    rotation_high_deg: float


@dataclass(slots=True)
class _Seen:
    scales: list[float] = field(default_factory=list)
    rotations: list[float] = field(default_factory=list)
    parities: set[int] = field(default_factory=set)


def learned(run: RunFolder, chunks: Iterable[int]) -> list[Learned]:
    """What finished chunks of a run teach: the same for the same chunks, in whatever order they are named.

    Returns
    -------
    list of Learned
        Those with the most frames first, at most `MOST_CAMERAS`.

    Raises
    ------
    BadRequest
        A chunk is damaged.
    """
    seen: dict[tuple[str, str, int, int], _Seen] = defaultdict(_Seen)
    columns = ["number", "scale_arcsec_px", "rotation_deg", "parity", "width_px", "height_px"]
    for number in sorted(chunks):
        path = run.chunk(number)
        rows = read_rows(path / "frames.parquet", ["number", "instrument", "telescope"])
        named = {row["number"]: (str(row["instrument"] or ""), str(row["telescope"] or "")) for row in rows}
        for row in read_rows(path / "solutions.parquet", [*columns, "false_probability"]):
            chance = row["false_probability"]
            if chance is None or float(chance) > MOST_FALSE:
                continue
            camera = *named[row["number"]], int(row["width_px"] or 0), int(row["height_px"] or 0)
            one = seen[camera]
            if len(one.scales) >= MOST_FRAMES:
                continue
            one.scales.append(float(row["scale_arcsec_px"] or 0.0))
            one.rotations.append(float(row["rotation_deg"] or 0.0))
            one.parities.add(int(row["parity"] or 0))
    # sorted twice: by frames, and where these are as many by name
    likely = sorted(sorted(seen), key=lambda camera: -len(seen[camera].scales))[:MOST_CAMERAS]
    return [_of(camera, seen[camera]) for camera in likely]


def _of(camera: tuple[str, str, int, int], seen: _Seen) -> Learned:
    scales = sorted(seen.scales)
    middle = statistics.median(scales)
    alike = [one for one in scales if abs(one / middle - 1.0) <= ALIKE]
    why, prior = "", None
    if len(scales) < LEAST_FRAMES:
        why = f"fewer than {LEAST_FRAMES} frames"
    elif len(alike) < LEAST_ALIKE * len(scales):
        why = f"scales differ: {scales[0]:.4g} to {scales[-1]:.4g} ″/px"
    else:
        # shortened, so that a recipe can be read
        low, high = round(alike[0] * (1.0 - ROOM), 6), round(alike[-1] * (1.0 + ROOM), 6)
        prior = CameraPrior(*camera, low, high, len(alike))
    return Learned(*camera, len(scales), prior, why, tuple(sorted(seen.parities)), *_arc(seen.rotations))


def _arc(angles_deg: list[float]) -> tuple[float, float]:
    """The shortest arc that has all angles."""
    ordered = sorted(angles_deg)
    gaps = [
        (after - before) % 360.0 for before, after in zip(ordered, [*ordered[1:], ordered[0]], strict=True)
    ]
    if len(ordered) == 1:
        return ordered[0], ordered[0]
    widest = max(range(len(gaps)), key=gaps.__getitem__)
    return ordered[(widest + 1) % len(ordered)], ordered[widest]
