"""The steps that let a mount move on: what a healthy fake does, and every fault by its name."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

import pytest

from drivers.acceptance.moving import judged_axis, judged_rate, speed_to_try
from drivers.acceptance.report import Capabilities
from drivers.acceptance.steps import STEPS, run_trial
from drivers.acceptance.trial import Trial
from drivers.generic.mount import GenericMount
from mountnav.devices import RateSpan, Skill
from mountnav.simulation.rate_faults import RateFault
from mountnav.sky.coordinates import Air
from tests.drivers.alpaca.alpaca_server import FakeTelescope, quick_mechanics
from tests.drivers.alpaca.test_language import rigged as alpaca
from tests.drivers.generic.plain_language import PlainLanguage
from tests.drivers.generic.plain_rig import HERE, plain, rigged

pytestmark = pytest.mark.first  # they wait for mounts: not at the end, when nothing else is left to do


@asynccontextmanager
async def on_trial(
    change: Callable[[PlainLanguage], object] = lambda _: None,
) -> AsyncIterator[tuple[Trial, PlainLanguage]]:
    language = plain(slew_rate_deg_s=5.0)
    async with rigged(language) as rig:
        change(language)
        # south of the zenith, well up
        trial = Trial(rig.mount, HERE, Air(), lowest_altitude_deg=10.0, watch_s=1.5)
        await rig.mount.slew(trial.at_hour_angle(10.0, 30.0))
        yield trial, language


async def tried(trial: Trial, *names: str) -> Capabilities:
    async def yes(_: str) -> bool:
        return True

    return await run_trial(trial, [step for step in STEPS if step.name in names], yes, driver="plain")


@pytest.mark.long
async def test_a_healthy_mount_passes() -> None:
    async with on_trial() as (trial, language):
        found = await tried(trial, "rates", "move-axis")
        assert all(step.done for step in found.steps), [step.why_not for step in found.steps]
        assert found.is_fine, [one for one in found.findings().values() if one.fine is False]
        values = {key: finding.value for key, finding in found.findings().items()}
        assert values["rates.ra"] == values["rates.dec"] == values["rates.both"] == "done"
        assert values["rates.ra.east"] == pytest.approx(10.0, abs=0.7)
        assert values["rates.both.north"] == pytest.approx(-10.0, abs=0.7)
        assert values["rates.end.seen"] == "as for a star"
        for axis in ("primary", "secondary"):
            for way in ("up", "down"):
                assert values[f"axis.{axis}.{way}"] == "done"
                assert values[f"axis.{axis}.{way}.rests"] == "rests"
        assert language.mechanics.beside_arcsec_s == (0.0, 0.0)


@pytest.mark.long
@pytest.mark.parametrize(
    ("fault", "key", "outcome", "words"),
    [
        (RateFault(ra_factor=-1.0), "rates.ra", "reversed", "the other way"),
        (RateFault(dec_factor=-1.0), "rates.both", "reversed", "the other way"),
        (RateFault(ra_factor=15.041), "rates.ra", "wrong amount", "seconds of right ascension"),
        (RateFault(ra_factor=225.0), "rates.ra", "wrong amount", "15 twice"),
        (RateFault(dec_factor=0.0), "rates.dec", "ignored", "at the sidereal rate"),
        (RateFault(swapped=True), "rates.ra", "other axis", "the other axis"),
    ],
)
async def test_a_fault_of_rates_has_its_name(fault: RateFault, key: str, outcome: str, words: str) -> None:
    async with on_trial(lambda language: language.mechanics.fail_rates(fault)) as (trial, _):
        found = await tried(trial, "rates")
        finding = found.findings()[key]
        assert finding.value == outcome
        assert words in finding.words
        assert finding.fine is False


async def test_what_a_mount_lacks_is_no_fault() -> None:
    async with on_trial() as (trial, language):
        language.skills = language.skills - {Skill.OFFSET_RATES, Skill.MOVE_AXIS}
        found = await tried(trial, "rates", "move-axis")
        assert found.is_fine
        assert {one.value for one in found.findings().values()} == {"refused: unsupported"}


async def test_it_is_not_led_below_what_is_allowed() -> None:
    async with on_trial() as (trial, language):
        low = Trial(trial.mount, HERE, Air(), lowest_altitude_deg=80.0, watch_s=1.0)
        orders = len(language.orders)
        found = await tried(low, "rates", "move-axis")
        assert found.findings()["rates.ra"].value == "not tried"
        assert found.findings()["axis.primary.up"].value == "not tried"
        assert not [one for one in language.orders[orders:] if one.startswith(("axis", "rates 1", "rates -"))]


@pytest.mark.long
async def test_an_axis_that_does_not_end_is_a_failure() -> None:
    async with on_trial() as (trial, language):
        language.axis_keeps_on = True
        language.stops_needed = 0
        found = await tried(trial, "move-axis")
        # the driver ends it by a stop, as soon as it is seen to go on
        assert found.findings()["axis.primary.up.rests"].value == "rests"
        assert not trial.mount.axes_moved
        assert any(one.startswith("stop") for one in language.orders)


@pytest.mark.long
async def test_one_whose_direction_is_open_is_found_out() -> None:
    telescope = FakeTelescope(quick_mechanics())
    telescope.axis_senses = [-1.0, 1.0]
    async with alpaca(telescope) as rig:
        mount = rig.mount
        assert isinstance(mount, GenericMount)
        found = await tried(Trial(mount, HERE, Air(), lowest_altitude_deg=10.0, watch_s=1.0), "move-axis")
        values = {key: finding.value for key, finding in found.findings().items()}
        assert values["axis.primary.up"] == "reversed"
        assert values["axis.primary.down"] == "done"
        assert values["axis.secondary.up"] == "done"
        assert found.is_fine


@pytest.mark.parametrize(
    ("measured", "other", "outcome"),
    [
        (10.0, 0.0, "done"),
        (10.2, 0.1, "done"),
        (-10.1, 0.0, "reversed"),
        (0.1, 0.0, "ignored"),
        (0.0, 10.0, "other axis"),
        (10.0, 5.0, "other axis too"),
        (150.4, 0.0, "wrong amount"),
        (15.04, 0.0, "wrong amount"),
    ],
)
def test_rates_are_judged(measured: float, other: float, outcome: str) -> None:
    assert judged_rate(10.0, measured, other, 0.3)[0] == outcome
    if outcome in ("done", "reversed", "ignored"):
        assert judged_rate(-10.0, -measured, -other, 0.3)[0] == outcome


def test_a_factor_is_named() -> None:
    assert "15.04" in judged_rate(10.0, 151.0, 0.0, 0.3)[1]
    assert "stopped following" in judged_rate(10.0, 15.04, 0.0, 0.3)[1]
    assert "per minute" in judged_rate(10.0, 600.0, 0.0, 0.3)[1]


def test_what_readings_cannot_show_is_not_judged() -> None:
    assert judged_rate(0.5, 0.0, 0.0, 0.3)[0] == "can't be told"


@pytest.mark.parametrize(
    ("along", "across", "outcome"),
    [(1080.0, 0.0, "done"), (-1080.0, 0.0, "reversed"), (0.0, 0.0, "moved nothing"),
     (1080.0, 600.0, "other axis too"), (4000.0, 0.0, "wrong amount"), (0.0, 1080.0, "other axis too")],
)  # fmt: skip
def test_axes_are_judged(along: float, across: float, outcome: str) -> None:
    assert judged_axis(1080.0, along, across, 2.0)[0] == outcome


def test_the_speed_to_try() -> None:
    assert speed_to_try((RateSpan(0.0, 4.0),)) == 0.3
    assert speed_to_try((RateSpan(0.004, 0.004), RateSpan(0.5, 0.5), RateSpan(6.0, 6.0))) == 0.5
    assert speed_to_try((RateSpan(2.0, 3.0),)) is None
    assert speed_to_try(()) is None
    assert speed_to_try((RateSpan(0.0, 0.1),)) == 0.1
