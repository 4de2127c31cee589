"""A stop goes out before every question that the port hasn't got yet, in whatever thread that waits."""

from __future__ import annotations

import asyncio
import os
import pty

from drivers.wire.line import SerialLine


async def test_a_stop_passes_a_question_that_a_thread_has_in_hand() -> None:
    ours, theirs = pty.openpty()
    line = SerialLine(os.ttyname(theirs))
    try:
        await line.open()
        try:
            with line._writing:  # as while other bytes are just written
                question = asyncio.create_task(line.write(b":GR#"))
                await asyncio.sleep(0.05)  # time for its thread to wait for the port
                stop = asyncio.create_task(line.write_now(b":Q#"))
                await asyncio.sleep(0.05)
            await asyncio.gather(question, stop)
            assert os.read(ours, 100) == b":Q#:GR#"
        finally:
            await line.close()
    finally:
        os.close(ours)
        os.close(theirs)


async def test_a_stop_that_nobody_waits_for_any_more_is_written_and_holds_up_nothing() -> None:
    ours, theirs = pty.openpty()
    line = SerialLine(os.ttyname(theirs))
    try:
        await line.open()
        try:
            with line._writing:
                stop = asyncio.create_task(line.write_now(b":Q#"))
                await asyncio.sleep(0)
                stop.cancel()
                await asyncio.sleep(0)
            await line.write(b":GR#")
            assert os.read(ours, 100) == b":Q#:GR#"
        finally:
            await line.close()
    finally:
        os.close(ours)
        os.close(theirs)
