"""Two plain pages for people: what this server is, how a telescope is set; nothing is changed [Alpaca §6]."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

from api.alpaca.telescope import AlpacaTelescope
from mountnav import __version__

_STYLE = (
    "body{font:16px/1.5 system-ui,sans-serif;max-width:46rem;margin:2rem auto;padding:0 1rem;"
    "background:#111;color:#ddd}a{color:#8bf}table{border-collapse:collapse}"
    "th,td{text-align:left;padding:.2rem 1rem .2rem 0;vertical-align:top}th{font-weight:normal;color:#999}"
)


def server_page(devices: Sequence[AlpacaTelescope]) -> str:
    """The page of the server."""
    rows = [
        (f"Telescope {device.number}", _link(f"/setup/v1/telescope/{device.number}/setup", device.id))
        for device in devices
    ]
    body = (
        f"<h1>mountnav {escape(__version__)}</h1>"
        "<p>Each telescope of this service is an ASCOM Alpaca telescope (ITelescopeV4) at this address.</p>"
        f"{_table(rows)}"
        "<p>What is set stands in the service's settings file; it is changed there, and not here.</p>"
        '<p><a href="/">The main page</a></p>'
    )
    return _page("mountnav: Alpaca", body)


def telescope_page(device: AlpacaTelescope) -> str:
    """The page of a telescope: its settings, and what it can."""
    mount, limits = device.mount, device.mount.limits
    site = mount.site
    state = device.snapshot.state
    rows = [
        ("Telescope", device.id),
        ("Device number", str(device.number)),
        ("UniqueID", device.unique_id),
        ("Mount", mount.name),
        ("Connected", "yes" if device.link.is_up() else f"no: {state.problem or 'it does not answer'}"),
        ("Mounting", mount.mounting or "not known"),
        ("Coordinates", "J2000 (ICRS)" if mount.epoch == "icrs" else "of date (JNow)"),
        ("Can", ", ".join(sorted(str(skill) for skill in mount.skills)) or "slew, sync, stop"),
        (
            "Site",
            f"latitude {site.latitude_deg:.5f}°, longitude {site.longitude_deg:.5f}° (east positive), "
            f"{site.height_m:.0f} m",
        ),
        ("Altitudes allowed", f"{limits.min_altitude_deg:g}° to {limits.max_altitude_deg:g}°"),
        ("Connected from the start", "yes" if device.settings.alpaca.auto_connect else "no"),
    ]
    body = (
        f"<h1>{escape(device.id)}</h1>"
        f"{_table((name, escape(value)) for name, value in rows)}"
        "<p>What is set stands in the service's settings file; it is changed there, and not here.</p>"
        '<p><a href="/">The main page</a> · <a href="/setup">All telescopes</a></p>'
    )
    return _page(f"mountnav: {device.id}", body)


def _link(where: str, words: str) -> str:
    return f'<a href="{escape(where)}">{escape(words)}</a>'


def _table(rows: Iterable[tuple[str, str]]) -> str:
    """Of names and pieces of HTML."""
    lines = "".join(f"<tr><th scope=row>{escape(name)}</th><td>{value}</td></tr>" for name, value in rows)
    return f"<table>{lines}</table>"


def _page(title: str, body: str) -> str:
    return (
        '<!DOCTYPE html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{_STYLE}</style></head><body>{body}</body></html>"
    )


__all__ = ["server_page", "telescope_page"]
