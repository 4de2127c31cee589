"""What all tables of the settings file have in common: nothing unknown, no NaN, no infinity."""

from __future__ import annotations

from collections.abc import Iterable
from typing import LiteralString

from pydantic import BaseModel, ConfigDict
from pydantic_core import PydanticCustomError

from mountnav.parsing import repeated


class Section(BaseModel):
    """One table of the file: unknown keys, NaN and infinities are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def require_unique(
    names: Iterable[str], slug: LiteralString, words: LiteralString, *, fix: str, key: str | None = None
) -> None:
    """Refuse tables that should differ and have one name.

    Parameters
    ----------
    slug : str
        Of the error.
    words : str
        What is wrong, with ``{name}`` in it.
    fix : str
        What to do.
    key : str, optional
        Of the tables, where the error is not found at them.
    """
    if twice := repeated(names):
        told = {"name": twice[0], "fix": fix}
        raise PydanticCustomError(slug, words, told if key is None else told | {"key": key})
