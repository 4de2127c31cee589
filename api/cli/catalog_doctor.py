"""`mountnav catalog doctor`: whether the catalogs at hand hold stars enough for each configured camera."""

from __future__ import annotations

import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from api.cli.options import Json, config_option
from api.cli.output import print_json

if TYPE_CHECKING:
    from api.http.doctor_record import CheckRecord, DoctorRecord

_WIDTH = 98
"""Columns of the text: a terminal of 100, with a margin."""
_SAYS = {
    "suffices": "The catalogs on this machine suffice: {fails} of the fields would fail.",
    "marginal": "The catalogs on this machine are marginal: {fails} of the fields would fail.",
    "insufficient": "The catalogs on this machine do NOT suffice: {fails} of the fields would fail.",
    "unknown": "Whether the catalogs suffice is not known.",
}
"""By the verdict's value."""


def doctor(
    config: Annotated[Path, config_option("The settings (TOML).")],
    as_json: Json = False,
) -> None:
    """Tell for each camera whether the catalogs hold stars enough, and which one would help."""
    from api.http.doctor_record import doctor_record
    from mountnav.catalog.catalog_set import open_catalogs
    from mountnav.catalog.doctor.cameras import camera_facts
    from mountnav.catalog.doctor.diagnosis import Verdict, diagnose, julian_year_now, named_catalogs, reach_of
    from mountnav.settings.described_cameras import described_camera
    from mountnav.settings.observatory import Settings

    settings = Settings.load(config)
    shelf = open_catalogs(settings.catalogs.choice())
    stores, epoch_yr = named_catalogs(shelf), julian_year_now()
    online = [source.name for source in settings.catalogs.online]
    records = []
    for telescope in settings.telescope:
        reach = reach_of(settings.site.latitude_deg, telescope.limits.min_altitude_deg)
        found = diagnose(camera_facts(described_camera(telescope)), reach, stores, epoch_yr=epoch_yr)
        records.append(doctor_record(found, online))
        if not as_json:
            sys.stdout.write("\n".join(lines_of(records[-1])) + "\n\n")
            sys.stdout.flush()
    if as_json:
        print_json({"telescopes": [record.model_dump(mode="json") for record in records]}, ascii_only=False)
    enough = all(record.catalogs.verdict is Verdict.SUFFICES for record in records)
    raise typer.Exit(0 if enough else 1)


def lines_of(record: DoctorRecord) -> Iterator[str]:
    """Write out what the doctor says of a telescope, in lines of less than 100 characters."""
    found, camera = record.catalogs, record.catalogs.camera
    yield record.telescope
    if camera.field_width_deg is not None and camera.field_height_deg is not None:
        yield (
            f"  {camera.field_width_deg:.3g}° × {camera.field_height_deg:.3g}°, {camera.width_px} × "
            f"{camera.height_px} px ({camera.size_from}) at {camera.scale_arcsec_px:.3g} ″/px "
            f"({camera.scale_from})"
        )
        yield f"  stars to magnitude {camera.depth_mag:.1f} ({camera.depth_from})"
        sky = found.sky
        yield (
            f"  declinations {sky.low_dec_deg:+.0f}° to {sky.high_dec_deg:+.0f}° are reached: "
            f"{sky.sky_percent:.0f} % of the sky, which counts below"
        )
        yield ""
        yield f"  {'':30}{'stars':>9}   {'stars in a frame at the galactic':^32}   {'fields that':>11}"
        heads = f"{'in all':>9}{'pole':>13}{'median':>11}{'plane':>11}{'would fail':>14}"
        yield f"  {'on this machine':30}{heads}"
        yield from (_row(check) for check in found.here)
        if len(found.here) > 1:
            yield f"  {'the best for each field':30}{'':44}{_of(found.fails_percent):>14}"
        yield ""
    yield from _wrapped(_SAYS[found.verdict.value].format(fails=_of(found.fails_percent)), "  ", "  ")
    if found.remedies:
        yield ""
        yield "  can be had (by a model of the Galaxy)"
        yield from (_row(check) for check in found.remedies)
        yield ""
    for sentence in found.advice:
        yield from _wrapped(sentence, "  - ", "    ")
    for name in found.online:
        yield from _wrapped(
            f"while there is a network, {name} is asked too (not counted here)", "  - ", "    "
        )


def _row(check: CheckRecord) -> str:
    uncovered = (
        f"  {_of(check.uncovered_percent)} not in it"
        if check.uncovered_percent and check.uncovered_percent > 0
        else ""
    )
    stars = "".join(
        f"{_number(value):>{width}}"
        for value, width in ((check.pole_stars, 13), (check.median_stars, 11), (check.plane_stars, 11))
    )
    return (
        f"  {check.name[:29]:30}{_millions(check.stars):>9}{stars}{_of(check.fails_percent):>14}{uncovered}"
    )


def _wrapped(sentence: str, first: str, others: str) -> list[str]:
    return textwrap.wrap(
        sentence,
        _WIDTH,
        initial_indent=first,
        subsequent_indent=others,
        break_long_words=False,
        break_on_hyphens=False,
    )


def _number(value: float | None) -> str:
    if value is None:
        return "–"
    return f"{value:.0f}" if value >= 100.0 else f"{value:.1f}"


def _of(percent: float | None) -> str:
    if percent is None:
        return "–"
    if percent < 0.1:
        return "< 0.1 %"
    return f"{percent:.1f} %" if percent < 99.95 or percent == 100.0 else "> 99.9 %"


def _millions(stars: int) -> str:
    if stars >= 995_000_000:
        return f"{stars / 1e9:.2f} G"
    return f"{stars / 1e6:.3g} M" if stars >= 1_000_000 else f"{stars / 1e3:.3g} k"
