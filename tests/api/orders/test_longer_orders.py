"""The longer kinds of jobs in virtual time: a series finds the true drift, a model run the true errors."""

from __future__ import annotations

import asyncio
import math
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import pytest

from api.orders.longer_orders import FAILURES_IN_A_ROW, run_series
from api.orders.model_run import run_model
from api.orders.targets import IcrsTarget
from api.orders.vocabulary import ModelRunOrder, SeriesOrder
from mountnav.errors import BadRequest, SolveFailed
from mountnav.journal.records import EntryKind
from mountnav.pointing.limits import Limits
from mountnav.pointing.model.model import PointingModel
from mountnav.settings.observatory import Settings
from mountnav.simulation.pointing_errors import PointingErrors
from mountnav.simulation.sky_script import Cloud, SkyScript
from mountnav.sky.sphere import offset_arcsec
from tests.navigation.virtual_rig import ERRORS, VirtualRig, in_virtual_time

TILTED = replace(ERRORS, me_arcsec=1800.0, ma_arcsec=900.0)
LIMITS = Limits(min_altitude_deg=25.0)


def _settings(file: Path | None = None) -> Settings:
    model = "" if file is None else f'model = {{ file = "{file}" }}\n'
    return Settings.parse(
        f"""
[site]
latitude_deg = 48.93
longitude_deg = 22.27
[[telescope]]
id = "rig"
{model}mount = {{ url = "fake+lx200://" }}
limits = {{ min_altitude_deg = 25.0 }}
camera = {{ kind = "simulated", width_px = 800, height_px = 600, scale_arcsec_px = 2.0 }}
"""
    )


def test_a_series_finds_the_drift_that_the_tube_truly_has() -> None:
    told: list[dict[str, object]] = []

    async def work(rig: VirtualRig) -> None:
        target = rig.up(-20.0, 25.0)
        order = SeriesOrder(
            target=IcrsTarget(ra_deg=target.ra_deg, dec_deg=target.dec_deg), looks=12, every_s=60.0
        )
        began = rig.clock.utc()
        report = await run_series(rig.navigator, order, told.append, rig.clock)
        assert (rig.clock.utc() - began).total_seconds() > 11 * 60.0
        assert (report.looks, report.solved, report.jumps) == (12, 12, [])
        assert report.drift is not None
        first, last = (datetime.fromisoformat(str(told[at]["mid_exposure_utc"])) for at in (0, -1))
        moved = offset_arcsec(rig.mechanics.truth(last), rig.mechanics.truth(first))
        span = (last - first).total_seconds() / 60.0
        true_east, true_north = moved.east_arcsec / span, moved.north_arcsec / span
        assert abs(true_north) > 0.5, "a tilted axis drifts"
        drift = report.drift
        assert drift.ra_cosdec_arcsec_min == pytest.approx(true_east, abs=0.1)
        assert drift.dec_arcsec_min == pytest.approx(true_north, abs=0.1)
        assert drift.dec_sigma_arcsec_min is not None
        assert 0.0 < drift.dec_sigma_arcsec_min < 0.1
        assert report.target_mount is not None
        assert report.target_mount.frame != "icrs" or rig.mount.epoch == "icrs"

    in_virtual_time(work, errors=TILTED, limits=LIMITS)
    assert [one["number"] for one in told] == list(range(1, 13))
    assert all(one["solved"] for one in told)


def test_a_series_under_clouds_is_given_up_and_tells_each_look() -> None:
    told: list[dict[str, object]] = []

    async def work(rig: VirtualRig) -> None:
        with pytest.raises(SolveFailed, match="stopped after"):
            await run_series(rig.navigator, SeriesOrder(looks=20), told.append, rig.clock)

    in_virtual_time(work, script=SkyScript(clouds=(Cloud(0.0, 1e6),)), limits=LIMITS)
    assert len(told) == FAILURES_IN_A_ROW
    assert all(one["problem"] and not one["solved"] for one in told)


@pytest.mark.long
def test_a_model_run_finds_the_errors_and_is_put_in_force_when_asked(tmp_path: Path) -> None:
    told: list[dict[str, object]] = []
    file = tmp_path / "model.json"
    errors = PointingErrors(
        ih_arcsec=300.0, id_arcsec=-200.0, ch_arcsec=150.0, me_arcsec=400.0, ma_arcsec=-250.0
    )

    async def work(rig: VirtualRig) -> None:
        settings = _settings(file)
        one = settings.telescope[0]
        journal = rig.journal
        order = ModelRunOrder(points=16, put_in_force=True)
        report = await run_model(
            rig.navigator, order, told.append, settings=settings, one=one, journal=journal, clock=rig.clock
        )
        assert report.accepted, report.reasons
        assert (report.in_force, report.written_to) == (True, str(file))
        assert rig.navigator.pointing.model_id == report.model_id
        assert PointingModel.load(file).id == report.model_id
        values = {term.name: term.value_arcsec for term in report.terms}
        assert values["CH"] == pytest.approx(150.0, abs=10.0)
        assert report.before_arcsec is not None
        assert report.sky_rms_arcsec is not None
        assert report.sky_rms_arcsec < 0.2 * report.before_arcsec
        assert any("in force" in entry.what for entry in rig.entries(EntryKind.MODEL))

    in_virtual_time(work, errors=errors, limits=LIMITS)
    numbers = [one["number"] for one in told]
    assert numbers == list(range(1, len(told) + 1))
    assert {one["part"] for one in told} == {"fit", "held-out", "fresh"}
    assert all(one["of"] == len(told) and one["solved"] for one in told)
    assert all(isinstance(one["error_arcsec"], float) and math.isfinite(one["error_arcsec"]) for one in told)


def test_a_model_run_is_cancelled_between_points_and_leaves_nothing_in_force() -> None:
    told: list[dict[str, object]] = []

    async def work(rig: VirtualRig) -> None:
        settings = _settings()
        run = asyncio.ensure_future(
            run_model(
                rig.navigator,
                ModelRunOrder(points=16),
                told.append,
                settings=settings,
                one=settings.telescope[0],
                journal=rig.journal,
                clock=rig.clock,
            )
        )
        while len(told) < 3:
            await rig.clock.sleep(1.0)
        run.cancel()
        with pytest.raises(asyncio.CancelledError):
            await run
        await rig.navigator.stop()
        assert rig.navigator.pointing.model_id is None

    in_virtual_time(work, limits=LIMITS)
    assert 3 <= len(told) < 8


def test_a_model_run_of_too_few_points_is_refused_before_anything_moves() -> None:
    async def work(rig: VirtualRig) -> None:
        settings = _settings()
        assert settings.telescope[0].model.min_points == 8
        with pytest.raises(BadRequest, match="of 8 points, 6 are to make the model"):
            await run_model(
                rig.navigator,
                ModelRunOrder(points=8),
                lambda attempt: None,
                settings=settings,
                one=settings.telescope[0],
                journal=rig.journal,
                clock=rig.clock,
            )
        assert rig.told("slewing") == []

    in_virtual_time(work, limits=LIMITS)


def test_a_model_cannot_be_put_in_force_where_no_file_is_set() -> None:
    async def work(rig: VirtualRig) -> None:
        settings = _settings()
        with pytest.raises(BadRequest, match="none is set"):
            await run_model(
                rig.navigator,
                ModelRunOrder(put_in_force=True),
                lambda attempt: None,
                settings=settings,
                one=settings.telescope[0],
                journal=rig.journal,
                clock=rig.clock,
            )
        assert rig.told("slewing") == []

    in_virtual_time(work, limits=LIMITS)
