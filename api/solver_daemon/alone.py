"""A command in a process of its own, where no solver is warm: ``-m api.solver_daemon.alone NAME ...``."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from api.solver_daemon.stub import FAULT_CODE
from mountnav.errors import MountnavError
from mountnav.start_up import by_one_thread


def run_alone(name: str, arguments: Sequence[str]) -> int:
    """Run a command here; its exit code."""
    from api.solver_commands.host import LocalHost
    from api.solver_commands.in_process import SolverInProcess
    from api.solver_commands.registry import command, known_name

    known = known_name(name)
    if known is None:
        print(f"mountnav: there is no command {name!r}", file=sys.stderr)
        return FAULT_CODE
    try:
        return command(known)(list(arguments), LocalHost(), SolverInProcess())
    except KeyboardInterrupt:
        return 130
    except (MountnavError, OSError) as fault:
        print(f"{known}: {fault}", file=sys.stderr)
        return FAULT_CODE


if __name__ == "__main__":
    by_one_thread()
    sys.exit(run_alone(sys.argv[1], sys.argv[2:]))
