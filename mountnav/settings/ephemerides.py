"""`[ephemerides]`: where imported elements lie, and which SPK files count."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import Field

from mountnav.settings.section import Section

if TYPE_CHECKING:
    from mountnav.ephemeris.imported import Imports


class EphemeridesSettings(Section):
    """`[ephemerides]`: see docs/explanation/moving-targets.md.

    Attributes
    ----------
    folder
        Where `mountnav ephemeris import` puts what it imports. Left out: $MOUNTNAV_EPHEMERIDES, else the data
        folder of the user.
    files
        SPK files (.bsp) elsewhere; they count before those in the folder, and before the shipped excerpt.
    """

    folder: Path | None = None
    files: tuple[Path, ...] = Field(default=(), max_length=50)

    def use(self) -> Imports:
        """Let names be found there from now on.

        Raises
        ------
        BadSettings
            One of the files can't be read, or is no SPK file.
        """
        # settings are read, and complained of, without the mathematics of orbits
        from mountnav.ephemeris.imported import use_imports
        from mountnav.errors import BadRequest, BadSettings
        from mountnav.sky.kernel import Kernel

        for path in self.files:
            try:
                Kernel(path)
            except BadRequest as wrong:
                raise BadSettings(
                    wrong.what, device="ephemerides.files", advice=wrong.advice or "correct its path"
                ) from wrong
        return use_imports(self.folder, self.files)
