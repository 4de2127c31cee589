"""`camera` of a telescope, of the kind "alpaca": which camera of which server, and how it is set."""

from __future__ import annotations

from typing import Literal, Self
from urllib.parse import quote

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from mountnav.settings.section import Section


class AlpacaCameraSettings(Section):
    """A camera of an Alpaca server; what is left out stays as it is in the camera."""

    kind: Literal["alpaca"]
    url: str = Field(pattern=r"^alpaca\+https?://")
    binning: int | None = Field(default=None, ge=1, le=16)
    gain: int | str | None = None
    offset: int | str | None = None
    focal_length_mm: float | None = Field(default=None, gt=0, le=100_000)
    download_s: float | None = Field(default=None, gt=0, le=3600)
    width_px: int | None = Field(default=None, ge=16, le=65536)
    height_px: int | None = Field(default=None, ge=16, le=65536)

    @property
    def device_url(self) -> str:
        """The URL with these settings as its options."""
        given = {
            "binning": self.binning,
            "gain": self.gain,
            "offset": self.offset,
            "focal_length_mm": self.focal_length_mm,
            "download_s": self.download_s,
        }
        added = [f"{name}={quote(str(value))}" for name, value in given.items() if value is not None]
        return f"{self.url}{'&' if '?' in self.url else '?'}{'&'.join(added)}" if added else self.url

    @model_validator(mode="after")
    def _said_once(self) -> Self:
        query = self.url.partition("?")[2]
        for name in ("binning", "gain", "offset", "focal_length_mm", "download_s"):
            if getattr(self, name) is not None and f"{name}=" in query:
                raise PydanticCustomError(
                    "said_twice",
                    "{key} is set, and the URL says it too",
                    {"key": name, "fix": f"remove {name} from the URL"},
                )
        return self
