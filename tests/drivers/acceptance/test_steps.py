"""The kit for owners' mounts, with a fake in place of the mount: what it finds, and that a fault shows."""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path
from typing import Any, Literal

import pytest

from api.cli.bench import BenchOptions, build_of, try_mount
from drivers.acceptance.report import Capabilities, Finding, StepResult, as_lines, differences
from drivers.acceptance.steps import STEPS, _judged_pulse, run_trial
from drivers.acceptance.trial import Trial
from drivers.fakes.bench import FakeOnPty
from drivers.fakes.faults import Fault
from drivers.generic.mount import GenericMount
from drivers.lx200.fake.base import FakeLx200
from drivers.lx200.fake.dialects import make_fake
from drivers.registry import open_mount
from mountnav.errors import BadRequest
from mountnav.simulation.machine import Machine
from mountnav.simulation.mechanics import Mechanics, PointingErrors
from mountnav.sky.coordinates import Air, Site

pytestmark = pytest.mark.first  # they wait for mounts: not at the end, when nothing else is left to do

HERE = Site(49.6, 36.9)
QUICK = "poll_s=0.05&start_grace_s=0.5&rest_s=0.2&sync_wait_s=0.5"


def fake_mount(faults: list[Fault] | None = None) -> FakeLx200:
    mechanics = Mechanics(HERE, Air(), PointingErrors(), slew_rate_deg_s=20.0, acceleration_deg_s2=40.0)
    return FakeLx200(mechanics, faults=faults or [])


@asynccontextmanager
async def on_trial(fake: FakeLx200) -> AsyncIterator[Trial]:
    with FakeOnPty(fake) as bench:
        mount = open_mount(f"lx200+serial://{bench.address}?{QUICK}", site=HERE)
        assert isinstance(mount, GenericMount)
        await mount.open()
        try:
            yield Trial(mount, HERE, Air(), watch_s=1.0)
        finally:
            await mount.close()


async def yes(question: str) -> bool:
    return True


async def whole(fake: FakeLx200, *names: str) -> Capabilities:
    steps = [step for step in STEPS if not names or step.name in names]
    async with on_trial(fake) as trial:
        return await run_trial(trial, steps, yes, driver="lx200")


@pytest.mark.long
async def test_a_healthy_mount_passes_every_step() -> None:
    found = await whole(fake_mount())
    assert [step.name for step in found.steps] == [step.name for step in STEPS]
    assert all(step.done for step in found.steps), [step.why_not for step in found.steps]
    values = {key: finding.value for key, finding in found.findings().items()}
    assert found.is_fine, [finding for finding in found.findings().values() if finding.fine is False]
    assert values["move.dec"] == values["move.ra.back"] == "arrived"
    assert values["stop"] == "done"
    assert values["limit.below-horizon"] == "refused: below-horizon"
    assert values["sync"] == "accepted and seen in the read-back"
    assert json.loads(json.dumps(found.as_dict()))["identity"] == found.identity


async def test_what_is_declined_is_not_done_and_nothing_moves_without_a_yes() -> None:
    asked: list[str] = []

    async def no(question: str) -> bool:
        asked.append(question)
        return False

    fake = fake_mount()
    async with on_trial(fake) as trial:
        heard = len(fake.heard)
        found = await run_trial(trial, STEPS, no, driver="lx200")
    assert len(asked) == len(STEPS)
    assert {step.why_not for step in found.steps} == {"declined"}
    assert not [said for said in fake.heard[heard:] if not said.startswith((b":G", b":D"))]


async def test_a_position_that_does_not_count_is_asked_for_before_anything_moves() -> None:
    asked: list[str] = []

    async def only_the_step(question: str) -> bool:
        asked.append(question)
        return question.startswith("move")

    fake = fake_mount()
    with FakeOnPty(fake) as bench:
        mount = open_mount(f"lx200+serial://{bench.address}?{QUICK}&trust_on_connect=no", site=HERE)
        assert isinstance(mount, GenericMount)
        await mount.open()
        moving = [step for step in STEPS if step.name == "move"]
        found = await run_trial(Trial(mount, HERE, Air()), moving, only_the_step, driver="lx200")
        await mount.close()
    assert "position may be wrong" in asked[1]
    assert found.steps[0].why_not == "its position can't be trusted"
    assert b":MS#" not in fake.heard


@pytest.mark.long
@pytest.mark.parametrize(
    ("fault", "step", "key", "value"),
    [
        (Fault("deaf", on=b":CM", times=2), "sync", "sync", "accepted and ignored"),
        (Fault("deaf", on=b":MS", times=9), "move", "move.dec", "stalled"),
    ],
)
async def test_what_a_mount_does_wrong_is_found_and_told_apart_from_a_fake(
    fault: Fault, step: str, key: str, value: str
) -> None:
    bad, good = await whole(fake_mount([fault]), step), await whole(fake_mount(), step)
    assert bad.findings()[key].value == value
    assert not bad.is_fine
    assert good.is_fine
    assert key in [one.key for one in differences(bad, good)]
    assert any(line.startswith("  BAD") for line in as_lines(bad, good))
    assert not differences(good, good)


def test_the_command_writes_its_report_and_a_transcript(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    report, transcript = tmp_path / "report.json", tmp_path / "said.jsonl"
    with FakeOnPty(fake_mount()) as bench:
        asked = BenchOptions(
            url=f"lx200+serial://{bench.address}?{QUICK}",
            latitude=49.6,
            longitude=36.9,
            step=["read", "sync"],
            yes=True,
            report=report,
            transcript=transcript,
        )
        assert try_mount(asked) == 0
        with pytest.raises(BadRequest, match="there is no step dance"):
            try_mount(BenchOptions(url=asked.url, latitude=0.0, longitude=0.0, step=["dance"]))
    told = capsys.readouterr().out
    assert "a fake of its kind does the same" in told
    kept = json.loads(report.read_text())
    assert [step["name"] for step in kept["mount"]["steps"]] == ["read", "sync"]
    assert kept["fake"]["driver"] == "lx200"
    lines = [json.loads(line) for line in transcript.read_text().splitlines()]
    assert lines[0]["dir"] == "header"
    said = [line for line in lines if line["dir"] == "driver->mount"]
    assert any(line["bytes"].startswith(":CM") for line in said)
    assert all(bytes.fromhex(line["hex"]).decode("latin-1") == line["bytes"] for line in said)


@pytest.mark.long
async def test_a_closed_terminal_stops_what_moves(tmp_path: Path) -> None:
    mechanics = Mechanics(HERE, Air(), PointingErrors(), slew_rate_deg_s=2.0, acceleration_deg_s2=40.0)
    report = tmp_path / "report.json"
    with FakeOnPty(FakeLx200(mechanics)) as bench:
        process = await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            "api.main",
            "bench",
            f"lx200+serial://{bench.address}?{QUICK}",
            *("--latitude", "49.6", "--longitude", "36.9", "--yes", "--step", "read", "--step", "flip"),
            *("--report", str(report)),
            stdout=asyncio.subprocess.DEVNULL,
        )
        async with asyncio.timeout(60.0):
            while not mechanics.slewing():
                await asyncio.sleep(0.02)
            process.terminate()
            assert await process.wait() != 0
            while mechanics.slewing():
                await asyncio.sleep(0.02)
    assert [step["name"] for step in json.loads(report.read_text())["mount"]["steps"]] == ["read"]


@pytest.mark.parametrize(
    ("spoil", "value"),
    [
        (lambda fake: fake.faults.append(Fault("deaf", on=b":M", times=99)), "moved nothing"),
        pytest.param(
            lambda fake: swap(fake, {"n": "s", "s": "n", "e": "w", "w": "e"}),
            "reversed",
            marks=pytest.mark.long,
        ),
        pytest.param(
            lambda fake: swap(fake, {"n": "e", "s": "w", "e": "n", "w": "s"}),
            "wrong axis",
            marks=pytest.mark.long,
        ),
    ],
    ids=["deaf", "reversed", "axes"],
)
async def test_a_pulse_is_judged_by_amount_and_direction(
    spoil: Callable[[FakeLx200], None], value: str
) -> None:
    fake = fine_mount()
    spoil(fake)
    bad = await whole(fake, "guide")
    assert not bad.is_fine
    values = {key: one.value for key, one in bad.findings().items()}
    assert {values[f"guide.{way}"] for way in ("north", "south", "east", "west")} == {value}


def fine_mount() -> FakeLx200:
    """One that reads finely, so that pulses are short."""
    mechanics = Mechanics(HERE, Air(), PointingErrors(), slew_rate_deg_s=20.0, acceleration_deg_s2=40.0)
    return make_fake("onstep", mechanics)


def swap(fake: FakeLx200, ways: dict[str, str]) -> None:
    """Wire the motors wrongly."""
    mechanics: Any = fake.mechanics
    right = mechanics.pulse
    mechanics.pulse = lambda way, rate, duration: right(ways[way], rate, duration)


@pytest.mark.parametrize("told_rate", [0.00208, None])
def test_a_pulse_of_the_wrong_size(told_rate: float | None) -> None:
    judged = partial(_judged_pulse, across_arcsec=0.0, duration_s=1.0, rate_deg_s=told_rate, cos_dec=1.0)
    assert judged(7.5, step_arcsec=0.1)[0] == "done"
    assert judged(3e-6, step_arcsec=0.1)[0] == "moved nothing"
    assert judged(-7.5, step_arcsec=0.1)[0] == "reversed"
    assert judged(75.0, step_arcsec=0.1)[0] == "too far"


async def test_a_mount_that_sets_out_below_the_horizon_is_a_failure() -> None:
    mechanics = Mechanics(HERE, Air(), PointingErrors(), slew_rate_deg_s=20.0, acceleration_deg_s2=40.0)
    found = await whole(FakeLx200(mechanics, lowest_altitude_deg=-90.0), "limit")
    (finding,) = [one for key, one in found.findings().items() if key == "limit.below-horizon"]
    assert (finding.value, finding.fine) == ("set out", False)
    assert not found.is_fine
    assert found.findings()["limit.back"].value == "arrived"


async def test_a_refusal_for_another_reason_proves_no_limit() -> None:
    fake = fake_mount()
    async with on_trial(fake) as trial:
        trial.mount.trust()
        trial.mount._session.distrust("for the test")
        (step,) = [step for step in STEPS if step.name == "limit"]
        (finding,) = await step.do(trial)
    assert finding.value == "refused: untrusted"
    assert finding.fine is False


def shown(**values: str) -> Capabilities:
    """A report of a mount that showed this."""
    step = StepResult(
        "shown", findings=[Finding(key.replace("_", "-"), said) for key, said in values.items()]
    )
    return Capabilities("", "", "", "", [], [], [step])


@pytest.mark.parametrize(
    ("protocol", "said", "build"),
    [
        ("lx200", {"flip": "flips"}, "german"),
        ("lx200", {"flip": "stays", "read.pier-side": "west"}, "fork"),
        ("lx200", {"read.pier-side": "east"}, "german"),
        ("lx200", {"read.pier-side": "unknown"}, "fork"),
        ("lx200", {}, "fork"),
        ("skywatcher", {}, "german"),
        ("nexstar", {"flip": "unknown"}, "german"),
    ],
)
def test_the_fake_to_compare_with_is_built_as_the_mount_shows_itself(
    protocol: str, said: dict[str, str], build: str
) -> None:
    mount = open_mount(f"{protocol}+serial:///dev/nowhere", site=HERE)
    assert isinstance(mount, GenericMount)
    found = shown(**said)
    assert build_of(found, mount, protocol, None).mounting == build
    assert build_of(found, mount, protocol, "german").mounting == "german"
    assert build_of(found, mount, protocol, "fork").mounting == "fork"


@pytest.mark.long
@pytest.mark.parametrize("mounting", ["german", "fork"])
def test_it_is_compared_with_a_fake_of_its_build(
    mounting: Literal["german", "fork"], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    build = Machine(mounting=mounting, slew_rate_deg_s=20.0, acceleration_deg_s2=40.0)
    fake = make_fake("onstep", Mechanics(HERE, Air(), PointingErrors(), machine=build))
    report = tmp_path / "report.json"
    with FakeOnPty(fake) as bench:
        asked = BenchOptions(
            url=f"lx200+serial://{bench.address}?{QUICK}",
            latitude=49.6,
            longitude=36.9,
            step=["read", "flip"],
            yes=True,
            report=report,
        )
        assert try_mount(asked) == 0
    kept = json.loads(report.read_text())
    flips = [
        next(one["value"] for step in kept[who]["steps"] for one in step["findings"] if one["key"] == "flip")
        for who in ("mount", "fake")
    ]
    assert flips[0] == flips[1]
    assert (flips[0] == "flips") is (mounting == "german")
