"""Who may come in by a port whose protocol knows no keys: by address alone, refused and told otherwise."""

from __future__ import annotations

from collections.abc import Callable

from api.access.audit import Audit, Seldom

__all__ = ["Door"]

_EACH = 1
"""So often a minute one address that was refused is noted."""
_ALL = 20
"""So many notes a minute of all of them together: they must not fill the journal. Doubled, 15 MB a day."""


class Door:
    """Lets addresses in or not; those that it refuses stand in the audit.

    Parameters
    ----------
    admits : callable (str) -> bool
        Of the settings.
    name : str
        Of the face, for the audit.
    """

    def __init__(self, admits: Callable[[str], bool], audit: Audit, name: str) -> None:
        self._admits, self._audit, self._name = admits, audit, name
        self._seldom = Seldom(_EACH, _ALL)

    def lets_in(self, address: str) -> bool:
        """Whether a client from there is served."""
        if self._admits(address):
            return True
        if (unnoted := self._seldom.due(address)) is not None:
            self._audit.stranger(
                address, f"connect to {self._name}", status=403, outcome="forbidden", unnoted=unnoted
            )
        return False
