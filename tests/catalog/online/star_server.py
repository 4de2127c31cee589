"""A real HTTP server that answers cones as VizieR, TAP and cone search services do, in good and bad moods.

The answers are shaped like real ones: the header and INFO elements of VizieR and of DaCHS' TAP, a database
that is down, an overflow told behind the table. The stars are those of the embedded catalog.
"""

from __future__ import annotations

import gzip
import re
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import parse_qs, urlsplit

import numpy as np

from mountnav.catalog.embedded import embedded_catalog
from mountnav.catalog.stars import Stars
from mountnav.sky.coordinates import Icrs

VIZIER = """<?xml version="1.0" encoding="UTF-8"?>
<VOTABLE version="1.4" xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance"
  xmlns="http://www.ivoa.net/xml/VOTable/v1.3"
  xsi:schemaLocation="http://www.ivoa.net/xml/VOTable/v1.3 http://www.ivoa.net/xml/VOTable/v1.3">
 <DESCRIPTION>
   VizieR Astronomical Server vizier.example
    Date: 2026-07-05T21:24:43 [V7.5.6]
   Explanations and Statistics of UCDs:			See LINK below
   In case of problem, please report to:	somebody@example
   In this version, NULL integer columns are written as an empty string
   &lt;TD&gt;&lt;/TD&gt;, explicitely possible from VOTable-1.3
 </DESCRIPTION>
<!-- VOTable description at http://www.ivoa.net/Documents/latest/VOT.html -->
<INFO ID="VERSION" name="votable-version" value="1.99+ (14-Oct-2013)"/>
<INFO ID="MaxTuples" name="-out.max" value="40000"/>
"""
TYCHO2_FIELDS = """
  <COOSYS ID="J2000" system="eq_FK5" equinox="J2000"/>
  <TABLE ID="I_259_tyc2" name="I/259/tyc2">
    <DESCRIPTION>*The Tycho-2 main catalogue</DESCRIPTION>
    <FIELD name="pflag" ucd="meta.code" datatype="char" arraysize="1"/>
    <FIELD name="RAmdeg" ucd="pos.eq.ra" ref="J2000" datatype="double" width="12" precision="8" unit="deg">
      <DESCRIPTION>? Mean Right Asc, ICRS, epoch J2000 (3)</DESCRIPTION><VALUES null="NaN" />
    </FIELD>
    <FIELD name="DEmdeg" ucd="pos.eq.dec" ref="J2000" datatype="double" width="12" precision="8" unit="deg">
      <VALUES null="NaN" />
    </FIELD>
    <FIELD name="e_RAmdeg" ucd="stat.error;pos.eq.ra" datatype="float" unit="mas"/>
    <FIELD name="e_DEmdeg" ucd="stat.error;pos.eq.dec" datatype="float" unit="mas"/>
    <FIELD name="EpRAm" ucd="time.epoch" datatype="float" unit="yr"/>
    <FIELD name="EpDEm" ucd="time.epoch" datatype="float" unit="yr"/>
    <FIELD name="pmRA" ucd="pos.pm;pos.eq.ra" datatype="float" unit="mas/yr"/>
    <FIELD name="pmDE" ucd="pos.pm;pos.eq.dec" datatype="float" unit="mas/yr"/>
    <FIELD name="e_pmRA" ucd="stat.error;pos.pm;pos.eq.ra" datatype="float" unit="mas/yr"/>
    <FIELD name="e_pmDE" ucd="stat.error;pos.pm;pos.eq.dec" datatype="float" unit="mas/yr"/>
    <FIELD name="BTmag" ucd="phot.mag;em.opt.B" datatype="float" unit="mag"><VALUES null="NaN" /></FIELD>
    <FIELD name="VTmag" ucd="phot.mag;em.opt.V" datatype="float" unit="mag"><VALUES null="NaN" /></FIELD>
    <FIELD name="RA(ICRS)" ucd="pos.eq.ra;meta.main" ref="J2000" datatype="double" unit="deg"/>
    <FIELD name="DE(ICRS)" ucd="pos.eq.dec;meta.main" ref="J2000" datatype="double" unit="deg"/>
<DATA><TABLEDATA>
"""
DACHS = """<?xml version='1.0' encoding='utf-8'?>
<VOTABLE version="1.5" xmlns="http://www.ivoa.net/xml/VOTable/v1.3">
 <COOSYS ID="system" epoch="J2000.0" system="ICRS"/>
 <RESOURCE type="results">
  <INFO name="request" value="/tap/sync"/>
  <INFO name="QUERY_STATUS" value="OK">Query successful</INFO>
"""
OWN_FIELDS = """  <TABLE name="stars">
   <FIELD ID="raj2000" datatype="double" name="raj2000" ref="system" ucd="pos.eq.ra;meta.main" unit="deg"/>
   <FIELD ID="dej2000" datatype="double" name="dej2000" ref="system" ucd="pos.eq.dec;meta.main" unit="deg"/>
   <FIELD datatype="float" name="e_ra" ucd="stat.error;pos.eq.ra" unit="deg"/>
   <FIELD datatype="float" name="e_dec" ucd="stat.error;pos.eq.dec" unit="deg"/>
   <FIELD datatype="double" name="pmra" ucd="pos.pm;pos.eq.ra" unit="deg/yr">
    <DESCRIPTION>Proper motion, cos(Dec) applied</DESCRIPTION></FIELD>
   <FIELD datatype="double" name="pmde" ucd="pos.pm;pos.eq.dec" unit="deg/yr"/>
   <FIELD datatype="float" name="vmag" ucd="phot.mag;em.opt.V" unit="mag"/>
   <DATA><TABLEDATA>
"""
NO_DATABASE = (
    VIZIER
    + """<INFO ID="Error" name="Error" value="The database is not currently reachable." />
<INFO name="Error" value=" " />
<INFO name="Error" value=" -- no connection" />
<INFO name="QUERY_STATUS" value="ERROR">

 -- no connection
 Report from: stdb_pg,     Status: STDB_ERR
Postgres connect error
</INFO>
<RESOURCE>
</RESOURCE>
</VOTABLE>
"""
)
TAP_ERROR = """<?xml version="1.0" encoding="UTF-8"?>
<VOTABLE version="1.3" xmlns="http://www.ivoa.net/xml/VOTable/v1.3">
 <RESOURCE type="results">
  <INFO name="QUERY_STATUS" value="ERROR">Field query: No such table: no.such</INFO>
 </RESOURCE>
</VOTABLE>
"""
CONE_ERROR = """<?xml version="1.0"?>
<VOTABLE version="1.0" xmlns="http://www.ivoa.net/xml/VOTable/v1.0">
  <DESCRIPTION>Browse data service</DESCRIPTION>
  <RESOURCE ID="error_resource">
   <PARAM ID="Error" name="Error" datatype="char" arraysize="*" value="DEC parameter out-of-range"/>
  </RESOURCE>
</VOTABLE>
"""
HTML = """<!DOCTYPE html><html><head><title>Please log in to the observatory's network</title></head>
<body>portal</body></html>"""

Mood = Callable[["Answering"], None]


class StarServer(ThreadingHTTPServer):
    """The server; `mood` says how it answers, `asked` what it was asked."""

    daemon_threads = True
    request_queue_size = 64

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Answering)
        self.mood: Mood = good
        self.asked: list[str] = []
        self.most_rows = 10**9
        self.over = threading.Event()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}"

    def handle_error(self, request: object, client_address: object) -> None:
        """Clients that hang up are part of the play."""


class Answering(BaseHTTPRequestHandler):
    server: StarServer

    def do_GET(self) -> None:
        self.server.asked.append(self.path)
        self.server.mood(self)

    def log_message(self, format: str, *args: object) -> None:
        pass

    @property
    def query(self) -> dict[str, str]:
        return {key: values[-1] for key, values in parse_qs(urlsplit(self.path).query).items()}

    def stars(self) -> Stars:
        """Those of the circle that is asked for, as they stood in 2000."""
        query = self.query
        if "QUERY" in query:
            found = re.search(r"CIRCLE\('ICRS', ([^,]+), ([^,]+), ([^)]+)\)", query["QUERY"])
            assert found is not None
            ra, dec, radius = (float(one) for one in found.groups())
        elif "SR" in query:
            ra, dec, radius = (float(query[key]) for key in ("RA", "DEC", "SR"))
        else:
            ra, dec = (float(one) for one in query["-c"].split())
            radius = float(query["-c.rd"])
        return embedded_catalog().cone(Icrs(ra, dec), radius, epoch_yr=2000.0)

    def send(
        self, body: str | bytes, *, status: int = 200, kind: str = "text/xml", packing: str = ""
    ) -> None:
        content = body.encode() if isinstance(body, str) else body
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        if packing:
            self.send_header("Content-Encoding", packing)
        self.end_headers()
        self.wfile.write(content)


def tycho2_votable(stars: Stars, end: str = "") -> str:
    """As VizieR gives I/259/tyc2. Every fifth star has no BT, those without a proper motion no mean place."""
    rows = []
    for n in range(len(stars)):
        place = f"{stars.ra_deg[n]:.9f}", f"{stars.dec_deg[n]:.9f}"
        moves = np.isfinite(stars.pm_dec_mas_yr[n])
        mean = place if moves else ("", "")
        bt, vt = ("", stars.mag[n]) if n % 5 == 0 else (stars.mag[n] + 0.545, stars.mag[n] + 0.045)
        sigma = 1000.0 * stars.sigma_arcsec[n]
        motion = (
            f"<TD>{stars.pm_ra_cosdec_mas_yr[n]:.4f}</TD><TD>{stars.pm_dec_mas_yr[n]:.4f}</TD><TD>1.0</TD><TD>1.0</TD>"
            if moves
            else "<TD></TD><TD></TD><TD></TD><TD></TD>"
        )
        rows.append(
            f"<TR><TD>{'' if moves else 'X'}</TD><TD>{mean[0]}</TD><TD>{mean[1]}</TD>"
            f"<TD>{sigma:.3f}</TD><TD>{sigma:.3f}</TD><TD>2000.0</TD><TD>2000.0</TD>{motion}"
            f"<TD>{bt if bt == '' else f'{bt:.4f}'}</TD><TD>{vt:.4f}</TD>"
            f"<TD>{place[0]}</TD><TD>{place[1]}</TD></TR>"
        )
    return (
        VIZIER
        + '<RESOURCE ID="yCat_1259" name="I/259">'
        + TYCHO2_FIELDS
        + "\n".join(rows)
        + f"\n</TABLEDATA></DATA>\n</TABLE>\n{end}</RESOURCE>\n</VOTABLE>\n"
    )


def own_votable(stars: Stars, end: str = "", fields: str = OWN_FIELDS) -> str:
    """As a TAP service gives a table of its own; lengths in degrees, as some do."""
    rows = []
    for n in range(len(stars)):
        sigma = stars.sigma_arcsec[n] / 3600.0
        values = [f"{stars.ra_deg[n]:.10f}", f"{stars.dec_deg[n]:.10f}", f"{sigma:.6e}", f"{sigma:.6e}"]
        for motion in (stars.pm_ra_cosdec_mas_yr[n], stars.pm_dec_mas_yr[n]):
            values.append("NaN" if np.isnan(motion) else f"{motion / 3.6e6:.9e}")
        values.append(f"{stars.mag[n]:.4f}")
        rows.append("<TR>" + "".join(f"<TD>{one}</TD>" for one in values) + "</TR>")
    return (
        DACHS
        + fields
        + "\n".join(rows)
        + f"\n   </TABLEDATA></DATA>\n  </TABLE>\n{end} </RESOURCE>\n</VOTABLE>\n"
    )


def votable(answering: Answering, end: str = "", most: int | None = None) -> str:
    stars = answering.stars()
    most = min(answering.server.most_rows, 10**9 if most is None else most)
    if len(stars) > most:
        end = '<INFO name="QUERY_STATUS" value="OVERFLOW">truncated result</INFO>\n' if most < 10**9 else end
        stars = stars.only(np.arange(most))
    return (own_votable if "QUERY" in answering.query or "SR" in answering.query else tycho2_votable)(
        stars, end
    )


# --- moods


def good(answering: Answering) -> None:
    answering.send(votable(answering))


def packed(answering: Answering) -> None:
    answering.send(gzip.compress(votable(answering).encode()), packing="gzip")


def silent(answering: Answering) -> None:
    answering.server.over.wait(30)


def trickling_body(answering: Answering) -> None:
    content = votable(answering).encode()
    answering.send_response(200)
    answering.send_header("Content-Length", str(len(content)))
    answering.end_headers()
    for byte in content:
        answering.wfile.write(bytes([byte]))
        if answering.server.over.wait(0.05):
            return


def trickling_headers(answering: Answering) -> None:
    answering.wfile.write(b"HTTP/1.1 200 OK\r\nX-Long: ")
    while not answering.server.over.wait(0.05):
        answering.wfile.write(b"x")


def cut_body(answering: Answering) -> None:
    content = votable(answering).encode()
    answering.send_response(200)
    answering.send_header("Content-Length", str(len(content)))
    answering.end_headers()
    answering.wfile.write(content[: len(content) // 2])


def cut_without_length(answering: Answering) -> None:
    content = votable(answering).encode()
    answering.send_response(200)
    answering.end_headers()
    answering.wfile.write(content[: len(content) * 2 // 3])


def cut_gzip(answering: Answering) -> None:
    content = gzip.compress(votable(answering).encode())
    answering.send(content[: len(content) // 2], packing="gzip")


def reset(answering: Answering) -> None:
    answering.connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    answering.connection.close()


def broken(answering: Answering) -> None:
    answering.send("<html><head><title>500 Internal</title></head></html>", status=500, kind="text/html")


def no_database(answering: Answering) -> None:
    answering.send(NO_DATABASE)


def tap_error(answering: Answering) -> None:
    answering.send(TAP_ERROR, status=400)


def tap_error_with_200(answering: Answering) -> None:
    answering.send(TAP_ERROR)


def cone_error(answering: Answering) -> None:
    answering.send(CONE_ERROR)


def overflow_told_behind(answering: Answering) -> None:
    answering.send(
        votable(answering, '<INFO name="QUERY_STATUS" value="OVERFLOW">truncated (maxtup=2)</INFO>\n')
    )


def web_page(answering: Answering) -> None:
    answering.send(HTML, kind="text/html")


def garbage(answering: Answering) -> None:
    answering.send(bytes(range(256)) * 40, kind="application/octet-stream")


def nothing(answering: Answering) -> None:
    answering.send("")


def broken_xml(answering: Answering) -> None:
    answering.send(votable(answering).replace("</TD></TR>", "</TD></TZ>", 1))


def entities(answering: Answering) -> None:
    bomb = '<!DOCTYPE VOTABLE [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;">]>\n<VOTABLE'
    answering.send(votable(answering).replace("<VOTABLE", bomb, 1))


def gzip_bomb(answering: Answering) -> None:
    start = votable(answering).encode()
    answering.send(gzip.compress(start + b" " * 40_000_000, compresslevel=1), packing="gzip")


def odd_packing(answering: Answering) -> None:
    answering.send(votable(answering), packing="br")


def wrong_units(answering: Answering) -> None:
    answering.send(votable(answering).replace('unit="deg"', 'unit="arcmin/s"'))


def hours(answering: Answering) -> None:
    text = re.sub(r"<TD>(\d+\.\d{9})</TD><TD>(-?\d+\.\d{9})</TD>", _in_hours, votable(answering))
    answering.send(text)


def _in_hours(place: re.Match[str]) -> str:
    return f"<TD>{float(place[1]) / 15.0:.9f}</TD><TD>{place[2]}</TD>"


def sexagesimal(answering: Answering) -> None:
    text = votable(answering).replace('datatype="double"', 'datatype="char" arraysize="12"')
    answering.send(text.replace('unit="deg"', 'unit="&quot;h:m:s&quot;"'))


def no_positions(answering: Answering) -> None:
    answering.send(re.sub(r"<TD>-?\d+\.\d{9}</TD>", "<TD></TD>", votable(answering)))


def galactic(answering: Answering) -> None:
    answering.send(votable(answering).replace('system="eq_FK5"', 'system="galactic"'))


def other_columns(answering: Answering) -> None:
    answering.send(votable(answering).replace('name="VTmag"', 'name="Hpmag"').replace('"BTmag"', '"Hp2"'))


def empty_table(answering: Answering) -> None:
    answering.send(tycho2_votable(answering.stars().only(np.zeros(0, dtype=int))))


def no_table(answering: Answering) -> None:
    answering.send(VIZIER + "<RESOURCE>\n</RESOURCE>\n</VOTABLE>\n")


def redirect_loop(answering: Answering) -> None:
    _redirect(answering, answering.path)


def redirect_elsewhere(answering: Answering) -> None:
    _redirect(answering, "http://elsewhere.invalid/votable")


def redirect_nowhere(answering: Answering) -> None:
    _redirect(answering, "http://[elsewhere")


def redirected(answering: Answering) -> None:
    """Once, on the same server."""
    if answering.path.startswith("/moved"):
        answering.send(votable(answering))
    else:
        _redirect(answering, "/moved" + answering.path)


def _redirect(answering: Answering, to: str) -> None:
    answering.send_response(302)
    answering.send_header("Location", to)
    answering.send_header("Content-Length", "0")
    answering.end_headers()


@contextmanager
def star_server() -> Iterator[StarServer]:
    server = StarServer()
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
    thread.start()
    try:
        yield server
    finally:
        server.over.set()
        server.shutdown()
        server.server_close()
        thread.join()
