"""`mountnav demo`: an observatory without hardware does the main job, while you watch.

The service runs as at an observatory, under uvicorn; the demo is only a client of its HTTP API. At the end
the result is judged twice: by the service's own last look, and by where the fake mount truly points.
"""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from api.cli.output import reason_of
from mountnav.errors import DeviceMissing

if TYPE_CHECKING:
    from rich.console import Console

    from api.demo.targets import Target
    from mountnav.client import Client, Json, ServerEvent
    from mountnav.settings.observatory import Settings
    from mountnav.sky.coordinates import Icrs

Which = Literal["comet", "pass"]
TRULY_CENTERED_ARCSEC = 45.0
"""Where the fake mount truly points, from the target. chosen: the tolerance of a centering is 30″, and until
the truth is read the mount drifts on; doubled, a centering that missed would pass."""
PICTURE_COLUMNS = 110
"""Width of the terminal in the picture: the table of the results fits without breaking its lines."""


@dataclass(frozen=True, slots=True)
class Centered:
    """How the centering of one target ended; `truly_arcsec` is the simulator's own truth."""

    target: Target
    job: Json
    truly_arcsec: float | None
    elapsed_s: float

    @property
    def ok(self) -> bool:
        """Whether the service says so and the truth agrees (to what the mount drifts meanwhile)."""
        return (
            self.job["state"] == "succeeded"
            and self.truly_arcsec is not None
            and self.truly_arcsec < TRULY_CENTERED_ARCSEC
        )


def demo(
    keep: Annotated[bool, typer.Option("--keep", help="Leave the service running afterwards.")] = False,
    host: Annotated[str, typer.Option(help="Where the service listens.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535)] = 8000,
    picture: Annotated[Path | None, typer.Option(help="Write a picture of the run (SVG) here.")] = None,
    comet: Annotated[
        bool, typer.Option("--comet", help="Follow a comet that passes the Earth, instead of stars.")
    ] = False,
    satellite: Annotated[
        bool, typer.Option("--pass", help="Follow a satellite's pass, instead of stars.")
    ] = False,
) -> None:
    """Center five targets with an observatory that has no hardware; or follow what moves.

    Exit code 1 if one of them is not where it should be, by where the fake mount truly points.
    """
    from rich.console import Console

    from api.demo.observatory import demo_journal, demo_settings, demo_settings_with_rates
    from mountnav.client import Client
    from mountnav.sky.iers import read_tables

    console = Console(record=picture is not None, width=PICTURE_COLUMNS if picture is not None else None)
    read_tables()
    settings = demo_settings(host, port)
    if comet or satellite:
        # the usual LX200 takes no rates
        settings = demo_settings_with_rates(settings)
    console.rule("[bold]mountnav demo: an observatory without hardware")
    with demo_journal(settings) as settings, _service(settings) as (base_url, truth):
        console.print(
            f"A fake LX200 mount that points wrongly, a simulated camera on the true sky, "
            f"the service at [bold]{base_url}[/] (docs: {base_url}/docs)"
        )
        with Client(base_url) as client:
            if comet or satellite:
                asked: dict[Which, bool] = {"comet": comet, "pass": satellite}
                wanted = [which for which, yes in asked.items() if yes]
                good, count = _follow_all(client, settings, truth, console, wanted), len(wanted)
            else:
                results = _center_all(client, settings, truth, console)
                _table(results, console)
                good, count = sum(result.ok for result in results), len(results)
                console.print(_sentence(results, good))
        console.print(
            f"API: {base_url}/v1/telescopes    docs: {base_url}/docs"
            + ("" if keep else "    (gone when this ends; `mountnav demo --keep` leaves them open)")
        )
        if picture is not None:
            console.save_svg(str(picture), title="mountnav demo")
        if keep:
            console.print("The service goes on; Ctrl-C ends it.")
            try:
                threading.Event().wait()
            except KeyboardInterrupt:
                console.print("ended")
    raise typer.Exit(0 if good == count > 0 else 1)


def _follow_all(
    client: Client, settings: Settings, truth: Callable[[], Icrs], console: Console, wanted: list[Which]
) -> int:
    """Follow what was asked for, one after the other; how many of them were followed."""
    from api.cli.demo_moving import azimuth_of, follow_one, made, prepare, told

    good = 0
    for which in wanted:
        az_deg = azimuth_of(settings)
        if which == "pass" and not prepare(client, az_deg, console):
            continue
        found = follow_one(client, made(which, settings, az_deg), settings.site.site, truth, console)
        told(found, client, console)
        good += found.ok
    return good


def _center_all(
    client: Client, settings: Settings, truth: Callable[[], Icrs], console: Console
) -> list[Centered]:
    from api.demo.observatory import TELESCOPE
    from api.demo.targets import targets_up_now
    from mountnav.catalog.embedded import embedded_catalog
    from mountnav.clock import utc_now
    from mountnav.sky.sphere import separation_arcsec

    targets = targets_up_now(utc_now(), settings.site.site, settings.air.air, embedded_catalog())
    names = ", ".join(target.name for target in targets)
    console.print(f"Five stars that are up now, spread over the sky: [bold]{names}[/]\n")
    results = []
    for number, target in enumerate(targets, 1):
        console.print(
            f"[bold]{number}/{len(targets)} {target.name}[/]  altitude {target.altitude_deg:.0f}°, "
            f"azimuth {target.azimuth_deg:.0f}°"
        )
        began = time.monotonic()
        job = client.center(TELESCOPE, target.position.ra_deg, target.position.dec_deg)
        for event in client.events(after="0"):
            if event.data.get("job_id") != job["id"]:
                continue
            line = _line(event, target.position)
            if line:
                console.print(f"  [dim]{time.monotonic() - began:6.1f} s[/]  {line}")
            if event.kind == "job" and event.data["state"] in ("succeeded", "failed", "cancelled"):
                break
        job = client.job(job["id"], wait_s=5.0)
        truly = separation_arcsec(truth(), target.position) if job["state"] == "succeeded" else None
        results.append(Centered(target, job, truly, time.monotonic() - began))
    return results


def _line(event: ServerEvent, target: Icrs) -> str | None:
    """One step of the way as a line; None for steps that need none."""
    from mountnav.sky.coordinates import Icrs
    from mountnav.sky.sphere import separation_arcsec

    data = event.data
    match event.kind:
        case "slewing":
            return f"slew to RA {data['ra_deg']:.4f}° Dec {data['dec_deg']:+.4f}°"
        case "solved":
            error_arcsec = separation_arcsec(Icrs(data["ra_deg"], data["dec_deg"]), target)
            return (
                f"frame solved: {data['pairs']} stars, rms {data['rms_arcsec']:.2f}″, chance "
                f"{data['false_probability']:.0e}; the target is [bold yellow]{_angle(error_arcsec)}[/] "
                "from the middle"
            )
        case "not-solved":
            return f"[red]frame not solved[/]: {data['reason']} ({data['detail']})"
        case "synced":
            return f"sync {data['outcome']}"
        case "job" if data["state"] == "succeeded":
            return "[green]centered[/]"
        case "job" if data["state"] in ("failed", "cancelled"):
            return f"[red]{data['state']}[/]: {data.get('problem', {}).get('detail', '')}"
    return None


def _table(results: list[Centered], console: Console) -> None:
    from rich.table import Table

    table = Table(title="What became of each target")
    table.add_column("target")
    for name in ("altitude", "error before", "error after", "truly", "tries", "stars", "time"):
        table.add_column(name, justify="right")
    for result in results:
        job_result = result.job.get("result") or {}
        tries = result.job.get("attempts") or []
        table.add_row(
            result.target.name,
            f"{result.target.altitude_deg:.0f}°",
            _angle(tries[0]["error_arcsec"]) if tries else "-",
            f"{job_result['error_after_arcsec']:.1f}″" if job_result else "[red]not centered[/]",
            f"{result.truly_arcsec:.1f}″" if result.truly_arcsec is not None else "-",
            str(len(tries)),
            str(tries[-1]["pairs"]) if tries else "-",
            f"{result.elapsed_s:.1f} s",
        )
    console.print()
    console.print(table)


def _sentence(results: list[Centered], good: int) -> str:
    before = [result.job["attempts"][0]["error_arcsec"] for result in results if result.job.get("attempts")]
    after = [result.job["result"]["error_after_arcsec"] for result in results if result.job.get("result")]
    color = "green" if good == len(results) > 0 else "red"
    text = f"[bold {color}]{good} of {len(results)} targets centered"
    if before and after:
        text += (
            f"[/]: from {_angle(min(before))} to {_angle(max(before))} off "
            f"to within {max(after):.1f}″ (tolerance 30″), "
            f"in {sum(result.elapsed_s for result in results):.0f} s."
        )
    else:
        text += "[/]."
    return text


def _angle(arcsec: float) -> str:
    return f"{arcsec / 60.0:.1f}′" if arcsec >= 100.0 else f"{arcsec:.1f}″"


@contextmanager
def _service(settings: Settings) -> Iterator[tuple[str, Callable[[], Icrs]]]:
    """The service in a thread of its own; its address, and where the fake truly points."""
    import uvicorn

    from api.demo.observatory import TELESCOPE
    from api.http.app import create_app

    host, port = settings.service.host, settings.service.port
    try:
        listening = socket.create_server((host, port))
        listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # as `api.http.serving.bind`
    except OSError as error:
        raise DeviceMissing(
            f"the service can't listen at {host}:{port}: {reason_of(error)}",
            advice="is another mountnav running? choose another one with --port",
        ) from error
    app = create_app(settings)
    server = uvicorn.Server(uvicorn.Config(app, log_level="warning", lifespan="on"))
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]}, name="service")
    thread.start()
    try:
        while not server.started:
            if not thread.is_alive():
                raise DeviceMissing("the service did not start", advice="see the message above")
            time.sleep(0.02)
        mechanics = app.state.service.observatory.telescope(TELESCOPE).mechanics
        yield f"http://{host}:{listening.getsockname()[1]}", mechanics.truth
    finally:
        server.should_exit = True
        thread.join()
        listening.close()
