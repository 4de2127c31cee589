"""The console script `mountnav`: errors become one clear line, and an exit code."""

from __future__ import annotations

import sys

from mountnav.errors import BadRequest, BadSettings, MountnavError


def main() -> None:
    """Run the command line; exit 1 on trouble, 2 on bad usage or settings, 130 when interrupted."""
    if sys.argv[1:] == ["--version"]:
        from mountnav import __version__

        print(f"mountnav {__version__}")
        return
    from api.cli import app

    try:
        app()
    except MountnavError as error:
        print(f"mountnav: {error}", file=sys.stderr)
        sys.exit(2 if isinstance(error, BadSettings | BadRequest) else 1)
    except KeyboardInterrupt:
        sys.exit(130)


if __name__ == "__main__":
    main()
