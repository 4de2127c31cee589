"""Hints from headers as programs write them: units, equinoxes, binning, doubts and disagreements."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
from astropy.coordinates import FK5, SkyCoord
from astropy.time import Time
from astropy.wcs import WCS
from hypothesis import given
from hypothesis import strategies as st

from mountnav.frames import Hint
from mountnav.reading import read_frame
from mountnav.reading.header_hints import hint_from_header
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec
from mountnav.solving.contradictions import contradictions_of_hints

Header = dict[str, str | int | float | bool]


@pytest.mark.parametrize(
    ("cards", "ra_deg", "dec_deg"),
    [
        ({"RA": 83.82, "DEC": -5.39}, 83.82, -5.39),
        ({"RA": "05:35:17.0", "DEC": "-05:23:28"}, 83.8208, -5.3911),
        ({"OBJCTRA": "05 35 17", "OBJCTDEC": "-05 23 28"}, 83.8208, -5.3911),
        ({"OBJCTRA": " 5 35 17.04", "OBJCTDEC": "-5 23 28.0"}, 83.821, -5.3911),
        ({"RA": "5h35m17s", "DEC": "-5d23m28s"}, 83.8208, -5.3911),
        ({"RA": "05:35.28", "DEC": "-05:23.47"}, 83.82, -5.3912),
        ({"RA": "05:35:17", "DEC": "-05*23'28"}, 83.8208, -5.3911),
        ({"RA": "83d49m15s", "DEC": "-5d23m28s"}, 83.8208, -5.3911),
        ({"RA": "83:49:15", "DEC": "-5:23:28"}, 83.8208, -5.3911),
        ({"RA": "83.82", "DEC": "-5.39"}, 83.82, -5.39),
        ({"RA": -276.18, "DEC": -5.39}, 83.82, -5.39),
        ({"OBJCTRA": "00 00 30", "OBJCTDEC": "-00 30 00"}, 0.125, -0.5),
        ({"OBJCTRA": "00 00 30", "OBJCTDEC": "-0 0 30"}, 0.125, -0.00833),
        ({"RA": 654.476, "DEC": 30.0, "OBJCTRA": "21 38 00", "OBJCTDEC": "+30 30 00"}, 324.5, 30.5),
        ({"RA-MNT": 301.56, "DEC-MNT": 44.46}, 301.56, 44.46),
        ({"TELRA": "08:14:54.240", "TELDEC": "-04:28:05.902"}, 123.726, -4.4683),
        ({"OBJCTRA": "00 00 00", "OBJCTDEC": "+00 00 00", "RA": 84.07, "DEC": -5.38}, 84.07, -5.38),
    ],
)
def test_places_in_every_usual_form(cards: Header, ra_deg: float, dec_deg: float) -> None:
    center = hint_from_header(cards, 100, 100).center
    assert center is not None
    assert center.ra_deg == pytest.approx(ra_deg, abs=1e-3)
    assert center.dec_deg == pytest.approx(dec_deg, abs=1e-3)


@pytest.mark.parametrize(
    "cards",
    [
        {},
        {"RA": 0.0, "DEC": 0.0},
        {"OBJCTRA": "00 00 00", "OBJCTDEC": "+00 00 00"},
        {"RA": 10.0},
        {"RA": 10.0, "DEC": 95.0},
        {"RA": 10.0, "DEC": "-91:00:00"},
        {"RA": float("nan"), "DEC": 3.0},
        {"RA": "25:00", "DEC": "high"},
        {"RA": "05:61:00", "DEC": "10:00:00"},
        {"RA": "05:35:60", "DEC": "10:00:00"},
        {"RA": "05:35.5:10", "DEC": "10:00:00"},
        {"RA": True, "DEC": True},
        {"RA": 10**400, "DEC": 5},
        {
            "CTYPE1": "RA---TAN",
            "CTYPE2": "DEC--TAN",
            "CRVAL1": 10.0,
            "CRVAL2": 5.0,
            "CDELT1": 1.0,
            "CDELT2": 1.0,
        },
        {
            "CTYPE1": "GLON-TAN",
            "CTYPE2": "GLAT-TAN",
            "CRVAL1": 10.0,
            "CRVAL2": 5.0,
            "CDELT1": 1e-3,
            "CDELT2": 1e-3,
        },
    ],
)
def test_absurd_places_are_passed_over(cards: Header) -> None:
    assert hint_from_header(cards, 100, 100).center is None


@pytest.mark.parametrize(
    ("cards", "comments", "main_deg", "other_deg"),
    [
        ({"RA": 5.588, "DEC": -5.39}, {}, 5.588, 83.82),
        ({"RA": 5.588, "DEC": -5.39}, {"RA": "[h] Observe object RA coordinate (J2000)"}, 83.82, None),
        ({"RA": 5.588, "DEC": -5.39}, {"RA": "Right Ascension [ hours ]"}, 83.82, None),
        ({"RA": 5.588, "DEC": -5.39}, {"RA": "[deg] RA of telescope"}, 5.588, None),
        ({"RA": 5.588, "DEC": -5.39}, {"RA": "Object J2000 RA in Degrees"}, 5.588, None),
        ({"RA": 83.82, "DEC": -5.39}, {}, 83.82, None),
        ({"RA": "05:35:17", "DEC": "-05:23:28"}, {"RA": "degrees"}, 83.82, 5.588),
        ({"RA": "05:35:17", "DEC": "-05:23:28"}, {"RA": "Object RA in Hours"}, 83.82, None),
        # the sexagesimal pair settles it
        ({"RA": 5.588, "DEC": -5.39, "TELRA": "05:35:17", "TELDEC": "-05:23:28"}, {}, 83.82, None),
        ({"RA": 5.588, "DEC": -5.39, "TELRA": "00:22:21", "TELDEC": "-05:23:28"}, {}, 5.588, None),
        # and goes first when it is the better known card
        ({"RA": 5.588, "DEC": -5.39, "OBJCTRA": "05 35 17", "OBJCTDEC": "-05 23 28"}, {}, 83.82, None),
    ],
)
def test_hours_and_degrees(
    cards: Header, comments: dict[str, str], main_deg: float, other_deg: float | None
) -> None:
    hint = hint_from_header(cards, 100, 100, comments)
    assert hint.center is not None
    assert hint.center.ra_deg == pytest.approx(main_deg, abs=2e-3)
    others = [one.center.ra_deg for one in hint.alternatives if one.center is not None]
    assert others == ([] if other_deg is None else [pytest.approx(other_deg, abs=1e-3)])
    assert not contradictions_of_hints(hint)


@pytest.mark.parametrize(
    ("cards", "comments", "equinox"),
    [
        ({"EQUINOX": 2026.8}, {}, 2026.8),
        ({"EPOCH": "1950.0"}, {}, 1950.0),
        ({"EQUINOX": "J2000"}, {}, None),
        ({"EQUINOX": 9.87654321e107}, {}, None),  # Siril writes it
        ({"EQUINOX": 2026.8}, {"RA": "Epoch : JNOW"}, 2026.8),
        ({"DATE-OBS": "2026-10-19T00:00:00"}, {"RA": "Epoch : JNOW"}, 2026.8),
        ({"EQUINOX": 2026.8}, {"RA": "[hms J2000] Target right ascension"}, None),
        ({"RADESYS": "ICRS", "EQUINOX": 2026.8}, {}, None),
        ({}, {}, None),
    ],
)
def test_places_of_another_equinox_are_precessed_as_astropy_does(
    cards: Header, comments: dict[str, str], equinox: float | None
) -> None:
    hint = hint_from_header({"RA": "12:29:23", "DEC": "12:53:33"} | cards, 100, 100, comments)
    frame = FK5(equinox=Time(equinox or 2000.0, format="jyear"))
    truth = SkyCoord("12h29m23s", "12d53m33s", frame=frame).icrs
    assert hint.center is not None
    assert separation_arcsec(hint.center, Icrs(truth.ra.deg, truth.dec.deg)) < 20.0


@pytest.mark.long
@given(
    ra=st.floats(0.1, 359.9),
    dec=st.floats(-85, 85),
    crpix=st.tuples(st.floats(-500, 1500), st.floats(-500, 1500)),
    turn=st.floats(0, 360),
    mirrored=st.booleans(),
    form=st.sampled_from(["cd", "pc", "crota", "exchanged"]),
)
def test_a_wcs_is_evaluated_at_the_center_as_astropy_does(
    ra: float, dec: float, crpix: tuple[float, float], turn: float, mirrored: bool, form: str
) -> None:
    step, angle = 7e-4, math.radians(turn)
    steps = (step if mirrored else -step), step
    cos, sin = math.cos(angle), math.sin(angle)
    names = ("RA---TAN", "DEC--TAN") if form != "exchanged" else ("DEC--TAN", "RA---TAN")
    cards: Header = {"CTYPE1": names[0], "CTYPE2": names[1], "CRPIX1": crpix[0], "CRPIX2": crpix[1]}
    cards |= {"CRVAL1": ra, "CRVAL2": dec} if form != "exchanged" else {"CRVAL1": dec, "CRVAL2": ra}
    if form == "crota":
        cards |= {"CDELT1": steps[0], "CDELT2": steps[1], "CROTA2": turn}
    else:
        matrix = ((cos, -sin), (sin, cos))
        for i in (1, 2):
            for j in (1, 2):
                if form == "pc":
                    cards[f"PC{i}_{j}"] = matrix[i - 1][j - 1]
                else:
                    cards[f"CD{i}_{j}"] = steps[i - 1] * matrix[i - 1][j - 1]
        if form == "pc":
            cards |= {"CDELT1": steps[0], "CDELT2": steps[1]}
    from astropy.io import fits

    truth = WCS(fits.Header(cards)).pixel_to_world(399.5, 299.5).icrs
    hint = hint_from_header(cards, 800, 600)
    assert hint.center is not None
    assert separation_arcsec(hint.center, Icrs(truth.ra.deg, truth.dec.deg)) < 1e-3
    assert hint.center_source == hint.scale_source == "WCS in the header"
    assert hint.scale_low_arcsec_px is not None
    assert hint.scale_high_arcsec_px is not None
    assert hint.scale_low_arcsec_px < 3600.0 * step < hint.scale_high_arcsec_px


SCALES: list[tuple[Header, dict[str, str], float, list[float]]] = [
    ({"FOCALLEN": 1000.0, "XPIXSZ": 9.0}, {}, 1.856, []),
    ({"FOCALLEN": 1000.0, "XPIXSZ": 9.0, "XBINNING": 2}, {}, 1.856, [3.713]),
    ({"FOCALLEN": 1000.0, "XPIXSZ": 9.0, "XBINNING": 2}, {"XPIXSZ": "Pixel Width in microns (after binning)"},
     1.856, []),
    ({"FOCALLEN": 1000.0, "XPIXSZ": 9.0, "XBINNING": 2}, {"XPIXSZ": "microns, includes binning if any"},
     1.856, []),
    ({"FOCALLEN": 1000.0, "XPIXSZ": 9.0, "XBINNING": 2, "PIXSIZE1": 4.5}, {}, 1.856, []),
    ({"FOCALLEN": 1000.0, "XPIXSZ": 4.5, "XBINNING": 2, "PIXSIZE1": 4.5}, {}, 1.856, [0.928]),
    ({"FOCALLEN": 1000.0, "PIXSIZE1": 4.5, "XBINNING": 2}, {}, 1.856, [0.928]),
    ({"FOCALLEN": 1000.0, "XPIXSZ": 9.0, "BINNING": "2x2", "SCALE": 3.713}, {}, 1.856, [3.713]),
    ({"FOCALLEN": 1.0, "XPIXSZ": 9.0}, {"FOCALLEN": "[m] focal length"}, 1.856, []),
    ({"FOCALLEN": 100.0, "XPIXSZ": 9.0}, {"FOCALLEN": "Focal length (cm)"}, 1.856, []),
    ({"FOCALLEN": "1000 mm", "XPIXSZ": "9.0 um"}, {}, 1.856, []),
    ({"FOCALLEN": 0.5, "XPIXSZ": 9.0}, {}, 3.713, []),
    ({"FOCALLEN": 2.032, "XPIXSZ": 9.0}, {}, 0.9136, []),  # as millimeters 913″/px: no optics
    ({"FOCALLEN": 8.0, "XPIXSZ": 9.0}, {}, 232.05, [0.23205]),  # a lens, or meters
    ({"FOCALLEN": 1000.0, "CCDXPIXE": 0.0000135, "CCDXBIN": 2}, {"CCDXPIXE": "[m] Size of pixels"},
     5.569, [2.785]),
    ({"PIXSCALE": 2.5}, {}, 2.5, []),
    ({"PIXSCALE": -2.5}, {}, 2.5, []),
    ({"SECPIX": "0.7"}, {}, 0.7, []),
    ({"PIXSCALE": "0.7 arcsec/pixel"}, {}, 0.7, []),
    ({"PIXSCALE": 0.0006944}, {}, 2.49984, []),
    ({"PIXSCALE": 0.0006944}, {"PIXSCALE": "[deg/pixel]"}, 2.49984, []),
    ({"PIXSCALE": 180}, {"PIXSCALE": "mas"}, 0.18, []),
    ({"IM_SCALE": 5.21}, {"IM_SCALE": "Image scale in arc-secs/pixel"}, 5.21, []),
    ({"CCDSCALE": 0.279, "CCDXBIN": 2}, {"CCDSCALE": "[arcsec/binned pixel] Scale"}, 0.279, []),
    ({"CTYPE1": "RA---TAN", "CTYPE2": "DEC--TAN", "CDELT1": -5e-4, "CDELT2": 5e-4, "CROTA2": 30.0}, {},
    1.8, []),
]  # fmt: skip


@pytest.mark.parametrize(("cards", "comments", "main", "others"), SCALES)
def test_scales_with_a_tenth_of_room(
    cards: Header, comments: dict[str, str], main: float, others: list[float]
) -> None:
    hint = hint_from_header(cards, 100, 100, comments)
    assert hint.scale_low_arcsec_px == pytest.approx(0.9 * main, rel=1e-3)
    assert hint.scale_high_arcsec_px == pytest.approx(1.1 * main, rel=1e-3)
    if "SCALE" in cards and "FOCALLEN" in cards:
        return  # two cards: see the disagreement's test
    assert [one.scale_high_arcsec_px for one in hint.alternatives] == [
        pytest.approx(1.1 * other, rel=1e-3) for other in others
    ]


@pytest.mark.parametrize(
    "cards",
    [
        {"FOCALLEN": 0.0, "XPIXSZ": 9.0},
        {"FOCALLEN": 1000.0, "XPIXSZ": 0.0},
        {"FOCALLEN": -1000.0, "XPIXSZ": 9.0},
        {"PIXSCALE": 0},
        {"SCALE": 1e9},
        {"PIXSCALE": "?"},
        {"PLTSCALE": 67.2, "XPIXELSZ": 15.0},  # arcseconds per millimeter
    ],
)
def test_absurd_scales_are_passed_over(cards: Header) -> None:
    assert hint_from_header(cards, 100, 100).scale_low_arcsec_px is None


def test_a_settled_doubt_is_none() -> None:
    cards: Header = {"FOCALLEN": 1000.0, "XPIXSZ": 9.0, "XBINNING": 2}
    wcs: Header = {
        "CTYPE1": "RA---TAN",
        "CTYPE2": "DEC--TAN",
        "CRVAL1": 10,
        "CRVAL2": 5,
        "CRPIX1": 50,
        "CRPIX2": 50,
    }
    agreeing = hint_from_header(cards | wcs | {"CDELT1": -1.8 / 3600, "CDELT2": 1.8 / 3600}, 100, 100)
    assert agreeing.alternatives == ()
    binned = hint_from_header(cards | wcs | {"CDELT1": -3.7 / 3600, "CDELT2": 3.7 / 3600}, 100, 100)
    assert binned.alternatives == ()
    assert binned.scale_source == "WCS in the header"


def test_cards_that_disagree_are_reported_and_the_other_reading_is_kept() -> None:
    cards: Header = {
        "CTYPE1": "RA---TAN", "CTYPE2": "DEC--TAN", "CRVAL1": 100.0, "CRVAL2": 20.0, "CRPIX1": 50,
        "CRPIX2": 50,
        "CDELT1": -5e-4, "CDELT2": 5e-4, "FOCALLEN": 400.0, "XPIXSZ": 9.0, "OBJCTRA": "05 35 17",
        "OBJCTDEC": "-05 23 28",
    }  # fmt: skip
    hint = hint_from_header(cards, 100, 100)
    assert hint.center is not None
    assert hint.center.ra_deg == pytest.approx(100.0, abs=1e-2)
    assert len(hint.alternatives) == 3
    assert {one.center_source for one in hint.alternatives} == {"WCS in the header", "OBJCTRA and OBJCTDEC"}
    told = sorted(str(one) for one in contradictions_of_hints(hint))
    assert len(told) == 2
    assert told[0].startswith("center: OBJCTRA and OBJCTDEC says RA 83.821° Dec -5.391°")
    assert told[1].startswith("scale: FOCALLEN and XPIXSZ says 4.641 ″/px (4.177 to 5.105)")
    assert "by WCS in the header" in told[1]


KEYS = [
    "RA", "DEC", "OBJCTRA", "OBJCTDEC", "TELRA", "TELDEC", "CRVAL1", "CRVAL2", "CTYPE1", "CTYPE2",
    "CRPIX1", "CRPIX2",
    "CD1_1", "CD1_2", "CD2_1", "CD2_2", "CDELT1", "CDELT2", "CROTA2", "PC1_1", "FOCALLEN", "XPIXSZ",
    "PIXSIZE1", "XBINNING",
    "BINNING", "PIXSCALE", "SCALE", "EQUINOX", "EPOCH", "RADESYS", "CUNIT1", "DATE-OBS", "MJD-OBS",
]  # fmt: skip
TEXTS = st.one_of(
    st.text(alphabet="0123456789:-+.TZ RADEChdm*'[]", max_size=20),
    st.sampled_from(
        ["RA---TAN", "DEC--TAN", "05 35 17.3", "-00 30 00", "1000mm", "JNOW", "deg", "[h]", "FK5", "J2000"]
    ),
)
ANY = st.one_of(TEXTS, st.floats(), st.integers(), st.booleans(), st.floats(-400, 400), st.floats(1e-5, 1e-2))


@given(st.dictionaries(st.sampled_from(KEYS), ANY), st.dictionaries(st.sampled_from(KEYS), TEXTS))
def test_no_header_raises_or_gives_a_hint_out_of_range(cards: Header, comments: dict[str, str]) -> None:
    hint = hint_from_header(cards, 640, 480, comments)
    assert len(hint.alternatives) <= 4
    for one in (hint, *hint.alternatives):
        if one.center is not None:
            assert 0.0 <= one.center.ra_deg < 360.0
            assert -90.0 <= one.center.dec_deg <= 90.0
        assert 0.0 < one.radius_deg <= 5.0
        low, high = one.scale_low_arcsec_px, one.scale_high_arcsec_px
        assert (low is None) == (high is None)
        if low is not None and high is not None:
            assert 0.005 < low < high < 700.0
        assert one is hint or one.alternatives == ()
    for told in contradictions_of_hints(hint):
        assert told.source
        assert "None" not in str(told)


@pytest.mark.long
def test_every_hint_of_the_real_frames_is_right_or_absent(shared: Path) -> None:
    folder = shared / "data" / "frames"
    with_center = with_scale = 0
    for one in json.loads((folder / "manifest.json").read_text())["frames"]:
        hint = read_frame(folder / one["file"], raw=True).hint
        # in none of these files do two cards contradict each other
        assert contradictions_of_hints(hint) == (), one["file"]
        place = scale = "–"
        if hint.center is not None and one.get("ra_deg") is not None:
            off_deg = separation_arcsec(hint.center, Icrs(one["ra_deg"], one["dec_deg"])) / 3600.0
            assert off_deg < hint.radius_deg, one["file"]
            place = f"{hint.center_source}: {off_deg:.3f}° off, radius {hint.radius_deg:g}°"
            with_center += 1
        low, high, true = hint.scale_low_arcsec_px, hint.scale_high_arcsec_px, one.get("scale_arcsec")
        if low is not None and high is not None:
            assert true is None or low < true < high, one["file"]
            scale = f"{hint.scale_source}: {low:.3f} to {high:.3f}, truth {true or 'unknown'}"
            with_scale += true is not None
        print(f"| {one['file']} | {one['truth_grade']} | {place} | {scale} |")
    assert (with_center, with_scale) == (18, 13)


def test_an_empty_header_gives_an_empty_hint() -> None:
    hint = hint_from_header({}, 100, 100)
    assert hint == Hint(radius_deg=hint.radius_deg)
