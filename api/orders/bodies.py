"""What all request bodies are: strict."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict


class Body(BaseModel):
    """A request's body: nothing unknown, no text or truth values for numbers, no NaN."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


def _kind_is_required(schema: dict[str, Any]) -> None:
    schema["required"] = ["kind", *(name for name in schema.get("required", ()) if name != "kind")]


class Tagged(Body):
    """One of several kinds of bodies: over the wire it says which."""

    model_config = ConfigDict(json_schema_extra=_kind_is_required)


__all__ = ["Body", "Tagged"]
