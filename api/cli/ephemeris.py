"""`mountnav ephemeris`: imports orbits, satellites and SPK files, and shows where a target stands when."""

from __future__ import annotations

import math
import sys
from datetime import datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from api.cli.options import Json, config_option
from api.cli.output import print_json, refusing_os_errors
from mountnav.errors import BadRequest, BadSettings
from mountnav.units import DEG_PER_HOUR, J2000_JD, J2000_UTC, sexagesimal_text

if TYPE_CHECKING:
    from mountnav.ephemeris.ephemeris import Ephemeris
    from mountnav.sky.coordinates import Air, Site

ephemeris_app = typer.Typer(
    help="Targets that move: imported orbits, satellites, SPK files; where they stand when.",
    no_args_is_help=True,
)

_Folder = Annotated[
    Path | None,
    typer.Option(
        help="Folder of imported ephemerides; else that of --config, MOUNTNAV_EPHEMERIDES, or your own."
    ),
]
_Config = Annotated[
    Path | None, config_option("Settings file: its ephemerides, site and air tables are used.")
]
_MOST_LINES = 500
"""Lines of a shown table at most. Doubled, a mistyped step fills twice as many screens."""
_LONGEST_HOURS = 24.0 * 60.0
"""Longest span of a shown table, h: two months."""


@ephemeris_app.command("import")
def import_(
    path: Annotated[
        Path,
        typer.Argument(
            help="MPCORB.DAT, CometEls.txt, their JSON (or .gz), SBDB's answer, TLE or OMM lists, or a .bsp."
        ),
    ],
    name: Annotated[
        str | None, typer.Option(help="What to call it; of the file's name if not given.")
    ] = None,
    folder: _Folder = None,
    config: _Config = None,
    as_json: Json = False,
) -> None:
    """Import a file of orbits or satellites, so that they are found by name; or an SPK file.

    An import of the same name is replaced at once when all of the new one is written.
    """
    from mountnav.ephemeris.imported import import_file

    shows = sys.stderr.isatty()

    def progress(count: int) -> None:
        if shows:
            sys.stderr.write(f"\r{count:,} objects")
            sys.stderr.flush()

    done = import_file(path, _folder_of(folder, config), name, progress)
    if shows:
        sys.stderr.write("\r" + " " * 30 + "\r")
    if as_json:
        print_json(
            {
                "slug": done.slug,
                "objects": done.objects,
                "refused": done.refused,
                "first_refused": list(done.first_refused),
            }
        )
        return
    typer.echo(f"{done.slug}: {done.objects:,} objects")
    if done.refused:
        typer.echo(
            f"{done.refused} entries couldn't be read, the first: {'; '.join(done.first_refused)}", err=True
        )


@ephemeris_app.command("list")
def list_(folder: _Folder = None, config: _Config = None, as_json: Json = False) -> None:
    """List what is there: the shipped excerpt of DE440, and what was imported."""
    from mountnav.ephemeris.imported import Imports
    from mountnav.sky.kernel import shipped

    where = _folder_of(folder, config)
    bodies = shipped().segments
    rows: list[dict[str, Any]] = [
        {
            "slug": "de440 (shipped)",
            "what": "kernel",
            "objects": len({one.target for one in bodies}),
            "source": bodies[0].source,
            "from": _day(max(one.first_jd for one in bodies)),
            "to": _day(min(one.last_jd for one in bodies)),
            "imported_utc": None,
            "problem": None,
        }
    ]
    for one in Imports(where).all():
        rows.append(
            {
                "slug": one.slug,
                "what": one.what,
                "objects": one.objects,
                "source": one.source,
                "from": None,
                "to": None,
                "imported_utc": None if one.imported_utc is None else one.imported_utc.isoformat(),
                "problem": one.problem,
            }
        )
    if as_json:
        for row in rows:
            print_json(row)
        return
    typer.echo(f"# imported ephemerides are in {where}")
    for row in rows:
        told = f"from {row['source']}" if row["source"] else ""
        if row["from"]:
            told += f", {row['from']} to {row['to']}"
        if row["imported_utc"]:
            told += f", imported {row['imported_utc'][:16]}Z"
        typer.echo(f"{row['slug']:<24} {row['what']:<9} {row['objects']:>9,}  {row['problem'] or told}")


@ephemeris_app.command()
def forget(
    slug: Annotated[str, typer.Argument(help="As `list` has it.")],
    folder: _Folder = None,
    config: _Config = None,
) -> None:
    """Remove an import."""
    from mountnav.ephemeris import imported

    gone = imported.forget(_folder_of(folder, config), slug)
    typer.echo(f"{gone.slug} is gone ({gone.objects:,} objects)")


@ephemeris_app.command()
def show(
    what: Annotated[
        str, typer.Argument(help="A name, or a file with elements of one object, or with a table.")
    ],
    at: Annotated[
        str | None, typer.Option(help="From this time on: 2026-11-26T20:00 (UTC); now if not given.")
    ] = None,
    hours: Annotated[float, typer.Option(min=0.0, max=_LONGEST_HOURS, help="How long.")] = 12.0,
    step_min: Annotated[
        float, typer.Option(min=0.001, max=100_000, help="Minutes between two lines.")
    ] = 30.0,
    site: Annotated[
        tuple[float, float, float] | None,
        typer.Option(metavar="LAT LON HEIGHT", help="Degrees (east positive) and meters; else of --config."),
    ] = None,
    folder: _Folder = None,
    config: _Config = None,
    as_json: Json = False,
) -> None:
    """Show where a target stands, how fast it moves, how uncertain that is, and what will happen to it."""
    from mountnav.clock import utc_now

    here, air = _site_of(site, config)
    _use(folder, config)
    begin = utc_now() if at is None else _instant(at)
    target = _target(what, begin, here)
    count = math.floor(hours * 60.0 / step_min + 1e-9) + 1
    if count > _MOST_LINES:
        raise BadRequest(
            f"that makes {count} lines; {_MOST_LINES} are the most", advice="give a longer --step-min"
        )
    rows = []
    problem = None
    for number in range(count):
        utc = begin + timedelta(minutes=step_min * number)
        try:
            rows.append(_row(target, utc, here, air))
        except BadRequest as refused:
            problem = refused
    if not rows and problem is not None:
        raise problem
    events = _events(target, begin, begin + timedelta(hours=hours), here, air)
    if as_json:
        for row in rows:
            print_json(row)
        for event in events:
            print_json(event)
        return
    typer.echo(
        f"# {target.name}, from {here.latitude_deg:.4f}, {here.longitude_deg:.4f}, {here.height_m:.0f} m"
    )
    typer.echo("# ICRS, topocentric, astrometric; altitude with refraction; rates on the sphere")
    typer.echo("utc                  ra           dec          alt    az   rate ″/min     pa   sigma ″")
    for row in rows:
        typer.echo(
            f"{row['utc'][:19]}Z {row['ra']} {row['dec']} "
            f"{row['altitude_deg']:6.2f} {row['azimuth_deg']:6.2f} "
            f"{row['rate_arcsec_s'] * 60.0:10.3f} {row['position_angle_deg']:6.1f} {row['sigma_arcsec']:9.2f}"
        )
    if problem is not None:
        typer.echo(f"# {count - len(rows)} lines are missing: {problem.what}")
    for event in events:
        typer.echo(f"# {event['words']}")


def _row(target: Ephemeris, utc: datetime, site: Site, air: Air) -> dict[str, Any]:
    from mountnav.ephemeris.ephemeris import sky_rates
    from mountnav.sky.chain import icrs_to_observed

    place = target.icrs(utc, site)
    rates = sky_rates(target, utc, site)
    observed = icrs_to_observed(place, utc, site, air)
    east = rates.ra_arcsec_s * math.cos(math.radians(place.dec_deg))
    return {
        "utc": utc.isoformat(),
        "ra_deg": place.ra_deg,
        "dec_deg": place.dec_deg,
        "ra": sexagesimal_text(place.ra_deg / DEG_PER_HOUR, 2, wrap=24),
        "dec": sexagesimal_text(place.dec_deg, 1, plus="+"),
        "altitude_deg": observed.alt_deg,
        "azimuth_deg": observed.az_deg,
        "ra_arcsec_s": rates.ra_arcsec_s,
        "dec_arcsec_s": rates.dec_arcsec_s,
        "rate_arcsec_s": rates.total_arcsec_s,
        "position_angle_deg": math.degrees(math.atan2(east, rates.dec_arcsec_s)) % 360.0,
        "sigma_arcsec": target.sigma_arcsec(utc),
    }


_SUN_CONE_DEG = 20.0
"""So near to the Sun it is told; the default of the settings."""


def _events(target: Ephemeris, begin: datetime, end: datetime, site: Site, air: Air) -> list[dict[str, Any]]:
    """Rising, setting, the meridian, and the Sun's cone; nothing beyond the target's own span."""
    from mountnav.pointing.limits import Limits
    from mountnav.pointing.limits.along import SkyEventKind, forecast

    if target.begins_utc is not None:
        begin = max(begin, target.begins_utc)
    if target.ends_utc is not None:
        end = min(end, target.ends_utc)
    told = (
        SkyEventKind.RISES,
        SkyEventKind.SETS,
        SkyEventKind.MERIDIAN,
        SkyEventKind.LOWER_MERIDIAN,
        SkyEventKind.SUN_NEAR,
        SkyEventKind.SUN_FAR,
    )
    limits = Limits(-90.0, sun_cone_deg=_SUN_CONE_DEG)
    try:
        found = forecast(limits, lambda utc: target.icrs(utc, site), begin, end, site, air)
    except BadRequest as refused:
        return [{"event": None, "words": f"what will happen can't be told: {refused.what}"}]
    return [
        {
            "event": one.kind.value,
            "utc": one.utc.isoformat(),
            "altitude_deg": one.alt_deg,
            "azimuth_deg": one.az_deg,
            "words": one.words,
        }
        for one in found
        if one.kind in told
    ]


def _target(what: str, utc: datetime, site: Site) -> Ephemeris:
    """What is meant: a file that is there, else a name."""
    from mountnav.ephemeris.named import ephemeris_of_name

    path = Path(what)
    if not path.is_file():
        return ephemeris_of_name(what, utc, site)
    from mountnav.ephemeris.any_text import ephemeris_of_text
    from mountnav.files import read_text

    with refusing_os_errors(f"{what} can't be read"):
        try:
            return ephemeris_of_text(read_text(path))
        except UnicodeDecodeError as wrong:
            raise BadRequest(f"{what} is not UTF-8 text") from wrong


def _instant(text: str) -> datetime:
    from mountnav.clock import utc_now
    from mountnav.journal.reading import instant

    return instant(text, utc_now())


def _folder_of(folder: Path | None, config: Path | None) -> Path:
    from mountnav.ephemeris.imported import ephemerides_folder

    if folder is not None or config is None:
        return ephemerides_folder(folder)
    from mountnav.settings.observatory import Settings

    return ephemerides_folder(Settings.load_ephemerides(config)[0].folder)


def _use(folder: Path | None, config: Path | None) -> None:
    from mountnav.ephemeris.imported import use_imports

    files: tuple[Path, ...] = ()
    if config is not None:
        from mountnav.settings.observatory import Settings

        files = Settings.load_ephemerides(config)[0].files
    use_imports(_folder_of(folder, config), files)


def _site_of(site: tuple[float, float, float] | None, config: Path | None) -> tuple[Site, Air]:
    from mountnav.sky.coordinates import Air, Site

    told, air = None, Air()
    if config is not None:
        from mountnav.settings.observatory import Settings

        _, told, air = Settings.load_ephemerides(config)
    if site is not None:
        lat, lon, height = site
        if not (-90.0 <= lat <= 90.0 and -180.0 <= lon <= 360.0 and -500.0 <= height <= 9000.0):
            raise BadRequest(f"{lat}, {lon}, {height} m is not a possible site")
        return Site(lat, (lon + 180.0) % 360.0 - 180.0, height), air
    if told is None:
        raise BadSettings(
            "the observing site is not known",
            advice="give --site LAT LON HEIGHT, or --config with a settings file",
        )
    return told, air


def _day(jd: float) -> str:
    return f"{J2000_UTC + timedelta(days=jd - J2000_JD):%Y-%m-%d}"
