"""A mount's axis that does what it does, and is corrected: the truth beside a guider that may not see it."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from mountnav.guiding.actuator import Actuator
from mountnav.guiding.guider import Correction, Guider, LookFate


class Mechanism:
    """Two axes with gain and play; `made` is what corrections have truly come to."""

    def __init__(self, gain: float = 1.0, play_arcsec: float = 0.0) -> None:
        self.gain, self.play = gain, play_arcsec
        self.place = [0.0, 0.0]
        self.made = [0.0, 0.0]
        self.rates = [0.0, 0.0]

    def move(self, axis: int, amount: float) -> None:
        """Move a motor: the primary axis has no play."""
        play = self.play if axis else 0.0
        reached = self.place[axis] + self.gain * amount
        self.place[axis] = min(max(reached, 0.0), play)
        self.made[axis] += reached - self.place[axis]


class Held:
    """A guider over a disturbance, look after look; everything by the seed."""

    def __init__(
        self,
        disturbance: Callable[[float], tuple[float, float]],
        *,
        noise: float = 0.3,
        every_s: float = 20.0,
        seed: int = 0,
        gain: float = 1.0,
        play_arcsec: float = 0.0,
        told_play: float | None = 0.0,
        primary: Actuator | None = None,
        period_s: float | None = None,
    ) -> None:
        self.disturbance, self.noise, self.every_s = disturbance, noise, every_s
        self.mechanism = Mechanism(gain, play_arcsec)
        self.guider = Guider(
            primary or Actuator(),
            Actuator(play_arcsec=told_play),
            start_sigma_arcsec=1.0,
            period_s=period_s,
        )
        self.drawn = np.random.default_rng(seed)
        self.now_s = 0.0
        self.fates: list[LookFate] = []
        self.corrections: list[Correction] = []
        self.errors: list[tuple[float, float]] = []
        self.wanted = [0.0, 0.0]

    def off(self) -> tuple[float, float]:
        """Where it truly looks beside its target."""
        d = self.disturbance(self.now_s)
        return d[0] + self.mechanism.made[0] - self.wanted[0], d[1] + self.mechanism.made[1] - self.wanted[1]

    def dither(self, east: float, north: float) -> None:
        """Want it elsewhere."""
        self.wanted[0] += east
        self.wanted[1] += north
        self.guider.wanted_elsewhere(east, north)

    def go(self, looks: int, *, solved: Callable[[int], bool] = lambda _: True, wrong: float = 0.0) -> None:
        """Live so many intervals; `wrong`: the first look is off by that besides."""
        for number in range(looks):
            if solved(number):
                off = self.off()
                seen = self.guider.look(
                    self.now_s,
                    off[0] + self.noise * self.drawn.standard_normal() + (wrong if number == 0 else 0.0),
                    off[1] + self.noise * self.drawn.standard_normal() + (wrong if number == 0 else 0.0),
                    self.noise,
                )
                self.fates.append(seen.fate)
            done = self.guider.correction(self.now_s + 2.0, self.every_s)
            self.guider.corrected(done, self.now_s + 2.0)
            self.corrections.append(done)
            for axis, part in enumerate((done.primary, done.secondary)):
                self.mechanism.move(axis, part.step_arcsec)
                self.mechanism.rates[axis] = part.rate_arcsec_s
            for _ in range(4):
                self.errors.append(self.off())
                self.now_s += self.every_s / 4.0
                for axis in range(2):
                    self.mechanism.move(axis, self.mechanism.rates[axis] * self.every_s / 4.0)

    def rms(self, axis: int, last: int) -> float:
        """Residual of an axis over the last so many looks."""
        return math.sqrt(float(np.mean(np.square([one[axis] for one in self.errors[-4 * last :]]))))

    def steps(self, axis: int) -> list[float]:
        """Corrections by steps of an axis."""
        return [(one.primary, one.secondary)[axis].step_arcsec for one in self.corrections]


def still(_: float) -> tuple[float, float]:
    """A mount that does nothing by itself."""
    return 0.0, 0.0


__all__ = ["Held", "Mechanism", "still"]
