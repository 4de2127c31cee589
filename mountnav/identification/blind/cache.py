"""Where the index lies in the user's cache, and how it gets there: built once, then shared."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from mountnav.catalog.packed import PackedStore
from mountnav.errors import BadSettings
from mountnav.files import cache_folder, locked
from mountnav.identification.blind.file_format import VERSION
from mountnav.identification.blind.index import BlindIndex

Progress = Callable[[float], None]


def index_path(catalog: PackedStore) -> Path:
    """Where the index of a catalog lies or would lie.

    Returns
    -------
    Path
        Its name carries the hash of the catalog's stars and the version of the format: another catalog, or
        another mountnav, has another file.
    """
    return cache_folder() / f"quads-{catalog.header.sections_sha256[:16]}-v{VERSION}.mnq"


def cached_index(
    catalog: PackedStore, *, progress: Progress | None = None, force: bool = False
) -> BlindIndex:
    """Open the index of a catalog; on first need it is built, which takes half a minute of one core.

    Parameters
    ----------
    progress : callable, optional
        Told the share that is done, 0 to 1, if it is built here.
    force : bool
        Build it even if it is there.

    Returns
    -------
    BlindIndex
        Of processes that call it at the same time one builds, and the others wait for it.

    Raises
    ------
    BadSettings
        The cache can't be written.
    """
    path = index_path(catalog)
    if not force and (found := installed_index(catalog)) is not None:
        return found
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with locked(path.with_suffix(".lock")):
            # another process may have built it meanwhile; a damaged one is built again
            if force or (found := installed_index(catalog)) is None:
                for left_behind in path.parent.glob(f"{path.name}.*.part"):
                    left_behind.unlink(missing_ok=True)  # by a process that was killed while it wrote
                # imported here: a caller who finds an index needs nothing of what builds it
                from mountnav.identification.blind.building import build

                build(catalog, path, progress=progress)
    except OSError as refused:
        raise BadSettings(
            f"the index for blind solving can't be written: {refused.strerror or refused}",
            device=str(path),
            advice="free 300 MB there, or set MOUNTNAV_CACHE to a folder that can be written",
        ) from refused
    return BlindIndex.open(path)


def installed_index(catalog: PackedStore) -> BlindIndex | None:
    """Open the index of a catalog if it was built before. Builds nothing.

    Returns
    -------
    BlindIndex or None
        None as well where the file is cut short, of another form or of other stars: it has to be built again.
    """
    path = index_path(catalog)
    try:
        found = BlindIndex.open(path) if path.is_file() else None
    except (BadSettings, OSError):
        return None
    if found is None or found.header.catalog_sha256 != catalog.header.sections_sha256:
        return None
    return found
