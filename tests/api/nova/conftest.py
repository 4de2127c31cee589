"""Services that tests of a module share: each costs half a second."""

from __future__ import annotations

from collections.abc import AsyncIterator

import pytest
import pytest_asyncio

from tests.api.nova.nova_service import Standing, standing


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def nova(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Standing]:
    """A service without keys."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MOUNTNAV_JOURNAL", str(tmp_path_factory.mktemp("nova") / "journal.sqlite"))
        async with standing() as found:
            yield found
