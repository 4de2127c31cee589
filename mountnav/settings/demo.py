"""`[demo]`: a virtual observatory, at a time and a speed of its own; only where there is no hardware."""

from __future__ import annotations

from collections.abc import Iterable
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Literal

from pydantic import Field, field_validator
from pydantic_core import PydanticCustomError

from mountnav.settings.section import Section

if TYPE_CHECKING:
    from mountnav.settings.telescope import TelescopeSettings

_FIRST = datetime(1990, 1, 1, tzinfo=UTC)
_LAST = datetime(2060, 1, 1, tzinfo=UTC)


class DemoSettings(Section):
    """`[demo]`: the service lives in a time of its own, with fake mounts and simulated cameras.

    Attributes
    ----------
    at : datetime, "night" or None
        When the virtual time begins (with its time zone). "night": now if it is dark, else at the beginning
        of the next night. None: now.
    speed : float
        Virtual seconds in one of the machine's. Sky, mounts, exposures, pauses and guide pulses all go by it;
        what waits for wires, solvers and clients does not.
    seed : int or None
        Of the camera's noise; `mountnav serve --demo --seed` also makes another mount of it.
    """

    at: datetime | Literal["night"] | None = None
    speed: float = Field(default=1.0, ge=0.1, le=60.0)
    seed: int | None = Field(default=None, ge=0, le=2**31 - 1)

    @field_validator("at", mode="before")
    @classmethod
    def _is_an_instant(cls, at: object) -> object:
        if at is None or at == "night":
            return at
        fix = "write 2026-12-01T22:00:00Z, or night"
        try:
            instant = datetime.fromisoformat(at) if isinstance(at, str) else at
        except ValueError:
            instant = None
        if not isinstance(instant, datetime) or instant.utcoffset() is None:
            raise PydanticCustomError(
                "demo_no_instant", "{at} is not an instant with its time zone", {"at": str(at), "fix": fix}
            )
        if not _FIRST <= instant <= _LAST:
            raise PydanticCustomError(
                "demo_far_off",
                "{at} is too far off for the tables of the Earth's rotation",
                {"at": str(at), "fix": f"choose a time between {_FIRST.year} and {_LAST.year}"},
            )
        return instant.astimezone(UTC)

    def require_no_hardware(self, telescopes: Iterable[TelescopeSettings]) -> None:
        """Refuse a virtual time where something real would be pointed by it.

        Raises
        ------
        PydanticCustomError
            A mount or a camera of these telescopes is real, or a night goes by a real file's age.
        """
        for number, one in enumerate(telescopes):
            if not one.mount.is_fake:
                raise PydanticCustomError(
                    "demo_with_hardware",
                    "a real mount ({url}) can't live in a virtual time",
                    {
                        "url": one.mount.url,
                        "key": ("telescope", number, "mount"),
                        "fix": 'take [demo] out, or set mount.url = "fake+lx200://"',
                    },
                )
            if one.camera.kind != "simulated":
                raise PydanticCustomError(
                    "demo_with_camera",
                    "the frames of a {kind} camera don't come from a virtual time",
                    {
                        "kind": one.camera.kind,
                        "key": ("telescope", number, "camera"),
                        "fix": 'take [demo] out, or set camera.kind = "simulated"',
                    },
                )
            if one.night.safety_file is not None:
                raise PydanticCustomError(
                    "demo_with_safety_file",
                    "the age of a safety file is not of a virtual time",
                    {"key": ("telescope", number, "night"), "fix": "take night.safety_file out"},
                )
