"""Ephemeris tables: recorded ones, ones made of known places in every form, and what is ambiguous."""

from __future__ import annotations

import json
import re
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mountnav.ephemeris import SolarSystemBody
from mountnav.ephemeris.angles_text import dec_of, in_utc, ra_of
from mountnav.ephemeris.any_text import read_table
from mountnav.ephemeris.csv_table import read_csv_table
from mountnav.ephemeris.horizons import read_horizons
from mountnav.ephemeris.mpes import read_mpes
from mountnav.ephemeris.table import MOST_ROWS, Table, TableRow
from mountnav.errors import BadRequest
from mountnav.sky.chain import icrs_to_apparent
from mountnav.sky.coordinates import Icrs, Site
from mountnav.sky.iers import tt_minus_utc_s
from mountnav.sky.planets import vector_to_body_km
from mountnav.sky.sphere import separation_arcsec
from mountnav.units import AU_KM
from tests.ephemeris.samples import GEOCENTER, SITE, astroquery_file

BEGIN = datetime(2026, 3, 1, tzinfo=UTC)
MOON = SolarSystemBody("moon")
MARS = SolarSystemBody("mars")


def moon_table(observer: object, step_min: float, rows: int, *, distance: bool = True) -> Table:
    site = GEOCENTER if observer == "geocenter" else SITE
    made = []
    for number in range(rows):
        utc = BEGIN + timedelta(minutes=step_min * number)
        far = float(np.linalg.norm(vector_to_body_km("moon", utc, site))) / AU_KM
        made.append(TableRow(utc, MOON.icrs(utc, site), far if distance else None))
    return Table("Moon", tuple(made), observer)  # type: ignore[arg-type]


@pytest.mark.parametrize(("observer", "step_min"), [("geocenter", 120), (SITE, 120), (SITE, 360)])
def test_a_table_with_distances_serves_every_site(observer: object, step_min: float) -> None:
    table = moon_table(observer, step_min, 14)
    for site in (SITE, Site(-30.0, 20.0, 100.0)):
        for part in (0.0, 0.03, 0.37, 0.5, 0.83, 1.0):
            utc = table.begins_utc + part * (table.ends_utc - table.begins_utc)
            off = separation_arcsec(table.icrs(utc, site), MOON.icrs(utc, site))
            assert off < 0.05 + 2.0 * table.sigma_arcsec(utc)
            assert table.sigma_arcsec(utc) < 30.0


def test_the_daily_parallax_of_a_coarse_table_isnt_interpolated() -> None:
    # a day's step at one hour of the day: the parallax looks constant in it, and is a degree
    table = moon_table(SITE, 1440, 8)
    utc = BEGIN + timedelta(days=3, hours=12)
    assert separation_arcsec(table.icrs(utc, SITE), MOON.icrs(utc, SITE)) < 60.0
    with pytest.raises(BadRequest, match=r"step of 24\.0 h and no distance"):
        moon_table(SITE, 1440, 8, distance=False)


def test_without_a_distance_it_serves_where_it_was_made_for() -> None:
    table = moon_table(SITE, 10, 30, distance=False)
    utc = BEGIN + timedelta(minutes=47)
    assert separation_arcsec(table.icrs(utc, SITE), MOON.icrs(utc, SITE)) < 0.05
    for other in (Site(40.1, -105.0, 1600.0), GEOCENTER):
        with pytest.raises(
            BadRequest, match=r"gives no distance: from here a body 1 au away stands .*″ elsewhere"
        ):
            table.icrs(utc, other)
    of_center = moon_table("geocenter", 10, 30, distance=False)
    with pytest.raises(BadRequest, match=r"is for the Earth's center.*at the Moon's distance 0\.9"):
        of_center.icrs(utc, SITE)


def test_the_estimate_of_the_error_is_worth_its_name() -> None:
    for step_min in (60, 240, 720):
        table = moon_table("geocenter", step_min, 12)
        for part in np.random.default_rng(3).uniform(0.0, 1.0, 25):
            utc = table.begins_utc + float(part) * (table.ends_utc - table.begins_utc)
            off = separation_arcsec(table.icrs(utc, GEOCENTER), MOON.icrs(utc, GEOCENTER))
            assert off < 0.05 + 1.5 * table.sigma_arcsec(utc)


def test_at_its_rows_it_is_its_rows_and_beyond_it_is_nothing() -> None:
    table = moon_table("geocenter", 30, 9)
    for row in table.rows:
        assert separation_arcsec(table.icrs(row.utc, GEOCENTER), row.place) < 1e-4
    for utc in (table.begins_utc - timedelta(seconds=1), table.ends_utc + timedelta(seconds=1)):
        with pytest.raises(BadRequest, match=r"begins at|ends at"):
            table.icrs(utc, SITE)
        with pytest.raises(BadRequest, match=r"begins at|ends at"):
            table.sigma_arcsec(utc)


@pytest.mark.parametrize("rows", [3, MOST_ROWS + 1])
def test_too_few_and_too_many_rows_are_refused(rows: int) -> None:
    with pytest.raises(BadRequest, match="rows"):
        Table("x", tuple(TableRow(BEGIN + timedelta(seconds=n), Icrs(1, 1)) for n in range(rows)), "here")


# -- Horizons ------------------------------------------------------------------------------------------------

_CENTERS = {
    "geocenter": "Center-site name: GEOCENTRIC\n"
    "Center geodetic : 0.00000000,0.00000000,0.0000000 {E-lon(deg),Lat(deg),Alt(km)}",
    "site": "Center-site name: (user defined site below)\n"
    "Center geodetic : 255.000000,40.0000000,1.6000000 {E-lon(deg),Lat(deg),Alt(km)}",
}


def hms(ra_deg: float) -> str:
    units = round(ra_deg / 15.0 * 3600_0000) % (24 * 3600_0000)
    return f"{units // 3600_0000:02d} {units // 60_0000 % 60:02d} {units % 60_0000 / 1e4:07.4f}"


def dms(dec_deg: float) -> str:
    units = round(abs(dec_deg) * 3600_000)
    sign = "-" if dec_deg < 0 else "+"
    return f"{sign}{units // 3600_000:02d} {units // 60_000 % 60:02d} {units % 60_000 / 1e3:06.3f}"


def horizons(
    *,
    csv: bool,
    degrees: bool,
    apparent: bool,
    center: str,
    scale: str = "UT",
    rows: int = 9,
    jd: bool = False,
) -> str:
    """Mars, as Horizons writes it."""
    site = GEOCENTER if center == "geocenter" else SITE
    ra_label = "a-app" if apparent else "ICRF"
    time_labels = f"Date__({scale})__HR:MN:SC.fff"
    lines = []
    for number in range(rows):
        utc = BEGIN + timedelta(hours=1 * number)
        place = MARS.icrs(utc, site)
        far = float(np.linalg.norm(vector_to_body_km("mars", utc, site))) / AU_KM
        ra, dec = place.ra_deg, place.dec_deg
        if apparent:
            seen = icrs_to_apparent(place, utc)
            ra, dec = seen.ra_deg, seen.dec_deg
        shown = utc if scale == "UT" else utc + timedelta(seconds=tt_minus_utc_s(utc))
        day = f"{shown:%Y-%b-%d %H:%M:%S}.{shown.microsecond // 1000:03d}"
        julian = (shown - datetime(2000, 1, 1, 12, tzinfo=UTC)) / timedelta(days=1) + 2451545.0
        first, second = (f"{ra:.7f}", f"{dec:.7f}") if degrees else (hms(ra), dms(dec))
        if csv:
            lines.append(
                f" {day},{f' {julian:.9f},' if jd else ''} , , {first:>13}, {second:>13}, {far:.14f},  1.5,"
            )
        else:
            lines.append(
                f" {day}{f' {julian:.9f}' if jd else ''} *m  {first:>13} {second:>13} {far:>17.14f}  -1.234"
            )
    if csv:
        title = f" {time_labels},{f' Date_________JD{scale},' if jd else ''} , , "
        title += f"R.A._({ra_label}), DEC_({ra_label}), delta, deldot,"
    else:
        width = 13 + 1 + 13
        label = f"R.A._({ra_label}" + ")"
        label = label + "_" * (width - len(label) - 3) + "DEC"
        title = f" {time_labels}" + (f" Date_________JD{scale}" if jd else "") + "     " + label
        title += " " + "delta".rjust(17) + "  deldot"
    return "\n".join(
        [
            "API VERSION: 1.2",
            "Target body name: Mars (499)                      {source: mar097}",
            "Center body name: Earth (399)                     {source: DE441}",
            _CENTERS[center],
            "****",
            title,
            "****",
            "$$SOE",
            *lines,
            "$$EOE",
            "Column meaning:",
        ]
    )


@pytest.mark.long
@pytest.mark.parametrize("csv", [False, True])
@pytest.mark.parametrize("degrees", [False, True])
@pytest.mark.parametrize("apparent", [False, True])
@pytest.mark.parametrize("center", ["geocenter", "site"])
@pytest.mark.parametrize("scale", ["UT", "TT"])
@pytest.mark.parametrize("jd", [False, True])
def test_horizons_in_all_its_forms(
    csv: bool, degrees: bool, apparent: bool, center: str, scale: str, jd: bool
) -> None:
    text = horizons(csv=csv, degrees=degrees, apparent=apparent, center=center, scale=scale, jd=jd)
    for form in (text, json.dumps({"signature": {"version": "1.2"}, "result": text})):
        table = read_table(form)
        assert table.name == "Mars (499)"
        assert (table.observer == "geocenter") == (center == "geocenter")
        utc = BEGIN + timedelta(hours=3, minutes=20)
        # apparent places of the table's maker here have no daily aberration, as those of the sky's room
        assert separation_arcsec(table.icrs(utc, SITE), MARS.icrs(utc, SITE)) < 0.05
        assert table.sigma_arcsec(utc) < (0.5 if apparent else 0.1)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("Earth (399)", "Sun (10)", "not on the Earth"),
        ("Center body name", "Center", "for whom"),
        ("R.A._(ICRF)", "R.A._(B1950)", "no column with astrometric"),
        ("R.A._(ICRF)", "R.A._(r-app)", "no column with astrometric"),
        ("Date__(UT)", "Date__(ZN)", "scale or zone"),
        ("$$EOE", "", "cut off"),
        ("$$SOE", "$$SOX", "not an ephemeris table|no table"),
        ("2026-Mar-01", "2026-Mxr-01", "not a time"),
        ("2026-Mar-01", "2026-Mar-41", "not a time"),
        ("GEOCENTRIC", "Somewhere", None),
        ("R.A._(ICRF), DEC_(ICRF)", "R.A._(ICRF), other", "no declination"),
    ],
)
@pytest.mark.parametrize("csv", [False, True])
def test_what_horizons_leaves_open_is_refused(csv: bool, old: str, new: str, says: str | None) -> None:
    text = horizons(csv=csv, degrees=True, apparent=False, center="geocenter")
    changed = text.replace(old, new)
    if changed == text:
        return
    if says is None:
        assert read_table(changed).observer == "geocenter"
        return
    with pytest.raises(BadRequest, match=says):
        read_table(changed)


@pytest.mark.parametrize(
    ("unit", "far_au"),
    [("KM and KM/S", 412.5 / AU_KM), ("AU and KM/S", 412.5), (None, None)],
)
def test_a_distance_of_some_hundreds_is_in_the_unit_that_the_legend_says(
    unit: str | None, far_au: float | None
) -> None:
    # a satellite of the Earth passes so near: taken for au it would stand at one place from everywhere
    text = horizons(csv=True, degrees=True, apparent=False, center="site")
    text, count = re.subn(r", [0-9]\.[0-9]{14},", ", 412.50000000000,", text)
    assert count == 9
    if unit is None:
        with pytest.raises(BadRequest, match="in au or in km"):
            read_table(text)
        return
    text += (
        "\n  'delta  deldot' =\n   Apparent range (\"delta\", light-time aberrated) and range-rate"
        f' ("delta-dot")\nof the target center relative to the observer.  Units: {unit}\n'
    )
    table = read_table(text)
    assert table.rows[0].distance_au == pytest.approx(far_au)


def test_vectors_of_horizons_are_refused() -> None:
    text = astroquery_file("jplhorizons", "ceres_vectors_range.txt")
    with pytest.raises(BadRequest):
        read_table(text)


def test_a_recorded_answer_of_horizons() -> None:
    table = read_horizons(astroquery_file("jplhorizons", "ceres_ephemerides_range.txt"))
    assert (table.name, table.observer, len(table.rows)) == ("1 Ceres (A801 AA)", "geocenter", 4)
    assert table.rows[1].place == Icrs(106.56175, 26.59903)
    assert table.rounding_arcsec == pytest.approx(0.036)
    single = astroquery_file("jplhorizons", "ceres_ephemerides_single.txt")
    with pytest.raises(BadRequest, match="4 to"):
        read_horizons(single)


# -- the MPC's service ---------------------------------------------------------------------------------------


def test_recorded_pages_of_the_mpc() -> None:
    table = read_mpes(astroquery_file("mpc", "2P_ephemeris_500-a-t.html"))
    assert (table.name, table.observer, len(table.rows)) == ("2P/Encke", "geocenter", 21)
    assert table.rows[0].utc == datetime(2018, 7, 30, 17, 46, 14, tzinfo=UTC)
    assert table.rows[0].distance_au == 3.181
    assert separation_arcsec(table.rows[0].place, Icrs(346.60333, -5.135)) < 0.1
    unsure = read_mpes(astroquery_file("mpc", "2024AA_ephemeris_500-a-t.html"))
    assert unsure.name == "2024 AA"
    assert unsure.rows[0].sigma_arcsec == pytest.approx(169 / 3)


def test_a_page_for_a_code_wants_to_be_told_for_whom() -> None:
    page = astroquery_file("mpc", "2P_ephemeris_G37-a-t.html")
    with pytest.raises(BadRequest, match="observatory code G37, whose coordinates it doesn't tell"):
        read_mpes(page)
    assert read_mpes(page, made_for="here").icrs(datetime(2018, 8, 3, tzinfo=UTC), SITE)


@pytest.mark.parametrize(
    "name", ["2P_ephemeris_500-G-t.html", "2P_ephemeris_500-s-t.html", "testfail_ephemeris_500-a-t.html"]
)
def test_other_pages_are_refused(name: str) -> None:
    with pytest.raises(BadRequest):
        read_table(astroquery_file("mpc", name))


# -- plain tables --------------------------------------------------------------------------------------------


def plain(
    header: str = "utc,ra_deg,dec_deg,distance_au", said: str = "# observer: geocenter\n# frame: icrs"
) -> str:
    lines = []
    for number in range(6):
        utc = BEGIN + timedelta(hours=number)
        place = MARS.icrs(utc, GEOCENTER)
        far = float(np.linalg.norm(vector_to_body_km("mars", utc, GEOCENTER))) / AU_KM
        lines.append(f"{utc.isoformat()},{place.ra_deg:.7f},{place.dec_deg:.7f},{far:.10f}")
    return f"# name: Mars\n{said}\n{header}\n" + "\n".join(lines) + "\n"


def test_a_plain_table() -> None:
    table = read_csv_table(plain())
    assert table.name == "Mars"
    utc = BEGIN + timedelta(hours=2, minutes=31)
    assert separation_arcsec(table.icrs(utc, SITE), MARS.icrs(utc, SITE)) < 0.01


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("# observer: geocenter", "", "for whom"),
        ("# observer: geocenter", "# observer: moon", "neither geocenter"),
        ("# observer: geocenter", "# observer: 95,0,0", "no place"),
        ("# frame: icrs", "", "frame is not told"),
        ("# frame: icrs", "# frame: b1950", "frame is 'b1950'"),
        ("# frame: icrs", "# frame: icrs\n# frame: icrs", "a second time"),
        ("distance_au", "distance", "no column"),
        ("distance_au", "utc", "twice"),
        ("ra_deg", "ra_hms", "no right ascension"),
        ("utc,ra_deg", "ra_deg,ra_hms", "one of utc"),
        ("2026-03-01T02:00:00+00:00", "yesterday", "not a time"),
        ("2026-03-01T02:00:00+00:00", "2026-03-01T09:00:00+00:00", "no later"),
        (",0.", ",-0.", "distance"),
    ],
)
def test_what_a_plain_table_leaves_open_is_refused(old: str, new: str, says: str) -> None:
    assert old in plain() or old == ",0."
    text = (
        plain().replace(old, new) if old in plain() else plain().replace(",1.", ",-1.").replace(",2.", ",-2.")
    )
    with pytest.raises(BadRequest, match=says):
        read_csv_table(text)


@given(st.floats(0.0, 359.999), st.floats(-89.99, 89.99))
def test_angles_in_both_forms_are_one(ra: float, dec: float) -> None:
    there = Icrs(ra_of(hms(ra).split(), "x")[0], dec_of(dms(dec).split(), "x")[0])
    assert (
        separation_arcsec(there, Icrs(ra_of([f"{ra:.9f}"], "x")[0], dec_of([f"{dec:.9f}"], "x")[0])) < 0.002
    )


@pytest.mark.parametrize(
    "parts", [["24", "0", "0"], ["1", "60", "0"], ["1", "0", "60"], ["1.5", "0", "0"], ["x"], ["361"], []]
)
def test_what_is_no_angle_is_refused(parts: list[str]) -> None:
    with pytest.raises(BadRequest):
        ra_of(parts, "x")


def test_small_negative_declinations_keep_their_sign() -> None:
    assert dec_of(["-00", "00", "01"], "x")[0] == pytest.approx(-1.0 / 3600.0)
    assert dec_of(["-0", "30"], "x") == (-0.5, 60.0)


def test_time_scales() -> None:
    told = datetime(2026, 3, 1, 0, 1, 9, 184000, tzinfo=UTC)
    assert in_utc(told, "TT") == BEGIN
    assert in_utc(BEGIN, "UT") == BEGIN
    # across the leap second of the end of 2016
    assert in_utc(datetime(2017, 1, 1, 0, 2, tzinfo=UTC), "TT") == datetime(
        2017, 1, 1, 0, 0, 50, 816000, tzinfo=UTC
    )
