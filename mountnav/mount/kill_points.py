"""The steps of an order, named, so that a test can end the process at each of them.

::

    step("slew begin")         about to be written down
    step("slew begun")         written down, not sent
    step("slew sent")          the driver is done, or has failed
    step("slew end")           about to be closed
    step("slew ended")         closed

In service nobody listens, and a step costs a comparison.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

_listener: Callable[[str], None] | None = None


def kill_point(name: str) -> None:
    """Tell whoever listens that this step is reached."""
    if _listener is not None:
        _listener(name)


@contextmanager
def watching_kill_points(listener: Callable[[str], None]) -> Iterator[None]:
    """Tell `listener` of each step, in all tasks of this process, until the context is left."""
    global _listener
    before, _listener = _listener, listener
    try:
        yield
    finally:
        _listener = before


__all__ = ["kill_point", "watching_kill_points"]
