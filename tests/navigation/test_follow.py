"""Following judged by the mechanics' truth: near its target, faults named, no rates afterwards."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import timedelta

import pytest

from mountnav.devices import OffsetRates
from mountnav.ephemeris import SkyRatesTarget
from mountnav.errors import BadRequest, Cancelled, DeviceRefused, OutsideLimits
from mountnav.journal.records import EntryKind
from mountnav.navigation.follow import Following
from mountnav.navigation.follow_plan import FollowBy
from mountnav.navigation.follow_report import FollowEnd, FollowProgress, FollowReport
from mountnav.navigation.rates_kept import RATES_KEPT
from mountnav.navigation.rates_seen import RateFault as Named
from mountnav.navigation.reports import Look
from mountnav.simulation.machine import Machine
from mountnav.simulation.rate_faults import RateFault
from mountnav.sky.sphere import separation_arcsec
from tests.navigation.rated_mount import RatedMount
from tests.navigation.virtual_rig import ERRORS, POLICY, SITE, VirtualRig, in_virtual_time

TOLERANCE = 5.0


class WithoutRates(RatedMount):
    """Takes no rates."""

    takes = False


class Slow(RatedMount):
    """Takes small rates alone."""

    most = OffsetRates(0.5, 0.5)


@dataclass
class Followed:
    """What came of it, and what was true meanwhile."""

    report: FollowReport
    truly: list[float]
    """From the end of the first minute of following on, each second: how far off the tube looked."""
    progress: list[FollowProgress]
    left: tuple[float, float]
    """Rates that the mount has afterwards."""
    rig: VirtualRig


def mover(
    rig: VirtualRig, ra: float, dec: float, *, hours: float = 2.0, ha_deg: float = -30.0
) -> SkyRatesTarget:
    begins = rig.clock.utc()
    return SkyRatesTarget(rig.up(ha_deg, 30.0), ra, dec, begins, begins + timedelta(hours=hours), "a mover")


def followed(
    ra: float,
    dec: float,
    *,
    minutes: float = 12.0,
    fault: RateFault | None = None,
    made: type[RatedMount] = RatedMount,
    settled_s: float = 60.0,
    tolerance_arcsec: float = TOLERANCE,
    prepare: Callable[[VirtualRig], None] = lambda rig: None,
    ha_deg: float = -30.0,
    look_every_s: float | None = None,
    **given: object,
) -> Followed:
    async def work(rig: VirtualRig) -> Followed:
        if fault is not None:
            rig.mechanics.fail_rates(fault)
        prepare(rig)
        target = mover(rig, ra, dec, ha_deg=ha_deg)
        progress: list[FollowProgress] = []
        truly: list[tuple[float, float]] = []

        async def watch() -> None:
            while True:
                await rig.clock.sleep(1.0)
                now = rig.clock.utc()
                if any(one.phase == "following" for one in progress):
                    off = separation_arcsec(rig.mechanics.truth(now), target.icrs(now, SITE))
                    truly.append((rig.clock.monotonic_s(), off))

        watching = asyncio.create_task(watch())
        try:
            report = await rig.navigator.follow(
                target,
                until_utc=rig.clock.utc() + timedelta(minutes=minutes),
                tolerance_arcsec=tolerance_arcsec,
                look_every_s=look_every_s,
                heard=progress.append,
            )
        finally:
            watching.cancel()
        begin = truly[0][0] + settled_s
        late = [off for at, off in truly if at >= begin]
        return Followed(report, late, progress, rig.mechanics.beside_arcsec_s, rig)

    return in_virtual_time(work, made=made, **given)  # type: ignore[arg-type]


@pytest.mark.long
@pytest.mark.parametrize(("ra", "dec"), [(0.05, -0.02), (1.0, 0.5), (-3.0, 2.0), (12.0, -9.0)])
def test_a_moving_target_is_followed_within_the_tolerance(ra: float, dec: float) -> None:
    done = followed(ra, dec)
    assert done.report.end is FollowEnd.TIME
    assert done.report.by is FollowBy.RATES
    assert max(done.truly) <= TOLERANCE + 1.0
    assert done.report.fault is None
    assert done.report.correction == ""
    assert done.left == (0.0, 0.0)
    assert done.rig.navigator.mount.offset_rates_in_force is None
    last = done.progress[-1]
    assert last.phase == "following"
    assert last.judgement is not None
    assert last.left_s < 120.0


FAULTS = {
    Named.SIGN_RA: RateFault(ra_factor=-1.0),
    Named.SIGN_DEC: RateFault(dec_factor=-1.0),
    Named.SIGNS: RateFault(ra_factor=-1.0, dec_factor=-1.0),
    Named.FACTOR_15: RateFault(ra_factor=15.041),
    Named.FACTOR_1_15: RateFault(ra_factor=1.0 / 15.041),
    Named.FACTOR_220: RateFault(ra_factor=220.0),
    Named.SWAPPED: RateFault(swapped=True),
}


@pytest.mark.long
@pytest.mark.parametrize("named", FAULTS)
def test_a_fault_of_the_rates_is_named_made_good_and_confirmed(named: Named) -> None:
    done = followed(2.0, 1.2, fault=FAULTS[named], settled_s=300.0)
    assert done.report.fault is named
    rates = done.rig.navigator.rates
    assert rates.correction is not None
    assert rates.correction.fault is named
    assert rates.confirmed
    assert max(done.truly) <= TOLERANCE + 1.0
    assert done.left == (0.0, 0.0)
    kept = [one.facts[RATES_KEPT] for one in done.rig.entries(EntryKind.LEARNED) if RATES_KEPT in one.facts]
    assert kept[-1]["confirmed"] is True
    assert kept[-1]["correction"]["fault"] == str(named)


@pytest.mark.long
@pytest.mark.parametrize(
    ("named", "fault"),
    [
        (Named.IGNORED, RateFault(ra_factor=0.0, dec_factor=0.0)),
        (Named.ONLY_DEC, RateFault(ra_factor=0.0)),
        (Named.ONLY_RA, RateFault(dec_factor=0.0)),
        (Named.UNEXPLAINED, RateFault(ra_factor=3.3, dec_factor=2.0)),
    ],
)
def test_what_no_order_makes_good_is_followed_by_other_means(named: Named, fault: RateFault) -> None:
    done = followed(2.0, 1.2, fault=fault, settled_s=420.0, minutes=15.0)
    assert done.report.fault is named
    assert done.rig.navigator.rates.correction is None
    assert done.report.by is not FollowBy.RATES
    # small slews leave what they leave, and that is told
    assert sorted(done.truly)[len(done.truly) // 2] <= TOLERANCE
    assert done.left == (0.0, 0.0)


@pytest.mark.long
def test_a_guess_since_which_nothing_is_seen_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    # tried is whether 15 times as much comes out right: where it does not, it may lead away at 30″/s, and no
    # frame shows stars any more
    looked = Following._looked

    async def blind(self: Following, exposure_s: float) -> Look | None:
        if self._on_trial:
            self._miss("no stars")
            return None
        return await looked(self, exposure_s)

    monkeypatch.setattr(Following, "_looked", blind)
    ignored = RateFault(ra_factor=0.0, dec_factor=0.0)
    done = followed(2.0, 1.2, fault=ignored, settled_s=420.0, minutes=15.0)
    assert any("a look showed nothing while it was tried whether" in note for note in done.report.notes)
    assert done.rig.navigator.rates.correction is None
    assert done.report.by is not FollowBy.RATES
    assert sorted(done.truly)[len(done.truly) // 2] <= TOLERANCE
    assert done.left == (0.0, 0.0)


@pytest.mark.long
@pytest.mark.long
def test_a_mount_that_runs_away_later_is_seen_by_its_readings() -> None:
    later: list[asyncio.Task[None]] = []

    def prepare(rig: VirtualRig) -> None:
        async def strike() -> None:
            # well after its rates were seen to be kept, between two looks
            await rig.clock.sleep(430.0)
            rig.mechanics.fail_rates(RateFault(220.0, 220.0))

        later.append(asyncio.create_task(strike()))

    done = followed(2.0, 1.2, prepare=prepare, minutes=10.0)
    assert done.report.fault is Named.FACTOR_220
    # 510″ in each second, for 10 s and a reading
    assert max(done.truly) < 7000.0
    assert done.truly[-1] < 60.0
    assert done.left == (0.0, 0.0)


@pytest.mark.long
@pytest.mark.parametrize("fault", [None, RateFault(lost_by_flip=True), RateFault(unturned=True)])
def test_a_mount_that_changes_sides_by_itself_is_followed_on_and_blamed_for_no_rate(
    fault: RateFault | None,
) -> None:
    flips = Machine(mounting="german", meridian_limits_deg=(10.0, 1.0), at_limit="flip")
    done = followed(2.0, 1.2, fault=fault, machine=flips, minutes=15.0, settled_s=660.0, ha_deg=-0.5)
    assert any("slewed by itself" in words for words in done.report.notes)
    assert not any("unexplained" in words for words in done.report.notes)
    assert done.report.by is FollowBy.RATES
    assert max(done.truly) <= 3.0 * TOLERANCE
    assert done.left == (0.0, 0.0)


class Late(RatedMount):
    """Behind a server that passes orders on late: what is off is never made good quite."""

    calls = 0

    async def set_offset_rates(self, rates: OffsetRates) -> None:
        """By 1 s to 2 s."""
        self.calls += 1
        await asyncio.sleep(1.0 + self.calls % 2)
        await super().set_offset_rates(rates)


@pytest.mark.long
@pytest.mark.parametrize("named", [Named.SIGN_DEC, Named.FACTOR_1_15])
def test_looks_that_follow_each_other_closely_name_a_fault_as_well(named: Named) -> None:
    # one each 4 s: sooner than what the one before has shown is made good
    short = replace(POLICY, exposure_s=1.0)
    done = followed(
        3.0, 1.7, fault=FAULTS[named], minutes=7.0, look_every_s=4.0, settled_s=240.0, policy=short, made=Late
    )
    assert done.report.fault is named
    assert max(done.truly) <= 4.0 * TOLERANCE
    assert done.left == (0.0, 0.0)


class Quarters(RatedMount):
    """Is told rates in quarters of an arcsecond a second, and asked for them it says so."""

    @property
    def rates_known(self) -> OffsetRates | None:
        """As it was told them."""
        known = super().rates_known
        if known is None:
            return None
        return OffsetRates(round(known.ra_arcsec_s * 4.0) / 4.0, round(known.dec_arcsec_s * 4.0) / 4.0)

    async def set_offset_rates(self, rates: OffsetRates) -> None:
        """Round them."""
        await super().set_offset_rates(
            OffsetRates(round(rates.ra_arcsec_s * 4.0) / 4.0, round(rates.dec_arcsec_s * 4.0) / 4.0)
        )


def test_a_fault_that_coarse_steps_can_t_make_good_is_named_and_followed_otherwise() -> None:
    both = RateFault(15.041, 15.041)
    done = followed(-3.4, 1.87, fault=both, made=Quarters, settled_s=120.0)
    assert done.report.fault is Named.FACTOR_15
    assert done.report.by is not FollowBy.RATES
    assert any("too coarse" in words for words in done.report.notes)
    assert max(done.truly) < 60.0
    assert done.left == (0.0, 0.0)


def test_rates_that_the_mount_denies_to_have_are_given_up_at_once() -> None:
    # the driver reads them back: no look is needed for that
    done = followed(2.0, 1.2, fault=RateFault(ra_factor=0.0, dec_factor=0.0, reads_zero=True))
    assert done.report.by is not FollowBy.RATES
    assert any("refused the rates" in note for note in done.report.notes)
    assert done.rig.navigator.rates.correction is None
    assert done.left == (0.0, 0.0)


@pytest.mark.long
def test_a_correction_from_before_is_used_from_the_beginning() -> None:
    first = followed(2.0, 1.2, fault=RateFault(dec_factor=-1.0), settled_s=300.0)
    kept = first.rig.navigator.rates.as_dict()

    def recall(rig: VirtualRig) -> None:
        rig.navigator.rates.restore(kept)

    again = followed(2.0, 1.2, fault=RateFault(dec_factor=-1.0), prepare=recall)
    assert max(again.truly) <= TOLERANCE + 1.0
    assert again.report.fault is None
    assert "other sign" in again.report.correction


@pytest.mark.long
def test_a_correction_that_looks_contradict_is_withdrawn() -> None:
    first = followed(2.0, 1.2, fault=RateFault(dec_factor=-1.0), settled_s=300.0)
    kept = first.rig.navigator.rates.as_dict()

    def recall(rig: VirtualRig) -> None:
        # its firmware was mended meanwhile
        rig.navigator.rates.restore(kept)

    again = followed(2.0, 1.2, prepare=recall, settled_s=300.0)
    assert again.rig.navigator.rates.correction is None
    assert any("withdrawn" in note for note in again.report.notes)
    assert max(again.truly) <= TOLERANCE + 1.0


@pytest.mark.long
def test_an_operator_can_have_a_correction_forgotten() -> None:
    first = followed(2.0, 1.2, fault=RateFault(dec_factor=-1.0), settled_s=300.0)
    kept = first.rig.navigator.rates.as_dict()

    async def work(rig: VirtualRig) -> dict[str, object]:
        rig.navigator.rates.restore(kept)
        assert rig.navigator.rates.correction is not None
        await rig.navigator.forget_rates()
        return dict(rig.entries(EntryKind.LEARNED)[-1].facts[RATES_KEPT])

    written = in_virtual_time(work, made=RatedMount)
    assert written["correction"] is None


@pytest.mark.long
def test_a_mount_without_rates_follows_by_small_slews_and_says_what_is_left() -> None:
    done = followed(0.3, 0.1, made=WithoutRates)
    assert done.report.by in (FollowBy.SLEWS, FollowBy.PULSES)
    assert "leaves up to" in done.report.plan.words
    assert sorted(done.truly)[len(done.truly) // 2] <= TOLERANCE


@pytest.mark.parametrize(("made", "ra"), [(WithoutRates, 40.0), (Slow, 40.0), (RatedMount, -9_000.0)])
def test_what_is_too_fast_is_refused_with_the_numbers_before_anything_moves(
    made: type[RatedMount], ra: float
) -> None:
    async def work(rig: VirtualRig) -> tuple[str, list[str]]:
        with pytest.raises(DeviceRefused) as refused:
            await rig.navigator.follow(
                mover(rig, ra, 0.0, hours=0.2), until_utc=rig.clock.utc() + timedelta(seconds=20)
            )
        return refused.value.what, rig.mount.received

    what, received = in_virtual_time(work, made=made)
    assert "too fast" in what
    assert "″/s" in what
    assert not set(received) & {"slew", "rates"}


@pytest.mark.long
def test_a_target_outside_the_limits_is_refused_and_one_that_leaves_them_is_followed_to_there() -> None:
    async def work(rig: VirtualRig) -> tuple[FollowReport, float]:
        with pytest.raises(OutsideLimits):
            await rig.navigator.follow(
                mover(rig, 0.1, 0.0, ha_deg=180.0), until_utc=rig.clock.utc() + timedelta(minutes=5)
            )
        assert "slew" not in rig.mount.received
        begins = rig.clock.utc()
        # sets, by itself and by the sky's turn
        target = SkyRatesTarget(
            rig.up(55.0, 10.0), -3.0, -8.0, begins, begins + timedelta(hours=2), "a setting one"
        )
        report = await rig.navigator.follow(
            target, until_utc=begins + timedelta(hours=1), tolerance_arcsec=20.0
        )
        return report, rig.mechanics.true_observed(report.ended_utc).alt_deg

    report, alt_deg = in_virtual_time(work, made=RatedMount, policy=replace(POLICY, min_altitude_deg=15.0))
    assert report.end is FollowEnd.LIMIT
    assert 15.0 <= alt_deg < 16.5
    assert report.events


@pytest.mark.long
@pytest.mark.parametrize("how", ["stop", "cancel"])
def test_a_stop_and_a_cancel_end_the_rates(how: str) -> None:
    async def work(rig: VirtualRig) -> tuple[tuple[float, float], list[OffsetRates]]:
        mount = rig.mount
        assert isinstance(mount, RatedMount)
        heard: list[FollowProgress] = []
        job = asyncio.create_task(
            rig.navigator.follow(
                mover(rig, 2.0, 1.0), until_utc=rig.clock.utc() + timedelta(minutes=30), heard=heard.append
            )
        )
        while not any(one.phase == "following" and one.sent is not None for one in heard):
            await rig.clock.sleep(1.0)
        assert rig.mechanics.beside_arcsec_s != (0.0, 0.0)
        if how == "stop":
            await rig.navigator.stop()
            with pytest.raises(Cancelled):
                await job
        else:
            job.cancel()
            with pytest.raises(asyncio.CancelledError):
                await job
        sent = len(mount.ordered)
        await rig.clock.sleep(300.0)
        assert len(mount.ordered) == sent, "rates were sent after the end"
        assert rig.navigator.mount.offset_rates_in_force is None
        assert rig.navigator.activity == "idle"
        return rig.mechanics.beside_arcsec_s, mount.ordered

    left, ordered = in_virtual_time(work, made=RatedMount)
    assert left == (0.0, 0.0)
    assert ordered[-1].none


@pytest.mark.long
def test_following_ends_with_its_ephemeris() -> None:
    async def work(rig: VirtualRig) -> FollowReport:
        return await rig.navigator.follow(
            mover(rig, 1.0, 1.0, hours=0.2), until_utc=rig.clock.utc() + timedelta(hours=1)
        )

    report = in_virtual_time(work, made=RatedMount)
    assert report.end is FollowEnd.EPHEMERIS
    assert any("ephemeris ends" in note for note in report.notes)


@pytest.mark.parametrize("minutes", [-1.0, 1500.0])
def test_an_end_that_can_not_be_is_refused(minutes: float) -> None:
    async def work(rig: VirtualRig) -> list[str]:
        with pytest.raises(BadRequest):
            await rig.navigator.follow(
                mover(rig, 1.0, 1.0), until_utc=rig.clock.utc() + timedelta(minutes=minutes)
            )
        return rig.mount.received

    assert "slew" not in in_virtual_time(work, made=RatedMount)


@pytest.mark.long
def test_a_drifting_mount_without_faults_is_never_corrected_for_one() -> None:
    # a polar axis 15′ off and a worm of 10″: all that drifts, at a comet's rates
    from tests.navigation.virtual_rig import ERRORS

    errors = replace(
        ERRORS, me_arcsec=900.0, ma_arcsec=-700.0, periodic_amplitude_arcsec=10.0, periodic_period_s=480.0
    )
    done = followed(0.06, -0.05, errors=errors, minutes=30.0)
    assert done.report.fault is None
    assert done.rig.navigator.rates.correction is None
    # once a minute it is looked at; a worm gives up to 8″ in between
    assert sorted(done.truly)[int(0.9 * len(done.truly))] <= TOLERANCE + 5.0


@pytest.mark.long
def test_a_german_mount_follows_on_either_side() -> None:
    done = followed(2.0, 1.2, machine=Machine(mounting="german"))
    assert max(done.truly) <= TOLERANCE + 1.0
    assert done.left == (0.0, 0.0)


@pytest.mark.long
def test_a_declination_that_is_in_its_play_is_no_fault_of_the_rates() -> None:
    # it stands still for a minute, and then goes as ordered
    done = followed(2.0, -1.0, errors=replace(ERRORS, backlash_arcsec=60.0), tolerance_arcsec=30.0)
    assert done.report.by is FollowBy.RATES
    assert done.report.fault is None
    assert done.report.correction == ""
    assert done.rig.navigator.rates.correction is None
    assert max(done.truly) <= 65.0
    assert done.truly[-1] <= 30.0
    assert done.left == (0.0, 0.0)


@pytest.mark.long
def test_a_fast_pass_is_waited_for_ahead_and_followed_by_rates_renewed_often() -> None:
    async def work(rig: VirtualRig) -> tuple[FollowReport, list[float]]:
        begins = rig.clock.utc()
        target = SkyRatesTarget(
            rig.up(-40.0, 10.0), 300.0, 200.0, begins, begins + timedelta(minutes=6), "a pass"
        )
        heard: list[FollowProgress] = []
        offs: list[float] = []

        async def watch() -> None:
            while True:
                await rig.clock.sleep(0.5)
                if any(one.phase == "following" for one in heard):
                    now = rig.clock.utc()
                    offs.append(separation_arcsec(rig.mechanics.truth(now), target.icrs(now, SITE)))

        watching = asyncio.create_task(watch())
        try:
            report = await rig.navigator.follow(
                target, until_utc=begins + timedelta(minutes=5), tolerance_arcsec=10.0, heard=heard.append
            )
        finally:
            watching.cancel()
        assert any(one.phase == "waiting" for one in heard)
        return report, offs

    report, offs = in_virtual_time(work, made=RatedMount)
    assert report.plan.fast
    assert report.centered is None
    # pointing errors of some arcminutes are known by one look ahead, and change on the way
    assert sorted(offs[60:])[len(offs[60:]) // 2] <= 120.0
    assert report.renewed > 10
