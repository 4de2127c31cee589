"""`mountnav night`: asks a running service about a telescope's night, or tells it what to do."""

from __future__ import annotations

import json
import sys
from typing import Any

import httpx

from mountnav.client import ServiceError
from mountnav.errors import DeviceMissing

LONGEST_S = 90.0
"""An order that ends a correction waits for its end."""


def run(telescope: str, word: str | None, *, why: str, service: str, token: str | None, as_json: bool) -> int:
    """Print the night of a telescope of a service, after an order if one is given.

    Parameters
    ----------
    telescope : str
    word : {"start", "stop", "pause", "resume"} or None
    why, service, token
        As of the options.
    as_json : bool

    Returns
    -------
    int
        0.

    Raises
    ------
    ServiceError
        The service refuses.
    DeviceMissing
        There is no service.
    """
    headers = {"Authorization": f"Bearer {token}"} if token else {}
    path = f"/v1/telescopes/{telescope}/night"
    try:
        with httpx.Client(base_url=service, headers=headers, timeout=LONGEST_S, trust_env=False) as http:
            answer = http.get(path) if word is None else http.post(f"{path}/{word}", json={"why": why})
    except httpx.HTTPError as cause:
        raise DeviceMissing(
            f"no mountnav service answers: {cause}", device=service, advice="start it, or give --service"
        ) from cause
    if answer.is_error:
        raise ServiceError(answer.json(), answer.status_code)
    night: dict[str, Any] = answer.json()
    sys.stdout.write(json.dumps(night, indent=1) + "\n" if as_json else shown(night))
    return 0


def shown(night: dict[str, Any]) -> str:
    """A night in lines for people."""
    lines = [
        f"{night['telescope']}: {night['phase']}" + (f" ({night['night_id']})" if night["night_id"] else "")
    ]
    for hold in night["holds"]:
        why = f": {night['unsafe_why']}" if hold == "not safe" and night["unsafe_why"] else ""
        lines.append(f"  nothing is corrected: {hold}{why}")
    if night["sun_altitude_deg"] is not None:
        lines.append(f"  Sun at {night['sun_altitude_deg']:+.1f}°")
    lines.append(
        f"  {night['frames']} frames, {night['placed']} identified, {night['waiting']} waiting; "
        f"{night['corrections']} corrections by {night['correct_by']}"
    )
    plate = night["calibration"]
    if plate is not None:
        lines.append(f"  {plate['scale_arcsec_px']:.3f} ″/px, {plate['rotation_deg']:.1f}°")
    drift = night["drift"]
    if drift is not None:
        lines.append(f"  field {drift['field']}, {drift['frames']} frames: {_off(drift)}")
        if drift["ra_cosdec_arcsec_min"] is not None:
            lines.append(
                f"  drift RA {drift['ra_cosdec_arcsec_min']:+.2f} ± "
                f"{drift['ra_cosdec_sigma_arcsec_min']:.2f} ″/min (times cos δ), Dec "
                f"{drift['dec_arcsec_min']:+.2f} ± {drift['dec_sigma_arcsec_min']:.2f} ″/min"
            )
    last = night["last"]
    if last is not None:
        text = f" ({last['text']})" if last["text"] else ""
        lines.append(f"  last: {last['act']}, {last['why']}{text}")
    for key in ("folder_problem", "recording_problem"):
        if night[key]:
            lines.append(f"  {night[key]}")
    return "\n".join(lines) + "\n"


def _off(drift: dict[str, Any]) -> str:
    last = drift["last"]
    return (
        f"off by {last['total_arcsec']:.1f}″ ({last['east_arcsec']:+.1f}″ east, "
        f"{last['north_arcsec']:+.1f}″ north)"
    )
