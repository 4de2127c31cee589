"""In a solving process: a decoder that hangs, and one that dies, over files of such names; for tests."""

import os
import signal
import sys
import time

if "api.solver.process" in sys.orig_argv:
    from mountnav.solving import solve

    _read = getattr(solve, "read_source")  # noqa: B009

    def _poisoned(source, *, name=None, **more):
        if str(name).startswith("hang"):
            time.sleep(3600.0)
        if str(name).startswith("die"):
            os.kill(os.getpid(), signal.SIGSEGV)
        return _read(source, name=name, **more)

    setattr(solve, "read_source", _poisoned)  # noqa: B010
