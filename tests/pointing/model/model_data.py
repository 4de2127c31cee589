"""Observations to fit: PMFIT's, spoiled ones, and those of telescopes whose errors are known."""

import math
from dataclasses import replace

import numpy as np

from mountnav.pointing.model.mechanical import Mechanical
from mountnav.pointing.model.rigorous import angles, axes_for, direction, geometry
from mountnav.pointing.model.tpoint_file import read_observations_text
from mountnav.units import RAD_PER_ARCSEC

SIX = ("IH", "ID", "CH", "ME", "MA", "TF")


def pmfit(shared) -> Mechanical:
    path = shared / "data" / "pointing" / "pmfit_equat.dat"
    return read_observations_text(path.read_text(), name=path.name)


def spoiled(m: Mechanical, seed: int, *, outliers: float = 0.08, syncs: int = 4):
    """Gross errors of 10 to 60′, and syncs of 10′ at random moments; what was done to which point."""
    rng = np.random.default_rng(seed)
    n = len(m)
    cuts = np.sort(rng.choice(np.arange(1, n), syncs, replace=False))
    segment = np.searchsorted(cuts, np.arange(n), side="right").astype(np.int64)
    angle = rng.uniform(0.0, 2.0 * np.pi, syncs)
    jumps = 600.0 * RAD_PER_ARCSEC * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    zero = np.vstack([np.zeros((1, 2)), np.cumsum(jumps, axis=0)])
    wrong = rng.choice(n, round(outliers * n), replace=False)
    lon, lat = angles(m.seen)
    size, way = (
        rng.uniform(600.0, 3600.0, len(wrong)) * RAD_PER_ARCSEC,
        rng.uniform(0.0, 2.0 * np.pi, len(wrong)),
    )
    lat[wrong] += size * np.sin(way)
    lon[wrong] += size * np.cos(way) / np.cos(lat[wrong])
    made = replace(
        m,
        seen=direction(lon, lat),
        read_lon_rad=m.read_lon_rad - zero[segment, 0],
        read_lat_rad=m.read_lat_rad - zero[segment, 1],
        segment=segment,
        segment_ids=tuple(f"s{number}" for number in range(syncs + 1)),
    )
    return made, np.isin(np.arange(n), wrong)


def telescope(
    kind,
    coefficients,
    *,
    n=60,
    noise_arcsec=2.0,
    seed=1,
    latitude_deg=48.93,
    both_sides=False,
    lowest_deg=15.0,
) -> Mechanical:
    """Looks of a telescope that is wrong by rigorous rotations, all over its sky."""
    rng = np.random.default_rng(seed)
    latitude = math.radians(latitude_deg)
    alt = np.arcsin(rng.uniform(math.sin(math.radians(lowest_deg)), 0.998, n))
    az = rng.uniform(-np.pi, np.pi, n)
    if kind == "altaz":
        seen = direction(az, alt)
    else:
        up = np.sin(latitude) * np.sin(alt) + np.cos(latitude) * np.cos(alt) * np.cos(az)
        west = -np.cos(alt) * np.sin(az)
        south = np.sin(alt) * np.cos(latitude) - np.cos(alt) * np.cos(az) * np.sin(latitude)
        seen = np.stack([south, west, up], axis=1)
    beyond = rng.random(n) < 0.5 if both_sides else np.zeros(n, dtype=bool)
    axes = axes_for(geometry(kind, latitude, coefficients), seen, beyond)
    keep = axes.reached & ~axes.near_pole
    noise = rng.normal(0.0, noise_arcsec * RAD_PER_ARCSEC, (n, 2))
    lon = axes.lon_rad + noise[:, 0] / np.cos(axes.lat_rad)
    return Mechanical(
        kind, latitude, seen, beyond, lon, axes.lat_rad + noise[:, 1], np.full(n, 0.5),
        np.zeros(n, dtype=np.int64), ("s",),
    ).chosen(keep)  # fmt: skip
