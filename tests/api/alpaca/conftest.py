"""One observatory for each test that asks for it."""

from __future__ import annotations

from collections.abc import AsyncIterator

import pytest
import pytest_asyncio

from tests.api.alpaca.alpaca_observatory import SPEED, AlpacaProbe, Running, running


@pytest.fixture
async def observatory() -> AsyncIterator[Running]:
    """A service of its own: a German mount with all skills, a fork with few, and one that isn't there."""
    async with running() as found:
        yield found


@pytest.fixture
async def fast() -> AsyncIterator[Running]:
    """The same at many times the speed of the sky, for what takes its time."""
    async with running(speed=SPEED) as found:
        yield found


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def shared_observatory(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Running]:
    """One for all tests of a module, for those that leave nothing behind."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MOUNTNAV_JOURNAL", str(tmp_path_factory.mktemp("alpaca") / "journal.sqlite"))
        async with running() as found:
            yield found


@pytest.fixture
def german(observatory: Running) -> AlpacaProbe:
    """Telescope 0: a German mount that can everything."""
    return observatory.probe


@pytest.fixture
def fork(observatory: Running) -> AlpacaProbe:
    """Telescope 1: a fork that can little."""
    return observatory.probe.at(1)
