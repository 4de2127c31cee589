"""Following a series: one frame is solved, the rest follow by shift; audits, and solving when lost."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import replace
from hashlib import blake2b
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.stars import Catalog
from mountnav.errors import BadFrame
from mountnav.frames import Frame, Hint
from mountnav.identification.plate import Plate
from mountnav.identification.preliminary import Preliminary
from mountnav.identification.selection import all_finite
from mountnav.identification.shift import mutual_pairs, sources_of
from mountnav.identification.trail_check import plate_stays
from mountnav.identification.wcs import plate_from_cards
from mountnav.measuring.measure import measure
from mountnav.measuring.measurements import Flag, Measurements
from mountnav.measuring.star_trail import star_trail
from mountnav.reading import demosaiced, read_frame
from mountnav.series.persistence import Persistence
from mountnav.series.report import series_report
from mountnav.series.results import FrameResult, Mode, SeriesReport, SeriesSettings, SeriesTimes, Shift
from mountnav.series.shift import (
    Anchor,
    Followed,
    MeasuredFrame,
    Size,
    field_turns,
    follow_frame,
    icrs_at_pixels,
    pixels_at_icrs,
    solution_of_move,
)
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import offset_arcsec, separation_arcsec
from mountnav.sky.wcs import is_zpn
from mountnav.solution import Reason, Solution, Verdict
from mountnav.solving.solve import solve

Array = NDArray[np.float64]
Index = NDArray[np.int64]


class SeriesMemory:
    """The sources of a series, by frame size: which were seen in how many frames.

    Parameters
    ----------
    frames : int
        In so many of them a source is persistent.
    """

    def __init__(self, frames: int) -> None:
        self._frames = frames
        self._of_size: dict[Size, Persistence] = {}
        self._ids: dict[int, Index] = {}

    def carry(self, size: Size, old: Plate | None, new: Plate | None) -> None:
        """Go on in the pixels of another anchor; start again where either has no plate."""
        memory = self._of_size.get(size)
        if memory is None or old is None or new is None:
            self._of_size[size] = Persistence(self._frames)
            return

        def to_new(x: Array, y: Array) -> tuple[Array, Array]:
            new_x, new_y = pixels_at_icrs(new, *icrs_at_pixels(old, x, y))
            far = (np.abs(new_x - new.center_x_px) > 1.5 * size[0]) | (
                np.abs(new_y - new.center_y_px) > 1.5 * size[1]
            )
            return np.where(far, np.nan, new_x), np.where(far, np.nan, new_y)

        memory.change_pixels(to_new)

    def added(self, look: MeasuredFrame, shift: Shift | None, result: FrameResult) -> FrameResult:
        """Add the frame's sources to what is known of the series."""
        m = look.measurements
        chosen = all_finite(m)
        dx, dy = (shift.dx_px, shift.dy_px) if shift else (0.0, 0.0)
        fwhm = m.fwhm_px[chosen]
        fwhm = fwhm[np.isfinite(fwhm)]
        reach = max(1.5, 0.6 * float(np.median(fwhm))) if fwhm.size else 1.5
        memory = self._of_size[look.size]
        ids = memory.add(m.x_px[chosen] + dx, m.y_px[chosen] + dy, m.flux[chosen], reach)
        self._ids[result.number] = ids
        return replace(result, persistent=int(memory.persistent(ids).sum()))

    def recounted(self, result: FrameResult) -> FrameResult:
        """A frame with its persistent sources as they are known now."""
        ids = self._ids.get(result.number)
        if ids is None:
            return result
        memory = self._of_size[(result.width_px, result.height_px)]
        return replace(result, persistent=int(memory.persistent(ids).sum()))

    def knows(self, result: FrameResult) -> bool:
        """Whether the frame's sources are known."""
        return result.number in self._ids

    def of_size(self, size: Size) -> Persistence:
        """What is known of the frames of one size."""
        return self._of_size[size]


SCALE_SHARE = 0.02
"""Share by which the scale of a frame may differ from that of the last solved one: temperature and focus
change it by less."""
NEAR_BUDGET_S = 10.0
"""Processor time of a full solution where the series should be, seconds; then come the caller's hints."""


def solve_in_series(
    frame: Frame,
    measurements: Measurements,
    catalog: Catalog,
    settings: SeriesSettings,
    *,
    near: Hint | None,
    hint: Hint | None,
) -> tuple[Verdict, float]:
    """Solve near where the series should be, then by caller's and header's hints; verdict and seconds."""
    began = time.perf_counter()
    solving = settings.solving
    verdict = None
    if near is not None:
        quick = replace(solving, budget_s=min(NEAR_BUDGET_S, solving.budget_s))
        verdict = solve(frame, catalog, hint=near, settings=quick, measurements=measurements)
    if verdict is None or not verdict.solved:
        again = solve(frame, catalog, hint=hint, settings=solving, measurements=measurements)
        verdict = again if again.solved or verdict is None else verdict
    return verdict, time.perf_counter() - began


def near_hint(frame: Frame, last: Solution | None, expected: Icrs | None) -> Hint | None:
    """Where the series is believed to be: where it should be by the shift, or where it was last."""
    if last is None:
        return None
    width = float(last.wcs["IMAGEW"])
    scale = last.scale_arcsec_px * width / frame.width_px  # another size is most often another binning
    share = SCALE_SHARE if frame.width_px == int(width) else 0.05
    field_deg = float(np.hypot(frame.width_px, frame.height_px)) * scale / 3600.0
    return Hint(
        center=expected or last.center,
        radius_deg=0.3 * field_deg if expected else max(1.0, 1.5 * field_deg),
        scale_low_arcsec_px=scale * (1.0 - share),
        scale_high_arcsec_px=scale * (1.0 + share),
        center_source="the series",
        scale_source="the series",
    )


AUDIT_SIGMAS = 5.0
"""A full solution contradicts the shift if they differ by more than so many of their errors together, and by
more than `AUDIT_LEAST_PX`. Chosen by hand."""
AUDIT_LEAST_PX = 1.0
"""A full solution that departs from the shift by less, pixels, contradicts nothing."""
LIGHT_REACH_PX = 3.0
"""How near to a shift's place its source is looked for, to see its light. Plain means are off by up to 0.4 px
(HATP-32); doubled, more neighbors are taken for it, and halved, a mean that is worse still loses its own."""
MORE_SOURCES = 1.5
"""With so many times the sources a frame takes the place of an unsolved first one. Chosen by hand."""
MOST_WAITING = 50
"""So many frames before the first solved one are kept, to be placed afterwards. A limit of memory."""


class SeriesFollower:
    """Follows a series frame by frame, as a night goes on.

    Parameters
    ----------
    hint : Hint, optional
        For full solutions; goes before what the headers say.
    """

    def __init__(
        self, catalog: Catalog, *, hint: Hint | None = None, settings: SeriesSettings | None = None
    ) -> None:
        self._catalog = catalog
        self._hint = hint
        self._settings = settings or SeriesSettings()
        self._anchors: dict[Size, Anchor] = {}
        self._memory = SeriesMemory(self._settings.persistent_frames)
        self._most_acknowledged: dict[Size, int] = {}
        self._waiting: dict[Size, list[MeasuredFrame]] = {}
        self._since_full: dict[Size, int] = {}
        self._failures: dict[Size, int] = {}
        self._last: Solution | None = None
        self._results: list[FrameResult] = []
        self._known: dict[bytes, int] = {}

    @property
    def results(self) -> tuple[FrameResult, ...]:
        """All frames so far; those before the first solved one are placed once there is one."""
        return tuple(self._results)

    def add(self, frame: Frame) -> FrameResult:
        """Take the next frame.

        Returns
        -------
        FrameResult
            Never raises for what the sky or the frame are like.
        """
        blank = FrameResult(len(self._results), frame.source, frame.mid_exposure_utc, Mode.NONE)
        # noise never repeats: equal pixels are the same exposure, and would count as one more sighting
        pixels = blake2b(np.ascontiguousarray(frame.pixels).data, digest_size=16).digest()
        if pixels in self._known:
            return self._done(replace(blank, notes=(f"a copy of frame {self._known[pixels]}, left out",)))
        self._known[pixels] = blank.number
        began = time.perf_counter()
        calibration = self._settings.solving.calibration
        try:
            if calibration is not None:
                frame, _ = calibration.applied(frame)
            frame = demosaiced(frame)
            measurements = measure(frame, settings=self._settings.solving.measuring)
        except BadFrame as fault:
            return self._done(replace(blank, notes=(f"{Reason.BAD_FRAME}: {fault.what}",)))
        spent = time.perf_counter() - began
        blank = replace(
            blank,
            measured=len(measurements),
            width_px=measurements.width_px,
            height_px=measurements.height_px,
            times=SeriesTimes(measure_s=spent),
        )
        look = MeasuredFrame(blank, measurements, sources_of(measurements, self._settings.preliminary))
        return self._done(self._placed(look, frame))

    def add_unread(self, source: str, why: str) -> FrameResult:
        """Take note of a frame that could not be read.

        Parameters
        ----------
        source : str
            The file.
        """
        return self._done(
            FrameResult(len(self._results), source, None, Mode.NONE, notes=(f"{Reason.BAD_FRAME}: {why}",))
        )

    def report(self) -> SeriesReport:
        """Sum up: persistence known from the whole series, segments between jumps, drift."""
        frames = [self._memory.recounted(result) for result in self._results]
        sizes = [(frame.width_px, frame.height_px) for frame in frames if self._memory.knows(frame)]
        size = max(set(sizes), key=sizes.count) if sizes else None
        return series_report(
            tuple(frames),
            self._settings,
            persistent=self._memory.of_size(size).sources() if size else None,
            anchor=self._anchors[size].number if size else None,
        )

    # -- one frame ------------------------------------------------------------------------------------------

    def _done(self, result: FrameResult) -> FrameResult:
        self._results.append(result)
        return result

    def _placed(self, look: MeasuredFrame, frame: Frame) -> FrameResult:
        anchor = self._anchors.get(look.size)
        if anchor is None or anchor.plate is None:
            # it may have to wait for a solved frame, and its pixels aren't kept
            look = replace(look, still=_stand(look.measurements, look.sources.index, frame))
        if anchor is None:
            return self._first_of_size(look, frame)
        began = time.perf_counter()
        got = follow_frame(anchor, look, self._settings)
        spent = time.perf_counter() - began
        look = replace(
            look, result=replace(look.result, times=replace(look.result.times, preliminary_s=spent))
        )
        found = got if isinstance(got, Followed) else None
        why = self._why_full(anchor, got, look.size)
        drawn_out = found is not None and not self._stood_still(found, anchor, look, frame)
        if drawn_out:
            # a shift fits one piece of every trail as well as another
            found, why = None, "its stars' light is drawn out or doubled"
        if why is None:
            assert found is not None
            self._since_full[look.size] += 1
            return self._result(look, anchor, found)
        expected = found.move.center if found and found.move else None
        verdict, spent = self._full(frame, look.measurements, expected)
        look = replace(look, result=replace(look.result, times=replace(look.result.times, full_s=spent)))
        if verdict.solution is None:
            self._failures[look.size] = self._failures.get(look.size, 0) + 1
            failure = f"full solution: {verdict.reason}"
            if found is None:
                if anchor.plate is None and len(look.measurements) > MORE_SOURCES * anchor.sources.x_px.size:
                    return self._new_anchor(look, None, (why, failure))
                return self._lost(look, (why, failure))
            self._since_full[look.size] += 1
            return self._result(look, anchor, found, (why, failure))
        self._failures[look.size] = 0
        self._since_full[look.size] = 0
        self._last = verdict.solution
        if drawn_out or verdict.moved:
            # where its sources were found isn't where its light has its middle: nothing is followed from it
            return replace(look.result, mode=Mode.FULL, solution=verdict.solution, notes=(why,))
        if found is not None and found.move is not None and self._keeps(found, look.size):
            audited = self._audited(look, anchor, found, verdict.solution)
            if audited is not None:
                return audited
            why += "; it contradicts the shift"
        return self._new_anchor(look, verdict.solution, (why,))

    def _first_of_size(self, look: MeasuredFrame, frame: Frame) -> FrameResult:
        verdict, spent = self._full(frame, look.measurements, None)
        look = replace(look, result=replace(look.result, times=replace(look.result.times, full_s=spent)))
        notes: tuple[str, ...] = ()
        if self._anchors:
            notes = (f"another size: {look.size[0]} × {look.size[1]} px",)
        if verdict.solution is None:
            notes = (*notes, f"full solution: {verdict.reason}")
            if len(look.measurements) < 1 or verdict.reason is Reason.TRAILED:
                return replace(look.result, notes=notes)
            self._failures[look.size] = 1
        elif verdict.moved:
            self._last = verdict.solution
            notes = (*notes, "its stars' light is drawn out or doubled: nothing is followed from it")
            return replace(look.result, mode=Mode.FULL, solution=verdict.solution, notes=notes)
        else:
            self._last = verdict.solution
        return self._new_anchor(look, verdict.solution, notes)

    def _why_full(self, anchor: Anchor, got: Followed | Preliminary, size: Size) -> str | None:
        """Why this frame needs a full solution; None if it doesn't."""
        if isinstance(got, Preliminary):
            return f"not followed: {got.detail}"
        since, failures = self._since_full.get(size, 0), self._failures.get(size, 0)
        # after failures full solutions are tried more and more seldom: they cost the most when they fail
        patient = since + 1 >= min(2**failures, 32)
        most = self._most_acknowledged.get(size, 0)
        self._most_acknowledged[size] = max(most, got.preliminary.acknowledged)
        why = None
        if anchor.plate is None:
            why = "no frame of this series is solved yet"
        elif got.move is not None and field_turns(got.move, self._settings):
            why = (
                f"the field has turned by {got.move.turn_deg:.3f}° and stretched by "
                f"{100 * got.move.stretch:.3f} %"
            )
        elif got.preliminary.acknowledged < self._settings.ack_fall * most:
            why = f"acknowledgements fell from {most} to {got.preliminary.acknowledged}"
        elif self._settings.audit_every and since + 1 >= self._settings.audit_every:
            why = "audit"
        return why if patient or failures == 0 else None

    def _stood_still(self, found: Followed, anchor: Anchor, look: MeasuredFrame, frame: Frame) -> bool:
        """Whether the light of the followed sources is where the shift has them."""
        if anchor.plate is None:
            return True
        pairing, chosen = found.pairing, found.pairing.second
        if not self._settings.preliminary.narrowing:
            # the plain mean pairs a few dozen sources at most: too few to separate their light from
            # neighbors'
            shift = np.array([pairing.dx_px, pairing.dy_px])
            more = mutual_pairs(anchor.sources, look.sources, shift, LIGHT_REACH_PX)[1]
            chosen = np.union1d(chosen, more)
        return _stand(look.measurements, look.sources.index[chosen], frame)

    def _keeps(self, found: Followed, size: Size) -> bool:
        """Whether the anchor still serves after a full solution."""
        assert found.move is not None
        enough = self._settings.ack_fall * self._most_acknowledged.get(size, 0)
        return not field_turns(found.move, self._settings) and found.preliminary.acknowledged >= enough

    def _audited(
        self, look: MeasuredFrame, anchor: Anchor, found: Followed, solution: Solution
    ) -> FrameResult | None:
        """The frame with both answers; None if they contradict each other."""
        assert found.move is not None
        assert anchor.solution is not None
        center = found.move.center
        sigma = float(
            np.hypot(solution.center_sigma_arcsec, anchor.solution.center_sigma_arcsec)
            + max(found.move.sigma_arcsec)
        )
        apart = separation_arcsec(solution.center, center)
        if apart > max(AUDIT_SIGMAS * sigma, AUDIT_LEAST_PX * solution.scale_arcsec_px):
            return None
        result = replace(
            look.result,
            mode=Mode.FULL,
            solution=solution,
            shift=found.shift,
            followed=center,
            audit=offset_arcsec(solution.center, center),
            notes=("audit",),
        )
        return self._memory.added(look, found.shift, result)

    def _result(
        self, look: MeasuredFrame, anchor: Anchor, found: Followed, notes: tuple[str, ...] = ()
    ) -> FrameResult:
        solution = None
        if found.move is not None and anchor.solution is not None:
            solution = solution_of_move(anchor, found, look)
        result = replace(
            look.result,
            mode=Mode.PRELIMINARY,
            solution=solution,
            shift=found.shift,
            followed=found.move.center if found.move else None,
            notes=notes,
        )
        if anchor.plate is None:
            self._wait(look)
        return self._memory.added(look, found.shift, result)

    def _lost(self, look: MeasuredFrame, notes: tuple[str, ...]) -> FrameResult:
        if self._last is None:
            self._wait(look)
        return replace(look.result, notes=notes)

    def _wait(self, look: MeasuredFrame) -> None:
        waiting = self._waiting.setdefault(look.size, [])
        if look.still and len(waiting) < MOST_WAITING:
            waiting.append(look)

    # -- full solutions and anchors -------------------------------------------------------------------------

    def _full(self, frame: Frame, measurements: Measurements, expected: Icrs | None) -> tuple[Verdict, float]:
        near = near_hint(frame, self._last, expected)
        return solve_in_series(frame, measurements, self._catalog, self._settings, near=near, hint=self._hint)

    def _new_anchor(
        self, look: MeasuredFrame, solution: Solution | None, notes: tuple[str, ...]
    ) -> FrameResult:
        size = look.size
        old = self._anchors.get(size)
        plate, ra, dec = None, np.zeros(0), np.zeros(0)
        # a lens too wide for a plate: its series are solved frame by frame
        if solution is not None and not is_zpn(solution.wcs):
            plate = plate_from_cards(solution.wcs, width_px=size[0], height_px=size[1])
            ra, dec = icrs_at_pixels(plate, look.sources.x_px, look.sources.y_px)
        anchor = Anchor(look.result.number, look.sources, plate, solution, ra, dec)
        self._anchors[size] = anchor
        self._most_acknowledged[size] = 0
        self._since_full[size] = 0
        self._memory.carry(size, old.plate if old else None, plate)
        result = replace(
            look.result,
            mode=Mode.FULL if solution is not None else Mode.NONE,
            solution=solution,
            notes=notes,
        )
        if solution is None:
            self._wait(look)
        result = self._memory.added(look, None, result)
        if solution is not None:
            self._place_waiting(anchor, size)
        return result

    def _place_waiting(self, anchor: Anchor, size: Size) -> None:
        """Place the frames that came before the first solved one."""
        for look in self._waiting.pop(size, []):
            got = follow_frame(anchor, look, self._settings)
            if isinstance(got, Followed):
                self._results[look.result.number] = self._result(look, anchor, got, ("placed afterwards",))


def _stand(m: Measurements, chosen: NDArray[np.int64], frame: Frame) -> bool:
    """Whether the light of some sources is where they were found: no piece of a trail, no double exposure."""
    if chosen.size == 0:
        return True
    clear = (m.flags[chosen] & int(Flag.SATURATED | Flag.BLEED)) == 0
    fwhm_px = float(np.median(m.fwhm_px[chosen]))
    path = star_trail(frame.pixels, m.x_px[chosen], m.y_px[chosen], m.flux[chosen], clear, fwhm_px)
    return path is None or plate_stays(path)


def follow(
    frames: Iterable[Frame | Path],
    catalog: Catalog,
    *,
    hint: Hint | None = None,
    settings: SeriesSettings | None = None,
) -> SeriesReport:
    """Follow a whole series.

    Parameters
    ----------
    frames : iterable of Frame or Path
        In order of time; files are read one by one, those that can't be read are reported.
    hint : Hint, optional
        For full solutions; goes before what the headers say.
    """
    follower = SeriesFollower(catalog, hint=hint, settings=settings)
    for frame_or_path in frames:
        if isinstance(frame_or_path, Path):
            try:
                frame = read_frame(frame_or_path, raw=True)
            except BadFrame as fault:
                follower.add_unread(str(frame_or_path), fault.what)
                continue
            follower.add(frame)
        else:
            follower.add(frame_or_path)
    return follower.report()
