"""What a job brought, without the stars: as it is remembered once the job is over.

A look comes with each star that was identified and each source that was measured, up to 1.5 MB for a rich
field. They are for who takes the look: the camera is learned by them, the last frame is drawn with them. What
the API shows of a job needs none of them, and a thousand jobs are remembered.
"""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np

from mountnav.solution import IdentifiedPairs, Solution, Verdict

__all__ = ["without_stars"]

_NONE = np.zeros(0)
_NO_PAIRS = IdentifiedPairs(
    *(_NONE,) * 11, flags=np.zeros(0, dtype=np.int64), used=np.zeros(0, dtype=bool), leverage=_NONE
)
_NO_PLACES, _NO_FLUX = np.zeros((0, 2), dtype=np.float32), np.zeros(0, dtype=np.float32)


def without_stars(result: object) -> object:
    """The same result; looks in it have no pairs and no positions of sources, all else is as it was."""
    return _bare(result, {})


def _bare(whole: Any, done: dict[int, Any]) -> Any:
    """One part; `done` has, by their ids, those that stand in several places, and do so afterwards."""
    if id(whole) in done:
        return done[id(whole)]
    bare = whole
    if type(whole) in (tuple, list):
        parts = [_bare(part, done) for part in whole]
        if any(part is not before for part, before in zip(parts, whole, strict=True)):
            bare = type(whole)(parts)
    elif is_dataclass(whole) and not isinstance(whole, type):
        changed: dict[str, Any] = {}
        if isinstance(whole, Solution):
            changed = {"identified": _NO_PAIRS}
        elif isinstance(whole, Verdict):
            changed = {"seen_px": _NO_PLACES, "seen_flux": _NO_FLUX}
        for one in fields(whole):
            part = getattr(whole, one.name)
            if one.init and one.name not in changed and (less := _bare(part, done)) is not part:
                changed[one.name] = less
        if changed:
            bare = replace(whole, **changed)
    done[id(whole)] = bare
    return bare
