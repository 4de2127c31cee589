"""The process that builds the index of the blind search, beside everything else and with the least priority.

It is started by `api.solver.blind_index`, never by hand: ``python -m api.solver.index_process DESCRIPTOR``.
"""

from __future__ import annotations

import os

from api.solver.attached import attached
from api.solver.messages import Built, Done, Progress, Setup, receive, send
from api.solver.process import sendable
from mountnav.catalog.packed import PackedStore
from mountnav.identification.blind.cache import cached_index

_LEAST_PRIORITY = 19
"""As `nice` counts, the least that there is: building an index takes minutes and is never urgent."""


def main() -> None:
    """Build, and tell how far it is."""
    link = attached()
    os.nice(_LEAST_PRIORITY)
    try:
        setup, _ = receive(link)
        assert isinstance(setup, Setup)
        assert isinstance(setup.catalog, PackedStore)
        try:
            index = cached_index(setup.catalog, progress=lambda share: send(link, Progress(share)))
        except Exception as error:  # it belongs to the service, which tells it
            send(link, Done(fault=sendable(error)))
        else:
            send(link, Built(index.path))
    except (EOFError, OSError):
        return


if __name__ == "__main__":
    main()
