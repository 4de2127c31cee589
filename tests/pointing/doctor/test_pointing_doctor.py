"""The doctor against simulated patients, ill in known ways or healthy: names, numbers, and silence."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace
from datetime import timedelta
from typing import Any

import numpy as np
import pytest

from benchmarks.pointing_doctor import START, Patient, errors_of, make, night, patient, target
from mountnav.devices import PierSide
from mountnav.errors import BadRequest
from mountnav.pointing.doctor import ORDINARY, Illness, diagnose, known
from mountnav.pointing.doctor.evidence import Fit, looks_at, zeros_of
from mountnav.pointing.doctor.facts import facts_of
from mountnav.simulation.geometry import true_direction
from mountnav.simulation.pointing_errors import PointingErrors
from mountnav.sky.chain import hour_angle_to_icrs
from mountnav.sky.coordinates import Air, HourAngle, Icrs, Site
from mountnav.sky.sphere import displaced

SITE = Site(48.93, 22.27, 700.0)


def rng(seed: int) -> np.random.Generator:
    return np.random.default_rng([2211, seed])


def ask(one: Patient, **more):
    return diagnose(
        one.looks,
        site=one.site,
        believed_epoch="icrs" if one.believes_icrs else "apparent",
        mounting="german",
        synced_on=one.syncs,
        # but for the tests of the longitude's sign itself
        **({"sign_confirmed": True} | more),
    )


def sound(seed: int, errors: PointingErrors | None = None, **more) -> Patient:
    """A mount whose terms are known."""
    generator = rng(seed)
    errors = errors or PointingErrors(ch_arcsec=300.0, me_arcsec=400.0, ma_arcsec=-250.0)
    return Patient(generator, SITE, Air(950.0), errors, **more)


MODEL = known(ch_arcsec=300.0, np_arcsec=0.0, me_arcsec=400.0, ma_arcsec=-250.0, sigma_arcsec=15.0)


@pytest.mark.parametrize("latitude", [52.0, -33.0])
def test_mechanics_agree_with_the_simulators(latitude: float) -> None:
    errors = PointingErrors(
        ch_arcsec=900.0, np_arcsec=-300.0, me_arcsec=2500.0, ma_arcsec=-1800.0, tf_arcsec=200.0
    )
    lon, lat = np.radians([-70.0, 20.0, 100.0, 250.0]), np.radians([10.0, -20.0, 75.0, 110.0])
    terms = np.radians(np.array([900.0, -300.0, 2500.0, -1800.0, 200.0, 0.0]) / 3600.0)
    tube, _ = looks_at(lon, lat, terms, np.radians(latitude))
    for number in range(4):
        ha, dec = np.radians(
            true_direction(np.degrees(lon[number]), np.degrees(lat[number]), errors, latitude)
        )
        wanted = [np.cos(dec) * np.cos(ha), np.cos(dec) * np.sin(ha), np.sin(dec)]
        assert np.allclose(tube[number], wanted, atol=1e-11)


def test_image_angles_follow_the_tube_on_both_sides_and_near_the_pole() -> None:
    one = sound(3, noise_arcsec=0.0, camera_noise_deg=0.0, camera_deg=77.0)
    one.segment = 1
    for ha, dec, side in (
        (30.0, 20.0, PierSide.EAST),
        (-40.0, 60.0, PierSide.WEST),
        (50.0, 86.0, PierSide.EAST),
    ):
        assert one.look(START, ha, dec, side) is not None
    facts = facts_of(tuple(one.looks), SITE)
    fitted = Fit(facts, MODEL, facts.west).fitted(facts.read_lon, facts.read_lat, zeros_of(facts))
    assert np.degrees(np.abs(fitted.misses)).max() * 3600.0 < 5.0
    # the camera's own angle comes out, the same for all three
    assert np.degrees(fitted.best[6]) % 360.0 == pytest.approx(77.0, abs=0.01)


def test_daylight_saving_time_is_told_in_seconds() -> None:
    one = sound(5, ahead_s=3600.0, noise_arcsec=1.0)
    night(one)
    (finding,) = ask(one, geometry=MODEL, zero_sigma_deg=0.1).findings
    assert finding.what is Illness.CLOCK
    clock = finding.numbers["clock"]
    assert clock.value == pytest.approx(
        3600.0, abs=4.0 * clock.sigma + 3.0
    )  # refraction's share of the zero point
    assert clock.sigma < 3.0
    assert "ahead: daylight saving time?" in finding.words
    assert Illness.LONGITUDE in finding.alternatives
    assert finding.numbers["longitude"].value == pytest.approx(22.27 + 15.04, abs=0.05)


def test_longitude_sign_is_told_with_the_clock_it_might_be() -> None:
    one = sound(6, ahead_s=-2.0 * 22.27 * 240.0 / 1.00273790935)
    night(one)
    (finding,) = ask(one).findings
    assert finding.what is Illness.LONGITUDE_SIGN
    assert Illness.CLOCK in finding.alternatives
    assert finding.numbers["longitude"].value == pytest.approx(-22.27, abs=0.7)
    assert "behind" in finding.words


@pytest.mark.parametrize("believes_icrs", [False, True])
@pytest.mark.parametrize("synced", [False, True])
def test_epoch_mix_up_is_told_with_its_scale(believes_icrs: bool, synced: bool) -> None:
    one = sound(8, believes_icrs=believes_icrs, speaks_icrs=not believes_icrs)
    night(one, synced=synced)
    (finding,) = ask(one, geometry=MODEL, noise_arcsec=60.0).findings
    assert finding.what is Illness.EPOCH
    scale = finding.numbers["scale"]
    assert scale.value == pytest.approx(1.0, abs=max(4.0 * scale.sigma, 0.35))
    assert 10.0 < finding.numbers["difference"].value < 24.0
    assert f"believed is {'J2000' if believes_icrs else 'JNow'}" in finding.words


def test_epoch_mix_up_and_polar_error_can_not_be_told_apart_at_once_but_later() -> None:
    """For the moment an epoch mix-up is a turn about an axis in the equator, as a polar axis 9′ off is."""
    one = sound(9, believes_icrs=True)
    night(one, minutes=(0.1, 0.2), looks=4)
    for look in one.looks:
        assert look.rotation_deg is not None
    blind = [replace(look, rotation_deg=None) for look in one.looks]
    said = diagnose(blind, site=SITE, believed_epoch="icrs", mounting="german")
    assert not said.findings
    mixed = sound(9, believes_icrs=True, speaks_icrs=False)
    night(mixed, minutes=(25.0, 60.0), looks=14)
    (finding,) = ask(mixed).findings
    assert finding.what is Illness.EPOCH


def test_a_slip_is_told_with_axis_size_and_time() -> None:
    one = sound(10, noise_arcsec=20.0)

    def slips(who: Patient) -> None:
        who.shift_deg = (who.shift_deg[0], who.shift_deg[1] + 2.5)

    night(one, looks=6, event=slips, at=3)
    (finding,) = ask(one).findings
    assert finding.what is Illness.SLIPPED
    assert "before look 4 of 6" in finding.words
    assert "declination axis" in finding.words
    assert abs(finding.numbers["slip"].value) == pytest.approx(
        150.0, abs=5.0 * finding.numbers["slip"].sigma + 1.0
    )
    assert finding.look_ids == ("l3", "l4")


def test_a_clock_put_on_in_the_night_is_no_slip() -> None:
    one = sound(11)

    def put(who: Patient) -> None:
        who.ahead_s += 3600.0

    night(one, looks=5, event=put, at=2)
    finding = ask(one).findings[0]
    assert finding.what is Illness.CLOCK
    assert Illness.SLIPPED in finding.alternatives


def test_a_sync_is_no_slip() -> None:
    one = sound(12)

    def shifts(who: Patient) -> None:
        who.shift_deg = (who.shift_deg[0] + 3.0, who.shift_deg[1])
        who.segment += 1

    night(one, looks=8, event=shifts, at=4)
    assert not ask(one).findings
    # the same jump within one segment is one
    lied = [replace(look, segment_id="s") for look in one.looks]
    said = diagnose(lied, site=SITE, believed_epoch="apparent", mounting="german")
    assert [each.what for each in said.findings] == [Illness.SLIPPED]


def test_a_false_solution_is_no_illness_of_the_mount() -> None:
    one = sound(13)
    night(one, looks=6)
    looks = list(one.looks)
    looks[2] = replace(looks[2], seen=displaced(looks[2].seen, 9000.0, -7000.0), rotation_deg=None)
    said = diagnose(looks, site=SITE, believed_epoch="apparent", mounting="german")
    assert [each.what for each in said.findings] == [Illness.WRONG_LOOK]
    assert said.findings[0].look_ids == ("l3",)


def test_other_hemisphere() -> None:
    one = sound(14, sense=-1.0)
    night(one)
    said = ask(one)
    assert [each.what for each in said.findings] == [Illness.HEMISPHERE]
    assert "+48.93" in said.findings[0].advice


@pytest.mark.parametrize(("sides", "words"), [("flip", "reported no other side"), ("stay", "did not turn")])
def test_misreported_sides(sides: str, words: str) -> None:
    one = sound(15)
    night(one, sides=sides)
    (finding,) = ask(one).findings
    assert finding.what is Illness.PIER_SIDE
    assert words in finding.words
    assert abs(finding.numbers["turn"].value) == pytest.approx(180.0, abs=3.0)
    # a rotator may do the same, and is no illness
    assert sides == "stay" or not ask(one, rotator=True).findings


def test_a_turned_camera_is_told_and_no_illness() -> None:
    one = sound(16)
    night(one, looks=4)
    assert all(each.rotation_deg is not None for each in one.looks)
    looks = [
        *one.looks[:2],
        *(replace(each, rotation_deg=(each.rotation_deg or 0.0) + 40.0) for each in one.looks[2:]),
    ]
    said = diagnose(looks, site=SITE, believed_epoch="apparent", mounting="german", sign_confirmed=True)
    assert [each.what for each in said.findings] == [Illness.CAMERA_TURNED]
    assert said.healthy is True


def test_mirrored_images() -> None:
    one = sound(17, parity=-1)
    night(one)
    assert [each.what for each in ask(one, expected_parity=1).findings] == [Illness.MIRRORED]
    assert ask(one, expected_parity=-1).healthy is True
    assert ask(one).healthy is True  # nothing else was expected
    single = [*one.looks[:3], replace(one.looks[3], parity=1)]
    said = diagnose(single, site=SITE, believed_epoch="apparent", expected_parity=-1)
    assert not said.findings
    assert [each.what for each in said.suspicions] == [Illness.MIRRORED]
    between = [one.looks[0], replace(one.looks[1], parity=1), *one.looks[2:]]
    said = diagnose(between, site=SITE, believed_epoch="apparent", expected_parity=-1)
    assert [each.what for each in said.findings] == [Illness.WRONG_LOOK]


def test_too_few_looks_are_said_to_be_few() -> None:
    one = sound(18)
    night(one, looks=2)
    said = ask(one)
    assert said.healthy is None
    assert not said.enough
    assert "4 are needed" in said.words
    nothing = diagnose([], site=SITE, believed_epoch="apparent")
    assert (nothing.healthy, nothing.observations) == (None, 0)


def test_readings_of_the_other_kind_do_not_count() -> None:
    one = sound(19)
    night(one)
    odd = replace(one.looks[0], reading=Icrs(1.0, 2.0))
    said = diagnose(
        [odd, *one.looks], site=SITE, believed_epoch="apparent", mounting="german", sign_confirmed=True
    )
    assert said.observations == 4
    assert said.healthy is True


def test_bad_parity_is_refused() -> None:
    with pytest.raises(BadRequest):
        diagnose([], site=SITE, believed_epoch="apparent", expected_parity=2)


def test_all_is_plain_json() -> None:
    one = sound(20, ahead_s=7200.0, parity=-1)
    night(one)
    record = json.loads(json.dumps(ask(one, expected_parity=1).as_dict(), allow_nan=False))
    assert {each["what"] for each in record["findings"]} == {"clock wrong", "mirrored image"}
    assert record["healthy"] is False


@pytest.mark.long
@pytest.mark.parametrize("kind", ["aligned", "scope", "eye"])
def test_healthy_nights_are_healthy(kind: str) -> None:
    """Polar axes up to 1° and cones up to 30′ off, nothing known of them, syncs in between: no alarm."""
    generator = np.random.default_rng([1, len(kind)])
    for number in range(12):
        one = make("healthy", generator, bool(number % 2), kind)
        said = one.judged()
        assert not said.findings, (number, said.words)


@pytest.mark.long
def test_any_illness_is_found_from_four_solves() -> None:
    """A small part of benchmarks/pointing_doctor.py, with what a model knows of the mount."""
    generator = np.random.default_rng(77)
    for illness in ("epoch", "DST", "longitude", "mirrored", "side:unreported", "side:invented", "slip"):
        for synced in (False, True):
            one = make(illness, generator, synced)
            said = one.with_model()
            names = {each.what for each in said.findings} | {
                other for each in said.findings for other in each.alternatives
            }
            assert set(one.wanted) & names, (illness, synced, said.words)


def test_long_polar_errors_stay_ordinary_over_a_night() -> None:
    generator = rng(30)
    one = patient(generator, "eye")
    one.errors = replace(errors_of(generator, "eye"), me_arcsec=3400.0, ma_arcsec=900.0, ch_arcsec=1700.0)
    night(one, looks=30, minutes=(5.0, 20.0), random_syncs=0.1)
    said = ask(one, geometry=ORDINARY)
    assert not said.findings, said.words


@pytest.mark.long
@pytest.mark.parametrize("kind", ["no image angles", "no sides told", "syncs kept on the sky", "a fork"])
def test_mounts_that_tell_less_are_healthy_too(kind: str) -> None:
    generator = rng(40)
    for number in range(9):
        one = patient(generator, ("aligned", "scope", "eye")[number % 3])
        if kind == "a fork":
            one.errors = replace(one.errors, ih_arcsec=0.0)
            for minutes in range(0, 100, 20):
                while (
                    one.look(START + timedelta(minutes=minutes), *target(generator, one.site), PierSide.EAST)
                    is None
                ):
                    pass
        else:
            night(one, looks=5, synced=bool(number % 2), random_syncs=0.15)
        looks = list(one.looks)
        if kind == "no image angles":
            looks = [replace(look, rotation_deg=None) for look in looks]
        if kind == "no sides told":
            looks = [replace(look, side=PierSide.UNKNOWN) for look in looks]
        if kind == "syncs kept on the sky":  # the home's error doesn't change its sign at a flip
            looks = [
                replace(look, reading=replace(look.reading, dec_deg=look.reading.dec_deg + 0.4))
                for look in looks
            ]
        said = diagnose(looks, site=one.site, believed_epoch="icrs" if one.believes_icrs else "apparent")
        assert not said.findings, (number, said.words)


# -- our own place and clock ---------------------------------------------------------------------------


def at(site: Site, one: Patient, *, confirmed: bool = False):
    """What a service says that believes to stand at `site`."""
    return diagnose(
        one.looks,
        site=site,
        believed_epoch="icrs" if one.believes_icrs else "apparent",
        mounting="german",
        synced_on=one.syncs,
        sign_confirmed=confirmed,
    )


@pytest.mark.long
def test_a_wrong_sign_of_our_longitude_is_never_healthy_nor_a_misreported_side() -> None:
    named = 0
    for seed in range(60):
        one = patient(rng(9000 + seed), "any")
        night(one, synced=bool(seed % 2))
        said = at(Site(one.site.latitude_deg, -one.site.longitude_deg, 200.0), one)
        assert said.healthy is not True, said.words
        assert Illness.PIER_SIDE not in [each.what for each in said.findings], said.words
        named += [each.what for each in said.findings] == [Illness.LONGITUDE_SIGN]
    # the others stand well both ways, and are told so
    assert named >= 24, named


def test_looks_below_the_ground_are_told_with_their_altitude() -> None:
    one = sound(31)
    one.site = Site(48.93, -105.0, 700.0)
    night(one, looks=6)
    said = at(replace(one.site, longitude_deg=105.0), one)
    (found,) = said.findings
    assert found.what is Illness.LONGITUDE_SIGN
    assert "below the ground" in found.words
    assert "-105.000° (east) all would stand above it" in found.words
    assert found.numbers["lowest_altitude_deg"].value < -2.0
    assert said.healthy is False


@pytest.mark.long
def test_where_both_signs_would_do_nobody_is_called_healthy_unless_the_mount_says_the_same() -> None:
    told: Counter[Any] = Counter()
    for seed in range(12):
        one = sound(400 + seed)
        night(one)
        said, sure = at(one.site, one), at(one.site, one, confirmed=True)
        assert not said.findings, said.words
        assert sure.healthy is True, sure.words
        told[said.healthy] += 1
        assert (said.healthy is True) or "its right sign?" in said.words
    assert told[True]
    assert told[None]


def test_one_false_solution_below_the_ground_is_no_wrong_longitude() -> None:
    one = sound(41)
    night(one, looks=6)
    utc = one.looks[2].utc
    nadir = hour_angle_to_icrs(HourAngle(179.0, -60.0, utc), one.site, one.air)
    one.looks[2] = replace(one.looks[2], seen=nadir)
    said = at(one.site, one)
    assert Illness.LONGITUDE_SIGN not in [each.what for each in said.findings], said.words
