"""Where a device of an Alpaca server is, and who asks; no I/O [Alpaca §1]."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Where:
    """A device's address.

    Attributes
    ----------
    server : str
        ``http://host:port`` or ``https://host:port``.
    kind : str
        ``telescope`` or ``camera``.
    number : int
        Of the device among its kind.
    user, password : str
        For HTTP Basic; empty for none.
    ca : str or None
        File of certificates to trust besides the system's.
    """

    server: str
    kind: str
    number: int
    user: str = ""
    password: str = ""
    ca: str | None = None

    @property
    def address(self) -> str:
        """For messages; without the password."""
        return f"alpaca+{self.server}/{self.kind}/{self.number}"

    def url(self, member: str) -> str:
        """Of one of its members [Alpaca §1]."""
        return f"{self.server}/api/v1/{self.kind}/{self.number}/{member}"
