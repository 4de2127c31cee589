"""Parts of numpy that a command imports without using them, put off until somebody does.

scipy's support of other arrays takes every name of numpy's (`from numpy import *`), and that imports numpy's
tools for tests, for Fortran and more, with `unittest` and `argparse`: a sixth of what `mountnav solve` costs.
"""

from __future__ import annotations

import importlib.util
import sys

UNUSED = ("numpy.f2py", "numpy.testing", "numpy.polynomial", "numpy.ctypeslib")
"""A solve calls none of them. If something does, it is imported then."""


def put_off_unused() -> None:
    """Let these modules be imported when they are first used, not when they are named.

    For commands that end: the standard library's lazy modules are meant for one thread at a time, which the
    service isn't.
    """
    import numpy  # noqa: F401 - its modules can be found only now

    for name in UNUSED:
        if name in sys.modules:
            continue
        spec = importlib.util.find_spec(name)
        if spec is None or spec.loader is None:
            continue  # another numpy
        spec.loader = importlib.util.LazyLoader(spec.loader)
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        spec.loader.exec_module(module)
        above, _, own = name.rpartition(".")
        setattr(sys.modules[above], own, module)
