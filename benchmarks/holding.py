"""Holding still over simulated nights: against doing nothing, and against the best that knew the truth.

``python -m benchmarks.holding [--seeds 0-999]``; exit code 1 if a night was worse than doing nothing, or the
median is above half of it or above 1.3 of the best; each night above 1.3 of the best is named.

Residual: root mean square of where the telescope looks from where it should, over the whole night from its
first moment, the learning included; seeing is no part of it, for nobody can correct it. All three controllers
live the same night: the same disturbances, the same looks, the same noise.

The best linear controller that knew the truth: a Kalman filter of each axis, whose model is that night's own
(the period, the true amplitude of each harmonic with its phase unknown, how large the drift is and how it
changes, variance and correlation time of gears and wind, the noise of each look, which looks are wrong, when
something jumps), and the law that is optimal for what the mount takes: the interval's mean put to zero by
steps; level and slope by steps and rates; x' = (√3 - 2) x by rates. With a linear model, Gaussian noise and a
quadratic cost no controller does better in the mean (the separation theorem). Its mount is better than ours,
too: it has no play, and but for the grain of its steps it does what it is told to the last digit.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mountnav.guiding.actuator import Actuator, ActuatorKind
from mountnav.guiding.guider import Correction, Guider, LookFate
from mountnav.guiding.law import NODE_WEIGHTS, line_through, node_times, rate_alone

Array = NDArray[np.float64]

LOOKS = 300
NO_WORSE = 1.0 + 1e-9
"""Held over nothing where no correction was made, but for rounding."""
SUB = 6
"""Moments between two looks at which the residual is measured."""
SIDEREAL = math.radians(15.041067 / 3600.0)


@dataclass
class TrueAxis:
    """What one axis does, and what is true of it."""

    slow: Array
    swing: Array
    gears: Array
    wind: Array
    jump: Array
    amplitudes: tuple[float, ...]
    period_s: float
    gears_sigma: float
    gears_tau_s: float
    walk: float
    wind_sigma: float

    @property
    def path(self) -> Array:
        """All of it, shape (LOOKS * SUB + 1,)."""
        return self.slow + self.swing + self.gears + self.wind + self.jump


@dataclass
class Night:
    """One simulated night."""

    seed: int
    every_s: float
    exposure_s: float
    axes: tuple[TrueAxis, TrueAxis]
    sigma: Array
    noise: Array
    noise_again: Array
    seeing_arcsec: float
    solved: NDArray[np.bool_]
    wrong: Array
    kind: ActuatorKind
    gain: tuple[float, float]
    gain_noise: float
    step_arcsec: float
    play_arcsec: tuple[float, float]
    play_told: bool
    period_told: bool
    altaz: bool
    delay: int
    jump_at: int
    words: str = ""
    facts: dict[str, float] = field(default_factory=dict)


def ornstein(rng: np.random.Generator, n: int, step_s: float, sigma: float, tau_s: float) -> Array:
    keep = math.exp(-step_s / tau_s)
    kick = sigma * math.sqrt(1.0 - keep * keep)
    noise = rng.standard_normal(n)
    out = np.empty(n)
    out[0] = 0.0
    for i in range(1, n):
        out[i] = keep * out[i - 1] + kick * noise[i]
    return out


def night(seed: int) -> Night:
    rng = np.random.default_rng(seed)
    every = float(rng.choice([15.0, 20.0, 30.0, 45.0, 60.0]))
    n = LOOKS * SUB + 1
    t = np.arange(n) * every / SUB
    altaz = bool(rng.random() < 0.15)
    cheap = bool(rng.random() < 0.6)
    fine = not cheap and bool(rng.random() < 0.4)
    south = bool(rng.random() < 0.5)
    latitude = math.radians(rng.uniform(15.0, 60.0) * (-1 if south else 1))
    # a place in the sky that stays above 25° for the night
    for _ in range(200):
        ha = rng.uniform(-4.0, 3.0) * math.pi / 12.0
        dec = math.asin(rng.uniform(-0.95, 0.95))
        h = ha + SIDEREAL * t
        sin_alt = math.sin(latitude) * math.sin(dec) + math.cos(latitude) * math.cos(dec) * np.cos(h)
        if sin_alt.min() > math.sin(math.radians(25.0)) and sin_alt.max() < math.sin(math.radians(85.0)):
            break
    else:
        ha, dec = 0.0, latitude * 0.6
        h = ha + SIDEREAL * t
        sin_alt = math.sin(latitude) * math.sin(dec) + math.cos(latitude) * math.cos(dec) * np.cos(h)
    alt = np.arcsin(np.clip(sin_alt, -1.0, 1.0))
    q = np.arctan2(np.sin(h), np.tan(latitude) * math.cos(dec) - math.sin(dec) * np.cos(h))
    east, north = np.zeros(n), np.zeros(n)
    if not altaz:
        polar = (rng.uniform(0.0, 10.0) if cheap else rng.uniform(0.0, 0.2 if fine else 2.0)) * 60.0
        turn = rng.uniform(0.0, 2.0 * math.pi)
        me, ma = polar * math.cos(turn), polar * math.sin(turn)
        east -= me * np.sin(h) * math.sin(dec) - ma * np.cos(h) * math.sin(dec)
        north += me * np.cos(h) + ma * np.sin(h)
        east += (
            (rng.normal(0.0, 15.0) if cheap else rng.normal(0.0, 0.1 if fine else 1.0))
            * t
            / 3600.0
            * math.cos(dec)
        )
    # refraction and sag act along the vertical
    refracts = fine or bool(rng.random() < 0.4)
    sag = rng.normal(0.0, 20.0 if cheap else 0.3 if fine else 5.0)
    vertical = (0.0 if refracts else 58.3) / np.tan(alt) + sag * np.cos(alt)
    if altaz:
        north += vertical
        model = rng.normal(0.0, 0.3 if fine else 20.0, 4)
        az = np.unwrap(
            np.arctan2(
                -np.cos(dec) * np.sin(h),
                math.cos(latitude) * math.sin(dec) - math.sin(latitude) * math.cos(dec) * np.cos(h),
            )
        )
        east += model[0] * np.sin(alt) + model[1] * np.cos(az) * np.sin(alt)
        north += model[1] * np.sin(az) + model[2] * np.cos(az)
    else:
        east += vertical * np.sin(q)
        north += vertical * np.cos(q)
    slow = [path - path[0] for path in (east, north)]
    cos_axis = math.cos(dec) if not altaz else float(np.cos(alt).mean())
    jump_at = int(rng.integers(LOOKS // 5, LOOKS)) if rng.random() < 0.1 else 0
    axes = []
    for number in range(2):
        follows = number == 0 or altaz
        size = (
            (rng.uniform(2.0, 15.0) if cheap else rng.uniform(0.0, 0.2 if fine else 1.5)) if follows else 0.0
        )
        shrink = cos_axis if number == 0 else 1.0
        period = float(rng.choice([150.0, 240.0, 358.0, 400.0, 479.0, 480.0, 600.0, 638.0]))
        period *= 1.0 + rng.uniform(-0.01, 0.01)
        shares = (1.0, rng.uniform(0.0, 0.3), rng.uniform(0.0, 0.2))
        amplitudes = tuple(size * shrink * share for share in shares)
        swing = np.zeros(n)
        for j, amplitude in enumerate(amplitudes, 1):
            swing += amplitude * np.sin(2.0 * math.pi * j * t / period + rng.uniform(0.0, 2.0 * math.pi))
        swing -= swing[0]
        gears_sigma = (
            rng.uniform(0.1, 1.2) if cheap else rng.uniform(0.01, 0.05) if fine else rng.uniform(0.02, 0.3)
        ) * (1.0 if follows else 0.3)
        gears_tau = float(np.exp(rng.uniform(math.log(30.0), math.log(900.0))))
        walk = (
            rng.uniform(0.0, 0.25) if cheap else rng.uniform(0.0, 0.01) if fine else rng.uniform(0.0, 0.05)
        ) / math.sqrt(60.0)
        wind = rng.uniform(0.0, 0.6) if rng.random() < 0.5 else 0.0
        gears = ornstein(rng, n, every / SUB, gears_sigma, gears_tau)
        gears += np.concatenate(
            ([0.0], np.cumsum(rng.standard_normal(n - 1) * walk * math.sqrt(every / SUB)))
        )
        jump = np.zeros(n)
        if jump_at:
            jump[jump_at * SUB + 3 :] = rng.choice([-1, 1]) * rng.uniform(4.0, 20.0)
        axes.append(
            TrueAxis(
                slow[number],
                swing,
                gears,
                ornstein(rng, n, every / SUB, wind, 3.0),
                jump,
                amplitudes,
                period,
                gears_sigma,
                gears_tau,
                walk,
                wind,
            )
        )
    exposure = min(0.4 * every, float(rng.uniform(2.0, 10.0)))
    seeing = rng.uniform(1.0, 4.0)
    motion = 0.25 * seeing / math.sqrt(exposure)
    solve = float(np.exp(rng.uniform(math.log(0.05), math.log(0.8))))
    sigma = solve * np.exp(rng.normal(0.0, 0.2, LOOKS))
    noise, noise_again = rng.standard_normal((2, LOOKS, 2)) * np.hypot(sigma, motion)[:, None]
    solved = rng.random(LOOKS) > rng.uniform(0.0, 0.15)
    if rng.random() < 0.2:
        cloud = int(rng.integers(20, LOOKS - 30))
        solved[cloud : cloud + int(rng.integers(5, 25))] = False
    wrong = np.zeros((LOOKS, 2))
    for at in np.flatnonzero(rng.random(LOOKS) < rng.uniform(0.0, 0.01)):
        wrong[at] = rng.choice([-1, 1], 2) * np.exp(rng.uniform(math.log(15.0), math.log(3000.0), 2))
    kind: ActuatorKind = str(rng.choice(["pulses", "pulses", "both", "rates"]))  # type: ignore[assignment]
    play = float(rng.uniform(0.0, 20.0)) if cheap and not altaz else 0.0
    told = (bool(rng.random() < 0.5), bool(rng.random() < 0.5))
    return Night(
        seed,
        every,
        exposure,
        (axes[0], axes[1]),
        sigma,
        noise,
        noise_again,
        motion,
        solved,
        wrong,
        kind,
        (float(np.clip(rng.normal(1.0, 0.1), 0.75, 1.25)), float(np.clip(rng.normal(1.0, 0.1), 0.75, 1.25))),
        float(rng.uniform(0.0, 0.05)),
        float(rng.choice([0.02, 0.1, 0.3])),
        (0.0, play),
        told[0],
        told[1],
        altaz,
        int(rng.integers(1, 4)),
        jump_at,
        f"{every:.0f} s {kind} {'cheap' if cheap else 'fine' if fine else 'good'}"
        f"{' alt-az' if altaz else ''} play {play:.0f}″ noise {math.hypot(solve, motion):.2f}″",
    )


class Plant:
    """The mount's axis under corrections."""

    def __init__(self, one: Night, axis: int, perfect: bool) -> None:
        self.gain = 1.0 if perfect else one.gain[axis]
        self.noise = 0.0 if perfect else one.gain_noise
        self.play = 0.0 if perfect else one.play_arcsec[axis]
        rng = np.random.default_rng((one.seed, axis, 7))
        self.rng = rng
        self.place = rng.uniform(0.0, self.play) if self.play else 0.0
        self.made = 0.0
        self.rate = 0.0
        self.step_arcsec = one.step_arcsec

    def step(self, amount: float) -> None:
        """Move by whole steps of its grain."""
        self.move(round(amount / self.step_arcsec) * self.step_arcsec)

    def move(self, amount: float) -> None:
        """Move the motor."""
        if amount == 0.0:
            return
        amount *= self.gain * (1.0 + self.noise * float(self.rng.standard_normal()))
        reached = self.place + amount
        self.place = min(max(reached, 0.0), self.play)
        self.made += reached - self.place


class Best:
    """The best linear controller of one axis, which knows what is true of it."""

    def __init__(self, one: Night, axis: int) -> None:
        true = one.axes[axis]
        dt = one.every_s / SUB
        self.kind = one.kind
        self.every = one.every_s
        H = len(true.amplitudes)
        n = 4 + 2 * H  # walk + rate, gears, wind, harmonics
        F = np.zeros((n, n))
        F[:2, :2] = [[1.0, dt], [0.0, 1.0]]
        kg, kw = math.exp(-dt / true.gears_tau_s), math.exp(-dt / 3.0)
        F[2, 2], F[3, 3] = kg, kw
        P = np.zeros((n, n))
        rates = np.diff(true.slow) / dt
        P[1, 1] = rates[0] ** 2
        Q = np.zeros((n, n))
        bend = (
            float(np.mean(np.diff(true.slow[:: 5 * SUB], n=2) ** 2)) / (5.0 * one.every_s) ** 3
            if LOOKS > 20
            else 0.0
        )
        Q[:2, :2] = bend * np.array([[dt**3 / 3.0, dt**2 / 2.0], [dt**2 / 2.0, dt]])
        Q[0, 0] += true.walk**2 * dt
        Q[2, 2] = true.gears_sigma**2 * (1.0 - kg * kg)
        Q[3, 3] = true.wind_sigma**2 * (1.0 - kw * kw)
        row = np.zeros(n)
        row[[0, 2, 3]] = 1.0
        for j, amplitude in enumerate(true.amplitudes):
            at = 4 + 2 * j
            turn = 2.0 * math.pi * (j + 1) * dt / true.period_s
            F[at : at + 2, at : at + 2] = [
                [math.cos(turn), math.sin(turn)],
                [-math.sin(turn), math.cos(turn)],
            ]
            P[at, at] = P[at + 1, at + 1] = 0.5 * amplitude**2
            row[at] = 1.0
        # the night begins on the target: the level undoes what the swing begins with
        for j in range(H):
            P[0, 0] += P[4 + 2 * j, 4 + 2 * j]
            P[0, 4 + 2 * j] = P[4 + 2 * j, 0] = -P[4 + 2 * j, 4 + 2 * j]
        self.F, self.Q, self.P, self.row = F, Q, P, row
        self.x = np.zeros(n)
        rows = []
        for ahead in node_times(one.every_s) + one.delay * dt:
            G = np.eye(n)
            G[0, 1] = ahead
            G[2, 2], G[3, 3] = math.exp(-ahead / true.gears_tau_s), math.exp(-ahead / 3.0)
            for j in range(H):
                at = 4 + 2 * j
                turn = 2.0 * math.pi * (j + 1) * ahead / true.period_s
                G[at : at + 2, at : at + 2] = [
                    [math.cos(turn), math.sin(turn)],
                    [-math.sin(turn), math.cos(turn)],
                ]
            rows.append(G.T @ row)
        self.rows = np.array(rows)

        # one step from look to look, and the forecast from the last look on
        whole, grown = np.eye(n), np.zeros((n, n))
        for _ in range(SUB):
            whole, grown = F @ whole, F @ grown @ F.T + Q
        self.F, self.Q = whole, grown

    def predict(self) -> None:
        """Go on to the next look."""
        self.x = self.F @ self.x
        self.P = self.F @ self.P @ self.F.T + self.Q

    def update(self, d: float, variance: float) -> None:
        """Take in a look: where the axis would be without corrections."""
        PH = self.P @ self.row
        S = float(self.row @ PH) + variance
        self.x = self.x + PH * ((d - float(self.row @ self.x)) / S)
        self.P = self.P - np.outer(PH, PH) / S

    def correct(self, plant: Plant) -> None:
        """Correct by the law that is optimal for what the mount takes."""
        path = self.rows @ self.x + plant.made
        if self.kind == "pulses":
            plant.step(-float(NODE_WEIGHTS @ path))
        elif self.kind == "rates":
            plant.rate = rate_alone(path, self.every)
        else:
            level, rate = line_through(path, self.every)
            plant.step(-level)
            plant.rate = -rate


def lived_best(one: Night) -> float:
    total = 0.0
    for axis in range(2):
        true = one.axes[axis]
        path = true.path
        best, plant = Best(one, axis), Plant(one, axis, perfect=True)
        step = one.every_s / SUB
        square = 0.0
        for look in range(LOOKS):
            for sub in range(SUB):
                k = look * SUB + sub
                if k:
                    plant.move(plant.rate * step)
                if k and sub == 0:
                    best.predict()
                if one.jump_at and k == one.jump_at * SUB + 3:
                    best.P[0, 0] += 100.0
                if sub == 0 and one.solved[look] and not one.wrong[look].any():
                    best.update(path[k] + one.noise[look, axis], one.sigma[look] ** 2 + one.seeing_arcsec**2)
                if sub == one.delay:
                    best.correct(plant)
                square += (path[k] + plant.made) ** 2
        total += square / (LOOKS * SUB)
    return math.sqrt(total)


def lived(one: Night, trace: list[tuple[float, ...]] | None = None) -> tuple[float, Guider]:
    actuators = [
        Actuator(
            kind=one.kind,
            step_arcsec=one.step_arcsec,
            error_share=0.05,
            most_arcsec=60.0,
            play_arcsec=0.0 if axis == 0 or one.altaz else one.play_arcsec[axis] if one.play_told else None,
        )
        for axis in range(2)
    ]
    guider = Guider(
        *actuators,
        start_sigma_arcsec=0.5,
        period_s=one.axes[0].period_s if one.period_told and not one.altaz else None,
        both_swing=one.altaz,
    )
    plants = [Plant(one, axis, perfect=False) for axis in range(2)]
    paths = [axis.path for axis in one.axes]
    step = one.every_s / SUB
    square = 0.0
    again = correct_at = -1
    for look in range(LOOKS):
        for sub in range(SUB):
            k = look * SUB + sub
            now = k * step
            if k:
                for plant in plants:
                    plant.move(plant.rate * step)
            if (sub == 0 and one.solved[look]) or k == again:
                noise = one.noise[look] + one.wrong[look] if sub == 0 else one.noise_again[look]
                seen = [paths[a][k] + plants[a].made + noise[a] for a in range(2)]
                told = guider.look(now, seen[0], seen[1], float(one.sigma[look]))
                # what is far off is looked at once more, as soon as that can be
                again = k + 3 if told.fate is LookFate.GATED and sub == 0 else -1
                correct_at = k + one.delay if again < 0 else again + one.delay
            if sub == 0 and not one.solved[look]:
                correct_at = k + one.delay
            if k == correct_at:
                left_s = ((look + 1) * SUB + one.delay - k) * step
                done: Correction = guider.correction(now, left_s)
                guider.corrected(done, now)
                for plant, part in zip(plants, (done.primary, done.secondary), strict=True):
                    plant.move(part.step_arcsec)
                    plant.rate = part.rate_arcsec_s
            off = [paths[a][k] + plants[a].made for a in range(2)]
            square += off[0] ** 2 + off[1] ** 2
            if trace is not None:
                trace.append((now, off[0], off[1], paths[0][k], paths[1][k]))
    return math.sqrt(square / (LOOKS * SUB)), guider


def lived_open(one: Night) -> float:
    n = LOOKS * SUB
    return math.sqrt(sum(float((axis.path[:n] ** 2).mean()) for axis in one.axes))


def summary(rows: list[tuple[float, ...]], took_s: float) -> bool:
    """Print what came of nights; whether all bounds were kept."""
    table = np.array(rows)
    names = ("nothing ″", "held ″", "best ″", "held / nothing", "held / best")
    for at, name in enumerate(names, 1):
        column = table[:, at]
        print(
            f"{name:15} min {column.min():.3f}  median {np.median(column):.3f}  "
            f"p90 {np.quantile(column, 0.9):.3f}  p99 {np.quantile(column, 0.99):.3f}  max {column.max():.3f}"
        )
    worse = int((table[:, 4] > NO_WORSE).sum())
    above = int((table[:, 5] > 1.3).sum())
    print(
        f"{len(rows)} nights: worse than nothing {worse}, above 1.3 of the best {above}; "
        f"{took_s:.0f} s of CPU",
        flush=True,
    )
    return worse == 0 and float(np.median(table[:, 4])) <= 0.5 and float(np.median(table[:, 5])) <= 1.3


def main() -> int:
    """Live all nights; print what came of them."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seeds", default="0-999", metavar="FIRST-LAST")
    asked = parser.parse_args()
    first, _, last = asked.seeds.partition("-")
    began = time.process_time()
    rows: list[tuple[float, ...]] = []
    for seed in range(int(first), int(last or first) + 1):
        one = night(seed)
        nothing, best = lived_open(one), lived_best(one)
        held, _ = lived(one)
        rows.append((seed, nothing, held, best, held / nothing, held / best))
        if held > NO_WORSE * nothing or held > 1.3 * best:
            print(
                f"seed {seed}: nothing {nothing:.2f}″ held {held:.2f}″ ({held / nothing:.3f}) "
                f"best {best:.2f}″ ({held / best:.3f})  {one.words}",
                flush=True,
            )
        if len(rows) % 100 == 0:
            summary(rows, time.process_time() - began)
    return 0 if summary(rows, time.process_time() - began) else 1


if __name__ == "__main__":
    sys.exit(main())
