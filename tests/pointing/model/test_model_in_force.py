"""A model at work on the simulator's mount: its terms come back, aims land, syncs and flips are known."""

import math
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from mountnav.devices import PierSide
from mountnav.errors import ModelRefused
from mountnav.pointing.model.fit import fit
from mountnav.pointing.model.in_force import ModelInForce, Pointing
from mountnav.pointing.model.mechanical import Conversion, mechanical
from mountnav.pointing.model.model import model_of
from mountnav.pointing.model.rigorous import direction, geometry, seen_from
from mountnav.pointing.observation import PointingObservation
from mountnav.simulation.machine import Machine
from mountnav.simulation.mechanics import Mechanics
from mountnav.simulation.pointing_errors import PointingErrors
from mountnav.simulation.sky_clock import FastClock
from mountnav.sky.chain import (
    hour_angle_to_apparent,
    hour_angle_to_icrs,
    icrs_to_apparent,
    observed_to_hour_angle,
)
from mountnav.sky.coordinates import Air, GeometricHourAngle, HourAngle, Icrs, Observed, Site
from mountnav.sky.sphere import displaced, offset_arcsec, separation_arcsec
from mountnav.units import RAD_PER_ARCSEC

SITE = Site(48.93, 22.27, 700.0)
AIR = Air(930.0, 5.0, 0.7)
START = datetime(2026, 11, 21, 20, 0, tzinfo=UTC)
TRUTH = {"ih": 300.0, "id": -200.0, "ch": 400.0, "np": 120.0, "me": 700.0, "ma": -500.0, "tf": 40.0}
NAMES = ("IH", "ID", "CH", "NP", "ME", "MA", "TF")


class Telescope:
    """The simulator's mount, without a wire; time stands still but for slews."""

    def __init__(self, mounting="german", **errors):
        self.clock = FastClock(0.0, START)
        self.mount = Mechanics(
            SITE,
            AIR,
            PointingErrors(**{f"{name}_arcsec": value for name, value in errors.items()}),
            machine=Machine(mounting=mounting, slew_rate_deg_s=20.0, acceleration_deg_s2=20.0),
            clock=self.clock,
        )
        self.rng = np.random.default_rng(1)
        self.segment = "first"

    def slew(self, place: Icrs):
        now = self.clock()
        assert self.mount.slew(icrs_to_apparent(place, now)) is None
        self.clock.on(60.0)

    def look(self, noise_arcsec=1.0) -> PointingObservation:
        now = self.clock()
        off = self.rng.normal(0.0, noise_arcsec, 2)
        return PointingObservation(
            now,
            displaced(self.mount.truth(), *off),
            max(noise_arcsec, 0.1),
            self.mount.reported(),
            side=self.mount.pier_side(),
            segment_id=self.segment,
            air=AIR,
        )

    def looks(self, count, noise_arcsec=1.0, lowest_deg=20.0):
        found = []
        for _ in range(count):
            alt = math.degrees(math.asin(self.rng.uniform(math.sin(math.radians(lowest_deg)), 0.98)))
            self.slew(self.place(float(self.rng.uniform(0, 360)), alt))
            found.append(self.look(noise_arcsec))
        return found

    def place(self, az_deg, alt_deg) -> Icrs:
        now = self.clock()
        return hour_angle_to_icrs(observed_to_hour_angle(Observed(az_deg, alt_deg, now), SITE), SITE, AIR)

    def at(self, ha_deg, dec_deg) -> Icrs:
        return hour_angle_to_icrs(HourAngle(ha_deg, dec_deg, self.clock()), SITE, AIR)

    def side_for(self, place: Icrs) -> PierSide:
        return self.mount.destination_side(icrs_to_apparent(place, self.clock()))

    def miss_arcsec(self, place: Icrs) -> float:
        return separation_arcsec(self.mount.truth(), place)


def made(telescope, count=40, terms=NAMES, noise_arcsec=1.0):
    m = mechanical(telescope.looks(count, noise_arcsec), Conversion(SITE, mounting="german"))
    found = fit(m, terms)
    return found, model_of(found, made_utc=START)


def in_force(model, **more) -> ModelInForce:
    return ModelInForce(model, site=SITE, air=AIR, mounting="german", **more)


@pytest.mark.parametrize("mounting", ["german", "fork"])
def test_the_simulators_own_terms_come_back(mounting):
    """The dummy pointing test of the SPK manual, refraction included, on both sides of the pier."""
    telescope = Telescope(mounting, **TRUTH)
    observations = telescope.looks(60)
    sides = {one.side for one in observations}
    assert sides == ({PierSide.EAST, PierSide.WEST} if mounting == "german" else {PierSide.UNKNOWN})
    found = fit(mechanical(observations, Conversion(SITE, mounting=mounting)), NAMES)
    off = (found.coefficients_arcsec - [TRUTH[name.lower()] for name in found.terms]) / found.sigma_arcsec
    assert np.max(np.abs(off)) < 3.5
    assert found.after.sky_rms_arcsec == pytest.approx(math.sqrt(2.0), rel=0.25)
    assert found.used.all()


def test_slews_land_on_their_targets():
    telescope = Telescope(**TRUTH)
    pointing: Pointing
    _, model = made(telescope)
    pointing = in_force(model)
    assert pointing.model_id == model.id
    pointing.observed(telescope.look())
    before, after = [], []
    for az, alt in ((40, 50), (130, 30), (200, 60), (290, 40), (350, 25), (90, 75)):
        target = telescope.place(az, alt)
        now = telescope.clock()
        # where it lands depends on the moment of arrival: aim for that
        side = telescope.side_for(target)
        telescope.slew(target)
        before.append(telescope.miss_arcsec(target))
        telescope.slew(pointing.aim(target, now + timedelta(seconds=60), side))
        after.append(telescope.miss_arcsec(target))
    # tracking without refraction drifts for a minute
    assert np.median(before) > 300.0
    assert max(after) < 5.0


def test_what_is_expected_is_what_is_seen():
    telescope = Telescope(**TRUTH)
    _, model = made(telescope)
    pointing = in_force(model)
    pointing.observed(telescope.look())
    ratios = []
    for look in telescope.looks(12):
        believed = look.reading
        from mountnav.sky.chain import apparent_to_icrs

        place = apparent_to_icrs(believed)
        told = pointing.expected(place, look.utc, look.side)
        seen = offset_arcsec(look.seen, place)
        assert seen.total_arcsec > 50.0
        miss = math.hypot(
            seen.east_arcsec - told.offset.east_arcsec, seen.north_arcsec - told.offset.north_arcsec
        )
        ratios.append(miss / told.sigma_arcsec)
        assert told.sigma_arcsec < 10.0
    assert max(ratios) < 4.0


def test_a_sync_makes_it_right_there_and_leaves_the_difference_elsewhere():
    telescope = Telescope(**TRUTH)
    _, model = made(telescope)
    pointing = in_force(model)
    here = telescope.place(150, 45)
    telescope.slew(here)
    telescope.clock.on(1.0)
    look = telescope.look(0.1)
    assert telescope.mount.sync(icrs_to_apparent(look.seen, look.utc)) is None
    telescope.segment = "after the sync"
    pointing.new_segment("after the sync", None)
    doubtful = pointing.expected(look.seen, look.utc, look.side)
    assert doubtful.sigma_arcsec > 1000.0
    after = telescope.look(0.1)
    pointing.new_segment("after the sync", after)
    told = pointing.expected(look.seen, look.utc, look.side)
    assert told.offset.total_arcsec < 2.0
    assert told.sigma_arcsec < 5.0
    # elsewhere: aimed by the model at once, without another look
    for az, alt in ((60, 40), (230, 60)):
        target = telescope.place(az, alt)
        side = telescope.side_for(target)
        there = pointing.aim(target, telescope.clock() + timedelta(seconds=60), side)
        telescope.slew(there)
        assert telescope.miss_arcsec(target) < 8.0
        telescope.slew(target)
        assert telescope.miss_arcsec(target) > 60.0


def test_the_pole_works():
    telescope = Telescope("fork", **(TRUTH | {"np": 20.0, "ch": 60.0}))
    found = fit(mechanical(telescope.looks(40), Conversion(SITE, mounting="fork")), NAMES)
    pointing = ModelInForce(model_of(found, made_utc=START), site=SITE, air=AIR)
    pointing.observed(telescope.look(0.1))
    for ha in range(-170, 180, 60):
        target = telescope.at(ha, 89.9)
        there = pointing.aim(target, telescope.clock() + timedelta(seconds=60), PierSide.UNKNOWN)
        telescope.slew(there)
        assert telescope.miss_arcsec(target) < 12.0
    zero = pointing.zero_points
    for _ in range(5):
        pointing.observed(telescope.look(0.1))  # say next to nothing of the hour angle
    assert pointing.zero_points.lon_arcsec == pytest.approx(zero.lon_arcsec, abs=60.0)


def test_aim_and_expected_are_inverse():
    telescope = Telescope(**TRUTH)
    _, model = made(telescope)
    pointing = in_force(model)
    pointing.observed(telescope.look())
    now = telescope.clock()
    for ha, dec in ((-60, 20), (-20, 70), (15, -5), (50, 40), (5, 85), (100, 75)):
        target = telescope.at(ha, dec)
        for side in (PierSide.EAST, PierSide.WEST):
            sent = pointing.aim(target, now, side)
            told = pointing.expected(sent, now, side)
            lands = displaced(sent, told.offset.east_arcsec, told.offset.north_arcsec)
            assert separation_arcsec(lands, target) < 1e-3


def test_one_wrong_look_changes_nothing_two_that_agree_do():
    telescope = Telescope(**TRUTH)
    _, model = made(telescope)
    pointing = in_force(model)
    for look in telescope.looks(4):
        pointing.observed(look)
    known = pointing.zero_points
    good = telescope.look()
    pointing.observed(replace(good, seen=displaced(good.seen, 900.0, -600.0)))
    assert pointing.zero_points.lon_arcsec == pytest.approx(known.lon_arcsec, abs=1e-9)
    pointing.observed(good)
    assert pointing.zero_points.lat_arcsec == pytest.approx(known.lat_arcsec, abs=3.0)
    # a clutch slips: the second look that says so is believed
    for look in telescope.looks(2):
        pointing.observed(replace(look, seen=displaced(look.seen, 0.0, 600.0)))
    assert abs(pointing.zero_points.lat_arcsec - known.lat_arcsec) > 500.0


def test_zero_points_get_better_with_looks_and_worse_with_time():
    telescope = Telescope(**TRUTH)
    _, model = made(telescope, noise_arcsec=5.0)
    pointing = in_force(model)
    sigma = []
    for look in telescope.looks(9, 5.0):
        pointing.observed(look)
        sigma.append(pointing.zero_points.sigma_lat_arcsec)
    assert sigma[-1] < 0.6 * sigma[0]
    target = telescope.at(20.0, 30.0)
    soon = pointing.expected(target, telescope.clock(), PierSide.EAST).sigma_arcsec
    late = pointing.expected(telescope.at(20.0, 30.0), telescope.clock() + timedelta(hours=6), PierSide.EAST)
    assert late.sigma_arcsec > soon + 2.0


@pytest.mark.long
def test_what_it_was_not_made_for_is_refused():
    telescope = Telescope(**TRUTH)
    _, model = made(telescope, 20)
    with pytest.raises(ModelRefused, match=r"latitude 48\.930°, the site is at -30\.000°"):
        ModelInForce(model, site=Site(-30.0, 22.27), air=AIR)
    with pytest.raises(ModelRefused, match="refraction"):
        ModelInForce(model, site=SITE, air=AIR, does_refraction=True)
    pointing = in_force(model)
    # the mount's own pole lies 860″ off the true one; the leaning tube can't look nearer to it than 520″
    pole = seen_from(
        geometry("equatorial", math.radians(48.93), {"ME": TRUTH["me"], "MA": TRUTH["ma"]}),
        np.zeros(1),
        np.array([np.pi / 2]),
    )[0]
    for ha in range(-180, 180, 6):
        for dec in np.arange(89.5, 90.0, 0.04):
            place = direction(np.radians([float(ha)]), np.radians([float(dec)]))[0]
            off_arcsec = np.linalg.norm(place - pole) / RAD_PER_ARCSEC
            if abs(off_arcsec - 520.0) > 100.0:
                assert refuses(pointing, telescope.at(ha, float(dec))) == (off_arcsec < 520.0)


def refuses(pointing, target):
    try:
        pointing.aim(target, START, PierSide.EAST)
    except ModelRefused:
        return True
    return False


def test_a_mount_that_allows_for_refraction():
    """Its readings are of the unrefracted sky, its axes at the refracted place."""
    now = START
    looks = []
    rng = np.random.default_rng(3)
    for _ in range(20):
        ha, dec = float(rng.uniform(-70, 70)), float(rng.uniform(-10, 80))
        truth = hour_angle_to_icrs(HourAngle(ha, dec, now), SITE, AIR)
        plain = hour_angle_to_apparent(GeometricHourAngle(ha, dec, now), SITE)
        for reading, does in ((icrs_to_apparent(truth, now), True), (plain, False)):
            looks.append((does, PointingObservation(now, truth, 0.1, reading, air=AIR)))
    for does in (True, False):
        mine = [one for told, one in looks if told is does]
        right = fit(mechanical(mine, Conversion(SITE, does_refraction=does)), ())
        wrong = fit(mechanical(mine, Conversion(SITE, does_refraction=not does)), ())
        assert right.after.sky_rms_arcsec is not None
        assert wrong.after.sky_rms_arcsec is not None
        assert right.after.sky_rms_arcsec < 0.7  # polar motion and diurnal aberration
        assert wrong.after.sky_rms_arcsec > 15.0
