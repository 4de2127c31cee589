"""A process: a program at one face of a service, that has the mount go on and lives as its kind does.

Arguments: the face ("http", "http-leased", "alpaca", "indi", "indi-mute", "lx200"), what goes on ("axis" or
"rates"), host and port. It prints "in force" when the mount was told, and goes on talking as such programs
do: an ASCOM program polls twice a second, an LX200 app asks for the position, an INDI client answers pings
("indi-mute": an old one, which knows none), a program of ours sends heartbeats and repeats what it holds.
"""

from __future__ import annotations

import json
import re
import socket
import sys
import threading
import time
from http.client import HTTPConnection
from typing import Any
from urllib.parse import urlencode

RATES_ARCSEC_S = (6.0, -4.0)
SIDEREAL_ARCSEC_S = 15.041067
EAST = "/v1/telescopes/east"
LEASE_S = 5.0
"""The shortest there is."""
HELD_S = 2.0
RATES_S = 6.0


def told() -> None:
    """The mount was told."""
    print("in force", flush=True)


class Http:
    """Requests on one connection, as most libraries send them."""

    def __init__(self, host: str, port: int) -> None:
        self._connection = HTTPConnection(host, port)
        self.headers: dict[str, str] = {}
        self.begun = False

    def ask(self, method: str, path: str, body: str | None = None, kind: str = "application/json") -> Any:
        """One request; its answer as JSON."""
        headers = self.headers | ({} if body is None else {"Content-Type": kind})
        self._connection.request(method, path, body, headers)
        answer = self._connection.getresponse()
        text = answer.read()
        # on a busy machine the order before may still run: it is given again
        assert answer.status < 300 or (self.begun and answer.status == 409), text
        return json.loads(text) if text else None

    def fastest_deg_s(self) -> float:
        """Of the axis that is moved; some mounts have steps, and take nothing between."""
        spans = self.ask("GET", "/api/v1/telescope/0/axisrates?Axis=1&ClientID=7")["Value"]
        return float(max(span["Minimum"] for span in spans))

    def post(self, path: str, **body: object) -> Any:
        """An order of ours, to its end if it is short."""
        return self.ask("POST", EAST + path, json.dumps(body))


def http(host: str, port: int, what: str, *, leased: bool) -> None:
    """By our own interface, with a lease or without."""
    client = Http(host, port)
    if leased:
        lease = client.post("/lease", ttl_s=LEASE_S, on_expiry="stop")
        client.headers["Mountnav-Lease"] = lease["lease"]
    ra_arcsec_s, dec_arcsec_s = RATES_ARCSEC_S
    speed_deg_s = client.fastest_deg_s()
    first = True
    while True:
        if what == "axis":
            client.post("/move-axis", axis="secondary", rate_deg_s=-speed_deg_s, for_s=HELD_S)
        elif first:
            # with a lease for as long as that lasts, else renewed before their end
            for_s = 600.0 if leased else RATES_S
            client.post("/offset-rates", ra_arcsec_s=ra_arcsec_s, dec_arcsec_s=dec_arcsec_s, for_s=for_s)
        elif not leased:
            client.post("/offset-rates", ra_arcsec_s=ra_arcsec_s, dec_arcsec_s=dec_arcsec_s, for_s=RATES_S)
        if leased and not first:
            client.ask("PUT", f"{EAST}/lease")
        if first:
            told()
        first, client.begun = False, True
        time.sleep(0.5 if what == "axis" else 1.5)


def alpaca(host: str, port: int, what: str) -> None:
    """By Alpaca."""
    client, number = Http(host, port), 7
    base = "/api/v1/telescope/0/"

    def put(member: str, **form: object) -> None:
        body = urlencode(form | {"ClientID": number, "ClientTransactionID": 1})
        answer = client.ask("PUT", base + member, body, "application/x-www-form-urlencoded")
        assert answer["ErrorNumber"] == 0, answer

    put("connected", Connected=True)
    if what == "axis":
        put("moveaxis", Axis=1, Rate=-client.fastest_deg_s())
    else:
        put("rightascensionrate", RightAscensionRate=RATES_ARCSEC_S[0] / SIDEREAL_ARCSEC_S)
    told()
    while True:
        client.ask("GET", f"{base}slewing?ClientID={number}")
        time.sleep(0.5)


def indi(host: str, port: int, what: str, *, mute: bool) -> None:
    """By INDI, of our server or of an `indiserver` before it."""
    connection = socket.create_connection((host, port))
    connection.sendall(b"<getProperties version='1.7'/>")
    pressed = threading.Event()

    def press() -> None:
        if what == "axis":
            say("Switch", "TELESCOPE_MOTION_NS", MOTION_SOUTH="On")
            return
        ra_arcsec_s, dec_arcsec_s = RATES_ARCSEC_S
        rates = {"TRACK_RATE_RA": SIDEREAL_ARCSEC_S - ra_arcsec_s, "TRACK_RATE_DE": dec_arcsec_s}
        say("Number", "TELESCOPE_TRACK_RATE", **{name: f"{value:.6f}" for name, value in rates.items()})
        say("Switch", "TELESCOPE_TRACK_MODE", TRACK_CUSTOM="On")

    def say(kind: str, name: str, **elements: str) -> None:
        inside = "".join(f"<one{kind} name='{key}'>{value}</one{kind}>" for key, value in elements.items())
        connection.sendall(
            f"<new{kind}Vector device='east' name='{name}'>{inside}</new{kind}Vector>".encode()
        )

    heard, wanted = b"", b"TELESCOPE_MOTION_NS" if what == "axis" else b"TELESCOPE_TRACK_MODE"
    while data := connection.recv(65_536):
        heard = (heard + data)[-200_000:]
        if not mute:
            for uid in re.findall(rb"<pingRequest uid=[\"']([^\"']*)[\"']", data):
                connection.sendall(b"<pingReply uid='" + uid + b"'/>")
        if not pressed.is_set() and wanted in heard:
            press()
            pressed.set()
            heard = b""
            told()


def lx200(host: str, port: int, what: str) -> None:
    """By LX200, a key held down."""
    assert what == "axis"
    connection = socket.create_connection((host, port))
    connection.sendall(b":RM#:Ms#")
    told()
    while True:
        connection.sendall(b":GR#")
        if not connection.recv(100):
            return
        time.sleep(0.5)


def main() -> None:
    """Live as the arguments say."""
    face, what, host, port = sys.argv[1:]
    match face:
        case "http" | "http-leased":
            http(host, int(port), what, leased=face == "http-leased")
        case "alpaca":
            alpaca(host, int(port), what)
        case "indi" | "indi-mute":
            indi(host, int(port), what, mute=face == "indi-mute")
        case "lx200":
            lx200(host, int(port), what)


if __name__ == "__main__":
    main()
