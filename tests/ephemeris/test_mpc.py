"""What the Minor Planet Center publishes: packed designations and days, lines and JSON."""

from __future__ import annotations

import json
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mountnav.ephemeris.any_text import read_elements
from mountnav.ephemeris.mpc import packed_epoch_jd, read_mpc_lines, unpacked
from mountnav.errors import BadRequest
from tests.ephemeris.samples import CERES_2023, HALLEY, HOWELL, PALLAS_2024


@pytest.mark.parametrize(
    ("packed", "readable"),
    [
        # the MPC's own examples
        ("00001", "1"),
        ("A0345", "100345"),
        ("a0017", "360017"),
        ("~0000", "620000"),
        ("~000z", "620061"),
        ("~AZaz", "3140113"),
        ("~zzzz", "15396335"),
        ("J95X00A", "1995 XA"),
        ("J95X01L", "1995 XL1"),
        ("J95F13B", "1995 FB13"),
        ("J98SA8Q", "1998 SQ108"),
        ("J98SC7V", "1998 SV127"),
        ("J98SG2S", "1998 SS162"),
        ("K99AJ3Z", "2099 AZ193"),
        ("K08Aa0A", "2008 AA360"),
        ("K07Tf8A", "2007 TA418"),
        ("PLS2040", "2040 P-L"),
        ("T1S3138", "3138 T-1"),
        ("_QC0000", "2026 CA620"),
        ("_QC0aEM", "2026 CZ6190"),
    ],
)
def test_packed_designations(packed: str, readable: str) -> None:
    assert unpacked(packed) == readable


@pytest.mark.parametrize(
    ("packed", "jd"), [("K239D", 2460200.5), ("K01A0", None), ("J9611", 2450083.5), ("K232P", 2460000.5)]
)
def test_packed_days(packed: str, jd: float | None) -> None:
    if jd is None:
        with pytest.raises(BadRequest, match="packed day"):
            packed_epoch_jd(packed)
    else:
        assert packed_epoch_jd(packed) == jd


@pytest.mark.parametrize("wrong", ["", "K23", "K23D9", "Z2311", "K2320", "K232V", "k239D"])
def test_what_is_no_packed_day_is_refused(wrong: str) -> None:
    with pytest.raises(BadRequest):
        packed_epoch_jd(wrong)


def test_a_line_of_mpcorb() -> None:
    one = read_elements(PALLAS_2024)[0]
    assert (one.name, one.aliases) == ("2 Pallas", ("2", "Pallas"))
    assert one.epoch_jd == 2460400.5
    assert one.q_au == pytest.approx(2.7704235 * (1 - 0.2303399))
    assert (one.inclination_deg, one.node_deg, one.peri_deg) == (34.92284, 172.91472, 310.88725)
    assert one.uncertainty == 0
    assert not one.comet
    # a letter says that U can't be trusted
    assert read_elements(PALLAS_2024[:105] + "E" + PALLAS_2024[106:])[0].uncertainty is None


def test_lines_of_comets() -> None:
    halley, howell = read_elements(f"{HALLEY}\n{HOWELL}\n")
    assert (halley.name, halley.aliases) == ("1P/Halley", ("1P", "Halley"))
    assert (halley.q_au, halley.eccentricity) == (0.583972, 0.967311)
    assert halley.epoch_jd == 2460796.5
    assert halley.comet
    assert (howell.name, howell.epoch_jd) == ("88P/Howell", 2459054.5)


def test_a_new_comet_is_found_by_its_designation() -> None:
    line = (
        "    CK23A030  2024 09 27.7405  0.391423  1.000093  308.4925   21.5596  139.1109  20241017   5.0  4.0"
        "  C/2023 A3 (Tsuchinshan-ATLAS)                            MPEC 2024-UA9"
    )
    one = read_elements(line)[0]
    assert one.name == "C/2023 A3 (Tsuchinshan-ATLAS)"
    assert "C/2023 A3" in one.aliases
    assert one.eccentricity > 1.0


def test_the_header_of_mpcorb_is_passed_over() -> None:
    text = (
        f"MINOR PLANET CENTER ORBIT DATABASE (MPCORB)\n\nwords\n{'-' * 160}\n{CERES_2023}\n\n{PALLAS_2024}\n"
    )
    assert [one.name for one in read_mpc_lines(text.splitlines())] == ["1 Ceres", "2 Pallas"]


@given(st.integers(0, 102), st.characters(codec="ascii", exclude_characters="\n\r"))
def test_a_changed_letter_of_a_line_is_read_or_refused(place: int, letter: str) -> None:
    with suppress(BadRequest):
        read_elements(CERES_2023[:place] + letter + CERES_2023[place + 1 :])


@given(st.integers(0, 102))
def test_a_cut_line_is_refused(length: int) -> None:
    with pytest.raises(BadRequest):
        read_elements(CERES_2023[:length])


RECORD = {
    "H": 10.4,
    "Number": "(433)",
    "Name": "Eros",
    "Principal_desig": "1898 DQ",
    "Other_desigs": ["1956 PC"],
    "Epoch": 2461000.5,
    "M": 310.5543,
    "Peri": 178.897,
    "Node": 304.2701,
    "i": 10.82847,
    "e": 0.22282,
    "n": 0.55977529,
    "a": 1.4581203,
    "U": "0",
}
COMET = {
    "Orbit_type": "C",
    "Year_of_perihelion": 2024,
    "Month_of_perihelion": 9,
    "Day_of_perihelion": 27.7405,
    "Perihelion_dist": 0.391423,
    "e": 1.000093,
    "Peri": 308.4925,
    "Node": 21.5596,
    "i": 139.1109,
    "Epoch_year": 2024,
    "Epoch_month": 10,
    "Epoch_day": 17,
    "Designation_and_name": "C/2023 A3 (Tsuchinshan-ATLAS)",
}
ORB = {
    "designation_data": {
        "permid": "433",
        "iau_name": "Eros",
        "unpacked_primary_provisional_designation": "1898 DQ",
    },
    "epoch_data": {"epoch": 61000.0, "timesystem": "TDT"},
    "orbit_fit_statistics": {"U_param": 1},
    "COM": {
        "coefficient_names": ["q", "e", "i", "node", "argperi", "peri_time"],
        "coefficient_values": [1.133, 0.2228, 10.828, 304.27, 178.897, 61088.33],
    },
}


def test_json_of_the_mpc() -> None:
    eros, comet = read_elements(json.dumps([RECORD, COMET]))
    assert (eros.name, set(eros.aliases)) == ("433 Eros", {"433", "Eros", "1898 DQ", "1956 PC"})
    assert (eros.epoch_jd, eros.uncertainty) == (2461000.5, 0)
    assert (comet.name, comet.aliases) == ("C/2023 A3 (Tsuchinshan-ATLAS)", ("C/2023 A3",))
    assert comet.perihelion_jd == pytest.approx(2460581.2405)
    for form in (ORB, {"mpc_orb": ORB}, [{"mpc_orb": ORB}]):
        own = read_elements(json.dumps(form))[0]
        assert (own.name, own.epoch_jd, own.uncertainty) == ("433 Eros", 2461000.5, 1)


@pytest.mark.parametrize(
    ("record", "key"),
    [(RECORD, key) for key in ("Epoch", "M", "Peri", "Node", "i", "e", "a")]
    + [
        (COMET, key)
        for key in ("Month_of_perihelion", "Perihelion_dist", "e", "Peri", "Node", "i", "Epoch_month")
    ],
)
@pytest.mark.parametrize("value", [None, "x", True, [], 1e308, float("nan")])
def test_a_field_that_is_none_is_refused(record: dict[str, object], key: str, value: object) -> None:
    with pytest.raises(BadRequest):
        read_elements(json.dumps(record | {key: value}))


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", "[1]", '{"a": 1}', "no orbit at all", "[" * 5000])
def test_what_holds_no_elements_is_refused(text: str) -> None:
    with pytest.raises(BadRequest):
        read_elements(text)
