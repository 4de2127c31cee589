"""An operator's commands to a running service: status, stop, center, follow, look, sync, park, track, watch.

All are calls of the HTTP API, as any other program makes them, and all end in one way. Exit codes: 0 done, 1
refused, failed or not known, 2 what was typed makes no sense, 130 interrupted; what was ordered goes on in
the service then. With ``--json`` one object goes to the standard output, however it ended::

    {"command": "center", "ok": false, "telescope": "east", "answer": null, "problem": {"detail": ...}}

`answer` is the API's own (a job, a state, ...), `problem` a problem of RFC 9457. Words of trouble go to the
standard error.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from api.cli.operate_targets import MovingTargetOptions, TargetOptions
from api.cli.options import LOCAL_SERVICE, ChosenTelescope, ServiceOptions, takes_options
from api.cli.output import print_json
from mountnav.errors import BadRequest, BadSettings, MountnavError
from mountnav.units import duration_text

if TYPE_CHECKING:
    from mountnav.client import Client
    from mountnav.client.results import Job, TelescopeState

__all__ = [
    "center",
    "follow",
    "look",
    "park",
    "reload",
    "slew",
    "status",
    "stop",
    "sync",
    "track",
    "unpark",
    "watch",
]

_USAGE, _FAILED = 2, 1
"""Exit codes: what was typed makes no sense; refused, failed or not known."""
_BAD_SLUGS = frozenset({"bad-request", "not-found"})
"""Problems of what was typed, not of a telescope."""

_RATE_WORDS: dict[str, Literal["lunar", "solar", "king"]] = {
    "lunar": "lunar",
    "solar": "solar",
    "king": "king",
}
Exposure = Annotated[float | None, typer.Option("--exposure", min=0.001, max=600, help="Seconds.")]


@dataclass(frozen=True, kw_only=True)
class OneOrAll(ServiceOptions):
    """Options of what is asked of one telescope, or of all."""

    telescope: Annotated[
        str | None, typer.Argument(help="Which one; all of them if left out.", show_default=False)
    ] = None


@dataclass(frozen=True, kw_only=True)
class BriefOptions(ServiceOptions):
    """Options of an order to one telescope that ends at once."""

    telescope: ChosenTelescope = None


@dataclass(frozen=True, kw_only=True)
class OrderOptions(BriefOptions):
    """Options of an order to one telescope."""

    detach: Annotated[
        bool, typer.Option("--detach", help="Exit as soon as it has begun; it goes on in the service.")
    ] = False


@dataclass(frozen=True, kw_only=True)
class MoveOptions(OrderOptions):
    """Options of an order that may take the place of another."""

    supersede: Annotated[
        bool, typer.Option("--supersede", help="End the job that holds the telescope, and take its place.")
    ] = False


@dataclass(slots=True)
class _Said:
    """What a command has to tell at its end."""

    command: str
    as_json: bool
    telescope: str | None = None
    answer: Any = None
    problem: dict[str, Any] | None = None
    words: list[str] = field(default_factory=list)
    code: int = 0

    def fail(self, problem: dict[str, Any], code: int = _FAILED) -> None:
        """It did not go well."""
        self.problem, self.code = problem, code

    def end(self) -> None:
        """Print it, and leave with its code."""
        if self.as_json:
            print_json(
                {
                    "command": self.command,
                    "ok": self.code == 0,
                    "telescope": self.telescope,
                    "answer": self.answer,
                    "problem": self.problem,
                },
                ascii_only=False,
            )
        else:
            for line in self.words:
                typer.echo(line)
        if self.problem is not None and not self.as_json:
            typer.echo(f"mountnav: {_problem_words(self.problem)}", err=True)
        if self.code:
            raise typer.Exit(self.code)


@contextmanager
def _telling(command: str, service: str, as_json: bool) -> Iterator[_Said]:
    """Whatever goes wrong in a command ends in one way."""
    said = _Said(command, as_json)
    try:
        import httpx

        from mountnav.client import ServiceError

        try:
            yield said
        except ServiceError as error:
            found = dict(error.problem)
            said.fail(found, _USAGE if error.slug in _BAD_SLUGS else _FAILED)
        # an unsupported protocol is a transport error too
        except (httpx.InvalidURL, httpx.UnsupportedProtocol) as error:
            said.fail(
                {
                    "title": "no address",
                    "detail": f"that is not the address of a service: {error}",
                    "device": service,
                    "advice": f"like {LOCAL_SERVICE}",
                },
                _USAGE,
            )
        except (httpx.TransportError, OSError) as error:
            said.fail(
                {
                    "title": "no service",
                    "detail": f"no mountnav service answers: {error or type(error).__name__}",
                    "device": service,
                    "advice": "start it, or give --service",
                }
            )
    except (BadRequest, BadSettings) as error:
        said.fail(_problem_of(error), _USAGE)
    except MountnavError as error:
        said.fail(_problem_of(error))
    said.end()


def _problem_of(error: MountnavError) -> dict[str, Any]:
    from mountnav.masking import masked

    return {
        "title": type(error).__name__,
        "detail": masked(error.what),
        "device": error.device,
        "advice": error.advice,
    }


def _problem_words(problem: dict[str, Any]) -> str:
    from mountnav.masking import masked

    said = str(problem.get("detail") or problem.get("title") or "refused")
    device, advice = problem.get("device"), problem.get("advice")
    text = f"{device}: {said}" if device else said
    return masked(f"{text} ({advice})" if advice else text)


# -- stop: it needs nothing but an address ---------------------------------------------------------------


@takes_options(OneOrAll)
def stop(options: OneOrAll) -> None:
    """Stop all motion now: of one telescope, or of all.

    Never refused as busy or leased. It asks for nothing before it is sent, and is sent again if its answer
    is lost. Exit code 1 unless every mount is known to have been told.
    """
    telescope = options.telescope
    with _asking("stop", options) as (said, client):
        said.telescope = telescope
        told: dict[str, Any]
        if telescope is not None:
            told = dict(client.stop(telescope))
            parts = [told]
        else:
            told = dict(client.stop_all())
            parts = list(told.get("telescopes") or [])
        said.answer = told
        said.words += [_stopped(part) for part in parts]
        if told.get("stopped") is not True:
            known = told.get("stopped") is False
            said.fail(
                {
                    "title": "not stopped" if known else "not known",
                    "detail": "not every mount could be told to stop"
                    if known
                    else "whether every mount was told to stop is not known yet; the service goes on trying",
                    "advice": "look at the mount, and at `mountnav status`",
                }
            )


# -- the settings read again ------------------------------------------------------------------------------


@takes_options(ServiceOptions)
def reload(options: ServiceOptions) -> None:
    """Have the service read its settings file again: telescopes are added, changed and taken out.

    All others go on meanwhile. One that is changed or taken out must be idle; whatever is wrong is told, and
    nothing is changed then. Needs a key with the role configure.
    """
    with _asking("reload", options) as (said, client):
        told = client.reload()
        said.answer = told
        named: list[tuple[str, list[str]]] = [
            ("added", told["added"]),
            ("changed", told["changed"]),
            ("taken out", told["removed"]),
        ]
        lines = [f"{word}: {', '.join(ids)}" for word, ids in named if ids]
        said.words += lines or ["all telescopes are as they were"]
        if told["needs_restart"]:
            said.words.append(f"counts from the next start on: {', '.join(told['needs_restart'])}")


def _stopped(part: dict[str, Any]) -> str:
    word = {True: "stopped", False: "NOT stopped", None: "not known yet"}[part.get("stopped")]
    line = f"{part.get('telescope')}: {word}"
    if part.get("cancelled_job_id"):
        line += f"; job {part['cancelled_job_id']} was cancelled"
    problem = part.get("problem")
    return f"{line}: {_problem_words(problem)}" if isinstance(problem, dict) else line


# -- what is known ---------------------------------------------------------------------------------------


@takes_options(OneOrAll)
def status(options: OneOrAll) -> None:
    """Tell where telescopes point, what they do, and what comes next. Asks no device.

    Exit code 1 if one of them is not connected.
    """
    telescope = options.telescope
    with _asking("status", options) as (said, client):
        said.telescope = telescope
        states = client.telescopes() if telescope is None else [client.telescope(telescope)]
        said.answer = states if telescope is None else states[0]
        for state in states:
            said.words += _state_words(state)
        away = [state["id"] for state in states if not state["connected"]]
        if away:
            said.fail(
                {
                    "title": "not connected",
                    "detail": f"not connected: {', '.join(away)}",
                    "advice": "see its problem; the service tries again by itself",
                }
            )


def _state_words(state: TelescopeState) -> list[str]:
    lines = [f"{state['id']}: {_doing(state)}"]
    on = state.get("on")  # an older service doesn't tell
    if on is not None:
        off = (
            ""
            if on["error_arcsec"] is None
            else f", {on['error_arcsec']:.1f}″ off at {_clock(on['error_utc'])}"
        )
        lines.append(f"  {'on' if on['arrived'] else 'to'} {on['name'] or 'a target'}{off}")
    place = state["icrs"]
    if place is not None:
        lines.append(f"  RA {place['ra_deg']:.4f}°, Dec {place['dec_deg']:+.4f}° (ICRS){_height(state)}")
    lines += [f"  {line}" for line in _moving_words(dict(state))]
    limit = state["next_limit"]
    if limit is not None:
        lines.append(
            f"  {limit['limit']} limit in {duration_text(limit['after_s'])}, at {_clock(limit['utc'])}"
        )
    lines += [f"  problem: {state['problem']}"] if state["problem"] else []
    lines += [f"  {state['contradiction']}"] if state["contradiction"] else []
    if state["trusted"] is False:
        lines.append("  its position is not trusted: `mountnav first-light`, or a recovery")
    return lines + [f"  warning: {words}" for words in state["warnings"]]


def _doing(state: TelescopeState) -> str:
    if not state["connected"]:
        return f"not connected (link {state['link'] or 'unknown'})"
    words = [state["activity"]]
    if state["parked"]:
        words.append("parked")
    elif state["tracking"] is not None:
        words.append("tracking" if state["tracking"] else "not tracking")
    if state["slewing"]:
        words.append("moving")
    if state["job_id"]:
        words.append(f"{state.get('job_kind') or 'an order'}, job {state['job_id']}")
    return ", ".join(words)


def _height(state: TelescopeState) -> str:
    alt_deg, az_deg = state["altitude_deg"], state["azimuth_deg"]
    return "" if alt_deg is None or az_deg is None else f"; altitude {alt_deg:.1f}°, azimuth {az_deg:.0f}°"


def _moving_words(state: dict[str, Any]) -> list[str]:
    """What moves beside the stars: rates in force, axes that are held, what is followed and comes next."""
    lines = []
    rates = state.get("rates")
    if rates:
        lines.append(
            f"rates {rates['ra_arcsec_s']:+.4f}″/s in RA, {rates['dec_arcsec_s']:+.4f}″/s in Dec "
            f"until {_clock(rates['ends_utc'])}"
        )
    lines += [
        f"{axis['axis']} axis moved by hand at {axis['rate_deg_s']:+.3f}°/s"
        for axis in state.get("axes_moved") or ()
    ]
    following = state.get("following")
    if following:
        lines.append(f"follows {following['name']} until {_clock(following['until_utc'])}")
        if following["words"]:
            lines.append(f"the sky says: {following['words']}")
        if following["next_event"]:
            lines.append(f"next: {following['next_event']}")
    return lines


def _clock(utc: str | None) -> str:
    """An instant as people read it: time of day, UTC."""
    return "an unknown time" if utc is None else f"{utc[11:19]} UTC"


# -- orders ----------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class CenterOptions(TargetOptions, MoveOptions):
    """Options of `center`."""

    tolerance: Annotated[
        float | None, typer.Option(min=0.01, max=3600, help="Arcseconds; else that of the settings.")
    ] = None


@takes_options(CenterOptions)
def center(options: CenterOptions) -> None:
    """Put a target into the middle of the frame: slew, look, correct, and again until it is there.

    TARGET is a name (M31, Vega, Jupiter, an imported comet), or a position: "05h34m31.9s +22d00m52s".
    """
    from mountnav.client import orders

    with _asking("center", options) as (said, client):
        where = options.chosen()
        what = orders.center(where, tolerance_arcsec=options.tolerance)
        _carry_out(said, client, options, what)


@dataclass(frozen=True, kw_only=True)
class SlewOptions(TargetOptions, MoveOptions):
    """Options of `slew`."""


@takes_options(SlewOptions)
def slew(options: SlewOptions) -> None:
    """Go to a target as the mount believes it; nothing is looked at. TARGET as of `center`."""
    from mountnav.client import orders

    with _asking("slew", options) as (said, client):
        where = options.chosen()
        _carry_out(said, client, options, orders.slew(where))


@dataclass(frozen=True, kw_only=True)
class LookOptions(OrderOptions):
    """Options of `look`."""

    exposure: Exposure = None


@takes_options(LookOptions)
def look(options: LookOptions) -> None:
    """Expose and solve: where it truly points. Moves and syncs nothing."""
    from mountnav.client import orders

    with _asking("look", options) as (said, client):
        _carry_out(said, client, options, orders.look(exposure_s=options.exposure))


@takes_options(OrderOptions)
def sync(options: OrderOptions) -> None:
    """Look, and tell the mount where it truly points."""
    from mountnav.client import orders

    with _asking("sync", options) as (said, client):
        _carry_out(said, client, options, orders.sync())


@takes_options(MoveOptions)
def park(options: MoveOptions) -> None:
    """Go to the park position and stay."""
    from mountnav.client import orders

    with _asking("park", options) as (said, client):
        _carry_out(said, client, options, orders.park())


@takes_options(OrderOptions)
def unpark(options: OrderOptions) -> None:
    """Be ready to move again."""
    from mountnav.client import orders

    with _asking("unpark", options) as (said, client):
        _carry_out(said, client, options, orders.unpark())


@dataclass(frozen=True, kw_only=True)
class TrackOptions(BriefOptions):
    """Options of `track`."""

    how: Annotated[
        str, typer.Argument(help="off, sidereal (or on), lunar, solar, king, or rates with --ra and --dec.")
    ]
    ra: Annotated[
        float | None,
        typer.Option("--ra", help="Of rates: change of RA, arcsec per second, not times cos(dec); east +."),
    ] = None
    dec: Annotated[
        float | None, typer.Option("--dec", help="Of rates: change of Dec, arcsec per second; north +.")
    ] = None
    for_s: Annotated[
        float | None, typer.Option("--for", min=0.1, max=14400, help="Of rates: their end, seconds from now.")
    ] = None


@takes_options(TrackOptions)
def track(options: TrackOptions) -> None:
    """Follow the sky at a rate, or rest. Rates beside the sidereal one end by themselves."""
    from mountnav.client import orders

    with _asking("track", options) as (said, client):
        what: orders.Order
        how, ra, dec, for_s = options.how, options.ra, options.dec, options.for_s
        if how == "rates":
            if ra is None or dec is None:
                raise BadRequest("rates need both --ra and --dec", advice="give 0 for a rate that is zero")
            what = orders.offset_rates(ra, dec, for_s=for_s)
        elif ra is not None or dec is not None or for_s is not None:
            raise BadRequest(f"--ra, --dec and --for are of rates, not of {how}", advice="`track rates ...`")
        elif how == "off":
            what = orders.tracking(False)
        elif how in ("on", "sidereal"):
            what = orders.tracking(True)
        elif (rate := _RATE_WORDS.get(how)) is not None:
            what = orders.tracking(True, rate=rate)
        else:
            raise BadRequest(
                f"no way to track is called {how!r}", advice="off, sidereal, lunar, solar, king, or rates"
            )
        _carry_out(said, client, options, what)


@dataclass(frozen=True, kw_only=True)
class FollowOptions(MovingTargetOptions, MoveOptions):
    """Options of `follow`."""

    for_s: Annotated[float | None, typer.Option("--for", min=1, help="Its end, seconds from now.")] = None
    until: Annotated[str | None, typer.Option(help="Its end: 2026-11-26T03:40 (UTC).")] = None
    tolerance: Annotated[float | None, typer.Option(min=0.01, max=3600, help="Arcseconds.")] = None
    exposure: Exposure = None
    every: Annotated[float | None, typer.Option(min=1, max=3600, help="Seconds between two looks at it.")] = (
        None
    )


@takes_options(FollowOptions)
def follow(options: FollowOptions) -> None:
    """Center a target that moves and track it by its rates, up to an end, with looks that confirm them."""
    from mountnav.client import orders

    with _asking("follow", options) as (said, client):
        where = options.chosen()
        if (options.for_s is None) == (options.until is None):
            raise BadRequest("a follow needs an end", advice="give one of --for and --until")
        what = orders.follow(
            where,
            duration_s=options.for_s,
            until_utc=None if options.until is None else _until(options.until),
            tolerance_arcsec=options.tolerance,
            exposure_s=options.exposure,
            look_every_s=options.every,
        )
        _carry_out(said, client, options, what)


def _until(text: str) -> datetime:
    """An end as it is typed; without a time zone it is UTC. Raises `BadRequest`."""
    try:
        at = datetime.fromisoformat(text)
    except ValueError:
        raise BadRequest(f"{text!r} is not a time", advice="like 2026-11-26T03:40 (UTC)") from None
    return at if at.tzinfo is not None else at.replace(tzinfo=UTC)


@contextmanager
def _asking(command: str, options: ServiceOptions) -> Iterator[tuple[_Said, Client]]:
    """A command to a service, and the client that asks it."""
    from mountnav.client import Client

    with (
        _telling(command, options.service, options.as_json) as said,
        Client(options.service, token=options.token) as client,
    ):
        yield said, client


def _carry_out(said: _Said, client: Client, options: BriefOptions, what: dict[str, Any]) -> None:
    """Give an order, tell its way, and wait for its end."""
    said.telescope = telescope = options.telescope or _only_one(client)
    supersede = isinstance(options, MoveOptions) and options.supersede
    job = client.order(telescope, what, supersede=supersede)
    said.answer = job
    if isinstance(options, OrderOptions) and options.detach:
        said.words.append(f"{telescope}: {job['kind']} has begun: job {job['id']}")
        return
    try:
        if not said.as_json:
            _tell_way(client, job)
        job = client.wait(job)
    except KeyboardInterrupt:
        typer.echo(f"the {job['kind']} goes on in the service: `mountnav stop {telescope}` ends it", err=True)
        raise
    said.answer = job
    if job["state"] != "succeeded":
        problem = job["problem"]
        said.fail(dict(problem) if problem is not None else {"detail": f"{job['kind']} {job['state']}"})
    else:
        said.words.append(f"{telescope}: {_result_words(job)}")


def _only_one(client: Client) -> str:
    """The telescope that is meant where none was named."""
    ids = [state["id"] for state in client.telescopes()]
    if len(ids) != 1:
        raise BadRequest("there are several telescopes", advice=f"--telescope, one of: {', '.join(ids)}")
    return ids[0]


def _tell_way(client: Client, job: Job) -> None:
    """Print the events of a job up to its end; of a stream that breaks off the end is asked for."""
    import httpx

    try:
        for event in client.events(job=job):
            if line := event_words(event.kind, event.data):
                typer.echo(f"  {line}", err=True)
    except httpx.TransportError as broken:
        typer.echo(f"  its events can't be followed any more: {broken}", err=True)


def event_words(kind: str, data: dict[str, Any]) -> str:
    """An event in a line; empty where it says nothing to a person."""
    match kind:
        case "slewing":
            return f"slews to RA {data['ra_deg']:.4f}° Dec {data['dec_deg']:+.4f}°"
        case "solved":
            return f"solved: {data.get('pairs')} stars, rms {_number(data.get('rms_arcsec'), 2)}″"
        case "not-solved":
            return f"not solved: {data.get('reason')}"
        case "attempt" if data.get("kind") == "follow-look":
            off = _number(data.get("off_arcsec"), 1)
            return f"look {data.get('number')}: {off}″ off. {data.get('words') or ''}".rstrip()
        case "attempt" if data.get("error_arcsec") is not None:
            return f"look {data.get('number')}: {_number(data.get('error_arcsec'), 1)}″ off"
        case "synced":
            return f"synced: {data.get('outcome')}"
        case "flipped":
            return f"changed sides of the pier: {data.get('from')} to {data.get('to')}"
        case "tactic":
            return f"looks again ({str(data.get('tactic')).replace('-', ' ')}): {data.get('why')}"
        case "job":
            problem = data.get("problem")
            why = f": {problem.get('detail')}" if isinstance(problem, dict) else ""
            return f"{data.get('kind')} {data.get('state')}{why}"
        case "exposing" | "solving" | "slewed" | "syncing" | "attempt":
            return ""
    told = " ".join(
        f"{name}={value}" for name, value in data.items() if name not in ("utc", "telescope", "job_id")
    )
    return f"{kind} {told}".rstrip()


def _number(value: object, digits: int) -> str:
    return f"{value:.{digits}f}" if isinstance(value, int | float) else "?"


def _result_words(job: Job) -> str:
    result = job["result"] or {}
    match result.get("kind"):
        case "center":
            return (
                f"centered: {_number(result['error_after_arcsec'], 1)}″ off (tolerance "
                f"{_number(result['tolerance_arcsec'], 0)}″) after {len(result['attempts'])} looks"
            )
        case "slew":
            miss = _number(result["miss_arcsec"], 1)
            return f"{result['outcome']}, {miss}″ from the target by its own reading"
        case "look":
            offset, seen = result["offset"], result["seen"]
            return (
                f"points at RA {seen['ra_deg']:.5f}°, Dec {seen['dec_deg']:+.5f}° (ICRS), "
                f"{_number(offset['total_arcsec'], 1)}″ from where the mount believes"
            )
        case "sync":
            return f"sync {result['outcome']}"
        case "offset-rates":
            if result["ends_utc"] is None:
                return "tracks at the sidereal rate"
            return (
                f"tracks at {_number(result['ra_arcsec_s'], 4)}″/s in RA, "
                f"{_number(result['dec_arcsec_s'], 4)}″/s in Dec until {_clock(result['ends_utc'])}"
            )
        case "follow":
            return (
                f"followed {result['target']} by {result['by']}: {result['within']} of {result['looks']} "
                f"looks within {_number(result['tolerance_arcsec'], 1)}″, worst "
                f"{_number(result['worst_arcsec'], 1)}″. {result.get('verdict') or ''}".rstrip()
            )
    return f"{job['kind']} done"


# -- what happens ----------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class WatchOptions(OneOrAll):
    """Options of `watch`."""

    as_json: Annotated[bool, typer.Option("--json", help="JSON lines, one an event.")] = False


@takes_options(WatchOptions)
def watch(options: WatchOptions) -> None:
    """Tell what happens, from now on until interrupted."""
    telescope = options.telescope
    with _asking("watch", options) as (said, client):
        said.telescope = telescope
        for event in client.events(telescope=telescope):
            if options.as_json:
                print_json({"id": event.event_id, "kind": event.kind, "data": event.data}, ascii_only=False)
            else:
                line = event_words(event.kind, event.data)
                if line:
                    at, of = _clock(event.data.get("utc")), event.data.get("telescope") or ""
                    typer.echo(f"{at}  {of}  {line}")
            sys.stdout.flush()
