"""`mountnav night`: a running service's nights: their state, and begun, ended, paused and resumed."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import typer

from api.cli.options import TelescopeOptions, takes_options
from api.cli.output import answering, print_json

night_app = typer.Typer(help="The nights of a running service.", no_args_is_help=True)

Order = Literal["start", "stop", "pause", "resume"]

LONGEST_S = 90.0
"""For an answer: an order that ends a correction waits for its end, which is a slew and a settling. chosen by
hand; with less, an order that was carried out is reported as unanswered."""


@dataclass(frozen=True, kw_only=True)
class NightOrderOptions(TelescopeOptions):
    """Options of an order to a night."""

    why: Annotated[str, typer.Option(help="The reason, in your words; the journal keeps it.")] = ""


@night_app.command()
@takes_options(TelescopeOptions)
def status(options: TelescopeOptions) -> None:
    """Show the night's phase, what was measured and corrected, and the drift so far."""
    _print_night(options)


@night_app.command()
@takes_options(NightOrderOptions)
def start(options: NightOrderOptions) -> None:
    """Begin now, whatever the Sun says."""
    _print_night(options, "start", options.why)


@night_app.command()
@takes_options(NightOrderOptions)
def stop(options: NightOrderOptions) -> None:
    """End tonight's; the next night begins by itself."""
    _print_night(options, "stop", options.why)


@night_app.command()
@takes_options(NightOrderOptions)
def pause(options: NightOrderOptions) -> None:
    """Correct nothing until `resume`; frames are still measured."""
    _print_night(options, "pause", options.why)


@night_app.command()
@takes_options(NightOrderOptions)
def resume(options: NightOrderOptions) -> None:
    """Go on after `pause`."""
    _print_night(options, "resume", options.why)


def _print_night(options: TelescopeOptions, order: Order | None = None, why: str = "") -> None:
    """Give the order, if there is one, and print the night. Raises `ServiceError`, `DeviceMissing`."""
    import httpx

    from mountnav.client import ServiceError

    headers = {"Authorization": f"Bearer {options.token}"} if options.token else {}
    path = f"/v1/telescopes/{options.telescope}/night"
    with (
        answering(options.service),
        httpx.Client(base_url=options.service, headers=headers, timeout=LONGEST_S, trust_env=False) as http,
    ):
        answer = http.get(path) if order is None else http.post(f"{path}/{order}", json={"why": why})
    if answer.is_error:
        raise ServiceError(answer.json(), answer.status_code)
    night: dict[str, Any] = answer.json()
    if options.as_json:
        print_json(night, indent=1)
    else:
        sys.stdout.write(shown(night))


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
