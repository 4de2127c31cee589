"""In whose form a morning report is posted; settings name it, and need nothing else of reports."""

from __future__ import annotations

from typing import Literal

__all__ = ["MessageKind"]

MessageKind = Literal["json", "slack", "discord", "ntfy"]
"""Whose form a message has."""
