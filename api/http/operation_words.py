"""What each operation of the interface does, refuses and answers, in words: for people who read `/docs`.

The docstring of a route says what it does. Here stand, by the name of the operation, a summary for menus,
what is refused or fails, and what comes back. What is the same for all orders is said once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from api.access.roles import ROLES

__all__ = ["OPERATIONS", "say_what_it_does"]


@dataclass(frozen=True, slots=True)
class Words:
    """Words about one operation.

    Attributes
    ----------
    summary : str
        Up to about six words.
    answer : str
        What a success holds.
    refuses : str
        What is refused, or makes the job fail, beyond what goes for all; "" for nothing.
    """

    summary: str
    answer: str
    refuses: str = ""


_JOB = "The job. It has been written down and goes on; `GET /v1/jobs/{id}` and the events follow it"
_ORDER = (
    "Refused at once, without a job: a body that makes no sense (422 `bad-request`); a second order while a "
    "job holds the telescope (409 `busy`; see `supersede`); an order of others than the holder of the lease "
    "(409 `leased`). What the limits, the sky or the mount forbid ends the job as failed; `problem` says why."
)
"""Goes for each route that starts a job."""
_NO_MOTION_UNTRUSTED = (
    "Fails outside the limits (`outside-limits`), and with `device-refused` while the mount is parked or its "
    "position isn't trusted."
)
_NIGHT = "The night as it stands afterwards"
_NO_NIGHT = "404 where the settings have no night for this telescope."

OPERATIONS: dict[str, Words] = {
    "get_metrics": Words("Metrics for Prometheus", "Text, one line for each figure"),
    "list_audit": Words(
        "Who ordered what",
        "A page of rows; `next_cursor` leads to the next one",
    ),
    "get_capabilities": Words(
        "What this service can do", "The lists; those of a telescope are of what its mount can do now"
    ),
    "list_catalogs": Words("Star catalogs", "The catalogs, in the sequence in which they are asked"),
    "follow_events": Words(
        "Events of all telescopes",
        "A stream of server-sent events that doesn't end",
        "If events after `Last-Event-ID` are no longer kept, the stream begins by saying how many.",
    ),
    "get_health": Words(
        "Health of the service", "Each part with its state; not a measure of a single request"
    ),
    "get_live": Words("Is the process alive?", "It is"),
    "get_ready": Words("Is the service ready?", "Orders are taken"),
    "list_jobs": Words("Jobs of all telescopes", "Jobs, newest first"),
    "get_job": Words(
        "One job",
        "The job as it stands",
        "404 for a job that isn't remembered, or belongs to a telescope that the key is not for.",
    ),
    "cancel_job": Words(
        "Cancel a job",
        "The job. Its mount has been told to stop, if it was this job's",
        "Anybody who may operate the telescope may cancel; no lease is needed.",
    ),
    "cancel_job_by_post": Words(
        "Cancel a job (by POST)",
        "The job. Its mount has been told to stop, if it was this job's",
        "Anybody who may operate the telescope may cancel; no lease is needed.",
    ),
    "follow_job_events": Words(
        "Events of one job",
        "A stream of server-sent events that ends with the job",
        "404 for an unknown job.",
    ),
    "next_panel": Words(
        "Go on to the next panel",
        "How many frames of the panel are still wanted",
        "422 if the job is no mosaic, is over, or hasn't centered its panel yet; 409 `leased` for others "
        "than the holder of the lease.",
    ),
    "list_journal": Words("The journal", "A page of lines; `next_cursor` leads to the next one"),
    "list_runs": Words("Starts of the service", "One row for each start"),
    "search_objects": Words(
        "Find objects by name",
        "Objects with their place now; an empty list if nothing has such a name. An object whose elements "
        "are too old has a `problem` in place of its position",
    ),
    "reload_settings": Words(
        "Read the settings again",
        "What was added, changed and taken out, and what needs a restart",
        "422 for settings with a mistake, 409 `busy` while a telescope that is to change is not idle.",
    ),
    "solve_upload": Words(
        "Solve an image file",
        "The solution, or why there is none: see `solved`",
        "The body is the file itself. 413 if it is too large, 422 `bad-frame` if it is no image that can be "
        "read.",
    ),
    "stop_all": Words(
        "Stop all telescopes",
        "Each telescope has been told to stop, or wasn't connected: see `telescopes`",
        "Never refused as busy or for want of a lease.",
    ),
    "list_telescopes": Words("All telescopes", "One state for each telescope"),
    "get_telescope": Words("State of a telescope", "Its state, with an ETag that names this reading"),
    "acknowledge_notice": Words(
        "Acknowledge the notice of a restart", "The notice that was acknowledged; null if there was none"
    ),
    "start_job": Words("Give any order", _JOB, _ORDER),
    "slew_telescope": Words("Slew to a place", _JOB, f"{_NO_MOTION_UNTRUSTED} {_ORDER}"),
    "center_telescope": Words(
        "Center a target",
        _JOB,
        f"{_NO_MOTION_UNTRUSTED} Fails with `solve-failed` if no frame can be identified, and with "
        "`target-not-reached` if corrections don't bring it nearer. A doubtful frame is never synced on. "
        f"{_ORDER}",
    ),
    "flip_telescope": Words(
        "Flip to the other pier side",
        _JOB,
        "Only for German mounts. Fails with `target-not-reached` (reason `wrong-side`) while the target "
        f"hasn't crossed the meridian far enough. {_ORDER}",
    ),
    "rotate_telescope": Words(
        "Turn the field", _JOB, f"Fails where no rotator is configured, or none answers. {_ORDER}"
    ),
    "mosaic_telescope": Words("Center the panels of a mosaic", _JOB, f"{_NO_MOTION_UNTRUSTED} {_ORDER}"),
    "search_with_telescope": Words(
        "Search round a place", _JOB, f"{_NO_MOTION_UNTRUSTED} Steps beyond a limit are left out. {_ORDER}"
    ),
    "follow_telescope": Words("Follow a moving target", _JOB, f"{_NO_MOTION_UNTRUSTED} {_ORDER}"),
    "look_telescope": Words(
        "Take a frame and solve it",
        _JOB,
        f"Fails with `solve-failed` if the frame can't be identified. {_ORDER}",
    ),
    "sync_telescope": Words(
        "Sync the mount on a frame",
        _JOB,
        "Fails with `sync-refused` where the frame or the mount leaves a doubt: its `reasons` name each one. "
        f"{_ORDER}",
    ),
    "recover_telescope": Words(
        "Find out where a lost mount points",
        _JOB,
        f"Fails if the looks don't agree, or if the place lies outside the limits. {_ORDER}",
    ),
    "first_light_telescope": Words(
        "First light of a new telescope", _JOB, f"Fails if the telescope is more than 10° off. {_ORDER}"
    ),
    "hold_telescope": Words("Hold the target still", _JOB, _ORDER),
    "dither_telescope": Words(
        "Move by a step of a dither pattern", _JOB, f"Fails if looks don't show it settled in time. {_ORDER}"
    ),
    "offset_telescope": Words("Nudge the telescope", _JOB, f"{_NO_MOTION_UNTRUSTED} {_ORDER}"),
    "move_telescope_axis": Words(
        "Move an axis by hand",
        _JOB,
        "Fails where the mount can't move its axes at a rate; ends before a limit is reached. " + _ORDER,
    ),
    "set_telescope_rates": Words(
        "Track at rates of its own",
        _JOB,
        "Fails where the mount can't keep such rates, or where they lead outside the limits before the end. "
        f"{_ORDER}",
    ),
    "track_telescope": Words(
        "Switch tracking on or off", _JOB, f"Fails for a rate that the mount hasn't. {_ORDER}"
    ),
    "park_telescope": Words(
        "Park",
        _JOB,
        "Fails with `target-not-reached` if the mount comes to rest elsewhere: don't close a roof over it "
        f"then. {_ORDER}",
    ),
    "unpark_telescope": Words("Unpark", _JOB, f"A mount that isn't parked stays as it is. {_ORDER}"),
    "home_telescope": Words("Go to the home position", _JOB, f"Fails where the mount has no home. {_ORDER}"),
    "trust_telescope": Words(
        "Say that the position is right",
        _JOB,
        "Nothing checks it: a wrong word lets the telescope move by a wrong position. `recover` asks the sky "
        f"instead. {_ORDER}",
    ),
    "doctor_telescope": Words(
        "Will the star catalogs do?",
        "Each catalog's verdict over the sky of this camera, and what would help",
    ),
    "get_drift": Words(
        "Drift of the mount",
        "The rates with their errors; null for what the looks don't tell",
    ),
    "follow_telescope_events": Words(
        "Events of one telescope",
        "A stream of server-sent events that doesn't end",
        "404 for an unknown telescope.",
    ),
    "get_forecast": Words(
        "What a named target will do",
        "Its place and rate now, and its events in the sequence of time",
        "404 for a name that isn't found.",
    ),
    "make_forecast": Words(
        "What any target will do",
        "Its place and rate now, and its events in the sequence of time",
        "422 for a target that makes no sense, or whose ephemeris doesn't reach the present.",
    ),
    "list_frames": Words(
        "Frames of the night", "Frames, newest first, with what was done about each", _NO_NIGHT
    ),
    "send_frame": Words(
        "Send a science frame",
        "The frame's id; it is measured in the background",
        "The body is the file itself, or JSON with the path of a file in a folder that the settings allow "
        f"(422 elsewhere). 409 `busy` while too many frames wait. {_NO_NIGHT}",
    ),
    "get_frame": Words(
        "One frame of the night", "The frame as far as it is known", "404 for an unknown frame."
    ),
    "list_telescope_jobs": Words("Jobs of one telescope", "Jobs, newest first"),
    "get_last_frame": Words("The last frame, in numbers", "Its stars and where it looked"),
    "get_last_frame_picture": Words("The last frame, as a picture", "WebP", "404 before the first look."),
    "release_lease": Words(
        "Give a lease back",
        "The telescope is free",
        "409 `lease-lost` without the secret of the lease; `force` ends another's, by the role configure.",
    ),
    "get_lease": Words(
        "Who holds the telescope", "The holder; `held` is false if there is none. Never the secret"
    ),
    "take_lease": Words(
        "Take a lease",
        "The lease with its secret, which is told this once",
        "409 `leased` if somebody else holds it; `force` breaks that, by the role configure.",
    ),
    "keep_lease": Words(
        "Keep a lease (heartbeat)",
        "The lease, which lasts for its `ttl_s` again",
        "409 `lease-lost` if it ran out.",
    ),
    "get_limits": Words(
        "Where the telescope may point", "The limits of the settings; null for what isn't limited"
    ),
    "list_looks": Words("Looks of a telescope", "A page of looks; `next_cursor` leads to the next one"),
    "get_night": Words("State of the night", "The night", _NO_NIGHT),
    "start_night": Words(
        "Begin the night", _NIGHT, f"409 `leased` for anybody but the holder of the lease. {_NO_NIGHT}"
    ),
    "stop_night": Words("End the night", _NIGHT, _NO_NIGHT),
    "pause_night": Words("Pause corrections", _NIGHT, _NO_NIGHT),
    "resume_night": Words(
        "Resume corrections", _NIGHT, f"409 `leased` for anybody but the holder of the lease. {_NO_NIGHT}"
    ),
    "say_busy": Words("Say that an exposure runs", _NIGHT, _NO_NIGHT),
    "say_safety": Words(
        "Say whether it is safe", _NIGHT, f"While it is unsafe, nothing is corrected. {_NO_NIGHT}"
    ),
    "get_offsets": Words(
        "Offsets of the last looks", "The offsets in the sequence of time, with their drift"
    ),
    "get_diagnosis": Words(
        "What is wrong with the pointing", "Each finding with its evidence and what to do"
    ),
    "get_sky": Words("The sky over the telescope", "The sky at this moment"),
    "stop_telescope": Words(
        "Stop a telescope",
        "It has been told to stop",
        "Never refused as busy or for want of a lease. 502, 503 or 504 mean that the stop may NOT have "
        "arrived: look at the mount.",
    ),
    "get_tonight": Words("The night at a glance", "What a strip over the night's hours is drawn from"),
    "get_wire": Words("Messages to and from the mount", "JSON lines; nothing if nothing has been said yet"),
    "get_version": Words("Version", "The version"),
    "get_truth": Words("Truth of a virtual observatory", "Time, and where each tube truly looks"),
    "skip_time": Words("Pass over a stretch of virtual time", "The virtual present, and how it was reached"),
}
"""By the name of the operation, which is its `operationId`."""

_BODIES = {
    "start_job": "The order; `kind` says which",
    "make_forecast": "The target, and how far ahead",
    "send_frame": "The file itself, or JSON with the path of a file on the service's machine",
    "solve_upload": "The file itself (FITS, XISF, camera raw or picture), or a form with a part `file`",
    "take_lease": "How long it lasts without a heartbeat, and what is done when it runs out",
    "skip_time": "Until when",
}
"""Of bodies that are no order's and say nothing themselves; the others are `_BODY_OF_ORDER`."""
_BODY_OF_ORDER = "The order's details"
_EXAMPLES: dict[str, Any] = {
    "telescope_id": "newton",
    "telescope": "newton",
    "job_id": "5f0e3c1a9d2b4e67",
    "frame_id": "n20261126-0042",
    "night_id": "2026-11-26",
    "since": "2026-11-26T18:00:00Z",
    "until": "2026-11-27T06:00:00Z",
    "wait": 30.0,
    "Prefer": "wait=30",
    "Idempotency-Key": "3f8c9a52-7d1e-4b0f-9c55-0a6d2c7e1b44",
    "Last-Event-ID": "1042",
    "limit": 100,
    "count": 20,
    "cursor": "4711",
    "hours": 12.0,
    "caller": "survey",
    "kind": ["sync", "refusal"],
    "outcome": "refused",
    "text": "horizon",
    "q": "M31",
    "name": "Jupiter",
    "ra_deg": 83.633,
    "dec_deg": 22.014,
    "target_ra_deg": 83.633,
    "target_dec_deg": 22.014,
    "radius_deg": 5.0,
    "scale_low_arcsec_px": 1.9,
    "scale_high_arcsec_px": 2.1,
    "budget_s": 30.0,
    "after": 0,
    "most": 500,
}
"""Of parameters, by their name."""
_ENTITY_TAG = "if-none-match"


def say_what_it_does(schema: dict[str, Any]) -> None:
    """Put the words into an OpenAPI document, and examples beside its parameters.

    Parameters
    ----------
    schema : dict
        Changed in place. Operations that have no words here keep what they have.
    """
    for path, operations in schema["paths"].items():
        for method, operation in operations.items():
            words = OPERATIONS.get(operation["operationId"])
            if words is not None:
                _say(operation, words, f"{method.upper()} {path}")
            for parameter in operation.get("parameters", ()):
                example = _EXAMPLES.get(parameter["name"])
                if parameter["name"].lower() == _ENTITY_TAG:
                    example = '"7c1f20"'
                if example is not None:
                    parameter.setdefault("example", example)


def _say(operation: dict[str, Any], words: Words, route: str) -> None:
    operation["summary"] = words.summary
    parts = [operation.get("description", "").strip(), words.refuses, _role_of(route)]
    operation["description"] = "\n\n".join(part for part in parts if part)
    for answer in operation["responses"].values():
        if answer.get("description") == "Successful Response":
            answer["description"] = words.answer
    body = operation.get("requestBody")
    if body is not None:
        body.setdefault("description", _BODIES.get(operation["operationId"], _BODY_OF_ORDER))


def _role_of(route: str) -> str:
    """What a key needs for it, in a sentence."""
    if route not in ROLES:
        return ""
    role = ROLES[route]
    return "Needs no key." if role is None else f"Needs the role `{role.value}`."
