"""What makes a whole mount of any language."""

from drivers.driven.mount import DrivenMount

__all__ = ["DrivenMount"]
