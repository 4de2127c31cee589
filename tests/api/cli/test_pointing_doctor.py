"""`mountnav pointing-doctor` and `mountnav drift` on files of observations, as an operator types them."""

from __future__ import annotations

import json
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from api.cli.drift import drift
from api.cli.pointing_doctor import pointing_doctor
from api.pointing.judgements import diagnosis_view, drift_view
from api.pointing.looks import read_looks
from benchmarks.pointing_doctor import Patient, night
from mountnav.devices import MountReading
from mountnav.errors import BadRequest
from mountnav.journal.records import CommandEnd, CommandRecord, LookRecord, Outcome
from mountnav.journal.sql_journal import open_journal
from mountnav.pointing.observation import read_observations, write_observations
from mountnav.simulation.pointing_errors import PointingErrors
from mountnav.sky.coordinates import Air, Site
from mountnav.sky.sphere import separation_arcsec

SITE = Site(48.93, 22.27)
WHERE = ["--latitude", "48.93", "--longitude", "22.27"]
app = typer.Typer()
app.command("pointing-doctor")(pointing_doctor)
app.command()(drift)


def typed(*words: str):
    return CliRunner().invoke(app, list(words), catch_exceptions=False)


@pytest.fixture
def ill(tmp_path: Path) -> Path:
    one = Patient(np.random.default_rng(4), SITE, Air(950.0), PointingErrors(), ahead_s=3600.0)
    night(one)
    write_observations(tmp_path / "night.jsonl", one.looks)
    return tmp_path / "night.jsonl"


def test_an_ill_mount_in_words_and_json(ill: Path) -> None:
    # a sync near the pole might have done it too, as long as nobody says that there was none
    assert (
        typed("pointing-doctor", str(ill), *WHERE).output.splitlines()[1].startswith("NOT SURE: clock wrong")
    )
    said = typed("pointing-doctor", str(ill), *WHERE, "--mounting", "german", "--unsynced")
    assert said.exit_code == 1
    assert "clock wrong" in said.output
    assert "daylight saving time?" in said.output
    assert "what to do: set the mount's clock" in said.output
    record = json.loads(typed("pointing-doctor", str(ill), *WHERE, "--unsynced", "--json").output)
    assert record["findings"][0]["what"] == "clock wrong"
    assert record["findings"][0]["numbers"]["clock"]["unit"] == "s"


def test_what_is_missing_or_wrong_is_told(ill: Path) -> None:
    for words, told in (
        ([], "site"),
        (["--latitude", "48"], "belong together"),
        (["--latitude", "148", "--longitude", "0"], "not a site"),
        ([*WHERE, "--mounting", "spade"], "mounting"),
        ([*WHERE, "--epoch", "B1950"], "B1950"),
        ([*WHERE, "--points-within", "-1"], "not a pointing error"),
        ([*WHERE, "--model", "nowhere.json"], "model"),
        ([*WHERE, "--since", "whenever"], "whenever"),
    ):
        with pytest.raises(BadRequest, match=told):
            typed("pointing-doctor", str(ill), *words)


def test_since_and_until_cut_the_night(ill: Path) -> None:
    said = typed("pointing-doctor", str(ill), *WHERE, "--until", "2020-01-01")
    assert said.exit_code == 0
    assert said.output.startswith("0 looks")


def test_a_drift_report_in_words_and_json(tmp_path: Path) -> None:
    from tests.pointing.drift.test_drift_report import NORTH, PLACES, watched

    followed, _ = watched(NORTH, PointingErrors(me_arcsec=300.0, ma_arcsec=240.0), PLACES[NORTH])
    path = tmp_path / "night.jsonl"
    write_observations(path, followed)
    said = typed("drift", str(path), *WHERE)
    assert said.exit_code == 0
    assert "advice: raise the polar axis 5." in said.output
    assert "settle time: unknown: the ends of slews aren't known" in said.output
    record = json.loads(typed("drift", str(path), *WHERE, "--json").output)
    assert len(record["stretches"]) == 3
    assert record["polar"]["from_drift"]["me_arcsec"] == pytest.approx(300.0, abs=15.0)
    assert typed("drift", str(path), *WHERE, "--until", "2020-01-01").exit_code == 1


def test_views_are_plain(ill: Path) -> None:
    night_looks = read_observations(ill)
    assert json.dumps(diagnosis_view(night_looks, site=SITE, epoch="apparent"), allow_nan=False)
    assert json.dumps(drift_view(night_looks, site=SITE), allow_nan=False)


async def test_a_journal_knows_its_syncs_and_slews(tmp_path: Path) -> None:
    one = Patient(np.random.default_rng(4), SITE, Air(950.0), PointingErrors(), ahead_s=3600.0)
    night(one, synced=True)
    path = tmp_path / "journal.sqlite"
    journal = open_journal(path)
    try:
        for number, look in enumerate(one.looks):
            reading = MountReading(look.reading, look.utc, slewing=False, pier_side=look.side)
            arrived = replace(reading, utc=look.utc - timedelta(seconds=20))
            order = CommandRecord(f"c{number}", "t", arrived.utc, "slew", look.segment_id, place=look.reading)
            await journal.begin(order)
            await journal.end(order.command_id, CommandEnd(arrived.utc, Outcome.DONE, after=arrived))
            await journal.look(
                LookRecord(
                    look.look_id,
                    "t",
                    look.utc,
                    True,
                    reading,
                    reading,
                    look.segment_id,
                    look.air,
                    seen=look.seen,
                    rotation_deg=look.rotation_deg,
                    parity=look.parity,
                )
            )
            if number == 0:
                (tie,) = one.syncs
                sync = CommandRecord("s", "t", tie.utc, "sync", look.segment_id, place=tie.reading)
                await journal.begin(sync)
                after = MountReading(tie.reading, tie.utc)
                await journal.end("s", CommandEnd(tie.utc, Outcome.DONE, after=after))
    finally:
        journal.close()
    found = read_looks(str(path), telescope="t", latitude=48.93, longitude=22.27)
    assert [each.look_id for each in found.observations] == ["l1", "l2", "l3", "l4"]
    assert found.synced_on is not None
    (synced,) = found.synced_on
    assert synced.segment_id == "s1"
    assert separation_arcsec(synced.seen, one.looks[0].seen) < 0.01
    assert len(found.slew_ends) == 4
    said = typed("pointing-doctor", str(path), "-t", "t", *WHERE)
    assert said.exit_code == 1
    assert "daylight saving time?" in said.output
    with pytest.raises(BadRequest, match="several telescopes"):
        read_looks(str(path), latitude=48.93, longitude=22.27)
