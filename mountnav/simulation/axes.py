"""One motor axis in motion: pieces of constant acceleration, so its angle is a closed formula of time.

An `AxisPath` is immutable; every order gives a new one that keeps the past, so the same instant has the
same angle however often and in whatever order it is asked for. Backlash is the play operator of hysteresis:
within a piece that doesn't reverse, the driven side is the clipped angle, so it is a closed formula as well.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass, replace

PAST_PIECES = 512
"""How much of the past is kept: about a hundred slews, further back than any mid-exposure."""


@dataclass(frozen=True, slots=True)
class Piece:
    """Motion from `start_s` until the next piece: angle, velocity, constant acceleration.

    `driven_deg` is the angle of the side behind the play at `start_s`; `steady` tells tracking and rest
    from a move, `guiding` a guide pulse from both.
    """

    start_s: float
    angle_deg: float
    velocity_deg_s: float
    acceleration_deg_s2: float
    driven_deg: float
    steady: bool
    guiding: bool = False

    def angle_at(self, t_s: float) -> float:
        """Motor angle at `t_s`, deg."""
        dt = t_s - self.start_s
        return self.angle_deg + dt * (self.velocity_deg_s + 0.5 * self.acceleration_deg_s2 * dt)

    def velocity_at(self, t_s: float) -> float:
        """Motor velocity at `t_s`, deg/s."""
        return self.velocity_deg_s + self.acceleration_deg_s2 * (t_s - self.start_s)

    def driven_at(self, t_s: float, play_deg: float) -> float:
        """Angle behind a play of `play_deg`: it lies between the motor's angle and that much above it."""
        angle = self.angle_at(t_s)
        return min(max(self.driven_deg, angle), angle + play_deg)


@dataclass(frozen=True, slots=True)
class AxisPath:
    """The motion of one axis, past and planned.

    Attributes
    ----------
    pieces : tuple of Piece
        In order of time, at least one; the first also stands for all time before it.
    play_deg : float
        Backlash.
    """

    pieces: tuple[Piece, ...]
    play_deg: float = 0.0

    @classmethod
    def resting(cls, t_s: float, angle_deg: float, velocity_deg_s: float, play_deg: float = 0.0) -> AxisPath:
        """Make a path in steady motion, with the play taken up from below."""
        return cls((Piece(t_s, angle_deg, velocity_deg_s, 0.0, angle_deg, True),), play_deg)

    def _piece(self, t_s: float) -> Piece:
        index = bisect_right(self.pieces, t_s, key=lambda piece: piece.start_s) - 1
        return self.pieces[max(index, 0)]

    def angle_at(self, t_s: float) -> float:
        """Motor angle, deg, unwrapped."""
        return self._piece(t_s).angle_at(t_s)

    def velocity_at(self, t_s: float) -> float:
        """Motor velocity, deg/s."""
        return self._piece(t_s).velocity_at(t_s)

    def driven_at(self, t_s: float) -> float:
        """Angle behind the play, deg, unwrapped."""
        return self._piece(t_s).driven_at(t_s, self.play_deg)

    def steady_at(self, t_s: float) -> bool:
        """Whether the axis tracks or rests."""
        return self._piece(t_s).steady

    def guiding_at(self, t_s: float) -> bool:
        """Whether a guide pulse moves the axis."""
        return self._piece(t_s).guiding

    def next_pieces(self, t_s: float) -> list[tuple[Piece, float, float]]:
        """Pieces from `t_s` on, each with the part of it that is still to come: from and until (s)."""
        first = max(bisect_right(self.pieces, t_s, key=lambda piece: piece.start_s) - 1, 0)
        ends = [piece.start_s for piece in self.pieces[first + 1 :]] + [math.inf]
        return [
            (piece, max(t_s, piece.start_s), end_s)
            for piece, end_s in zip(self.pieces[first:], ends, strict=True)
        ]

    def _continued(self, t_s: float, legs: list[tuple[float, float]], velocity_deg_s: float) -> AxisPath:
        """Cut the path at `t_s`; lead it on by legs of (duration s, acceleration), then at `velocity_deg_s`.

        A leg that turns round is cut at the turn, as the play operator needs.
        """
        past = [piece for piece in self.pieces if piece.start_s < t_s][-PAST_PIECES:]
        now = self._piece(t_s)
        piece = Piece(t_s, now.angle_at(t_s), now.velocity_at(t_s), 0.0, self.driven_at(t_s), False)
        for duration_s, acceleration in legs:
            piece = replace(piece, acceleration_deg_s2=acceleration)
            turn_s = -piece.velocity_deg_s / acceleration if acceleration else -1.0
            for leg_s in [turn_s, duration_s - turn_s] if 0.0 < turn_s < duration_s else [duration_s]:
                if leg_s <= 0.0:
                    continue
                past.append(piece)
                end_s = piece.start_s + leg_s
                piece = replace(
                    piece,
                    start_s=end_s,
                    angle_deg=piece.angle_at(end_s),
                    velocity_deg_s=piece.velocity_at(end_s),
                    driven_deg=piece.driven_at(end_s, self.play_deg),
                )
        past.append(replace(piece, velocity_deg_s=velocity_deg_s, acceleration_deg_s2=0.0))
        return replace(self, pieces=tuple(past))

    def to_velocity(
        self, t_s: float, velocity_deg_s: float, acceleration_deg_s2: float, *, steady: bool
    ) -> AxisPath:
        """From `t_s` on ramp to a velocity and keep it; `steady` says whether that is tracking or rest."""
        change = velocity_deg_s - self.velocity_at(t_s)
        legs = [(abs(change) / acceleration_deg_s2, math.copysign(acceleration_deg_s2, change))]
        return self._continued(t_s, legs, velocity_deg_s)._ending(steady)

    def halted(self, t_s: float, *, steady: bool = True) -> AxisPath:
        """Stand still from `t_s` on, at once: no motor stops like this by itself."""
        path = self._continued(t_s, [], 0.0)
        return path._ending(steady)

    def pulsed(
        self,
        t_s: float,
        rate_deg_s: float,
        velocity_deg_s: float,
        acceleration_deg_s2: float,
        duration_s: float,
    ) -> AxisPath:
        """Run for a time `rate_deg_s` (signed) faster than `velocity_deg_s`, and go on with that.

        From steady motion it ends exactly rate times duration away from where it would have been: what the
        first ramp lacks the last one makes up; a pulse shorter than its ramps is lower, and somewhat longer.
        """
        a, size = acceleration_deg_s2, abs(rate_deg_s)
        change = velocity_deg_s + rate_deg_s - self.velocity_at(t_s)
        first_s = abs(change) / a
        if first_s <= duration_s:
            legs = [
                (first_s, math.copysign(a, change)),
                (duration_s - first_s, 0.0),
                (size / a, -math.copysign(a, rate_deg_s)),
            ]
        else:
            ramp_s = math.sqrt(size * duration_s / a)
            legs = [(ramp_s, math.copysign(a, rate_deg_s)), (ramp_s, -math.copysign(a, rate_deg_s))]
        path = self._continued(t_s, legs, velocity_deg_s)
        *pulse, last = (piece for piece in path.pieces if piece.start_s >= t_s)
        past = (piece for piece in path.pieces if piece.start_s < t_s)
        pieces = (*past, *(replace(piece, guiding=True) for piece in pulse), last)
        return replace(path, pieces=pieces)._ending(True)

    def to_angle(
        self,
        t_s: float,
        angle_deg: float,
        velocity_deg_s: float,
        rate_deg_s: float,
        acceleration_deg_s2: float,
    ) -> AxisPath:
        """From `t_s` on catch up with a target in the shortest time, and stay on it.

        Parameters
        ----------
        t_s : float
            Now.
        angle_deg, velocity_deg_s : float
            Where the target is now (unwrapped) and how it runs.
        rate_deg_s, acceleration_deg_s2 : float
            Limits of the axis relative to the target; the profile is a trapezoid.
        """
        a = acceleration_deg_s2
        distance = angle_deg - self.angle_at(t_s)
        start = self.velocity_at(t_s) - velocity_deg_s
        side = math.copysign(1.0, distance - start * abs(start) / (2.0 * a))
        distance, start = side * distance, side * start
        peak = min(rate_deg_s, math.sqrt(max(a * distance + 0.5 * start * start, 0.0)))
        first_s = abs(peak - start) / a
        cruise = distance - 0.5 * (start + peak) * first_s - peak * peak / (2.0 * a)
        legs = [
            (first_s, side * math.copysign(a, peak - start)),
            (max(cruise, 0.0) / peak if peak > 0.0 else 0.0, 0.0),
            (peak / a, -side * a),
        ]
        path = self._continued(t_s, legs, velocity_deg_s)
        # rounding of the legs must not leave the axis beside its target
        last = path.pieces[-1]
        exact = angle_deg + velocity_deg_s * (last.start_s - t_s)
        last = replace(last, angle_deg=exact)
        last = replace(last, driven_deg=last.driven_at(last.start_s, self.play_deg))
        return replace(path, pieces=(*path.pieces[:-1], last))._ending(True)

    def _ending(self, steady: bool) -> AxisPath:
        return replace(self, pieces=(*self.pieces[:-1], replace(self.pieces[-1], steady=steady)))
