"""The frozen interface: `python -m api.http.openapi` writes docs/openapi.json; a test compares them."""

from __future__ import annotations

import json
from pathlib import Path

from api.http.app import create_app
from mountnav.settings.observatory import Settings

FROZEN_PATH = Path(__file__).resolve().parents[2] / "docs" / "openapi.json"

_ANY_SETTINGS = """
[site]
latitude_deg = 0.0
longitude_deg = 0.0
[[telescope]]
id = "any"
mount = { url = "fake+lx200://" }
camera = { kind = "simulated" }
"""


def openapi_text() -> str:
    """Write out the OpenAPI description, with the keys in a fixed order."""
    schema = create_app(Settings.parse(_ANY_SETTINGS)).openapi()
    return json.dumps(schema, indent=1, sort_keys=True, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    FROZEN_PATH.write_text(openapi_text(), encoding="utf-8")
