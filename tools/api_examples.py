"""Ask a virtual observatory for the answers that the description of the interface shows as examples.

python tools/api_examples.py && python -m api.http.openapi
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import httpx

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
sys.path.insert(0, str(ROOT / "tools"))

from docs_pictures import served  # noqa: E402

from api.http.examples import ANSWERS_PATH, BODIES  # noqa: E402

_KEPT = 2
"""Entries of a list that are shown."""
_DIGITS = 6
"""Of numbers: more says nothing to a reader."""


def cut(value: Any) -> Any:
    """A value with short lists and short numbers."""
    if isinstance(value, dict):
        return {key: cut(one) for key, one in value.items()}
    if isinstance(value, list):
        return [cut(one) for one in value[:_KEPT]]
    return round(value, _DIGITS) if isinstance(value, float) else value


def asked(url: str) -> dict[str, Any]:
    """Order a centering, then ask for everything.

    Parameters
    ----------
    url : str
        Of the service.

    Returns
    -------
    dict
        Answers by the name of their schema.
    """
    found: dict[str, Any] = {}
    east = f"{url}/v1/telescopes/demo"
    with httpx.Client(timeout=120.0) as client:

        def get(schema: str, path: str, **parameters: str) -> None:
            answer = client.get(path, params=parameters)
            answer.raise_for_status()
            found[schema] = answer.json()

        body = {"target": {"kind": "name", "name": "Capella"}}
        job = client.post(f"{east}/center", json=body, params={"wait": "110"})
        job.raise_for_status()
        found["JobView"] = job.json()
        get("TelescopeView", east)
        get("LimitsView", f"{east}/limits")
        get("SkyView", f"{east}/sky")
        get("LookOffsetsView", f"{east}/offsets")
        get("LastFrameView", f"{east}/last-frame")
        get("ForecastView", f"{east}/forecast", name="Jupiter")
        get("JournalPageView", f"{url}/v1/journal", newest_first="true")
        get("HealthView", f"{url}/v1/health")
        get("ReadyView", f"{url}/v1/health/ready")
        get("LiveView", f"{url}/v1/health/live")
        get("VersionView", f"{url}/v1/version")
        found["StopView"] = client.post(f"{east}/stop").json()
        found["StopAllView"] = client.post(f"{url}/v1/stop").json()
        taken = client.post(f"{east}/lease", json=BODIES["LeaseBody"]).json()
        found["TakenLeaseView"] = taken
        get("LeaseView", f"{east}/lease")
        refused = client.post(f"{east}/slew", json=body, headers={"Mountnav-Lease": "another"})
        found["Problem"] = refused.json()
    return found


def main() -> None:
    with served() as service:
        found = cut(asked(service.url))
    text = json.dumps(found, indent=1, sort_keys=True, ensure_ascii=False)
    # nobody's own machine
    text = text.replace(service.url, "http://localhost:8000").replace(str(Path.home()), "/home/observer")
    ANSWERS_PATH.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
