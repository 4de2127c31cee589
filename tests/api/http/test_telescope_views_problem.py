"""What is wrong with a telescope is told as long as it is so, and no longer."""

from __future__ import annotations

from pathlib import Path

from mountnav.errors import DeviceMissing
from tests.api.indi_server.face_rig import observatory


async def test_a_mount_that_answers_again_has_no_old_problem(tmp_path: Path) -> None:
    async with observatory(tmp_path) as service:
        telescope = service.observatory.telescope("east")
        await service.dispatcher.watch("east").refresh()
        await telescope.lost(DeviceMissing("the line was lost", device="east", advice="check the cable"))
        state = await telescope.state()
        assert state.connected
        assert "the line was lost" not in (state.problem or "")
        # one that isn't there says so
        gone = await service.observatory.telescope("gone").state()
        assert not gone.connected
        assert "there-is-no-such-port" in (gone.problem or "")
