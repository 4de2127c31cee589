"""Kill points: named steps of an order at which a test may end the process, or do something else.

::

    kill_point("slew begin")         about to be written down
    kill_point("slew begun")         written down, not sent
    kill_point("slew sent")          the driver is done, or has failed
    kill_point("slew end")           about to be closed
    kill_point("slew ended")         closed

They prove that after ``kill -9`` at any of them nothing is lost and nothing is done twice
(`benchmarks.killed_child`, `tests/navigation/test_navigator_killed.py`). They are calls in the code and no
decorator, since most lie between two awaits of one function: written, and not sent. In service nobody
listens, and a kill point costs a comparison.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

_listener: Callable[[str], None] | None = None


def kill_point(name: str) -> None:
    """Tell a test that this step is reached; in service do nothing."""
    if _listener is not None:
        _listener(name)


@contextmanager
def watching_kill_points(listener: Callable[[str], None]) -> Iterator[None]:
    """Call `listener` at each kill point, in all tasks of this process, until the context is left."""
    global _listener
    before, _listener = _listener, listener
    try:
        yield
    finally:
        _listener = before


__all__ = ["kill_point", "watching_kill_points"]
