"""A frame that was read, placed and compared, and what the rules are told of it."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

from mountnav.frames import Frame
from mountnav.navigation.reports import Look
from mountnav.night.events import FrameSeen
from mountnav.night.frame_rules import begun_utc
from mountnav.night.frames_in import Arrived
from mountnav.night.placing import Placed
from mountnav.night.states import PlateSeen
from mountnav.night.telescope import FrameLooked
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import Offset, offset_arcsec
from mountnav.solution import Solution


@dataclass(frozen=True, slots=True)
class Seen:
    """A frame that was read, placed and compared."""

    frame: Frame
    placed: Placed
    looked: FrameLooked

    def event(self, arrived: Arrived, utc: datetime, *, moving: bool, segment: str) -> FrameSeen:
        """What the rules are told at `utc`.

        Parameters
        ----------
        arrived : Arrived
        utc : datetime
        moving : bool
            Whether the telescope is at work.
        segment : str
            Of the mount.
        """
        solution = self.placed.verdict.solution
        look = self.looked.look
        error, sigma = _error(look, solution, arrived.target)
        return FrameSeen(
            utc=utc,
            frame_id=arrived.frame_id,
            arrived_utc=arrived.arrived_utc,
            mid_utc=self.frame.mid_exposure_utc,
            begun_utc=begun_utc(self.frame.mid_exposure_utc, self.frame.exposure_s),
            held=arrived.held,
            placed=solution is not None,
            fully=self.placed.fully,
            plate=None if solution is None else _plate(solution, self.frame),
            error=error,
            of_target=arrived.target is not None,
            sigma_arcsec=sigma,
            doubts=tuple(str(one) for one in self.looked.doubts),
            moving=moving,
            field=self.placed.field,
            segment=segment,
            detail=self.looked.why if solution is not None else _why_not(self.placed),
        )


def _error(look: Look | None, solution: Solution | None, target: Icrs | None) -> tuple[Offset | None, float]:
    """What the telescope is off, and how well that is known."""
    if look is None or solution is None:
        return None, 0.0
    error = look.offset if target is None else offset_arcsec(look.seen, target)
    return error, solution.center_sigma_arcsec


def _plate(solution: Solution, frame: Frame) -> PlateSeen:
    size = frame.width_px, frame.height_px
    return PlateSeen(solution.scale_arcsec_px, solution.rotation_deg, solution.parity, size)


def _why_not(placed: Placed) -> str:
    verdict = placed.verdict
    reason = str(verdict.reason) if verdict.reason is not None else "not identified"
    return f"{reason} ({verdict.detail})" if verdict.detail and verdict.detail != reason else reason
