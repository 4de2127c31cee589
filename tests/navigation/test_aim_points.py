"""Points beside the frame's middle: pixels, arms, and where the middle must look; judged by rotations."""

from __future__ import annotations

import math
from datetime import UTC, datetime

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mountnav.devices import PierSide
from mountnav.errors import BadRequest, BadSettings
from mountnav.navigation.aim_points import (
    Arm,
    FrameSize,
    MountFrame,
    OffsetPoint,
    PixelPoint,
    Unreachable,
    arm_by_camera,
    arm_seen,
    axis_for,
    by_name,
    frame_size_of,
    middle_for,
    pixel_in,
)
from mountnav.navigation.camera import Normal
from mountnav.navigation.reports import CameraIdentity
from mountnav.simulation.sky_script import SkyScript
from mountnav.simulation.sky_seen import SeenThrough, SkySeen
from mountnav.simulation.truth_frame import FrameTruth
from mountnav.simulation.virtual_time import VirtualClock
from mountnav.sky.chain import icrs_to_hour_angle, observed_to_icrs
from mountnav.sky.coordinates import Air, Icrs, Observed, Site
from mountnav.sky.sphere import position_angle_deg, separation_arcsec
from mountnav.solution import Solution
from mountnav.solving.settings import SolveSettings

SITE, VACUUM = Site(48.9, 22.3, 300.0), Air(pressure_hpa=0.0)
NOW = datetime(2026, 11, 21, 22, 0, tzinfo=UTC)

angles = st.floats(0.0, 359.999)
lengths = st.floats(0.0, 12_000.0)


def solved(center: Icrs, rotation_deg: float, through: SeenThrough) -> Solution:
    """As a solver finds a frame; its center is off by its noise, which is made tiny here."""
    clock = VirtualClock(NOW)
    frame = FrameTruth(center, rotation_deg, 0.0, 1).frame(
        through.width_px, through.height_px, 5.0, NOW, "drawn"
    )
    from mountnav.frames import Hint

    verdict = SkySeen(SkyScript(), clock, through).verdict(
        frame, Hint(center=center, radius_deg=1.0), SolveSettings()
    )
    assert verdict.solution is not None
    return verdict.solution


# -- where the middle must look ----------------------------------------------------------------------------


def _vector(longitude_deg: float, latitude_deg: float) -> np.ndarray:
    lon, lat = math.radians(longitude_deg), math.radians(latitude_deg)
    return np.array([math.cos(lat) * math.cos(lon), math.cos(lat) * math.sin(lon), math.sin(lat)])


@given(longitude_deg=angles, latitude_deg=st.floats(-90.0, 90.0), length_arcsec=lengths, angle_deg=angles)
def test_the_arc_from_the_middle_leads_to_the_target(
    longitude_deg: float, latitude_deg: float, length_arcsec: float, angle_deg: float
) -> None:
    found = middle_for(longitude_deg, latitude_deg, length_arcsec, angle_deg)
    if isinstance(found, Unreachable):
        # only by the pole, and no further from it than the arm is long
        assert 90.0 - abs(latitude_deg) <= length_arcsec / 3600.0 + 1e-6
        assert 0.0 <= found.short_arcsec <= length_arcsec + 1e-3
        return
    middle = _vector(*found)
    assert abs(found[1]) <= 90.0 + 1e-9
    # by vectors, independent of spherical trigonometry: north and east at the middle
    lon, lat = map(math.radians, found)
    north = np.array([-math.sin(lat) * math.cos(lon), -math.sin(lat) * math.sin(lon), math.cos(lat)])
    east = np.array([-math.sin(lon), math.cos(lon), 0.0])
    angle, length = math.radians(angle_deg), math.radians(length_arcsec / 3600.0)
    end = math.cos(length) * middle + math.sin(length) * (math.cos(angle) * north + math.sin(angle) * east)
    assert np.linalg.norm(end - _vector(longitude_deg, latitude_deg)) < 1e-9


@given(ra_deg=angles, dec_deg=st.floats(-35.0, 85.0), length_arcsec=lengths, angle_deg=angles)
@pytest.mark.parametrize("mounting", ["german", "altaz"])
def test_the_point_of_a_tube_there_looks_at_the_target(
    mounting: str, ra_deg: float, dec_deg: float, length_arcsec: float, angle_deg: float
) -> None:
    target, arm = Icrs(ra_deg, dec_deg), Arm(length_arcsec, angle_deg)
    frame = MountFrame(mounting, NOW, SITE)  # type: ignore[arg-type]
    if mounting == "altaz" and not 10.0 < frame.longitude_latitude(target)[1] < 85.0:
        return
    axis = axis_for(target, arm, 33.0, frame)
    assert isinstance(axis, Icrs)
    # how the image stands there among the stars, and where the point is then
    there = arm.end(axis, frame.rotation_deg(axis, 33.0))
    # aberration differs along the arm, and altitudes are turned back to 0.1″
    assert separation_arcsec(there, target) < 0.2 + 2e-4 * length_arcsec


def test_a_point_can_not_be_brought_to_the_pole() -> None:
    frame = MountFrame("german", NOW, SITE)
    pole = frame.icrs(0.0, 90.0)
    found = axis_for(pole, Arm(3600.0, 90.0), 0.0, frame)
    assert isinstance(found, Unreachable)
    assert found.short_arcsec == pytest.approx(3600.0, rel=1e-3)


def test_on_the_other_side_of_the_pier_the_middle_looks_the_other_way() -> None:
    frame, target = MountFrame("german", NOW, SITE), Icrs(40.0, 30.0)
    one, other = (axis_for(target, Arm(1800.0, 50.0), angle, frame) for angle in (20.0, 200.0))
    assert isinstance(one, Icrs)
    assert isinstance(other, Icrs)
    assert separation_arcsec(one, other) == pytest.approx(3600.0, abs=1.0)


# -- arms --------------------------------------------------------------------------------------------------


@given(
    x=st.floats(0.0, 2999.0),
    y=st.floats(0.0, 1999.0),
    rotation_deg=angles,
    parity=st.sampled_from([1, -1]),
    dec_deg=st.floats(-85.0, 85.0),
    bend=st.sampled_from([0.0, 3e-9, -3e-9]),
)
def test_what_was_learned_and_what_is_seen_agree(
    x: float, y: float, rotation_deg: float, parity: int, dec_deg: float, bend: float
) -> None:
    through = SeenThrough(parity=parity, sigma_px=0.0, distortion_px2=bend)
    size = FrameSize(through.width_px, through.height_px)
    solution = solved(Icrs(120.0, dec_deg), rotation_deg, through)
    point = PixelPoint("fiber", x, y)
    seen = arm_seen(point, solution, size)
    normal = Normal(5, solution.scale_arcsec_px, 0.0, parity, distortion_px2=bend)
    learned = arm_by_camera(point, normal, size)
    assert learned is not None
    assert learned.length_arcsec == pytest.approx(seen.length_arcsec, abs=0.5)
    if seen.length_arcsec > 20.0:
        off_deg = (learned.angle_deg - seen.angle_deg + 180.0) % 360.0 - 180.0
        assert abs(off_deg) < 0.01
    # and the end of the arm is where the plate says that the pixel looks
    middle = solution.icrs_at((size.width_px - 1) / 2, (size.height_px - 1) / 2)
    assert separation_arcsec(seen.end(middle, solution.rotation_deg), solution.icrs_at(x, y)) < 1e-6


def test_up_in_the_image_is_along_its_rotation_and_right_by_its_parity() -> None:
    size = FrameSize(101, 101)
    for parity, right_deg in ((1, 270.0), (-1, 90.0)):
        normal = Normal(5, 2.0, 0.0, parity)
        up, right = (
            arm_by_camera(PixelPoint("", *pixel), normal, size) for pixel in ((50.0, 60.0), (60.0, 50.0))
        )
        assert up is not None
        assert right is not None
        assert (up.length_arcsec, up.angle_deg) == pytest.approx((20.0, 0.0), abs=1e-6)
        assert right.angle_deg == pytest.approx(right_deg)


def test_another_tube_is_found_again_however_the_camera_is_turned_since() -> None:
    point = OffsetPoint("guider", 600.0, 800.0, at_rotation_deg=30.0)
    arm = arm_by_camera(point, None, None)
    assert arm is not None
    assert arm.length_arcsec == pytest.approx(1000.0)
    middle = Icrs(80.0, 10.0)
    same = arm.end(middle, 30.0)
    assert position_angle_deg(middle, same) == pytest.approx(math.degrees(math.atan2(600.0, 800.0)), abs=1e-6)
    flipped = arm.end(middle, 210.0)
    assert separation_arcsec(same, flipped) == pytest.approx(2000.0, abs=0.1)


def test_nothing_is_known_of_a_pixel_before_the_camera_is() -> None:
    assert arm_by_camera(PixelPoint("", 5.0, 5.0), None, FrameSize(100, 100)) is None
    assert arm_by_camera(PixelPoint("", 5.0, 5.0), Normal(5, 2.0, 0.0, 1), None) is None


# -- pixels ------------------------------------------------------------------------------------------------


def test_the_edges_of_a_frame_belong_to_it() -> None:
    size = FrameSize(100, 50)
    assert pixel_in(PixelPoint("", -0.5, 49.5), size) == (-0.5, 49.5)
    for x, y in ((-0.6, 10.0), (99.6, 10.0), (10.0, 49.6), (10.0, -0.51)):
        with pytest.raises(BadRequest, match="isn't within"):
            pixel_in(PixelPoint("slit", x, y), size)


@given(x=st.floats(0.0, 2999.0), y=st.floats(0.0, 1999.0), binning=st.sampled_from([2, 3, 4]))
def test_a_binned_frame_shows_the_same_place(x: float, y: float, binning: int) -> None:
    point = PixelPoint("", x, y, 3000, 2000)
    size = FrameSize(3000 // binning, 2000 // binning)
    try:
        there = pixel_in(point, size)
    except BadRequest:
        # the pixels that are left over at the edge
        assert x > size.width_px * binning - 1 or y > size.height_px * binning - 1
        return
    # edges of pixels are the same places in both
    assert (there[0] + 0.5) * binning == pytest.approx(x + 0.5)
    assert (there[1] + 0.5) * binning == pytest.approx(y + 0.5)
    # by the binnings alone, and back
    again = PixelPoint("", there[0], there[1], size.width_px, size.height_px, binning)
    assert pixel_in(again, FrameSize(size.width_px * binning, size.height_px * binning, 1)) == pytest.approx(
        (x, y), abs=1e-9
    )


def test_a_part_of_the_chip_is_another_frame() -> None:
    with pytest.raises(BadRequest, match="another part of the chip"):
        pixel_in(PixelPoint("", 10.0, 10.0, 3000, 2000), FrameSize(1500, 500))


def test_the_frame_of_a_camera_is_read_of_its_identity() -> None:
    assert frame_size_of(str(CameraIdentity("ASI 2600 MM", 6248, 4176))) == FrameSize(6248, 4176)
    assert frame_size_of(str(CameraIdentity("x", 800, 600, "2x2"))) == FrameSize(800, 600, 2)
    assert frame_size_of("") is None
    assert frame_size_of("a camera × b") is None


@pytest.mark.parametrize("wrong", [math.nan, math.inf])
def test_what_is_no_number_is_no_point(wrong: float) -> None:
    with pytest.raises(BadSettings):
        PixelPoint("", wrong, 1.0)
    with pytest.raises(BadSettings):
        OffsetPoint("", 1.0, wrong, 0.0)


def test_a_point_far_off_is_a_mistyped_one() -> None:
    with pytest.raises(BadSettings, match="further than"):
        OffsetPoint("", 100_000.0, 0.0, 0.0)


def test_a_wrong_name_is_told_with_the_right_ones() -> None:
    points = (PixelPoint("slit", 1.0, 1.0), PixelPoint("fiber", 2.0, 2.0))
    assert by_name(points, "fiber") is points[1]
    with pytest.raises(BadRequest, match="slit, fiber"):
        by_name(points, "Fiber ")


@pytest.mark.parametrize(("az_deg", "alt_deg"), [(100.0, 40.0), (180.0, 20.0), (260.0, 30.0), (350.0, 70.0)])
def test_an_alt_azimuth_mount_s_camera_stands_alike_all_over_the_sky(az_deg: float, alt_deg: float) -> None:
    place, above = (
        observed_to_icrs(Observed(az_deg, alt, NOW), SITE, VACUUM) for alt in (alt_deg, alt_deg + 0.1)
    )
    # upright on the tube: +y looks towards the zenith; then turned by 10°, as rotations are counted
    upright_deg = position_angle_deg(place, above)
    frame = MountFrame("altaz", NOW, SITE)
    for turned_deg in (0.0, 10.0, 200.0):
        angle_deg = frame.angle_deg(place, upright_deg + turned_deg)
        assert math.cos(math.radians(angle_deg - turned_deg)) == pytest.approx(1.0, abs=1e-6)


def test_the_mount_s_frame_counts_longitudes_to_the_east() -> None:
    frame, place = MountFrame("german", NOW, SITE), Icrs(40.0, 30.0)
    east = Icrs(41.0, 30.0)
    assert frame.longitude_latitude(east)[0] > frame.longitude_latitude(place)[0]
    assert separation_arcsec(frame.icrs(*frame.longitude_latitude(place)), place) < 1e-3
    assert icrs_to_hour_angle(place, NOW, SITE, VACUUM).ha_deg == pytest.approx(
        -frame.longitude_latitude(place)[0]
    )
    assert PierSide.EAST.other is PierSide.WEST
