"""A journal in memory, for simulations and tests: the same rows, in the order they were written."""

from __future__ import annotations

from mountnav.journal.records import CommandEnd, CommandRecord, Entry, EntryKind, LookRecord


class MemoryJournal:
    """Keeps what is written, in lists.

    Attributes
    ----------
    ends : dict of str to CommandEnd
        By command.
    """

    def __init__(self) -> None:
        self.looks: list[LookRecord] = []
        self.commands: list[CommandRecord] = []
        self.ends: dict[str, CommandEnd] = {}
        self.entries: list[Entry] = []

    async def look(self, record: LookRecord) -> None:
        """Keep a look."""
        self.looks.append(record)

    async def begin(self, command: CommandRecord) -> None:
        """Keep a command."""
        self.begin_now(command)

    def begin_now(self, command: CommandRecord) -> None:
        """Keep a command."""
        self.commands.append(command)

    async def end(self, command_id: str, end: CommandEnd) -> None:
        """Keep a command's end."""
        self.ends[command_id] = end

    async def note(self, entry: Entry) -> None:
        """Keep anything else."""
        self.note_now(entry)

    def note_now(self, entry: Entry) -> None:
        """Keep anything else."""
        self.entries.append(entry)

    async def recent(self, telescope: str, kind: EntryKind, count: int) -> list[Entry]:
        """The last entries of a kind, oldest first."""
        found = [one for one in self.entries if one.telescope == telescope and one.kind is kind]
        return found[-count:] if count > 0 else []

    @property
    def in_flight(self) -> list[CommandRecord]:
        """Commands that were begun and not closed."""
        return [command for command in self.commands if command.command_id not in self.ends]
