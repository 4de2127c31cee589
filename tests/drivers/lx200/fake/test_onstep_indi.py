"""The real indi_lx200_OnStep against the fake, on both kinds of wire."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.drivers.lx200.fake.indi_judge import Judge, let_it_judge
from tests.drivers.lx200.german_fakes import german

JUDGE = Judge("indi_lx200_OnStep", "LX200 OnStep", written_arcsec=8.0, read_arcsec=8.0)


@pytest.mark.long
@pytest.mark.parametrize("tcp", [False, True])
async def test_it_gets_its_way_and_reports_what_the_mount_believes(tmp_path: Path, tcp: bool) -> None:
    await let_it_judge(JUDGE, german("onstep"), tmp_path, tcp=tcp)
