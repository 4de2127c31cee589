"""Measure pointing models: PMFIT's data, spoiled data, speed, and how honest the figures are.

Run: python -m benchmarks.pointing_model [--data FILE] [--seeds 200] [--json]

published     the six standard terms on PMFIT's equatorial file: sky RMS, coefficients, zero points alone
automatic     terms chosen by leave-one-out, and what points that had no part in the choice say of it
spoiled       8 % gross errors of 10 to 60′ and 4 syncs of 10′ at random moments, many times over
speed         1,000 points, 14 terms true, selection included; process time, best of five
sigmas        synthetic telescopes, both sides of the pier: coefficients off by how many of their sigmas
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from mountnav.errors import ModelRefused
from mountnav.pointing.model.acceptance import predicted
from mountnav.pointing.model.fit import fit
from mountnav.pointing.model.mechanical import Mechanical
from mountnav.pointing.model.rigorous import angles, axes_for, direction, geometry
from mountnav.pointing.model.tpoint_file import read_observations_text
from mountnav.units import RAD_PER_ARCSEC

SIX = ("IH", "ID", "CH", "ME", "MA", "TF")
PUBLISHED = {"IH": -92.258, "ID": -126.738, "CH": 44.210, "ME": 64.848, "MA": -2.992, "TF": 10.993}
FOURTEEN = {
    "IH": 300.0, "ID": -200.0, "CH": 120.0, "NP": 40.0, "ME": 90.0, "MA": -60.0, "TF": 30.0, "FO": 25.0,
    "HCES": 20.0, "HCEC": -18.0, "DCES": 15.0, "HHSH2": 14.0, "HDCH2": 12.0, "HDSH3": 10.0,
}  # fmt: skip


def telescope(coefficients: dict[str, float], n: int, noise_arcsec: float, seed: int) -> Mechanical:
    """Looks of an equatorial telescope at latitude 48.93°, on both sides of the pier."""
    rng = np.random.default_rng(seed)
    latitude = math.radians(48.93)
    seen = rng.normal(size=(20 * n, 3))
    seen /= np.linalg.norm(seen, axis=1)[:, None]
    up = math.cos(latitude) * seen[:, 0] + math.sin(latitude) * seen[:, 2]
    seen = seen[up > math.sin(math.radians(15.0))][:n]
    beyond = rng.random(n) < 0.5
    axes = axes_for(geometry("equatorial", latitude, coefficients), seen, beyond)
    noise = rng.normal(0.0, noise_arcsec * RAD_PER_ARCSEC, (n, 2))
    return Mechanical(
        "equatorial", latitude, seen, beyond, axes.lon_rad + noise[:, 0] / np.cos(axes.lat_rad),
        axes.lat_rad + noise[:, 1], np.full(n, 0.5), np.zeros(n, dtype=np.int64), ("s",),
    )  # fmt: skip


def spoiled(m: Mechanical, seed: int) -> Mechanical:
    """8 % gross errors of 10 to 60′, 4 syncs of 10′."""
    rng = np.random.default_rng(seed)
    n = len(m)
    segment = np.searchsorted(
        np.sort(rng.choice(np.arange(1, n), 4, replace=False)), np.arange(n), side="right"
    )
    way = rng.uniform(0.0, 2.0 * np.pi, 4)
    zero = np.vstack([np.zeros((1, 2)), np.cumsum(np.stack([np.cos(way), np.sin(way)], axis=1), axis=0)])
    zero *= 600.0 * RAD_PER_ARCSEC
    wrong = rng.choice(n, round(0.08 * n), replace=False)
    lon, lat = angles(m.seen)
    size, way = (
        rng.uniform(600.0, 3600.0, len(wrong)) * RAD_PER_ARCSEC,
        rng.uniform(0.0, 2.0 * np.pi, len(wrong)),
    )
    lat[wrong] += size * np.sin(way)
    lon[wrong] += size * np.cos(way) / np.cos(lat[wrong])
    return replace(
        m,
        seen=direction(lon, lat),
        read_lon_rad=m.read_lon_rad - zero[segment, 0],
        read_lat_rad=m.read_lat_rad - zero[segment, 1],
        segment=segment.astype(np.int64),
        segment_ids=tuple(f"s{number}" for number in range(5)),
    )


def published(m: Mechanical) -> dict[str, object]:
    found = fit(m, SIX)
    told = dict(zip(found.terms, found.coefficients_arcsec.tolist(), strict=True))
    return {
        "sky_rms_arcsec": round(found.after.sky_rms_arcsec, 3),
        "zero_points_alone_arcsec": round(found.before.sky_rms_arcsec, 3),
        "loo_arcsec": round(found.loo_arcsec, 3),
        "largest_difference_arcsec": round(max(abs(told[name] - PUBLISHED[name]) for name in SIX), 3),
    }


def automatic(m: Mechanical, trials: int = 30) -> dict[str, object]:
    found = fit(m)
    rng = np.random.default_rng(1)
    total = count = 0.0
    for _ in range(trials):
        out = np.isin(np.arange(len(m)), rng.permutation(len(m))[: len(m) // 5])
        one = fit(m.chosen(~out))
        chosen = dict(zip(one.geometry_terms, one.coefficients_arcsec[2:].tolist(), strict=True))
        off = predicted(one.observations, one.used, m.chosen(out), chosen)
        total += float(np.sum(off**2))
        count += len(off)
    return {
        "terms": list(found.terms),
        "loo_arcsec": round(found.loo_arcsec, 3),
        "sky_rms_arcsec": round(found.after.sky_rms_arcsec, 3),
        "condition": round(found.condition, 1),
        "unseen_points_arcsec": round(math.sqrt(total / count), 3),
    }


def spoiled_many(m: Mechanical, seeds: int) -> dict[str, object]:
    clean, seen, auto, refused = [], [], [], 0
    whole = np.ones(len(m), dtype=np.bool_)
    for seed in range(seeds):
        made = spoiled(m, seed)
        try:
            found = fit(made, SIX)
        except ModelRefused:
            refused += 1
            continue
        told = dict(zip(found.geometry_terms, found.coefficients_arcsec[2:].tolist(), strict=True))
        clean.append(math.sqrt(float(np.mean(np.sum(predicted(m, whole, m, told) ** 2, axis=1)))))
        seen.append(found.after.population_rms_arcsec)
        if seed < 50:
            auto.append(fit(made).loo_arcsec)
    return {
        "seeds": seeds,
        "refused": refused,
        "on_the_good_data_arcsec": {"median": round(float(np.median(clean)), 2), "max": round(max(clean), 2)},
        "told_population_rms_arcsec": {
            "median": round(float(np.median(seen)), 2),
            "max": round(max(seen), 2),
        },
        "automatic_loo_arcsec": {"median": round(float(np.median(auto)), 2), "max": round(max(auto), 2)},
    }


def speed() -> dict[str, object]:
    m = telescope(FOURTEEN, 1000, 3.0, 1)
    result: dict[str, object] = {}
    for name, terms in (("given", tuple(FOURTEEN)), ("chosen", "auto")):
        best, found = math.inf, None
        for _ in range(5):
            began = time.process_time()
            found = fit(m, terms)
            best = min(best, time.process_time() - began)
        assert found is not None
        result[f"{name}_s"] = round(best, 3)
        result[f"{name}_terms"] = len(found.terms)
        result[f"{name}_loo_arcsec"] = round(found.loo_arcsec, 3)
    return result


def sigmas(trials: int = 40) -> dict[str, object]:
    truth = {name: FOURTEEN[name] for name in ("IH", "ID", "CH", "NP", "ME", "MA", "TF")}
    off = []
    for seed in range(trials):
        found = fit(telescope(truth, 50, 2.0, seed), tuple(truth))
        off.append((found.coefficients_arcsec - [truth[name] for name in found.terms]) / found.sigma_arcsec)
    values = np.array(off)
    return {
        "trials": trials,
        "rms_of_error_over_sigma": round(float(np.sqrt(np.mean(values**2))), 3),
        "within_1_sigma": round(float(np.mean(np.abs(values) < 1.0)), 3),
        "within_2_sigma": round(float(np.mean(np.abs(values) < 2.0)), 3),
        "largest": round(float(np.max(np.abs(values))), 2),
    }


def main() -> None:
    told = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    shared = Path(os.environ.get("MOUNTNAV_SHARED", Path(__file__).resolve().parents[2] / "shared"))
    told.add_argument("--data", type=Path, default=shared / "data" / "pointing" / "pmfit_equat.dat")
    told.add_argument("--seeds", type=int, default=200)
    told.add_argument("--json", action="store_true")
    options = told.parse_args()
    results: dict[str, object] = {}
    if options.data.exists():
        m = read_observations_text(options.data.read_text(), name=str(options.data))
        if m.kind == "equatorial":
            results["published"] = published(m)
            results["spoiled"] = spoiled_many(m, options.seeds)
        results["automatic"] = automatic(m)
    else:
        print(f"{options.data} is not there: give --data", file=sys.stderr)
    results["speed"] = speed()
    results["sigmas"] = sigmas()
    if options.json:
        print(json.dumps(results, ensure_ascii=False))
        return
    for name, values in results.items():
        print(name)
        assert isinstance(values, dict)
        for key, value in values.items():
            print(f"  {key:28} {value}")


if __name__ == "__main__":
    main()
