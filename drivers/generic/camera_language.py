"""What a family of cameras must be able to say and do; `ExposingCamera` makes a camera of it."""

from __future__ import annotations

from typing import Protocol

from drivers.generic.shot import Shot
from drivers.wire.wire_log import WireLog
from mountnav.frames import Frame


class CameraLanguage(Protocol):
    """A camera behind a connection of its own. No method is called twice at once, but for `send_abort`."""

    done: tuple[str, ...]
    """What was set at the last opening, or before the last exposure, in words."""

    @property
    def name(self) -> str:
        """Name, for messages."""
        ...

    @property
    def log(self) -> WireLog:
        """All that was said lately; images are abbreviated."""
        ...

    @property
    def usable(self) -> bool:
        """Whether it is open and not lost."""
        ...

    async def open(self) -> None:
        """Connect, anew if it was lost, and set up; what fails leaves no connection behind."""
        ...

    async def close(self) -> None:
        """Release the connection; the camera stays connected, for others."""
        ...

    async def wait_until_idle(self, shot: Shot) -> None:
        """Wait a moment until no exposure runs, one that was just aborted for example.

        Raises
        ------
        BadRequest
            If the camera takes no such exposure.
        Busy
            If another program's runs.
        """
        ...

    async def set_up(self) -> None:
        """Have the whole chip read out as the configuration says: another program may have used it since."""
        ...

    async def take(self, shot: Shot) -> Frame:
        """Order the exposure and wait for its image; raises `Cancelled` when it is aborted."""
        ...

    def send_abort(self) -> None:
        """Send the order to abort, past all others; its outcome is not waited for, a lost link is none."""
        ...
