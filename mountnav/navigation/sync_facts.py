"""A sync in numbers, as the journal keeps it: absolute values, what was expected, and what came of it."""

from __future__ import annotations

import math
from enum import StrEnum

from mountnav.navigation.camera_normal import Normal
from mountnav.navigation.doubts import SyncContext
from mountnav.navigation.reports import Look
from mountnav.navigation.sync_policy import SyncPolicy
from mountnav.navigation.sync_read_back import ReadBack
from mountnav.sky.coordinates import Icrs


class SyncEnd(StrEnum):
    """How a sync transaction ended; `outcome` of the journal's rows of `EntryKind.SYNC`."""

    COMMITTED = "committed"
    REFUSED = "refused by the mount"
    IGNORED = "ignored by the mount"
    ELSEWHERE = "taken for another place"
    BY_SIGHT = "not taken, counts by sight"
    """A look has shown how far off it is."""
    UNDONE = "undone"
    UNDO_FAILED = "undo failed"
    UNKNOWN = "unknown"
    """It may have been carried out: the mount could not be asked."""
    INTERRUPTED = "interrupted"
    """The work was cancelled after the sync was sent."""


def look_facts(found: Look, normal: Normal | None) -> dict[str, object]:
    """What was seen and believed, and how the frame compares with those before it."""
    solution = found.solution
    return {
        "look_id": found.look_id,
        "seen": place_facts(found.seen),
        "believed": place_facts(found.believed),
        "offset_east_arcsec": found.offset.east_arcsec,
        "offset_north_arcsec": found.offset.north_arcsec,
        "offset_arcsec": found.offset.total_arcsec,
        "mid_exposure_utc": found.mid_exposure_utc.isoformat(),
        "pairs": solution.pairs,
        "rms_arcsec": number(solution.rms_arcsec),
        "sigma_arcsec": number(solution.center_sigma_arcsec),
        "false_probability": number(solution.false_probability),
        "mode": solution.mode,
        "scale_arcsec_px": solution.scale_arcsec_px,
        "rotation_deg": solution.rotation_deg,
        "parity": solution.parity,
        "usual_scale_arcsec_px": None if normal is None else normal.scale_arcsec_px,
        "usual_camera_angle_deg": None if normal is None else normal.camera_angle_deg,
    }


def context_facts(context: SyncContext, policy: SyncPolicy) -> dict[str, object]:
    """What was known besides."""
    expected = context.expected
    return {
        "rule": str(policy.rule),
        "syncs_tonight": context.counts.tonight,
        "syncs_on_target": context.counts.on_target,
        "modeled": context.modeled,
        "expected_east_arcsec": None if expected is None else expected.offset.east_arcsec,
        "expected_north_arcsec": None if expected is None else expected.offset.north_arcsec,
        "expected_sigma_arcsec": None if expected is None else number(expected.sigma_arcsec),
    }


def read_back_facts(sent: ReadBack) -> dict[str, object]:
    """What the mount's readings showed."""
    return {
        "seen_as": str(sent.outcome),
        "read_back": place_facts(sent.place),
        "read_back_miss_arcsec": sent.miss_arcsec,
        "after_s": sent.after_s,
    }


def place_facts(place: Icrs) -> dict[str, float]:
    """An ICRS place."""
    return {"ra_deg": place.ra_deg, "dec_deg": place.dec_deg}


def number(value: float) -> float | None:
    """JSON knows no infinity."""
    return value if math.isfinite(value) else None


__all__ = ["SyncEnd", "context_facts", "look_facts", "number", "place_facts", "read_back_facts"]
