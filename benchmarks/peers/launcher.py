"""Run one program and write down what it took: CPU, wall, memory; itself too small to count.

Run: python -I -S launcher.py RECORD SECONDS PROGRAM [ARGUMENT ...]

A process that starts another leaves its own peak memory in the other's record (the kernel counts what was
mapped before exec). The benchmark with its drawn frames is large, so it starts this small file, which imports
nothing but the standard library, and this file starts the program.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from types import FrameType


def main() -> None:
    record, seconds, *command = sys.argv[1:]
    began = time.monotonic()
    child = os.fork()
    if child == 0:
        try:
            os.execvp(command[0], command)
        finally:
            os._exit(127)

    late = False

    def give_up(_signal: int, _frame: FrameType | None) -> None:
        nonlocal late
        late = True
        # the benchmark starts this file as the leader of a session of its own: its group is the program's
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        os.killpg(0, signal.SIGTERM)

    signal.signal(signal.SIGALRM, give_up)
    signal.alarm(max(1, round(float(seconds))))
    # the program's own children, whom it waited for, are in its usage
    _, status, used = os.wait4(child, 0)
    with open(record, "w", encoding="utf-8") as out:
        json.dump(
            {
                "status": os.waitstatus_to_exitcode(status),
                "late": late,
                "cpu_s": used.ru_utime + used.ru_stime,
                "wall_s": time.monotonic() - began,
                "peak_kb": used.ru_maxrss,
            },
            out,
        )


if __name__ == "__main__":
    main()
