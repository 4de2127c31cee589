"""Which camera a frame is from: what is learned of one says nothing of another on the same telescope."""

from __future__ import annotations

from dataclasses import dataclass

from mountnav.frames import Frame

OUTSIDE = "a camera from outside"
"""Name of the camera of a frame from outside that tells none."""


@dataclass(frozen=True, slots=True)
class CameraIdentity:
    """A camera as its frames show it: by name, size and binning.

    Attributes
    ----------
    name : str
        As the frame's header says, or the camera that was asked for it.
    width_px, height_px : int
        Of its frames; a region read out alone is another camera, since its middle is another place.
    binning : str
        As "2x2"; empty where the header doesn't tell.
    """

    name: str
    width_px: int
    height_px: int
    binning: str = ""

    def __str__(self) -> str:
        """For messages and the journal; also its key there."""
        binned = f" binned {self.binning}" if self.binning else ""
        return f"{self.name} {self.width_px}×{self.height_px}{binned}"


def camera_of(frame: Frame, asked: str | None = None) -> CameraIdentity:
    """The camera of a frame.

    Parameters
    ----------
    frame : Frame
    asked : str, optional
        Name of the camera that was asked for it; None: it came from outside.
    """
    told = frame.header.get("INSTRUME")
    name = str(told).strip() if isinstance(told, str) and told.strip() else asked or OUTSIDE
    across, down = (_count(frame.header.get(key)) for key in ("XBINNING", "YBINNING"))
    across, down = across or down, down or across
    binning = f"{across}x{down}" if across and down else ""
    return CameraIdentity(name, frame.width_px, frame.height_px, binning)


def _count(value: object) -> int:
    return int(value) if isinstance(value, int | float) and 0 < value < 100 else 0


__all__ = ["OUTSIDE", "CameraIdentity", "camera_of"]
