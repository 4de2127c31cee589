"""What is fuzzed: each target takes any bytes, and raises nothing but what its parser promises."""

from __future__ import annotations

import contextlib
import io
import json
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from importlib import import_module
from pathlib import Path

import numpy as np
from astropy.io import fits
from PIL import Image

from api.alpaca.answering import MEMBERS, read_parameters
from api.alpaca.codec import BadParameter
from api.indi_server.parser import Hearing
from api.nova import codec as nova_codec
from api.nova import forms as nova_forms
from api.planetarium import lx200_codec, stellarium_codec
from api.solver.messages import BadAnswer, Done, Fault, Progress, Ready, read, written
from drivers.alpaca.codec import base as alpaca_codec
from drivers.alpaca.codec import exposure
from drivers.alpaca.discovery import Heard
from drivers.fakes.faults import parse_faults
from drivers.fakes.recording import read_dialogue
from drivers.indi.codec.messages import Reader
from drivers.indi.codec.state import Properties
from drivers.indi.codec.xml_stream import ElementStream
from drivers.registry import open_mount
from drivers.wire.command import Command, Unreadable
from mountnav.catalog.packed.format import decode_header as decode_packed
from mountnav.catalog.readers import open_reader
from mountnav.errors import BadFrame, BadRequest, BadSettings, MountnavError
from mountnav.identification.blind.file_format import Header, decode_header, encode_header
from mountnav.journal.reading import Mark
from mountnav.night.recording import read_recording
from mountnav.pointing.limits.horizon import Horizon
from mountnav.pointing.model.model import PointingModel
from mountnav.pointing.model.planning import read_run
from mountnav.pointing.model.tpoint_file import read_observations_text
from mountnav.pointing.observation import read_observations
from mountnav.reading import read_frame
from mountnav.reading.star_lists import is_star_list, read_star_list
from mountnav.settings.observatory import Settings
from mountnav.simulation.machine_file import MachineFile
from mountnav.simulation.pointing_errors import PointingErrors
from mountnav.simulation.sky_script import SkyScript
from mountnav.sky import typed_coordinates
from mountnav.sky.coordinates import Site
from tests.fuzz import ephemerides, files
from tests.reading.raw_files import dng
from tests.reading.xisf_files import xisf

CORPORA = Path(__file__).parent / "corpora"
"""A folder for each target: inputs that once broke it, or that reach far."""


@dataclass(frozen=True, slots=True)
class Target:
    """A parser under fuzz.

    Attributes
    ----------
    run : callable (bytes)
        Whatever it raises is a finding.
    seeds : callable () -> list of bytes
        Good inputs to begin with, beside the kept corpus.
    """

    run: Callable[[bytes], None]
    seeds: Callable[[], list[bytes]]


def corpus(name: str) -> list[bytes]:
    """The seeds of a target, and what is kept of it."""
    folder = CORPORA / name
    kept = [one.read_bytes() for one in sorted(folder.iterdir())] if folder.is_dir() else []
    return [*TARGETS[name].seeds(), *kept]


@contextlib.contextmanager
def _promised(*kinds: type[Exception]) -> Iterator[None]:
    """What a parser raises by its promise is an answer; an error of ours says something."""
    try:
        yield
    except kinds as told:
        if not str(told):
            raise AssertionError("an error without a word") from told


def _file(read_it: Callable[[Path], object], ending: str = "") -> Callable[[bytes], None]:
    """A parser that wants a path."""

    def run(data: bytes) -> None:
        path = files.folder() / f"input{ending}"
        path.write_bytes(data)
        with _promised(MountnavError):
            read_it(path)

    return run


def _bytes(read_it: Callable[[bytes], object]) -> Callable[[bytes], None]:
    """A parser that sees to its text itself."""

    def run(data: bytes) -> None:
        with _promised(MountnavError):
            read_it(data)

    return run


def _text(read_it: Callable[[str], object]) -> Callable[[bytes], None]:
    """A parser that wants text."""

    def run(data: bytes) -> None:
        with _promised(MountnavError):
            read_it(data.decode("utf-8", "replace"))

    return run


# -- frames --------------------------------------------------------------------------------------------------


def _frame(data: bytes) -> None:
    with _promised(BadFrame):
        frame = read_frame(data)
        assert frame.pixels.ndim == 2
        assert frame.exposure_s is None or math.isfinite(frame.exposure_s)


def _xisf_frames() -> list[bytes]:
    pixels = np.random.default_rng(2).integers(0, 60_000, (18, 20)).astype(np.uint16)
    keywords = {"DATE-OBS": "'2026-11-21T03:04:05.6'", "EXPTIME": "2.0", "FOCALLEN": "400", "XPIXSZ": "3.76"}
    packings = ("", "zlib", "zlib+sh", "lz4hc+sh", "zstd+sh")
    one_each = [xisf(pixels, packing=packing, keywords=keywords) for packing in packings]
    colors = np.stack([pixels] * 3).astype(np.float32)
    return [*one_each, xisf(colors, normal=True), xisf(pixels, packing="zlib", parts=3)]


def _raw_files() -> list[bytes]:
    mosaic = np.random.default_rng(5).integers(0, 60_000, (40, 48)).astype(np.uint16)
    return [dng(mosaic), dng(mosaic[:20, :32], pattern=bytes((1, 0, 2, 1)))]


def _frames() -> list[bytes]:
    rng = np.random.default_rng(1)
    pixels = rng.integers(0, 60_000, (20, 24)).astype(np.uint16)
    header = fits.Header()
    header["DATE-OBS"], header["EXPTIME"], header["OBJCTRA"] = "2026-11-21T03:04:05.6", 2.0, "05 40 12"
    header["OBJCTDEC"], header["FOCALLEN"], header["XPIXSZ"] = "+30 01 02", 400.0, 3.76
    header["BAYERPAT"], header["SITELAT"], header["SITELONG"] = "RGGB", "+48 10 00", "11 30 00"
    found = []
    for hdus in (
        [fits.PrimaryHDU(pixels, header)],
        [fits.PrimaryHDU(), fits.ImageHDU(pixels.astype(np.float32), header)],
        [fits.PrimaryHDU(), fits.CompImageHDU(pixels, header)],
        [fits.PrimaryHDU(), fits.CompImageHDU(pixels, header, compression_type="GZIP_2")],
    ):
        file = io.BytesIO()
        fits.HDUList(hdus).writeto(file)
        found.append(file.getvalue())
    for kind in ("PNG", "JPEG", "TIFF", "BMP"):
        file = io.BytesIO()
        Image.fromarray((pixels >> 8).astype(np.uint8)).save(file, kind)
        found.append(file.getvalue())
    import bz2
    import gzip

    return [*found, gzip.compress(found[0], mtime=0), bz2.compress(found[0])]


def _star_list(data: bytes) -> None:
    is_star_list(data)
    with _promised(BadFrame):
        found = read_star_list(data, "list")
        assert found.x_px.size == found.y_px.size == found.flux.size
        assert np.isfinite(found.x_px).all()
        assert np.isfinite(found.y_px).all()
        assert found.width_px > 0
        assert found.height_px > 0


def _star_lists() -> list[bytes]:
    columns = [fits.Column(name=name, format=form, array=np.arange(5.0)) for name, form in
               (("X", "E"), ("Y", "D"), ("FLUX", "J"), ("VIGNET", "1B"))]  # fmt: skip
    table = fits.BinTableHDU.from_columns(columns)
    table.header["IMAGEW"], table.header["IMAGEH"] = 640, 480
    file = io.BytesIO()
    fits.HDUList([fits.PrimaryHDU(), table]).writeto(file)
    return [
        file.getvalue(),
        b"x,y,flux\n1,2,3\n4.5,6e1,nan\n",
        b"#  1 X_IMAGE  x\n#  2 Y_IMAGE  y\n#  3 MAG_AUTO  m\n 1 2 -3.5\n 4 5 -6\n",
        b"10.5\t20.5\n11\t12\n",
    ]


# -- wires ---------------------------------------------------------------------------------------------------

_CODECS = {
    "lx200": (
        "codec.base",
        "codec.am5",
        "codec.onstep",
        "codec.tenmicron",
        "codec.gemini",
        "codec.astro_physics",
        "codec.dialect",
    ),
    "nexstar": ("codec.base", "codec.passthrough", "codec.dialect"),
    "ioptron": ("codec.v3", "codec.v2", "codec.greeting", "codec.dialect"),
    "skywatcher": ("codec",),
}


@cache
def _commands(family: str) -> tuple[Command[object], ...]:
    """Each question of a family whose reply can be read: the constants of its codecs, in dicts too."""
    found: list[Command[object]] = []
    for name in _CODECS[family]:
        module = import_module(f"drivers.{family}.{name}")
        for value in vars(module).values():
            many = (
                value.values() if isinstance(value, dict) else value if isinstance(value, tuple) else (value,)
            )
            found += [one for one in many if isinstance(one, Command)]
        for maker, arguments in _MADE.items():
            if hasattr(module, maker):
                with contextlib.suppress(TypeError):
                    made = getattr(module, maker)(*arguments)
                    found += [made] if isinstance(made, Command) else []
    if family == "skywatcher":
        codec = import_module("drivers.skywatcher.codec")
        axis = next(iter(codec.Axis))
        for maker in (
            "counts_per_turn",
            "timer_hz",
            "fast_ratio",
            "features",
            "status",
            "position",
        ):
            found.append(getattr(codec, maker)(axis))
        found.append(codec.board())
    return tuple(found)


_MADE: dict[str, tuple[object, ...]] = {
    "set_ra": (10.0,),
    "set_dec": (10.0,),
    "slew": (10.0, 20.0),
    "echo": (b"x",),
}


def _replies(family: str) -> Callable[[bytes], None]:
    def run(data: bytes) -> None:
        for command in _commands(family):
            for final in (False, True):
                with _promised(Unreadable):
                    found = command.read(data, final)
                    assert found is None or 0 <= found.length <= len(data)

    return run


_SAID = [
    b"05:35:17#", b"-05*23:28#", b"+89*59'59.9#", b"1", b"0", b"0Below horizon#", b"1Object#", b"AUTO#",
    b"nNpH#", b"n#", b"e5#", b"On-Step#", b"10micron GM1000HPS#", b"2026-11-21#", b"+002#", b"G\x00\x01#",
    b"12AB,4000#", b"12AB0500,40000500#", b"\x04\x15#", b"x#", b"0030#", b"+0123456789012345678901#",
    b"+12345678901234567890#", b"=\r", b"=000000\r", b"=563412\r", b"!0\r", b"=0210A1\r", b"=301\r",
]  # fmt: skip


def _xml(data: bytes) -> None:
    whole, parts = ElementStream(), ElementStream()
    together = whole.feed(data)
    pieces = [one for at in range(0, len(data), 7) for one in parts.feed(data[at : at + 7])]
    assert len(together) == len(pieces)


def _heard(data: bytes) -> None:
    hearing = Hearing()
    for at in range(0, len(data), 50):
        hearing.feed(data[at : at + 50])


def _indi_client(data: bytes) -> None:
    reader, properties = Reader(), Properties()
    for at in range(0, len(data), 50):
        for event in reader.feed(data[at : at + 50]):
            properties.take(event, _NOON, 1.0)
    for device in properties.devices():
        for name, one in properties.of(device).items():
            assert properties.get(device, name) == one
            for element in one.values:
                assert (one.number(element), one.on(element), one.text(element)) is not None


_NOON = datetime(2026, 11, 21, 12, tzinfo=UTC)
_TOLD = [
    b'<defNumberVector device="T" name="EQUATORIAL_EOD_COORD" state="Ok" perm="rw">'
    b'<defNumber name="RA" format="%m" min="0" max="24" step="0">5:35:17</defNumber>'
    b'<defNumber name="DEC" format="%m" min="-90" max="90" step="0">-5.4</defNumber></defNumberVector>'
    b'<setNumberVector device="T" name="EQUATORIAL_EOD_COORD" state="Busy" timestamp="2026-11-21T00:00:00">'
    b'<oneNumber name="RA">5.5</oneNumber></setNumberVector>',
    b'<defSwitchVector device="T" name="TELESCOPE_PARK" state="Idle" perm="rw" rule="OneOfMany">'
    b'<defSwitch name="PARK">Off</defSwitch></defSwitchVector><delProperty device="T"/>',
]


_XML = [
    b'<getProperties version="1.7"/><enableBLOB device="a">Never</enableBLOB>',
    b'<newNumberVector device="T" name="EQUATORIAL_EOD_COORD"><oneNumber name="RA">5:35:17</oneNumber>'
    b'<oneNumber name="DEC">-5.4</oneNumber></newNumberVector>',
    b'<newSwitchVector device="T" name="TELESCOPE_ABORT_MOTION"><oneSwitch name="ABORT">On</oneSwitch>'
    b"</newSwitchVector>",
    b'<setBLOBVector device="C" name="CCD1"><oneBLOB name="CCD1" size="3" format=".fits" enclen="4">'
    b"QUJD</oneBLOB></setBLOBVector>",
    b'<?xml version="1.0"?><!-- note --><message message="a &lt; b &#65;"/>',
]


def _lx200_server(data: bytes) -> None:
    buffer, turns = data, 0
    lx200_codec.is_http(data)
    while buffer:
        command, buffer = lx200_codec.cut(buffer)
        turns += 1
        assert turns <= len(data) + 1
        if command is None:
            break
        with _promised(ValueError):
            lx200_codec.plain_angle(command)


def _stellarium(data: bytes) -> None:
    reader = stellarium_codec.GotoStream()
    with _promised(ValueError):
        for at in range(0, len(data), 9):
            for goto in reader.feed(data[at : at + 9]):
                assert 0.0 <= goto.place.ra_deg < 360.0
                assert abs(goto.place.dec_deg) <= 90.0


def _alpaca(data: bytes) -> None:
    for kind in ("application/json", "application/imagebytes", "text/html"):
        with _promised(alpaca_codec.Malformed, MountnavError):
            value = alpaca_codec.read_answer(data, kind, 1).value
            for understood in (
                alpaca_codec.number,
                alpaca_codec.integer,
                alpaca_codec.truth,
                alpaca_codec.text,
                alpaca_codec.instant,
                alpaca_codec.named_values,
            ):
                with _promised(alpaca_codec.Malformed):
                    understood(value)
        with _promised(alpaca_codec.Malformed, MountnavError):
            exposure.read_image(data, kind, 1)


def _discovery(data: bytes) -> None:
    heard = Heard()
    heard.datagram_received(data, ("10.0.0.1", 32227))
    assert all(0 < int(one.rpartition(":")[2]) < 65536 for one in heard.addresses)


def _alpaca_parameters(data: bytes) -> None:
    text = data.decode("utf-8", "replace")
    for member in MEMBERS.values():
        given = {name: text for one in member.takes for name in (one.name, one.name.lower())}
        with _promised(BadParameter):
            read_parameters(member, given)


def _typed(data: bytes) -> None:
    text = data.decode("utf-8", "replace")
    for read_it in (
        typed_coordinates.read_target,
        typed_coordinates.read_position,
        typed_coordinates.read_ra_deg,
        typed_coordinates.read_dec_deg,
    ):
        with _promised(BadRequest):
            match read_it(text):
                case typed_coordinates.TypedPosition(ra_deg=ra_deg, dec_deg=dec_deg):
                    assert 0.0 <= ra_deg < 360.0
                    assert abs(dec_deg) <= 90.0
                case float(one):
                    assert -90.0 <= one < 360.0
                case _:
                    pass


def _mount_url(data: bytes) -> None:
    with _promised(BadSettings):
        open_mount(data.decode("utf-8", "replace"), site=Site(48.1, 11.6, 500.0))


_URLS = [
    b"lx200+serial:///dev/ttyUSB0?baud=9600&settle_s=2", b"onstep+tcp://192.168.1.1:9999?dtr=off",
    b"indi://localhost:7624/Telescope%20Simulator", b"alpaca+http://user:word@host:11111/telescope/0",
    b"skywatcher+udp://192.168.4.1:11880", b"nexstar+serial:///dev/ttyUSB0", b"ioptron+tcp://[::1]:8080",
]  # fmt: skip

_ALPACA = [
    b'{"Value": 12.5, "ClientTransactionID": 1, "ServerTransactionID": 2, "ErrorNumber": 0}',
    b'{"Value": "2026-11-21T03:04:05.1234567Z", "ClientTransactionID": 1, "ErrorNumber": 0}',
    b'{"Value": [{"Name": "Slewing", "Value": false}], "ClientTransactionID": 1, "ErrorNumber": 0}',
    b'{"Type": 2, "Rank": 2, "Value": [[1, 2], [3, 4]], "ClientTransactionID": 1, "ErrorNumber": 0}',
    b"".join(one.to_bytes(4, "little") for one in (1, 0, 1, 2, 44, 2, 2, 2, 2, 2, 0, 1, 2, 3, 4)),
]


def _solver_answer(data: bytes) -> None:
    with _promised(BadAnswer):
        read(data)


def _catalog(kind: str, ending: str) -> Callable[[bytes], None]:
    def read_it(path: Path) -> None:
        reader = open_reader(kind, path)
        for part in reader.parts():
            for _ in reader.read(part):
                pass

    return _file(read_it, ending)


_ECSV = b"""# %ECSV 1.0
# ---
# delimiter: ','
# datatype:
# - {name: source_id, datatype: int64}
# - {name: ra, datatype: float64, unit: deg}
# - {name: dec, datatype: float64, unit: deg}
# - {name: pmra, datatype: float64}
# - {name: pmdec, datatype: float64}
# - {name: ref_epoch, datatype: float64}
# - {name: phot_g_mean_mag, datatype: float64}
source_id,ra,dec,pmra,pmdec,ref_epoch,phot_g_mean_mag
1,10.0,20.0,1.0,2.0,2016.0,12.0
2,10.1,20.1,,,2016.0,null
"""

_CSV = _ECSV[_ECSV.index(b"source_id,") :]

_TPOINT = b"""label
:NODA
+48 10 00
10 20 30 +10 10 10 10 20 31 +10 10 11 10 25 30
END
"""
_EQMOD = (
    b'<aligndata>\n    <site name="a" lon="11.4" lat="47.27">\n        <point>\n'
    b"            <index>0</index>\n"
    b"            <synctime>5.0</synctime>\n            <celestialra>4.0</celestialra>\n"
    b"            <celestialde>40</celestialde>\n            <telescopera>4.01</telescopera>\n"
    b"            <telescopede>40.1</telescopede>\n        </point>\n    </site>\n</aligndata>\n"
)
_PMFIT = b"""label
E
48.1
 10.000000 +20.000000  10.010000 +20.010000
 50.000000 -20.000000  50.010000 -20.010000
"""
_SKY = b"""seed = 1
satellite_every = 5
[[clouds]]
from_min = 10
to_min = 20
[[incidents]]
at_min = 30
what = "silence"
for_s = 5.0
"""

_SETTINGS = b"""[site]
latitude_deg = 48.1
longitude_deg = 11.6
[solving.identification]
stages = [[12, 50]]
[[telescope]]
id = "east"
[telescope.mount]
url = "fake+lx200://"
[telescope.camera]
kind = "simulated"
"""


def _index_head(data: bytes) -> None:
    with _promised(BadSettings):
        header, _ = decode_header(data, file="index")
        header.layout()
        assert math.isfinite(header.epoch_yr)


def _json_lines(*lines: dict[str, object]) -> bytes:
    return "".join(json.dumps(one) + "\n" for one in lines).encode()


def _nova(data: bytes) -> None:
    """A request of the nova API: its form, in pieces, then its JSON and what that asks."""
    with _promised(nova_codec.NovaError):
        reader = nova_forms.Multipart(b"bound", 100_000)
        try:
            for at in range(0, len(data), 61):
                reader.feed(data[at : at + 61])
            given = nova_codec.read_request(reader.finish().json or b"")
        finally:
            reader.form.close()
        asked = nova_codec.read_asked(given)
        nova_codec.hint_of(asked, asked.width_px)
        if "x" in given:
            nova_codec.stars_text(given["x"], given.get("y"))


def _nova_requests() -> list[bytes]:
    asked = {
        "session": "a",
        "scale_type": "ul",
        "scale_units": "degwidth",
        "scale_lower": 0.5,
        "scale_upper": "2",
        "center_ra": 1.5,
        "center_dec": -2,
        "radius": 3,
        "image_width": 100,
        "parity": 2,
        "tweak_order": 0,
        "x": [1, 2.5],
        "y": [3, 4],
    }
    head = "Content-disposition: form-data; name="
    text = (
        f'--bound\r\n{head}"request-json"\r\n\r\n{json.dumps(asked)}\r\n'
        f'--bound\n{head}"file"; filename="a.fits"\r\n\r\n1 2\n3 4\n\r\n--bound--\r\n'
    )
    return [text.encode()]


TARGETS: dict[str, Target] = {
    "frame": Target(_frame, _frames),
    "frame-xisf": Target(_frame, _xisf_frames),
    "frame-raw": Target(_frame, _raw_files),
    "nova": Target(_nova, _nova_requests),
    "star-list": Target(_star_list, _star_lists),
    "settings": Target(_text(lambda text: Settings.parse(text)), lambda: [_SETTINGS]),
    "faults": Target(
        _text(lambda text: parse_faults(text)),
        lambda: [b'[random]\nseed = 7\nrate = 0.02\n[[fault]]\nkind = "late"\non = ":GR"\ndelay_s = 2.0\n'],
    ),
    "satellites": Target(_bytes(ephemerides.satellites), ephemerides.satellite_seeds),
    "elements": Target(_bytes(ephemerides.elements), ephemerides.element_seeds),
    "ephemeris-table": Target(_bytes(ephemerides.tables), ephemerides.table_seeds),
    "ephemeris-text": Target(
        _bytes(ephemerides.any_text),
        lambda: [*ephemerides.satellite_seeds()[:1], *ephemerides.table_seeds()[:1]],
    ),
    "ephemeris-import": Target(_file(ephemerides.imports, ".dat"), ephemerides.import_seeds),
    "ephemeris-kernel": Target(_file(ephemerides.kernels, ".bsp"), ephemerides.kernel_seeds),
    "dialogue": Target(
        _file(read_dialogue),
        lambda: [_json_lines({"t": 1.2, "dir": "driver->mount", "hex": "3a", "meaning": ""})],
    ),
    "night-recording": Target(
        _file(read_recording),
        lambda: [
            _json_lines(
                {"kind": "header", "version": 3}, {"kind": "event", "utc": "2026-11-21T00:00:00+00:00"}
            )
        ],
    ),
    "observations": Target(
        _file(read_observations),
        files.observations,
    ),
    "tpoint": Target(_text(lambda text: read_observations_text(text)), lambda: [_TPOINT, _PMFIT, _EQMOD]),
    "model": Target(_text(lambda text: PointingModel.from_json(text)), lambda: [files.model()]),
    "run": Target(_file(read_run), lambda: [b'# plan {"points": [], "fresh": [], "telescope": "a"}\n']),
    "horizon": Target(_file(Horizon.read), lambda: [b"# az alt\n0 10\n90 20\n180 15\n"]),
    "machine": Target(
        _file(MachineFile.from_toml), lambda: [b"[machine]\n[errors]\nih_arcsec = 2.0\n[clock]\n"]
    ),
    "errors": Target(_file(PointingErrors.from_toml), lambda: [b"ih_arcsec = 2.0\n"]),
    "sky-script": Target(_file(SkyScript.from_toml), lambda: [_SKY]),
    "blind-index": Target(
        _index_head, lambda: [encode_header(Header("c", "0" * 64, 2000.0, 10, [10], [10]))]
    ),
    "packed-header": Target(
        lambda data: _packed(data),
        lambda: [files.packed(), b"MNAVSTAR" + (2).to_bytes(4, "little") + (20).to_bytes(4, "little")],
    ),
    "gaia-csv": Target(_catalog("gaia", ".csv"), lambda: [_ECSV, _CSV, _ECSV.replace(b"# ", b"#", 1)]),
    "gaia-votable": Target(
        _catalog("gaia", ".vot"),
        lambda: [files.gaia_votable(), b"<?xml version='1.0'?><VOTABLE><RESOURCE/></VOTABLE>"],
    ),
    "gaia-fits": Target(files.catalog("gaia", "gaia.fits"), lambda: [files.gaia_fits()]),
    "gaia-parquet": Target(files.catalog("gaia", "gaia.parquet"), lambda: [files.gaia_parquet()]),
    "ucac4": Target(files.catalog("ucac4", files.UCAC4_NAME), lambda: [files.ucac4_zone()]),
    "usno-b1": Target(files.catalog("usno-b1", "b0010.cat"), lambda: [files.usno_zone()]),
    "astap": Target(files.catalog("astap", files.ASTAP_NAME), lambda: [files.astap_area()]),
    "siril": Target(files.catalog("siril", "siril_cat.dat"), lambda: [files.siril_file()]),
    "astrometry-net": Target(
        files.catalog("astrometry-net", "index-5206.fits"), lambda: [files.index_file()]
    ),
    "packed": Target(files.read_packed, lambda: [files.packed()]),
    "journal": Target(files.read_journal, lambda: [files.journal()]),
    "indi-blob": Target(files.blob, files.blobs),
    "lx200": Target(_replies("lx200"), lambda: _SAID),
    "nexstar": Target(_replies("nexstar"), lambda: _SAID),
    "ioptron": Target(_replies("ioptron"), lambda: _SAID),
    "skywatcher": Target(_replies("skywatcher"), lambda: _SAID),
    "indi-xml": Target(_xml, lambda: _XML),
    "indi-client": Target(_indi_client, lambda: _TOLD),
    "indi-server": Target(_heard, lambda: _XML),
    "lx200-server": Target(
        _lx200_server, lambda: [b":GR#:Sr05:35:17#:Sd-05*23:28#:MS#", b"\x06:Q#", b"GET / HTTP/1.1"]
    ),
    "stellarium": Target(
        _stellarium, lambda: [(20).to_bytes(2, "little") + bytes(10) + (1 << 30).to_bytes(4, "little") * 2]
    ),
    "alpaca": Target(_alpaca, lambda: _ALPACA),
    "alpaca-discovery": Target(_discovery, lambda: [b'{"AlpacaPort": 11111}', b'{"AlpacaPort": [[]]}']),
    "alpaca-parameters": Target(
        _alpaca_parameters, lambda: [b"12.5", b"-1", b"true", b"2026-11-21T03:04:05.1234567Z", b"1e-3"]
    ),
    "typed": Target(_typed, lambda: [b"05:35:17 -05:23:28", b"83.82, -5.39", b"5h35m17s -5d23m28s", b"M 42"]),
    "mount-url": Target(_mount_url, lambda: _URLS),
    "solver-answer": Target(
        _solver_answer,
        lambda: [
            written(one) for one in (Ready(1.0, ("x",)), Progress(0.5), Done(fault=Fault("BadFrame", "x")))
        ],
    ),
    "cursor": Target(
        _text(lambda text: Mark.decoded(text)), lambda: [b"WyIyMDI2LTExLTIxVDAwOjAwOjAwKzAwOjAwIiwxLDJd"]
    ),
}


def _packed(data: bytes) -> None:
    with _promised(BadSettings, BadRequest):
        decode_packed(data, file="packed")
