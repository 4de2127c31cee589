"""A fake mount on a pseudo-terminal for the length of a ``with``: for scripts, notebooks and doctests."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from mountnav.clock import utc_now
from mountnav.simulation.mechanics import Mechanics
from mountnav.simulation.pointing_errors import PointingErrors
from mountnav.sky.coordinates import Air, Site

__all__ = ["served_fake"]

_SITE = Site(49.0, 20.0, 500.0)
"""Where a fake stands if nobody says: mid-northern, so that half of the sky is up."""


@contextmanager
def served_fake(protocol: str, dialect: str | None = None, *, site: Site | None = None) -> Iterator[str]:
    """Serve a fake and give the URL to open it by.

    Parameters
    ----------
    protocol, dialect
        As `drivers.registry.make_fake` takes them.
    site : Site, optional
        Where the fake stands.

    Yields
    ------
    str
        ``lx200+serial:///dev/pts/3`` or the like; it is gone when the ``with`` ends.

    Raises
    ------
    BadRequest
        There is no such protocol or dialect.
    """
    # a fake is served where somebody asks for one: nothing of it is imported before
    from drivers.fakes.bench import FakeOnPty
    from drivers.registry import fake_machine, make_fake

    mechanics = Mechanics(
        site or _SITE, Air(pressure_hpa=0.0), PointingErrors(), machine=fake_machine(protocol)
    )
    fake = make_fake(protocol, dialect, mechanics, clock=utc_now, monotonic=time.monotonic)
    with FakeOnPty(fake) as bench:
        yield f"{protocol}+serial://{bench.address}"
