"""A child process that writes commands and tells each on its standard output, until it is killed."""

from __future__ import annotations

import asyncio
import sys

from mountnav.journal.records import CommandEnd, Outcome
from mountnav.journal.sql_journal import open_journal
from tests.journal.samples import at, look_of, note_of, slew_of


async def main(url: str) -> None:
    journal = open_journal(url)

    async def one_telescope(name: str) -> None:
        number = 0
        while True:
            number += 1
            command = slew_of(name, number, facts={"number": number, "long": "x" * (number % 3000)})
            await journal.begin(command)
            print("begun", command.command_id, number, flush=True)
            journal.note_now(note_of(f"note {number}", name, number))
            await journal.look(look_of(name, number))
            await journal.end(command.command_id, CommandEnd(at(number), Outcome.DONE, f"end {number}"))
            print("ended", command.command_id, number, flush=True)

    await asyncio.gather(*(one_telescope(name) for name in ("east", "west")))


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1]))
