"""What makes a whole mount of any language."""

from drivers.generic.mount import DrivenMount

__all__ = ["DrivenMount"]
