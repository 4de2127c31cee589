"""The UniqueID of each telescope: made once, kept beside the journal, never changed [Alpaca §6]."""

from __future__ import annotations

import json
import logging
import os
import tempfile
from collections.abc import Sequence
from pathlib import Path
from uuid import NAMESPACE_URL, UUID, uuid4, uuid5

from mountnav.files import locked
from mountnav.journal.database import database_url, file_of, state_folder
from mountnav.parsing import json_of
from mountnav.settings.observatory import Settings

_log = logging.getLogger(__name__)


def ids_path(settings: Settings) -> Path:
    """Where the ids of a service of these settings lie: beside its journal."""
    journal = file_of(database_url(settings.journal.where))
    return (state_folder() if journal is None else journal.parent) / "alpaca-ids.json"


def unique_ids(path: Path, telescopes: Sequence[str]) -> dict[str, str]:
    """The UniqueID of each telescope; one that has none yet gets one, which is written down first.

    Where nothing can be written down they follow from the machine's name and the telescope's: better than
    ids that change with each start, and it is logged. A file that can't be read is never written over.

    Parameters
    ----------
    path : Path
    telescopes : sequence of str
        Ids of the settings.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # two services may share a folder
        with locked(path.with_suffix(".lock")):
            known = _read(path)
            fresh = {one: str(uuid4()) for one in telescopes if one not in known}
            if fresh:
                known |= fresh
                _write(path, known)
    except (OSError, ValueError) as error:
        _log.warning("the Alpaca ids in %s can't be kept, and are made of names: %s", path, error)
        return {
            one: str(uuid5(NAMESPACE_URL, f"mountnav://{os.uname().nodename}/{one}")) for one in telescopes
        }
    return {one: known[one] for one in telescopes}


def _read(path: Path) -> dict[str, str]:
    """Raises ValueError for a file that holds anything else."""
    if not path.exists():
        return {}
    found = json_of(path.read_text(encoding="utf-8"))
    if not isinstance(found, dict):
        raise ValueError("it holds no ids")
    return {str(name): str(UUID(str(value))) for name, value in found.items()}


def _write(path: Path, ids: dict[str, str]) -> None:
    with tempfile.NamedTemporaryFile(
        "w", encoding="utf-8", dir=path.parent, prefix=path.name, delete=False
    ) as file:
        json.dump(ids, file, indent=1, sort_keys=True)
        file.flush()
        os.fsync(file.fileno())
    Path(file.name).replace(path)


__all__ = ["ids_path", "unique_ids"]
