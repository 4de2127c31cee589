"""`mountnav model fit`, `show`, `export`, `import` and `plan`."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import Literal
from uuid import uuid4

from api.cli.model_sources import Source, Whose, source, whose
from mountnav.clock import SystemClock
from mountnav.errors import BadRequest
from mountnav.files import read_bytes
from mountnav.pointing.model.acceptance import Made, make
from mountnav.pointing.model.fit import Fit
from mountnav.pointing.model.model import PointingModel, model_of, noted
from mountnav.pointing.model.planning import RunPlan, allowed_by, plan
from mountnav.pointing.model.terms import term
from mountnav.pointing.model.tpoint_file import model_from, read_coefficients, write_coefficients


def terms_of(text: str | None, about: Whose) -> Sequence[str] | Literal["auto"]:
    """Read ``auto`` or ``IH,ID,CH``; the settings' if not given."""
    if text is None:
        return about.model.terms
    if text == "auto":
        return "auto"
    names = tuple(name.strip().upper() for name in text.split(",") if name.strip())
    if not names:
        raise BadRequest("no terms are given", advice="auto, or names such as IH,ID,CH,ME,MA,TF")
    return names


def show_fit(
    given: str,
    about: Whose,
    *,
    terms: str | None,
    out: Path | None,
    against: Path | None,
    since: datetime | None,
    until: datetime | None,
    anyway: bool,
    as_json: bool,
) -> int:
    """Fit, judge, write; 0 if the model is accepted, 1 if it is not.

    Raises
    ------
    MountnavError
        Nothing could be fitted.
    """
    read = source(given, about, since=since, until=until)
    old = _old(about, against, out)
    made = made_of(read, about, terms_of(terms, about), old)
    model = model_made(made, about, read.said)
    accepted = made.judged.accepted
    written = out is not None and (accepted or anyway)
    if written:
        assert out is not None
        if not accepted:
            model = noted(model, *(f"written though: {reason}" for reason in made.judged.reasons))
        model.save(out)
    if as_json:
        print_json(fit_record(made, model, out if written else None))
    else:
        sys.stdout.write("\n".join(fit_lines(made, model)) + "\n")
        if out is not None:
            told = f"written to {out}" if written else f"NOT written to {out}: what was there stays"
            sys.stdout.write(told + "\n")
    return 0 if accepted else 1


def _old(about: Whose, against: Path | None, out: Path | None) -> PointingModel | None:
    """What the new one must be better than: the one named, the settings', or the one to be overwritten."""
    for path in (against, about.model.file, out):
        if path is not None and (path is against or path.exists()):
            return PointingModel.load(path)
    return None


def made_of(
    read: Source, about: Whose, terms: Sequence[str] | Literal["auto"], old: PointingModel | None
) -> Made:
    """Make the model of a source with a telescope's settings."""
    return make(
        read.all,
        terms=terms,
        highest_harmonic=about.model.highest_harmonic,
        max_sigma_arcsec=about.model.max_sigma_arcsec,
        min_points=about.model.min_points,
        old=old,
        held_out=read.held_out,
        fresh=read.fresh,
    )


def model_made(made: Made, about: Whose, said: str) -> PointingModel:
    """Give it its identity."""
    return model_of(
        made.fit,
        made_utc=SystemClock().utc(),
        does_refraction=about.model.does_refraction,
        telescope=about.telescope,
        source=said,
    )


def fit_record(made: Made, model: PointingModel, written: Path | None) -> dict[str, object]:
    """What `--json` tells of a fit."""
    found = made.fit
    return {
        "accepted": made.judged.accepted,
        "judgement": _finite(asdict(made.judged)),
        "model": json.loads(model.to_json()),
        "written_to": None if written is None else str(written),
        "observations": len(found.observations),
        "used": int(found.used.sum()),
        "visits": len(found.points),
        "after": _finite(asdict(found.after)),
        "before": _finite(asdict(found.before)),
        "loo_arcsec": found.loo_arcsec if math.isfinite(found.loo_arcsec) else None,
        "condition": found.condition if math.isfinite(found.condition) else None,
        "correlation": [[round(float(one), 4) for one in row] for row in found.correlation],
        "segments": [asdict(one) for one in found.segments],
        "steps": [_finite(asdict(one)) for one in found.steps],
        "residuals_arcsec": [
            {"xi": round(float(xi), 3), "eta": round(float(eta), 3), "used": bool(used)}
            for (xi, eta), used in zip(found.residuals_arcsec, found.used, strict=True)
        ],
    }


def _finite(record: dict[str, object]) -> dict[str, object]:
    return {
        key: None if isinstance(value, float) and not math.isfinite(value) else value
        for key, value in record.items()
    }


def fit_lines(made: Made, model: PointingModel) -> Iterator[str]:
    """Write out a fit."""
    found, judged = made.fit, made.judged
    yield from model_lines(model)
    yield ""
    yield f"{'':24}{'zero points alone':>20}{'with the model':>18}"
    rows = (
        ("sky RMS (n-k), as PMFIT", found.before.sky_rms_arcsec, found.after.sky_rms_arcsec),
        ("sky RMS (n)", found.before.population_rms_arcsec, found.after.population_rms_arcsec),
        ("90 % within", found.before.percent_90_arcsec, found.after.percent_90_arcsec),
        ("largest", found.before.max_arcsec, found.after.max_arcsec),
    )
    for name, before, after in rows:
        yield f"{name:24}{_arcsec(before, 20)}{_arcsec(after, 18)}"
    if found.after.sky_rms_arcsec is None:
        yield "(n-k) is unknown where each look costs an unknown, as after many syncs: see left out in turn"
    yield ""
    yield f"{'':24}{'what was there':>20}{'the new model':>18}"
    pairs = (
        ("left out in turn", judged.old_loo_arcsec, judged.new_loo_arcsec),
        (f"{judged.held_out} held-out visits", judged.old_held_out_arcsec, judged.new_held_out_arcsec),
    )
    for name, before, after in pairs[: 2 if judged.held_out else 1]:
        yield f"{name:24}{_arcsec(before, 20)}{_arcsec(after, 18)}"
    yield from _far(found)
    if len(found.segments) > 1:
        yield ""
        yield f"{len(found.segments)} segments with zero points of their own:"
        for one in found.segments:
            names = ", ".join(name[:12] or "-" for name in one.segment_ids)
            if one.first_arcsec is None:
                yield f"  {names}: no point counts"
            else:
                yield (
                    f"  {one.points:4d} points  {model.terms[0]} {one.first_arcsec:+9.1f}″  "
                    f"{model.terms[1]} {one.second_arcsec:+9.1f}″  {names}"
                )
    yield ""
    yield "accepted: " if judged.accepted else "NOT accepted; the old one stays:"
    for reason in judged.reasons:
        yield f"  {reason}"


def _arcsec(value: float | None, width: int) -> str:
    """A figure in its column; unknown is no number."""
    told = "unknown" if value is None or not math.isfinite(value) else f"{value:.2f}″"
    return f"{told:>{width}}"


def _far(found: Fit) -> Iterator[str]:
    looks, used = len(found.observations), int(found.used.sum())
    if len(found.points) < looks:
        yield f"{looks} looks are {len(found.points)} visits of targets, and as much is known"
    if used < looks:
        yield f"{looks - used} of {looks} looks are left out as gross errors"


def model_lines(model: PointingModel) -> Iterator[str]:
    """Write out a model."""
    yield f"{model.kind} model {model.id[:12]} of {model.telescope or 'no telescope'}"
    yield (
        f"made {model.made_utc:%Y-%m-%d %H:%M} UTC of {model.source or 'unknown'}: "
        f"{model.n_used} of {model.n} points, latitude {model.site_latitude_deg:.4f}°"
    )
    if model.sky_rms_arcsec is None and model.population_rms_arcsec is not None:
        yield f"sky RMS (n-k) unknown, (n) {model.population_rms_arcsec:.2f}″"
    elif model.sky_rms_arcsec is not None:
        before = "" if model.before_arcsec is None else f", zero points alone {model.before_arcsec:.1f}″"
        yield f"sky RMS {model.sky_rms_arcsec:.2f}″{before}"
    if model.loo_arcsec is not None:
        yield f"left out in turn, targets are predicted to {model.loo_arcsec:.2f}″"
    yield ""
    for name, value, sigma in zip(model.terms, model.coefficients_arcsec, model.sigma_arcsec, strict=True):
        yield f"  {name:8} {value:+10.2f}″ ± {sigma:7.2f}″  {term(model.kind, name).meaning}"
    for note in model.notes:
        yield f"  note: {note}"


def show_model(path: Path, as_json: bool) -> None:
    """Print a model. Raises `BadRequest`."""
    model = PointingModel.load(path)
    if as_json:
        sys.stdout.write(model.to_json())
    else:
        sys.stdout.write("\n".join(model_lines(model)) + "\n")


def export(path: Path, out: Path | None) -> None:
    """Write a model as a TPOINT file of coefficients. Raises `BadRequest`."""
    text = write_coefficients(PointingModel.load(path))
    if out is None:
        sys.stdout.write(text)
    else:
        out.write_text(text, encoding="utf-8")
        sys.stdout.write(f"written to {out}\n")


def import_(path: Path, out: Path, about: Whose, latitude_deg: float | None) -> None:
    """Make a model file of a TPOINT file of coefficients. Raises `BadRequest`."""
    if latitude_deg is None and about.site is None:
        raise BadRequest(
            "the latitude of the telescope is not known", advice="give --config, --site or --latitude"
        )
    try:
        text = read_bytes(path).decode("utf-8", "replace")
    except OSError as cause:
        raise BadRequest(f"{path} can't be read: {cause.strerror}") from cause
    latitude = latitude_deg if latitude_deg is not None else about.site.latitude_deg if about.site else 0.0
    model = model_from(
        read_coefficients(text, name=str(path)),
        model_id=uuid4().hex,
        site_latitude_deg=latitude,
        made_utc=SystemClock().utc(),
        does_refraction=about.model.does_refraction,
        telescope=about.telescope,
    )
    model.save(out)
    sys.stdout.write("\n".join(model_lines(model)) + f"\nwritten to {out}\n")


def planned(
    about: Whose,
    points: int | None,
    kind: Literal["spiral", "random"],
    seed: int,
    both_sides_each: bool = False,
) -> RunPlan:
    """Plan a run over the sky that a telescope's limits allow. Raises `BadRequest`."""
    if about.settings is None or about.site is None:
        raise BadRequest("a run needs the limits of a telescope", advice="give the settings with --config")
    return plan(
        points or about.model.run_points,
        about.site,
        allowed_by(about.settings.limits.limits, about.site),
        mounting=about.settings.mount.mounting,
        kind=kind,
        seed=seed,
        both_sides_each=both_sides_each,
    )


def show_plan(
    config: Path,
    telescope: str | None,
    points: int | None,
    kind: Literal["spiral", "random"],
    seed: int,
    both_sides_each: bool,
    as_json: bool,
) -> None:
    """Print the points of a run. Raises `BadRequest`, `BadSettings`."""
    about = whose(config, telescope)
    found = planned(about, points, kind, seed, both_sides_each)
    if as_json:
        record = {
            "telescope": about.telescope,
            "way_deg": round(found.way_deg, 2),
            "points": [asdict(one) for one in found.points],
        }
        print_json(record)
        return
    sys.stdout.write(f"{'':>4} {'azimuth':>8} {'altitude':>8} {'HA':>8} {'Dec':>7}  side\n")
    for one in found.points:
        held = "  held out" if one.held_out else ""
        sys.stdout.write(
            f"{one.number:4d} {one.az_deg:8.2f} {one.alt_deg:8.2f} {one.ha_deg:8.2f} {one.dec_deg:7.2f}  "
            f"{one.side}{held}\n"
        )
    sys.stdout.write(f"{len(found.points)} points; the axes turn {found.way_deg:.0f}° in all\n")


def print_json(record: dict[str, object]) -> None:
    """One line of JSON on standard output."""
    sys.stdout.write(json.dumps(record, ensure_ascii=False, allow_nan=False) + "\n")
