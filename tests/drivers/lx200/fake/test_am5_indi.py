"""The real indi_lx200am5 against the fake, on both kinds of wire."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.drivers.lx200.fake.indi_judge import Judge, let_it_judge
from tests.drivers.lx200.german_fakes import german

JUDGE = Judge("indi_lx200am5", "ZWO AM5", written_arcsec=16.0, read_arcsec=8.0, parks_home=True)


@pytest.mark.long
@pytest.mark.parametrize("tcp", [False, True])
async def test_it_gets_its_way_and_reports_what_the_mount_believes(tmp_path: Path, tcp: bool) -> None:
    await let_it_judge(JUDGE, german("am5"), tmp_path, tcp=tcp)
