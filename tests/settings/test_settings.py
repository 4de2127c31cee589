"""Settings: what is accepted, and that every fault names its line, its field and the fix."""

from __future__ import annotations

import dataclasses
import hashlib
from dataclasses import replace
from pathlib import Path

import pytest

from mountnav.errors import BadSettings
from mountnav.identification.settings import IdentificationSettings, PreliminarySettings
from mountnav.measuring.settings import MeasuringSettings
from mountnav.settings.explained import line_of
from mountnav.settings.observatory import Settings
from mountnav.settings.solving import _RANGES
from mountnav.settings.telescope import FolderCameraSettings, SimulatedCameraSettings

GOOD = """\
[site]
latitude_deg = 47.0
longitude_deg = 11.0

[[telescope]]
id = "east"
mount = { url = "lx200+serial:///dev/ttyUSB0?baud=9600", epoch = "icrs" }
[telescope.camera]
kind = "folder"
path = "/var/frames"

[[telescope]]
id = "west"
exposure_s = 1
[telescope.mount]
url = "fake+lx200://"
[telescope.mount.errors]
ih_arcsec = 300.0
[telescope.camera]
kind = "simulated"
parity = -1
[telescope.centering]
tolerance_arcsec = 10.0
"""
EXAMPLE = Path(__file__).resolve().parents[2] / "deploy" / "observatory.toml"


def test_a_good_file_is_read_whole(tmp_path: Path) -> None:
    path = tmp_path / "observatory.toml"
    path.write_text(GOOD)
    settings = Settings.load(path)
    east, west = settings.telescope
    assert isinstance(east.camera, FolderCameraSettings)
    assert isinstance(west.camera, SimulatedCameraSettings)
    assert (east.mount.epoch, west.camera.parity, west.centering.tolerance_arcsec) == ("icrs", -1, 10.0)
    assert west.mount.errors is not None
    assert west.mount.errors.ih_arcsec == 300.0
    assert settings.service.host == "127.0.0.1"


def test_the_example_of_deploy_is_good() -> None:
    assert Settings.load(EXAMPLE).telescope


@pytest.mark.parametrize(
    ("old", "new", "line", "field", "told"),
    [
        ("latitude_deg = 47.0", "latitude_deg = 97.0", 2, "site.latitude_deg", "less than or equal to 90"),
        ("latitude_deg = 47.0", "latitude_deg = nan", 2, "site.latitude_deg", "finite"),
        ("latitude_deg = 47.0", "", 1, "site.latitude_deg", "add latitude_deg = ..."),
        ("longitude_deg", "longitud_deg", 3, "site.longitud_deg", "did you mean longitude_deg?"),
        ('"icrs"', '"j2000"', 7, "telescope[0].mount.epoch", "'apparent' or 'icrs'"),
        ('"lx200+serial:///dev/ttyUSB0?baud=9600"', '"/dev/ttyUSB0"', 7, "mount.url", "lx200+serial:///dev"),
        ('kind = "folder"', 'kind = "webcam"', 8, "telescope[0].camera", 'write kind = "folder"'),
        ('path = "/var/frames"', "", 8, "telescope[0].camera.path", "required"),
        ("ih_arcsec", "ih_arcmin", 18, "mount.errors.ih_arcmin", "did you mean ih_arcsec?"),
        (
            "tolerance_arcsec = 10.0",
            "tolerance_arcsec = -1",
            23,
            "centering.tolerance_arcsec",
            "greater than 0",
        ),
        ('"fake+lx200://"', '"lx200+socket://h:1"', 17, "mount.errors", "remove errors"),
        ('"fake+lx200://"', '"fake+eq6://"', 16, "mount.url", 'write url = "fake+lx200://"'),
        ('"west"', '"east"', 5, "telescope", "two telescopes have the id east"),
        ('"west"', '"We st"', 13, "telescope[1].id", "lower-case"),
    ],
)
def test_a_fault_names_line_field_and_fix(old: str, new: str, line: int, field: str, told: str) -> None:
    assert old in GOOD
    with pytest.raises(BadSettings) as caught:
        Settings.parse(GOOD.replace(old, new, 1), name="observatory.toml")
    text = str(caught.value)
    assert "observatory.toml" in text
    assert f"line {line}:" in text
    assert field in text
    assert told in text


def test_bad_toml_names_its_line() -> None:
    with pytest.raises(BadSettings, match=r"line 6: this is not TOML"):
        Settings.parse(GOOD.replace('id = "east"', "id = east"))


def test_an_unended_text_is_told_as_such() -> None:
    with pytest.raises(BadSettings, match="ends too early"):
        Settings.parse("a = {")


def test_several_faults_are_told_together() -> None:
    with pytest.raises(BadSettings, match="2 faults") as caught:
        Settings.parse(GOOD.replace("47.0", "97.0").replace("11.0", "999.0"))
    assert "line 2" in str(caught.value)
    assert "line 3" in str(caught.value)


def test_a_missing_file_is_told(tmp_path: Path) -> None:
    with pytest.raises(BadSettings, match="can't be read"):
        Settings.load(tmp_path / "none.toml")


def test_a_file_of_bytes_is_told(tmp_path: Path) -> None:
    path = tmp_path / "x.toml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(BadSettings, match="UTF-8"):
        Settings.load(path)


@pytest.mark.parametrize("host", ["0.0.0.0", "192.168.1.5", "::", "observatory.example"])
def test_wider_than_loopback_needs_a_token(host: str) -> None:
    wide = f'[service]\nhost = "{host}"\n{GOOD}'
    with pytest.raises(BadSettings, match=r"line 2: service\.host: .*no API token"):
        Settings.parse(wide)
    token = hashlib.sha256(b"secret").hexdigest()
    with_token = wide.replace("[service]", f'[service]\napi_token_sha256 = "{token}"')
    assert Settings.parse(with_token).service.host == host


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "::1", "127.9.9.9"])
def test_loopback_needs_none(host: str) -> None:
    assert Settings.parse(f'[service]\nhost = "{host}"\n{GOOD}').service.is_loopback


def test_a_simulated_camera_needs_a_fake_mount() -> None:
    wrong = GOOD.replace('kind = "folder"\npath = "/var/frames"', 'kind = "simulated"')
    with pytest.raises(BadSettings, match=r"line 8: telescope\[0\]\.camera: a simulated camera"):
        Settings.parse(wrong)


def test_lines_inside_long_strings_are_no_keys() -> None:
    text = 'a = """\nb = 1\n[c]\n"""\nb = 2\n'
    assert line_of(text, ("b",)) == 5
    assert line_of(text, ("c",)) is None


def test_lines_of_tables_in_tables() -> None:
    text = "[[t]]\nx.y = 1\n[[t]]\n[t.u]\n'z' = 2\n[[t.v]]\nw = 1\n[[t.v]]\nw = 2\n"
    assert line_of(text, ("t", 0, "x", "y")) == 2
    assert line_of(text, ("t", 1, "u", "z")) == 5
    assert line_of(text, ("t", 1, "v", 1, "w")) == 9
    assert line_of(text, ("t", 1, "u", "missing")) == 4


@pytest.mark.parametrize(
    ("table", "told"),
    [
        ('[solving]\nprofile = "papr"', "'measured' or 'paper'"),
        ("[solving.identification]\nk_heigth = 0.2", "did you mean k_height?"),
        ('[solving.identification]\nk_height = "wide"', "valid number"),
        ("[solving.identification]\nm_reg = 2.5", "valid integer"),
        ("[solving.identification]\nk_height = inf", "finite"),
        ("[solving.identification]\nv_min_ident = 70", "at most 1"),
        ("[solving.identification]\nk_rej = -3.0", "at least 0"),
        ("[solving.preliminary]\nm_reg = 0", "at least 1"),
        ("[solving.preliminary]\nr_rej = 20", "did you mean r_rej_px?"),
        ("[solving.measuring]\nthreshold = 6.0", "did you mean threshold_sigma?"),
    ],
)
def test_a_wrong_parameter_of_solving_is_told_with_its_line(table: str, told: str) -> None:
    with pytest.raises(BadSettings) as caught:
        Settings.parse(f"{table}\n{GOOD}")
    assert told in str(caught.value)
    assert "line 2: solving." in str(caught.value)


def test_single_parameters_lie_over_the_profile() -> None:
    text = '[solving]\nprofile = "paper"\n[solving.identification]\nmin_share = 0.5\n'
    solving = Settings.parse(text + GOOD).solving
    paper = IdentificationSettings.paper()
    assert solving.identification_settings == replace(paper, min_share=0.5)
    assert solving.measuring_settings == MeasuringSettings()
    assert solving.preliminary_settings == PreliminarySettings()
    assert Settings.parse(GOOD).solving.preliminary_settings == PreliminarySettings.measured()


@pytest.mark.parametrize(
    ("table", "line"),
    [
        ("identification", "angle_arcmin = 0.01"),  # asked numpy for 4 TiB
        ("identification", "angle_arcmin = 0"),
        ("identification", "stages = [[100, 100000]]"),
        ("identification", "stages = [[2, 50]]"),
        ("identification", f"stages = {[[20, 50]] * 9}"),
        ("identification", "frame_triangles = 1000000000"),
        ("identification", "tile_step = 0.001"),
        ("identification", "tile_radius = 1000.0"),
        ("identification", "corner_radius = 1000.0"),
        ("identification", "m_reg = 100000"),
        ("identification", "n_confirm_stars = 100000000"),
        ("identification", "outward_fields = 1e9"),
        ("identification", "fragments = 100000"),
        ("identification", "degree_max = 1000"),
        ("preliminary", "m_reg = 100000"),
        ("preliminary", "n_mea_reg = 10000000"),
        ("preliminary", "tries = 100000000"),
        ("measuring", "max_sources = 1000000000"),
        ("measuring", "box_px = 1"),
        ("measuring", "detection_sigma_px = 1e6"),
    ],
)
def test_what_costs_memory_has_a_bound_that_is_told(table: str, line: str) -> None:
    name = line.partition(" ")[0]
    with pytest.raises(BadSettings, match=rf"{name}.*(at most|at least)"):
        Settings.parse(f"{GOOD}\n[solving.{table}]\n{line}\n", name="o.toml")


def test_every_parameter_has_its_range() -> None:
    for kind in (IdentificationSettings, PreliminarySettings, MeasuringSettings):
        for field in dataclasses.fields(kind):
            if field.type not in ("bool", "tuple[Stage, ...]"):
                assert field.name in _RANGES, field
