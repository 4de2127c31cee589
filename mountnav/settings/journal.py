"""`[journal]`: where everything is written down."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, Self

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from mountnav.journal.database import audit_key_beside, default_url
from mountnav.settings.section import Section


class JournalSettings(Section):
    """`[journal]`: where everything is written down.

    Attributes
    ----------
    url : str
        A file's path, or ``postgresql://user@host/database`` (password: ``~/.pgpass``). Empty: the
        environment's MOUNTNAV_JOURNAL, else ``journal.sqlite`` in $XDG_STATE_HOME/mountnav, else in
        ``~/.local/state/mountnav``. A service always keeps a journal: without one it would not know after a
        crash what it had ordered.
    keep_days : float
        Looks, jobs and passing notes older than this are removed; 0 keeps all. Commands with their outcomes,
        models, settings, syncs, segments, refusals and faults are never removed.
    max_size_mb : float
        When a file of SQLite holds more than this, the oldest looks and passing notes are removed; 0 for no
        bound. A look takes about 0.7 kB, a command 0.6 kB.
    looks_keep_days, audit_keep_days : float or None
        The same for looks, and for the audit, where they are to be kept for another time; 0 keeps all.
    fsync : {"commands", "always", "never"}
        What must be on the disk itself before it counts as written. Nothing is lost when the process is
        killed; a power cut or a crash of the machine can lose what the operating system still held:
        ``commands``: the last looks and notes, never a command or its outcome; ``always``: nothing;
        ``never``: all of the last seconds.
    audit_key_file : Path or None
        The key that seals the audit, made if it isn't there (mode 0600). None: ``audit.key`` beside the
        file, else in the folder of the user's state. Anyone who has it can forge the audit.
    """

    url: str = Field(default="", max_length=1000)
    keep_days: float = Field(default=1100.0, ge=0, le=100_000)
    looks_keep_days: float | None = Field(default=None, ge=0, le=100_000)
    audit_keep_days: float | None = Field(default=None, ge=0, le=100_000)
    max_size_mb: float = Field(default=4096.0, ge=0, le=1_000_000)
    fsync: Literal["commands", "always", "never"] = "commands"
    audit_key_file: Path | None = None

    @property
    def where(self) -> str:
        """Path or URL."""
        return self.url or default_url()

    @property
    def audit_key_path(self) -> Path:
        """Where the audit's key is."""
        return self.audit_key_file or audit_key_beside(self.where)

    @model_validator(mode="after")
    def _url_makes_sense(self) -> Self:
        from mountnav.errors import BadSettings
        from mountnav.journal.database import database_url

        if not self.url:
            return self
        try:
            database_url(self.url)
        except BadSettings as error:
            raise PydanticCustomError(
                "no_journal_there", "{what}", {"what": error.what, "key": "url", "fix": error.advice or ""}
            ) from error
        return self
