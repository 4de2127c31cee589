"""Alpaca's management answers, unique ids and setup pages [Alpaca §6].

A telescope's UniqueID is made once, kept beside the journal, and never changed. The setup pages change
nothing.
"""

from __future__ import annotations

import json
import logging
import os
import tempfile
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path
from uuid import NAMESPACE_URL, UUID, uuid4, uuid5

from api.alpaca.codec import Page
from api.alpaca.telescope import AlpacaTelescope
from mountnav import __version__
from mountnav.files import locked
from mountnav.journal.database import database_url, file_of, state_folder
from mountnav.parsing import json_of
from mountnav.settings.observatory import Settings

__all__ = ["ids_path", "management_value", "server_page", "telescope_page", "unique_ids"]


_log = logging.getLogger(__name__)


def ids_path(settings: Settings) -> Path:
    """Where the ids of a service of these settings lie: beside its journal."""
    journal = file_of(database_url(settings.journal.where))
    return (state_folder() if journal is None else journal.parent) / "alpaca-ids.json"


def unique_ids(path: Path, telescopes: Sequence[str]) -> dict[str, str]:
    """The UniqueID of each telescope; one that has none yet gets one, which is written down first.

    Where nothing can be written down they follow from the machine's name and the telescope's: better than
    ids that change with each start, and it is logged. A file that can't be read is never written over.

    Parameters
    ----------
    telescopes : sequence of str
        Ids of the settings.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # two services may share a folder
        with locked(path.with_suffix(".lock")):
            known = _read(path)
            fresh = {telescope: str(uuid4()) for telescope in telescopes if telescope not in known}
            if fresh:
                known |= fresh
                _write(path, known)
    except (OSError, ValueError) as error:
        _log.warning("the Alpaca ids in %s can't be kept, and are made of names: %s", path, error)
        return {
            telescope: str(uuid5(NAMESPACE_URL, f"mountnav://{os.uname().nodename}/{telescope}"))
            for telescope in telescopes
        }
    return {telescope: known[telescope] for telescope in telescopes}


def _read(path: Path) -> dict[str, str]:
    """Raises ValueError for a file that holds anything else."""
    if not path.exists():
        return {}
    found = json_of(path.read_text(encoding="utf-8"))
    if not isinstance(found, dict):
        raise ValueError("it holds no ids")
    return {str(name): str(UUID(str(value))) for name, value in found.items()}


def _write(path: Path, ids: dict[str, str]) -> None:
    with tempfile.NamedTemporaryFile(
        "w", encoding="utf-8", dir=path.parent, prefix=path.name, delete=False
    ) as file:
        json.dump(ids, file, indent=1, sort_keys=True)
        file.flush()
        os.fsync(file.fileno())
    Path(file.name).replace(path)


def management_value(page: Page, devices: Sequence[AlpacaTelescope], location: str) -> object:
    """The value of one of the management's answers.

    Parameters
    ----------
    location : str
        Of the settings.
    """
    match page:
        case "apiversions":
            return [1]
        case "description":
            return {
                "ServerName": "mountnav",
                "Manufacturer": "mountnav",
                "ManufacturerVersion": __version__,
                "Location": location,
            }
        case "configureddevices":
            return [
                {
                    "DeviceName": device.name,
                    "DeviceType": "Telescope",
                    "DeviceNumber": device.number,
                    "UniqueID": device.unique_id,
                }
                for device in devices
            ]


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
