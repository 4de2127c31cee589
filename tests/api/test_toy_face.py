"""A face is a listener that orders at the dispatcher: done with a toy (docs/how-to/add-a-face.md)."""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
import pytest_asyncio

from api.access.callers import Role
from api.listeners.listeners import Listener, Listeners
from api.service import Service
from mountnav.clock import utc_now
from mountnav.sky.chain import icrs_to_observed
from mountnav.sky.coordinates import Air
from tests.api import toy_face
from tests.api.indi_server.face_rig import SITE, observatory
from tests.api.toy_face import ToyFace
from tests.conftest import ROOT

PAGE = ROOT / "docs" / "how-to" / "add-a-face.md"


@pytest_asyncio.fixture
async def service(tmp_path: Path) -> AsyncIterator[Service]:
    """A service with a fake mount, and the toy among its listeners: once for operators, once to look on."""
    async with observatory(tmp_path) as opened:
        made: dict[str, Listener] = {
            "toy": ToyFace(opened, "east", role=Role.OPERATE),
            "toy-view": ToyFace(opened, "east", role=Role.VIEW),
        }
        # shut with the service
        opened.listeners = Listeners({name: lambda face=face: face for name, face in made.items()})  # type: ignore[misc]
        await opened.listeners.start()
        await opened.dispatcher.watch("east").refresh()
        yield opened


async def ask(service: Service, words: bytes, *, face: str = "toy") -> list[bytes]:
    """Send all at once; the answers."""
    state = service.listeners.states[face]
    reader, writer = await asyncio.open_connection(state.host, state.port)
    writer.write(words)
    writer.write_eof()
    async with asyncio.timeout(60.0):
        answers = await reader.read()
    writer.close()
    return answers.splitlines()


async def test_the_state_is_that_of_the_last_snapshot(service: Service) -> None:
    altitude, unknown = await ask(service, b"state\nhello\n")
    state = service.dispatcher.watch("east").latest.state
    assert state.icrs is not None
    there = icrs_to_observed(state.icrs, utc_now(), SITE, Air())
    assert float(altitude) == pytest.approx(there.alt_deg, abs=0.1)
    assert unknown == b"what?"


async def test_a_stop_goes_by_the_dispatcher_and_needs_its_role(service: Service) -> None:
    assert (await ask(service, b"stop\n"))[0] in {b"stopped", b"stopping"}
    (refused,) = await ask(service, b"stop\n", face="toy-view")
    assert refused.startswith(b"refused: ")


async def test_a_line_without_end_is_let_go(service: Service) -> None:
    assert await ask(service, b"x" * 1000) == []
    assert len(await ask(service, b"state\n")) == 1


def test_the_page_quotes_the_toy() -> None:
    (quoted,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert quoted == Path(toy_face.__file__).read_text(encoding="utf-8")
