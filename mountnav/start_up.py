"""A start that costs less: what isn't used is put off, and nothing is searched for garbage meanwhile.

A solve calls a dozen functions of scipy's. To import them by the usual way brings 400 modules: scipy's
packages import all they hold, and scipy's support of other arrays takes every name of numpy's. Here the
packages are there, but empty: a name is looked for in the modules that hold what a solve uses, and with the
first name that isn't there the whole package is imported, as ever.

Commands that end call `put_off_unused`; a process that solves is started by ``python -m mountnav.start_up
MODULE ARGUMENTS``. The service itself needs none of scipy.
"""

from __future__ import annotations

import gc
import importlib
import importlib.util
import os
import sys
import threading
from collections.abc import Iterator, MutableMapping
from contextlib import contextmanager
from types import ModuleType
from typing import Any, Final

BY_ONE_THREAD: Final = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
"""How many threads numpy's linear algebra takes: as many as there are cores, where these are not set."""

KEPT_BELOW_BYTES: Final = 32 << 20
"""Arrays up to so large are made in memory that was used before, where it is kept: the most that glibc
takes. 100 frames of 4 to 11 Mpx took 0.6 s of system time so, and 6.9 s otherwise."""
KEPT_BYTES: Final = 128 << 20
"""What a process may keep of the memory of its last frame. Doubled, each worker of an archive holds so much
more; halved, a frame of 9 Mpx has its arrays cleared anew each time."""

UNUSED: Final = (
    *("numpy.f2py", "numpy.testing", "numpy.polynomial", "numpy.ctypeslib"),
    *("scipy._lib.array_api_compat.numpy", "scipy._lib.array_api_extra", "pydoc"),
    # where scipy has them from 1.18 on
    *("scipy._external.array_api_compat.numpy", "scipy._external.array_api_extra"),
)
"""Most solves call none of them. If something does, it is imported then."""

HELD_BY: Final = {
    "scipy.linalg": ("_misc",),
    "scipy.ndimage": ("_filters", "_measurements", "_morphology", "_interpolation"),
    "scipy.sparse": (),
    "scipy.spatial": ("_ckdtree", "_kdtree"),
    "scipy.special": ("_ufuncs",),
}
"""Packages of scipy's, and their modules that hold what a solve uses: in them a name is looked for first.
They are scipy's own affair: where another scipy has none of that name, the whole package is imported."""


def by_one_thread(environment: MutableMapping[str, str] = os.environ) -> None:
    """Let numpy, which is not imported yet, compute by one thread; what the user has set stays.

    A solve's matrices are small: on two cores OpenBLAS's threads wait for each other, and a solve takes twice
    the CPU and no less time; with more cores it is worse. Several frames at once are for several processes.
    """
    for name in BY_ONE_THREAD:
        environment.setdefault(name, "1")


class LateModule(ModuleType):
    """A module that is imported when it is first asked for a name that none of a few others holds."""

    def __getattr__(self, name: str) -> Any:
        """What the module itself doesn't hold yet."""
        late: _Late = vars(self)["_late"]
        return late.found(self, name)


class _Late:
    """How a late module comes by its names.

    One thread at a time imports late modules: others wait, and what it imports in turn sees them half done,
    as with any import. That lock and Python's own locks of modules know nothing of each other: this is for
    processes in which one thread does the importing, not for the service.
    """

    _lock = threading.RLock()

    def __init__(self, held_by: tuple[str, ...]) -> None:
        self._held_by = held_by
        self._under_way = False

    def found(self, module: ModuleType, name: str) -> Any:
        with self._lock:
            if name in vars(module):  # another thread was first
                return vars(module)[name]
            if self._under_way:
                raise AttributeError(f"module {module.__name__!r} has no attribute {name!r} yet")
            whole_name = f"{module.__name__}.{name}"
            if hasattr(module, "__path__") and importlib.util.find_spec(whole_name) is not None:
                # a module of a package: one that is half imported itself may ask for it
                return importlib.import_module(whole_name)
            self._under_way = True
            try:
                if not self._found_in_part(module, name):
                    _run(module)
            finally:
                self._under_way = False
        return getattr(module, name)

    def _found_in_part(self, module: ModuleType, name: str) -> bool:
        for part in self._held_by:
            held = _imported(f"{module.__name__}.{part}")
            if held is not None and name in getattr(held, "__all__", ()):
                setattr(module, name, getattr(held, name))
                return True
        return False


def _run(module: ModuleType) -> None:
    """Import the whole of a late module: from now on it is as any other."""
    spec = module.__spec__
    assert spec is not None
    assert spec.loader is not None
    spec.loader.exec_module(module)
    module.__class__ = ModuleType


def _imported(name: str) -> ModuleType | None:
    try:
        return importlib.import_module(name)
    except ImportError:
        return None  # another scipy


def put_off_unused() -> None:
    """Let these modules be imported when they are first used, not when they are named. Twice is fine."""
    import numpy  # noqa: F401 - its modules can be found only now

    for name in (*UNUSED, *HELD_BY):
        if name in sys.modules:
            continue
        above, _, own = name.rpartition(".")
        if above and _imported(above) is None:
            continue
        spec = importlib.util.find_spec(name)
        if spec is None or spec.loader is None:
            continue  # another numpy or scipy
        module = importlib.util.module_from_spec(spec)
        module.__class__ = LateModule
        vars(module)["_late"] = _Late(HELD_BY.get(name, ()))
        sys.modules[name] = module
        if above:
            setattr(sys.modules[above], own, module)


_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
"""What glibc calls these settings (``malloc.h``)."""


def keep_memory() -> None:
    """Let a process that reads many frames make arrays in memory that it used before, where glibc can.

    Otherwise the system clears 20 MB anew for each frame of 11 Mpx: a sixth of its CPU time.
    """
    import ctypes

    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):
        return  # another C library has other ways
    mallopt(_MMAP_THRESHOLD, KEPT_BELOW_BYTES)
    mallopt(_TRIM_THRESHOLD, KEPT_BYTES)


@contextmanager
def no_garbage_sought() -> Iterator[None]:
    """While modules are imported: they stay, and so does what they make.

    Python's collector looks through all of it again and again, in vain: a tenth of what a command's start
    costs. What is there at the end is left out of its later searches, too.
    """
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        if was_on:
            gc.enable()


def main() -> None:
    """Run the `main` of a module, with these put off."""
    with no_garbage_sought():
        put_off_unused()
        del sys.argv[0]
        module = importlib.import_module(sys.argv[0])
    module.main()


if __name__ == "__main__":
    main()
