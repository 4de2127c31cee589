"""What the solver's process may take of the computer, set by itself before it reads anything."""

from __future__ import annotations

import contextlib
import math
import os
import resource
from dataclasses import dataclass
from pathlib import Path

_MB = 1_000_000
"""Bytes."""

MOST_MEMORY_MB = 4000.0
"""Memory of the process where the settings are silent, unless half of the computer's is less. A frame of
60 megapixels needs 1.5 GB; doubled, a computer of 8 GB is filled by one frame that was made for it."""

MOST_FILES = 256
"""Descriptors: catalogs, their caches, a connection to an online catalog. It holds about 20; doubled, a
process that leaks them holds twice as many of the system's."""

MOST_FILE_BYTES = 2_500_000_000
"""Longest file it may write: pixels of a frame that it was asked to read, tiles of a catalog.
300 megapixels take 2.4 GB at most. Doubled, a damaged program could fill twice as much of a disk."""

READING_CPU_S = 60.0
"""Reading and measuring the largest frame on a slow computer: what a task may compute beyond its budget.
Doubled, a file that was made to keep the process busy does so twice as long."""

_DIES_FIRST = 500
"""Added to the kernel's badness (-1000 to 1000) when memory is out: it dies before the service does."""


@dataclass(frozen=True, slots=True)
class Limits:
    """What the process may take.

    Attributes
    ----------
    memory_mb : float or None
        Its own memory; what it maps of catalogs and indexes isn't counted. None: half of the computer's,
        at most `MOST_MEMORY_MB`.
    more_cpu_s : float
        What a task may compute beyond its budget, for reading and measuring.
    """

    memory_mb: float | None = None
    more_cpu_s: float = READING_CPU_S

    @property
    def memory_bytes(self) -> int:
        """The limit of memory."""
        if self.memory_mb is not None:
            return int(self.memory_mb * _MB)
        whole = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
        return int(min(MOST_MEMORY_MB * _MB, 0.5 * whole))

    def impose(self) -> None:
        """Bind this process, for good."""
        # RLIMIT_DATA and not RLIMIT_AS: a catalog of 50 GB may be mapped, and costs nothing
        _lower(resource.RLIMIT_DATA, self.memory_bytes)
        _lower(resource.RLIMIT_NOFILE, MOST_FILES)
        _lower(resource.RLIMIT_FSIZE, MOST_FILE_BYTES)
        _lower(resource.RLIMIT_CORE, 0)
        with contextlib.suppress(OSError):  # a kernel without /proc
            Path("/proc/self/oom_score_adj").write_text(str(_DIES_FIRST), encoding="ascii")


def _lower(which: int, wanted: int) -> None:
    _, most = resource.getrlimit(which)
    least = wanted if most == resource.RLIM_INFINITY else min(wanted, most)
    resource.setrlimit(which, (least, least))


def allow_cpu_s(more_s: float) -> None:
    """Let this process compute for so long from now on; after that the kernel ends it (SIGXCPU)."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    wanted = math.ceil(used.ru_utime + used.ru_stime + more_s) + 1
    _, most = resource.getrlimit(resource.RLIMIT_CPU)
    resource.setrlimit(
        resource.RLIMIT_CPU, (wanted if most == resource.RLIM_INFINITY else min(wanted, most), most)
    )


def own_memory_mb() -> float:
    """Memory that this process holds for itself, MB; 0 where the kernel doesn't tell."""
    with contextlib.suppress(OSError, ValueError):
        for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
            if line.startswith("RssAnon:"):
                return float(line.split()[1]) * 1024 / _MB
    return 0.0
