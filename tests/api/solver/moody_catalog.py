"""A catalog that hangs, dies or fails where it is told to: what a bug or a full memory does to a solver."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

from mountnav.catalog.embedded import embedded_catalog
from mountnav.catalog.stars import Stars
from mountnav.sky.coordinates import Icrs

HANGS = Icrs(10.0, 70.0)
DIES = Icrs(10.0, -70.0)
DIES_ONCE = Icrs(200.0, -70.0)
FAILS = Icrs(200.0, 70.0)
COMPUTES = Icrs(300.0, -70.0)


class MoodyCatalog:
    """The embedded one, but for five places.

    Parameters
    ----------
    folder : Path
        Where it leaves a note of having died once. As long as a file ``cold`` lies there, whoever asks waits.
    """

    name = "moody"

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def cone(
        self, center: Icrs, radius_deg: float, *, epoch_yr: float, mag_limit: float | None = None
    ) -> Stars:
        def at(place: Icrs) -> bool:
            return abs(center.dec_deg - place.dec_deg) < 8.0 and abs(center.ra_deg - place.ra_deg) < 40.0

        while (self._folder / "cold").exists():
            time.sleep(0.02)
        if at(HANGS):
            time.sleep(1000.0)
        while at(COMPUTES):
            pass
        if at(FAILS):
            raise ZeroDivisionError("a bug")
        died = self._folder / "died"
        if at(DIES) or (at(DIES_ONCE) and not died.exists()):
            died.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return embedded_catalog().cone(center, radius_deg, epoch_yr=epoch_yr, mag_limit=mag_limit)
