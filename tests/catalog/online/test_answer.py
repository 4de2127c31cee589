"""Columns of known and unknown tables: chosen by name, UCD or settings, in the right unit or not at all."""

from __future__ import annotations

from collections.abc import Sequence
from xml.sax.saxutils import quoteattr

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from mountnav.catalog.online.answer import Roles, columns_of, roles_of
from mountnav.catalog.online.request import Circle, Got, SourceFailed, Unusable, question
from mountnav.catalog.online.source import OnlineSource, known_table
from mountnav.catalog.online.stars import Received, stars_of
from mountnav.catalog.stars import StarFlag
from mountnav.settings.catalogs import OnlineSettings

HERE = Circle(10.0, 60.0, 0.5)
Field = tuple[str, str, str]
"""Name, UCD, unit."""


def answer(
    fields: Sequence[Field],
    rows: Sequence[Sequence[object]],
    *,
    coosys: str = 'system="ICRS" epoch="J2016.0"',
    texts: Sequence[str] = (),
    described: dict[str, str] | None = None,
) -> Got:
    told = ""
    for name, ucd, unit in fields:
        kind = 'datatype="char" arraysize="*"' if name in texts else 'datatype="double"'
        words = (described or {}).get(name, "")
        told += (
            f"<FIELD name={quoteattr(name)} ucd={quoteattr(ucd)} unit={quoteattr(unit)} ref='s' {kind}>"
            f"<DESCRIPTION>{words}</DESCRIPTION></FIELD>\n"
        )
    data = "".join(
        "<TR>" + "".join(f"<TD>{'' if one is None else one}</TD>" for one in row) + "</TR>" for row in rows
    )
    text = (
        '<?xml version="1.0"?><VOTABLE version="1.4" xmlns="http://www.ivoa.net/xml/VOTable/v1.3">'
        f'<RESOURCE type="results"><COOSYS ID="s" {coosys}/><TABLE>{told}<DATA><TABLEDATA>{data}'
        "</TABLEDATA></DATA></TABLE></RESOURCE></VOTABLE>"
    )
    return Got(200, "text/xml", text.encode())


def understood(source: OnlineSource, got: Got) -> tuple[Roles, Received]:
    roles = roles_of(columns_of(got, asked_rows=1000), source)
    return roles, stars_of(roles, source, HERE)


PLAIN = (
    ("alpha", "pos.eq.ra;meta.main", "deg"),
    ("delta", "pos.eq.dec;meta.main", "deg"),
    ("ea", "stat.error;pos.eq.ra", "mas"),
    ("ed", "stat.error;pos.eq.dec", "arcsec"),
    ("mua", "pos.pm;pos.eq.ra", "mas/yr"),
    ("mud", "pos.pm;pos.eq.dec", '"/yr'),
    ("r", "phot.mag;em.opt.R", "mag"),
    ("v", "phot.mag;em.opt.V", "mag"),
)
COS = {"mua": "Proper motion in RA * cos(DE)"}
ROW = (10.1, 60.1, 20.0, 0.03, 5.0, 0.007, 11.0, 12.5)
SOURCE = OnlineSource("own", protocol="cone", url="http://x")


def test_an_unknown_table_is_understood_by_its_ucds() -> None:
    roles, received = understood(SOURCE, answer(PLAIN, [ROW], described=COS))
    stars = received.columns
    assert (roles.band, roles.epoch_yr) == ("V", 2016.0)
    assert stars.mag.tolist() == [12.5]
    assert stars.pm_ra_cosdec_mas_yr.tolist() == [5.0]
    assert stars.pm_dec_mas_yr.tolist() == pytest.approx([7.0])
    # the mean of both variances, at the mean epoch
    t = 16.0
    assert (stars.error_curve @ [1, t, t * t])[0] == pytest.approx((20.0**2 + 30.0**2) / 2)


def test_old_ucds_are_known_too() -> None:
    fields = (
        ("RA", "POS_EQ_RA_MAIN", "deg"),
        ("DEC", "POS_EQ_DEC_MAIN", "deg"),
        ("Rmag", "PHOT_JHN_R", ""),
    )
    source = OnlineSource("old", protocol="cone", url="http://x", epoch_yr=1985.0, sigma_mas=250.0)
    roles, received = understood(source, answer(fields, [(10.0, 60.0, 14.0)], coosys='system="eq_FK5"'))
    assert (roles.band, roles.epoch_yr) == ("R", 1985.0)
    assert received.columns.flags is not None
    assert received.columns.flags.tolist() == [StarFlag.NO_PROPER_MOTION]
    assert np.sqrt(received.columns.error_curve @ [1, -15.0, 225.0])[0] == pytest.approx(250.0)


@pytest.mark.parametrize(
    ("source", "got", "said"),
    [
        (SOURCE, answer(PLAIN, [ROW]), "can't determine whether mua is multiplied by cos(Dec)"),
        (SOURCE, answer(PLAIN, [ROW], described=COS, coosys='system="ICRS"'), "set epoch_yr"),
        (SOURCE, answer(PLAIN, [ROW], described=COS, coosys='system="eq_FK4" epoch="J2000"'), "in eq_FK4"),
        (
            SOURCE,
            answer(PLAIN[1:], [ROW[1:]], described=COS),
            "can't determine the column of ra: set columns",
        ),
        (SOURCE, answer(PLAIN[:6], [ROW[:6]], described=COS), "can't determine the column of the magnitude"),
        (SOURCE, answer(PLAIN, [ROW], described=COS, texts=["alpha"]), "can't determine the column of ra"),
        (
            SOURCE,
            answer((*PLAIN[:2], *PLAIN[4:]), [(*ROW[:2], *ROW[4:])], described=COS),
            "the errors of its positions are unknown: set sigma_mas",
        ),
        (
            SOURCE,
            answer(
                (*PLAIN, ("ra2", "pos.eq.ra", "deg"), ("ra3", "pos.eq.ra", "deg"))[1:], [(*ROW, 1, 2)[1:]]
            ),
            "several columns have the UCD pos.eq.ra (ra2, ra3)",
        ),
        (
            SOURCE,
            answer((*PLAIN[:4], ("mua", "pos.pm;pos.eq.ra", ""), *PLAIN[5:]), [ROW], described=COS),
            'set columns = {pm_ra = "mua [mas/yr]"}',
        ),
        (
            SOURCE,
            answer((*PLAIN[:2], ("ea", "stat.error;pos.eq.ra", "s"), *PLAIN[3:]), [ROW], described=COS),
            "column ea is in s, which is not in mas",
        ),
        (
            OnlineSource("own", protocol="cone", url="http://x", columns={"mag": "nothere"}),
            answer(PLAIN, [ROW], described=COS),
            "there is no column nothere",
        ),
        (
            OnlineSource("own", protocol="cone", url="http://x", band="I"),
            answer(PLAIN, [ROW], described=COS),
            "can't determine the column of a magnitude of band I",
        ),
        (
            OnlineSource("own", protocol="cone", url="http://x", columns={"mag": "v"}),
            answer(PLAIN, [ROW], described=COS),
            "set band",
        ),
        (SOURCE, answer(PLAIN, [(370.0, *ROW[1:])], described=COS), "not RA and Dec in degrees"),
        (SOURCE, answer(PLAIN, [(12.0, *ROW[1:])], described=COS), "1 of its 1 stars lie outside"),
        (SOURCE, answer(PLAIN, [(None, *ROW[1:])], described=COS), "1 of its 1 rows have no position"),
    ],
)
def test_what_cannot_be_told_is_refused_with_what_to_configure(
    source: OnlineSource, got: Got, said: str
) -> None:
    with pytest.raises(Unusable) as raised:
        understood(source, got)
    assert said in raised.value.why


def test_places_in_single_precision_are_not_better_than_that() -> None:
    got = answer(PLAIN, [ROW], described=COS)
    single = Got(200, "", got.body.replace(b"ref='s' datatype=\"double\"", b"ref='s' datatype=\"float\"", 2))
    sigmas = []
    for one in (got, single):
        _, received = understood(SOURCE, one)
        sigmas.append(np.sqrt(received.columns.error_curve @ [1, 16.0, 256.0])[0])
    assert sigmas[0] == pytest.approx(np.sqrt((20.0**2 + 30.0**2) / 2))
    assert sigmas[1] == pytest.approx(np.hypot(sigmas[0], 32.0))


def test_configured_columns_go_before_all_else() -> None:
    columns = {"mag": "r", "pm_ra": "", "pm_dec": "", "e_ra": "ea [arcsec]"}
    source = OnlineSource("own", protocol="cone", url="http://x", columns=columns, band="Rc", epoch_yr=1999.5)
    roles, received = understood(source, answer(PLAIN, [ROW]))
    stars = received.columns
    assert (roles.band, roles.epoch_yr) == ("Rc", 1999.5)
    assert stars.mag.tolist() == [11.0]
    assert np.isnan(stars.pm_dec_mas_yr).all()
    t = -0.5
    assert (stars.error_curve @ [1, t, t * t])[0] == pytest.approx((20000.0**2 + 30.0**2) / 2)


def test_rows_without_place_and_twins_are_left_out_and_counted() -> None:
    rows: list[tuple[object, ...]] = [(10.0 + 0.001 * n, *ROW[1:]) for n in range(30)]
    rows += [rows[3], rows[3], (None, *ROW[1:])]
    _, received = understood(SOURCE, answer(PLAIN, rows, described=COS))
    assert (received.without_place, received.doubled) == (1, 2)
    assert received.columns.ra_deg.size == 30


UCAC4_FIELDS = tuple(
    (name, "", unit)
    for name, unit in (
        ("RAJ2000", "deg"),
        ("DEJ2000", "deg"),
        ("ePos", "mas"),
        ("EpRA", "yr"),
        ("EpDE", "yr"),
        ("pmRA", "mas/yr"),
        ("pmDE", "mas/yr"),
        ("e_pmRA", "mas/yr"),
        ("e_pmDE", "mas/yr"),
        ("f.mag", "mag"),
        ("a.mag", "mag"),
        ("Bmag", "mag"),
        ("Vmag", "mag"),
        ("of", ""),
        ("db", ""),
    )
)


def test_ucac4_rows() -> None:
    rows = [
        (10, 60, 22, 2001.15, 2001.45, 10.1, -2.7, 1.9, 2.3, 13.301, 13.273, 13.971, 13.327, 0, 0),
        (10, 60.1, 123, 1991.32, 1994.97, 0, 0, 50, 50, 16.1, None, None, None, 5, 0),
        (10, 60.2, 22, 2000, 2000, 1, 1, 1, 1, None, None, 8.0, 7.4, 1, 31),
    ]
    roles, received = understood(OnlineSource("u", table="I/322A"), answer(UCAC4_FIELDS, rows, coosys=""))
    stars = received.columns
    assert (roles.band, roles.color_name, roles.epoch_yr) == ("UCAC", "B-V", 2000.0)
    assert stars.mag.tolist() == pytest.approx([13.273, 16.1, 7.3])
    assert stars.color_mag is not None
    assert stars.flags is not None
    assert stars.color_mag[[0, 2]].tolist() == pytest.approx([0.644, 0.6])
    none, other, double = StarFlag.NO_PROPER_MOTION, StarFlag.OTHER_BAND, StarFlag.DOUBLE
    assert stars.flags.tolist() == [0, none, other | double]
    assert np.isnan(stars.pm_dec_mas_yr).tolist() == [False, True, False]
    # e.g. row 1: 123 mas of both coordinates in 1993, then 50 mas/yr
    t = 26.9
    years = np.array([2026.9 - 1991.32, 2026.9 - 1994.97])
    expected = 123.0**2 / 2 + (50.0 * years) ** 2
    assert (stars.error_curve @ [1, t, t * t])[1] == pytest.approx(expected.mean())


def test_usno_b1_rows() -> None:
    names = (
        "RAJ2000 DEJ2000 e_RAJ2000 e_DEJ2000 Epoch pmRA pmDE e_pmRA e_pmDE B1mag R1mag B2mag R2mag Imag Ndet"
    )
    units = "deg deg mas mas yr mas/yr mas/yr mas/yr mas/yr mag mag mag mag mag"
    fields = tuple((name, "", unit) for name, unit in zip(names.split(), [*units.split(), ""], strict=True))
    rows = [
        (10, 60, 50, 60, 1975.1, 12, -8, 3, 3, 15.0, 14.1, 15.2, 14.0, 13.5, 5),
        (10, 60.1, 999, 999, 1970, 0, 0, 0, 0, None, 16.0, None, None, None, 1),
        (10, 60.2, 100, 100, 1970, 0, 0, 0, 0, None, None, 18.0, None, None, 2),
        (10, 60.3, 100, 100, 1970, 0, 0, 0, 0, None, None, None, None, None, 2),
    ]
    _, received = understood(OnlineSource("u", table="I/284"), answer(fields, rows, coosys=""))
    stars = received.columns
    assert stars.mag.tolist() == pytest.approx([14.0, 16.0, 17.1, 21.0])
    assert stars.flags is not None
    assert stars.color_mag is not None
    none, doubt = StarFlag.NO_PROPER_MOTION, StarFlag.DOUBTFUL
    other, nothing = StarFlag.OTHER_BAND, StarFlag.NO_MAGNITUDE
    assert stars.flags.tolist() == [0, none | doubt, none | other, none | nothing]
    assert stars.color_mag[0] == pytest.approx(1.2)
    sigma_1975 = np.sqrt(stars.error_curve @ [1, -24.9, 24.9**2])[0]
    assert sigma_1975 == pytest.approx(np.sqrt(200.0**2 + (50.0**2 + 60.0**2) / 2))


def test_gaia_rows_as_vizier_and_as_the_archive_name_them() -> None:
    vizier = "RA_ICRS DE_ICRS e_RA_ICRS e_DE_ICRS pmRA pmDE e_pmRA e_pmDE Gmag BP-RP RUWE"
    archive = "ra dec ra_error dec_error pmra pmdec pmra_error pmdec_error phot_g_mean_mag bp_rp ruwe"
    units = "deg deg mas mas mas/yr mas/yr mas/yr mas/yr mag mag"
    rows = [
        (10, 60, 0.0539, 0.0468, 1031.472, -1723.619, 0.068, 0.055, 5.364037, 1.323604, 1.298),
        (10, 60.1, 1.2, 1.1, None, None, None, None, 20.5, None, 2.5),
    ]
    for table, names in (("I/355/gaiadr3", vizier), ("gaiadr3.gaia_source", archive)):
        fields = tuple(
            (name, "", unit) for name, unit in zip(names.split(), [*units.split(), ""], strict=True)
        )
        source = OnlineSource("g", protocol="tap", url="http://x/tap", table=table)
        roles, received = understood(source, answer(fields, rows, coosys=""))
        stars = received.columns
        assert (roles.band, roles.color_name, roles.epoch_yr) == ("G", "BP-RP", 2016.0)
        assert stars.pm_dec_mas_yr[0] == -1723.619
        assert stars.flags is not None
        assert stars.flags.tolist() == [0, StarFlag.NO_PROPER_MOTION | StarFlag.DOUBLE]
        assert np.sqrt(stars.error_curve @ [1, 16.0, 256.0])[0] == pytest.approx(0.0505, abs=0.0002)


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_an_answer_cut_or_changed_anywhere_is_an_answer_or_a_refusal(data: st.DataObject) -> None:
    body = bytearray(answer(PLAIN, [ROW] * 3, described=COS).body)
    where = data.draw(st.integers(0, len(body) - 1))
    if data.draw(st.booleans()):
        del body[where:]
    else:
        body[where] = data.draw(st.integers(0, 255))
    try:
        understood(SOURCE, Got(200, "text/xml", bytes(body)))
    except SourceFailed:
        return
    assert len(body) > 100


def test_each_cut_of_an_answer_is_refused() -> None:
    body = answer(PLAIN, [ROW], described=COS).body
    for end in range(0, len(body) - 1, 7):
        with pytest.raises(SourceFailed):
            understood(SOURCE, Got(200, "text/xml", body[:end]))


def test_questions_are_asked_in_each_protocols_words() -> None:
    circle = Circle(10.0, -5.0, 0.5)
    vizier = question(OnlineSource("g", table="I/355"), circle, 16.0)
    assert vizier.startswith("https://vizier.cds.unistra.fr/viz-bin/votable?-source=I%2F355%2Fgaiadr3&")
    assert "-c=10.000000%20-5.000000" in vizier
    assert "-c.rd=0.500000" in vizier
    assert vizier.endswith("&Gmag=%3C%3D16")
    mirror = OnlineSource("g", url="https://mirror.example/viz-bin/votable", table="I/284")
    assert question(mirror, circle, 16.0).startswith("https://mirror.example/viz-bin/votable?-source=I%2F284")
    assert "mag=%3C" not in question(mirror, circle, 16.0)
    tap = OnlineSource("u", protocol="tap", url="http://x/tap/", table="I/322A")
    asked = question(tap, circle, None)
    assert asked.startswith("http://x/tap/sync?REQUEST=doQuery&LANG=ADQL&FORMAT=votable&MAXREC=40000&QUERY=")
    assert "%22f.mag%22" in asked
    assert "%22of%22" in asked
    assert "FROM%20%22I%2F322A%2Fout%22%20WHERE%201%3DCONTAINS" in asked
    own = OnlineSource("u", protocol="tap", url="http://x", table="own.t", columns={"ra": "r a", "mag": "g"})
    assert "POINT%28%27ICRS%27%2C%20%22r%20a%22%2C%20dec%29" in question(own, circle, 15.5)
    assert question(own, circle, 15.5).endswith("AND%20g%20%3C%3D%2015.5")
    cone = OnlineSource("c", protocol="cone", url="http://x/scs?cat=5&")
    assert question(cone, circle, 12.0).startswith(
        "http://x/scs?cat=5&RA=10.000000&DEC=-5.000000&SR=0.500000"
    )


def test_known_tables_go_by_both_names() -> None:
    assert known_table("I/355") is known_table("I/355/gaiadr3")
    assert known_table("I/355/paramp") is None


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"table": ""}, "which table"),
        ({"protocol": "tap", "table": "a.b"}, "no default address"),
        ({"table": "I/355", "columns": {"dek": "x"}}, "a star has no dek"),
        ({"table": "I/355", "url": "ftp://x"}, "url"),
        ({"table": "x; DROP"}, "table"),
        ({"table": "I/355", "ask": "sometimes"}, "ask"),
        ({"table": "I/355", "name": "Up/../down"}, "name"),
        ({"table": "I/355", "behind": "cache"}, "behind"),
    ],
)
def test_settings_that_cannot_work_are_refused(given: dict[str, object], said: str) -> None:
    with pytest.raises(ValidationError) as raised:
        OnlineSettings.model_validate({"name": "one"} | given)
    assert said in str(raised.value)


def test_fingerprints_tell_makings_apart_and_mirrors_are_alike() -> None:
    one = OnlineSource("g", table="I/355")
    assert (
        one.fingerprint()
        == OnlineSource("g", url="https://mirror.example", table="I/355/gaiadr3").fingerprint()
    )
    assert one.fingerprint() != OnlineSource("g", table="I/322A").fingerprint()
    assert one.fingerprint() != OnlineSource("g", table="I/355", columns={"mag": "BPmag"}).fingerprint()
    assert one.fingerprint() == OnlineSource("g", table="I/355", timeout_s=3.0, mag_limit=14.0).fingerprint()
    taps = {OnlineSource("t", protocol="tap", url=f"http://{n}", table="t").fingerprint() for n in "ab"}
    assert len(taps) == 2
