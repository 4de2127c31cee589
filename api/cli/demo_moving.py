"""`mountnav demo --comet` and `--pass`: what moves is followed, and judged by where the mount truly looks.

As in the demo of stars the service knows nothing of the demo: it is given elements, as anybody would give
them. While it follows, the fake mount is asked where its tube truly points, and the target's own ephemeris
where it should.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from statistics import median
from typing import TYPE_CHECKING, Any, Literal

from api.demo.moving import comet_elements, satellite_lines
from api.demo.observatory import TELESCOPE
from mountnav.client import targets
from mountnav.clock import utc_now
from mountnav.ephemeris.any_text import read_elements
from mountnav.ephemeris.ephemeris import Ephemeris, sky_rates
from mountnav.ephemeris.satellite import EarthSatellite
from mountnav.ephemeris.small_body import SmallBody
from mountnav.ephemeris.tle import read_tle
from mountnav.sky.chain import observed_to_icrs
from mountnav.sky.coordinates import Icrs, Observed, Site
from mountnav.sky.planets import position_of_body
from mountnav.sky.sphere import separation_arcsec

if TYPE_CHECKING:
    from rich.console import Console

    from mountnav.client import Client, Json
    from mountnav.client.stream import ServerEvent
    from mountnav.settings.observatory import Settings

__all__ = ["Followed", "Moving", "azimuth_of", "follow_one", "made", "prepare", "told"]

Which = Literal["comet", "pass"]

COMET_S, PASS_S = 150.0, 60.0
"""How long each is followed, s. chosen: the comet moves by some arcminutes in that time, the satellite over
a fifth of the sky; doubled, the demo takes twice as long."""
TRULY_FOLLOWED_ARCSEC = {"comet": 45.0, "pass": 900.0}
"""How far the tube may truly be off in the median, ″: of the comet as `demo` has it of stars; of the
satellite a quarter of a degree, what a finder shows. Doubled, a target that leaves the frame passes."""
TO_TOP_S = 70.0
"""So long before it is highest the satellite's pass is ordered, s: the mount is there by then. Doubled, one
waits for a minute."""
LOOK_EVERY_S = 10.0
"""Between two looks at the comet, s: an observer has a minute. Doubled, too few say how fast it moves."""
_SAMPLE_S = 0.25
"""How often it is looked where the tube truly points, s."""
_SETTLED_S = 8.0
"""The first seconds of following don't count: it has just been caught."""
_ALTITUDE_DEG = 55.0
"""How high a target stands as it begins: above haze, below where an alt-az mount turns fast."""
_AZIMUTHS_DEG = (150.0, 210.0, 110.0, 250.0)
"""Where a target may stand; the one farthest from the Sun is taken. All are in the south, since near the pole
a mount that points so wrongly is not synced, and then nothing tells a pass how wrong it points."""


@dataclass(frozen=True, slots=True)
class Moving:
    """A target that moves, as the service is given it and as it truly is."""

    which: Which
    ephemeris: Ephemeris
    target: targets.Target
    duration_s: float


@dataclass(slots=True)
class Followed:
    """How following ended; `off_arcsec` by the simulator's own truth, moment by moment."""

    moving: Moving
    job: Json
    off_arcsec: list[float] = field(default_factory=list)
    elapsed_s: float = 0.0

    @property
    def ok(self) -> bool:
        """Whether the service says so and the truth agrees."""
        within = TRULY_FOLLOWED_ARCSEC[self.moving.which]
        return (
            self.job["state"] == "succeeded"
            and len(self.off_arcsec) > 10
            and median(self.off_arcsec) < within
        )


def azimuth_of(settings: Settings) -> float:
    """In which direction a target may stand: the one farthest from the Sun."""
    utc, site, air = utc_now(), settings.site.site, settings.air.air
    sun = position_of_body("sun", utc, site)

    def from_sun(az_deg: float) -> float:
        place = observed_to_icrs(Observed(az_deg, _ALTITUDE_DEG, utc), site, air)
        return separation_arcsec(place, sun)

    return max(_AZIMUTHS_DEG, key=from_sun)


def made(which: Which, settings: Settings, az_deg: float) -> Moving:
    """Make a target for the demo's site and this moment."""
    utc, site, air = utc_now(), settings.site.site, settings.air.air
    if which == "comet":
        text = comet_elements(utc, site, air, alt_deg=_ALTITUDE_DEG, az_deg=az_deg)
        return Moving(which, SmallBody(read_elements(text)[0]), targets.elements(text), COMET_S)
    lines = satellite_lines(utc, site, in_s=TO_TOP_S, alt_deg=_ALTITUDE_DEG, az_deg=az_deg)
    duration_s = TO_TOP_S + PASS_S / 2.0
    return Moving(which, EarthSatellite(read_tle(lines)[0]), targets.satellite(lines), duration_s)


def prepare(client: Client, az_deg: float, console: Console) -> bool:
    """Center a place where the pass will be: there the mount must point well by itself."""
    console.print("A pass leaves little time for looks: first the place where it will be is centered")
    job = client.wait(client.center(TELESCOPE, target=targets.altaz(_ALTITUDE_DEG, az_deg)))
    for one in job["attempts"]:
        how = one.get("correction") or ""
        why = one.get("why") or ""
        console.print(f"  look {one['number']}: {_angle(one['error_arcsec'])} off; {how} {why}")
    console.print(f"  {job['state']}")
    return job["state"] == "succeeded"


def follow_one(
    client: Client, moving: Moving, site: Site, truth: Callable[[], Icrs], console: Console
) -> Followed:
    """Have it followed, and watch where the tube truly points meanwhile."""
    rates = sky_rates(moving.ephemeris, utc_now(), site)
    console.print(
        f"[bold]{moving.ephemeris.name}[/]: moves by {_speed(rates.total_arcsec_s)} among the stars now; "
        f"{moving.ephemeris.sigma_arcsec(utc_now()):.0f}″ uncertain"
    )
    forecast = client.forecast(TELESCOPE, moving.target, hours=2.0)
    for foretold in forecast["events"][:4]:
        console.print(f"  [dim]foretold[/]  {foretold['words']}")
    watch = _Watch(truth)
    began = time.monotonic()
    every_s = LOOK_EVERY_S if moving.which == "comet" else None
    job = client.follow(TELESCOPE, moving.target, duration_s=moving.duration_s, look_every_s=every_s)
    with watch:
        for event in client.events(job=job):
            line = _line(event)
            if line:
                console.print(f"  [dim]{time.monotonic() - began:6.1f} s[/]  {line}")
        job = client.wait(job)
    found = Followed(moving, job, elapsed_s=time.monotonic() - began)
    result = job["result"]
    if result is not None:
        first = datetime.fromisoformat(result["began_utc"]) + timedelta(seconds=_SETTLED_S)
        last = datetime.fromisoformat(result["ended_utc"])
        found.off_arcsec = [
            separation_arcsec(place, moving.ephemeris.icrs(utc, site))
            for utc, place in watch.seen
            if first <= utc <= last
        ]
    return found


def told(found: Followed, client: Client, console: Console) -> None:
    """What became of it: how far off in truth, measured rates against ordered, and that they have ended."""
    job, result = found.job, found.job["result"]
    if result is None:
        problem = job["problem"] or {}
        console.print(f"[bold red]{found.moving.ephemeris.name}: {job['state']}[/]: {problem.get('detail')}")
        return
    looks = [one for one in job["attempts"] if one.get("kind") == "follow-look"]
    measured = next((one for one in reversed(looks) if one.get("seen_dec_arcsec_s") is not None), None)
    console.print(f"  {result['plan']}")
    if measured is not None:
        console.print(
            f"  rates ordered  {_rates(measured, 'ordered')}\n  rates measured {_rates(measured, 'seen')}"
        )
    if result["verdict"]:
        console.print(f"  the sky says: {result['verdict']}")
    state = client.telescope(TELESCOPE)
    left = "none" if state["rates"] is None else f"STILL {state['rates']}"
    console.print(f"  ended: {result['outcome']}; rates in force afterwards: {left}")
    color = "green" if found.ok else "red"
    if found.off_arcsec:
        console.print(
            f"[bold {color}]{found.moving.ephemeris.name} followed for "
            f"{result['elapsed_s']:.0f} s[/]: truly {_angle(median(found.off_arcsec))} off in the median of "
            f"{len(found.off_arcsec)} moments, {_angle(max(found.off_arcsec))} at most; "
            + (
                f"by {result['looks']} looks {_angle(result['rms_arcsec'])} rms"
                if looks
                else "too fast for looks"
            )
        )
    else:
        console.print(f"[bold {color}]{found.moving.ephemeris.name}: followed too shortly to be judged")


def _rates(look: dict[str, Any], which: str) -> str:
    """Rates of a look as people read them, with their errors where it has them."""
    parts = []
    for name in ("ra", "dec"):
        sigma = look.get(f"{which}_{name}_sigma_arcsec_s")
        error = "" if sigma is None else f" ± {sigma:.3f}"
        parts.append(f"{look[f'{which}_{name}_arcsec_s']:+.3f}{error}″/s {name.upper()}")
    return ", ".join(parts)


class _Watch:
    """Looks again and again where the tube truly points; a context."""

    def __init__(self, truth: Callable[[], Icrs]) -> None:
        self._truth = truth
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="truth", daemon=True)
        self.seen: list[tuple[datetime, Icrs]] = []

    def __enter__(self) -> _Watch:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._over.wait(_SAMPLE_S):
            before = utc_now()
            place = self._truth()
            self.seen.append((before + (utc_now() - before) / 2, place))


def _line(event: ServerEvent) -> str | None:
    """One step of the way as a line; None for steps that need none."""
    data = event.data
    match event.kind:
        case "slewing":
            return f"slew to RA {data['ra_deg']:.4f}° Dec {data['dec_deg']:+.4f}°"
        case "not-solved":
            return f"[red]frame not solved[/]: {data['reason']} ({data['detail']})"
        case "synced":
            return f"sync {data['outcome']}"
        case "attempt" if data.get("kind") == "follow-look":
            off, told_of_it = _angle(data.get("off_arcsec")), str(data.get("words") or "")
            return f"look {data.get('number')}: [bold yellow]{off} off[/]{told_of_it.partition(' off')[2]}"
        case "attempt" if data.get("error_arcsec") is not None:
            return f"centering: [bold yellow]{_angle(data['error_arcsec'])}[/] off"
        case "job" if data["state"] in ("failed", "cancelled"):
            return f"[red]{data['state']}[/]: {data.get('problem', {}).get('detail', '')}"
        case "job" if data["state"] == "succeeded":
            return "[green]followed to its end[/]"
        case "following" if data.get("phase") != "following":
            return str(data.get("words") or "") or None
    return None


def _angle(arcsec: float | None) -> str:
    if arcsec is None:
        return "?"
    if arcsec >= 3600.0:
        return f"{arcsec / 3600.0:.2f}°"
    return f"{arcsec / 60.0:.1f}′" if arcsec >= 100.0 else f"{arcsec:.1f}″"


def _speed(arcsec_s: float) -> str:
    return f"{arcsec_s / 3600.0:.2f}°/s" if arcsec_s >= 360.0 else f"{arcsec_s:.2f}″/s"
