"""The console script `mountnav`: errors become one clear line, and an exit code."""

from __future__ import annotations

import gc
import io
import os
import sys
from contextlib import suppress

from mountnav.errors import BadRequest, BadSettings, JournalDamaged, MountnavError


def main() -> None:
    """Run the command line; exit 1 on trouble, 2 on bad usage or settings, 130 when interrupted."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        # a terminal or pipe of another encoding has no arc second sign: a question mark there, and no end
        sys.stdout.reconfigure(errors="replace")
    if sys.argv[1:] == ["--version"]:
        from mountnav import __version__

        print(f"mountnav {__version__}")
        return
    if len(sys.argv) > 1 and not sys.argv[1].startswith("-"):
        from api.solver_commands.registry import NAMES

        if sys.argv[1] in NAMES:
            # `mountnav astap ...` is what the installed command is: nothing else has to be imported
            from api.solver_daemon.stub import run

            sys.exit(run(sys.argv[1], sys.argv[2:]))
    from mountnav.start_up import by_one_thread

    by_one_thread()
    # what is imported stays: no garbage is sought until the command begins (`api.cli.commands.top`)
    gc.disable()
    try:
        from api.cli.commands import app_of

        app_of(sys.argv[1:])()
    except MountnavError as error:
        from mountnav.masking import masked

        print(f"mountnav: {masked(str(error))}", file=sys.stderr)
        # 2: the same again would end the same way, so that a service manager doesn't begin it again
        sys.exit(2 if isinstance(error, BadSettings | BadRequest | JournalDamaged) else 1)
    except KeyboardInterrupt:
        sys.exit(130)
    except BrokenPipeError:
        # the reader of our output has gone; Python would complain once more when it closes it
        _write_no_more()
        sys.exit(1)
    except OSError as error:
        # without its file's name nobody knows what to mend
        about = "" if error.filename is None else f"{os.fsdecode(error.filename)}: "
        print(f"mountnav: {about}{error.strerror or error}", file=sys.stderr)
        _write_no_more()
        sys.exit(1)
    finally:
        gc.enable()


def _write_no_more() -> None:
    """What is still to be written to a standard output that takes nothing goes nowhere."""
    # it may have been closed before we began, or be no file
    with suppress(AttributeError, OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


if __name__ == "__main__":
    main()
