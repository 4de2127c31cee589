"""mountnav finds out where a telescope really points: a library for notebooks, and the core of the service.

    >>> import mountnav as mn
    >>> solved = mn.solve("m31.fits")      # doctest: +SKIP
    >>> solved.center, solved.wcs          # doctest: +SKIP

Names are imported when they are first used, so that `import mountnav` costs nothing. What `__all__` has is
stable: docs/reference/library/stability.md says what that means. No web framework and no serial port is known
in here.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mountnav.client import AsyncClient, Client
    from mountnav.errors import MountnavError, SolveFailed
    from mountnav.frames import Frame, Hint
    from mountnav.library.devices import fake_mount, open_camera, open_mount
    from mountnav.library.images import read
    from mountnav.library.pointing import FittedPointing, fit_pointing
    from mountnav.library.solved import SolvedFrame, solve
    from mountnav.library.stars import cone
    from mountnav.pointing.model.model import PointingModel
    from mountnav.sky.coordinates import Air, Apparent, HourAngle, Icrs, Observed, Site
    from mountnav.solution import Solution, Verdict
    from mountnav.solving.settings import SolveSettings

    __version__: str

_HOME = {
    "Air": "mountnav.sky.coordinates",
    "Apparent": "mountnav.sky.coordinates",
    "AsyncClient": "mountnav.client",
    "Client": "mountnav.client",
    "FittedPointing": "mountnav.library.pointing",
    "Frame": "mountnav.frames",
    "Hint": "mountnav.frames",
    "HourAngle": "mountnav.sky.coordinates",
    "Icrs": "mountnav.sky.coordinates",
    "MountnavError": "mountnav.errors",
    "Observed": "mountnav.sky.coordinates",
    "PointingModel": "mountnav.pointing.model.model",
    "Site": "mountnav.sky.coordinates",
    "Solution": "mountnav.solution",
    "SolveFailed": "mountnav.errors",
    "SolveSettings": "mountnav.solving.settings",
    "SolvedFrame": "mountnav.library.solved",
    "Verdict": "mountnav.solution",
    "cone": "mountnav.library.stars",
    "fake_mount": "mountnav.library.devices",
    "fit_pointing": "mountnav.library.pointing",
    "open_camera": "mountnav.library.devices",
    "open_mount": "mountnav.library.devices",
    "read": "mountnav.library.images",
    "solve": "mountnav.library.solved",
}
"""Where each public name is defined."""

__all__ = [
    "Air",
    "Apparent",
    "AsyncClient",
    "Client",
    "FittedPointing",
    "Frame",
    "Hint",
    "HourAngle",
    "Icrs",
    "MountnavError",
    "Observed",
    "PointingModel",
    "Site",
    "Solution",
    "SolveFailed",
    "SolveSettings",
    "SolvedFrame",
    "Verdict",
    "__version__",
    "cone",
    "fake_mount",
    "fit_pointing",
    "open_camera",
    "open_mount",
    "read",
    "solve",
]


def __getattr__(name: str) -> object:
    if name == "__version__":
        from mountnav.version import version

        return version()
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found: object = getattr(import_module(_HOME[name]), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
