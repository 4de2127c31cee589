"""The real indi_lx200_10micron against the fake, on both kinds of wire."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.drivers.lx200.fake.indi_judge import Judge, let_it_judge
from tests.drivers.lx200.german_fakes import german

JUDGE = Judge("indi_lx200_10micron", "10micron", written_arcsec=0.2, read_arcsec=0.6)


@pytest.mark.long
@pytest.mark.parametrize("tcp", [False, True])
async def test_it_gets_its_way_and_reports_what_the_mount_believes(tmp_path: Path, tcp: bool) -> None:
    await let_it_judge(JUDGE, german("10micron"), tmp_path, tcp=tcp)
