"""Frames that lie in the shared folder: the rendered ones with exact truth, and the real ones."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from astropy.io import fits

from benchmarks.frames import Known, rendered
from benchmarks.frames import real as known_real
from benchmarks.peers.running import WRONG_PX, Job

WIDE_DEG = 0.6
"""Real frames of grade A and B with a field like this are to be solved without a hint."""


def rendered_jobs(shared: Path, presets: str, folder: Path) -> Iterator[Job]:
    """The rendered frames, unpacked to what a camera writes; a file is there until the next is asked for."""
    truths = {one["file"]: one for one in json.loads(_truth(shared).read_text(encoding="utf-8"))}
    for known in rendered(shared):
        truth = truths[known.path.name]
        if truth["preset"] not in presets:
            continue
        plain = folder / known.path.name.removesuffix(".fz")
        with fits.open(known.path) as hdus:
            image = hdus[1]
            # a header's word about the telescope would be a hint
            kept = {key: image.header[key] for key in ("DATE-OBS", "EXPTIME") if key in image.header}
            pixels = np.asarray(image.data)
        if pixels.dtype != np.uint16:
            pixels = np.clip(np.rint(pixels), 0, 65535).astype(np.uint16)
        fits.PrimaryHDU(pixels, fits.Header(kept)).writeto(plain)
        yield Job(
            name=plain.stem,
            preset=f"{truth['preset']} given",
            path=plain,
            width_px=truth["w"],
            height_px=truth["h"],
            center=known.center,
            scale_arcsec_px=known.scale_arcsec_px,
            hint=known.hint,
            catalog_stars=truth["ncat"],
        )
        plain.unlink()


def real_jobs(shared: Path) -> Iterator[Job]:
    """The real frames as they are."""
    for known in known_real(shared):
        yield Job(
            name="/".join(known.path.parts[-2:]),
            preset=_kind(known),
            path=known.path,
            width_px=0,
            height_px=0,
            center=known.center,
            scale_arcsec_px=known.scale_arcsec_px,
            hint=known.hint,
            allowed_px=known.allowed_px() if known.scale_arcsec_px else max(WRONG_PX, 60.0),
        )


def _truth(shared: Path) -> Path:
    return shared / "data" / "rendered" / "truth.json"


def _kind(known: Known) -> str:
    if known.grade in "AB":
        return f"real A, B, {'≥' if known.field_deg >= WIDE_DEG else '<'} {WIDE_DEG:g}°"
    return f"real {known.grade}"
