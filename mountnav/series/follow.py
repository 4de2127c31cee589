"""Following a series: one frame solved fully, the rest by shift, audited, anew when the field is lost."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass, replace
from hashlib import blake2b
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.stars import Catalog
from mountnav.errors import BadFrame
from mountnav.frames import Frame, Hint
from mountnav.identification.plate import Plate
from mountnav.identification.preliminary import Preliminary, find_shift
from mountnav.identification.selection import all_finite
from mountnav.identification.shift import Pairing
from mountnav.identification.sources import Sources, sources_of
from mountnav.identification.wcs import wcs_cards
from mountnav.measuring.measure import measure
from mountnav.measuring.measurements import Measurements
from mountnav.reading import demosaiced, read_frame
from mountnav.series.persistence import Persistence
from mountnav.series.report import series_report
from mountnav.series.results import FrameResult, Mode, SeriesReport, SeriesSettings, SeriesTimes, Shift
from mountnav.series.shift import Moved, moved, pixels, places, plate_from_cards, turned
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import offset_arcsec, separation_arcsec
from mountnav.solution import IdentifiedPairs, Reason, Solution, Verdict
from mountnav.solve import solve

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Size = tuple[int, int]

TREND_SIGMAS = 5.0
AUDIT_SIGMAS = 5.0
AUDIT_LEAST_PX = 1.0
"""A full solution that departs from the shift by less contradicts nothing."""
SCALE_SHARE = 0.02
"""How well the scale of a series is known once a frame is solved."""
MORE_SOURCES = 1.5
"""With so many times the sources a frame takes the place of an unsolved first one."""
NEAR_BUDGET_S = 10.0
"""Wall time of a full solution where the series is believed to be; then come the caller's hints."""
MOST_WAITING = 50
"""So many frames before the first solved one are kept, to be placed afterwards."""


@dataclass(frozen=True, slots=True)
class _Anchor:
    """The frame that others are followed from."""

    number: int
    sources: Sources
    plate: Plate | None
    solution: Solution | None
    ra_deg: Array
    dec_deg: Array


@dataclass(frozen=True, slots=True)
class _Look:
    """A frame without its pixels."""

    result: FrameResult
    measurements: Measurements
    sources: Sources

    @property
    def size(self) -> Size:
        return self.measurements.width_px, self.measurements.height_px


@dataclass(frozen=True, slots=True)
class _Followed:
    """What the shift says of a frame."""

    preliminary: Preliminary
    shift: Shift
    move: Moved | None
    pairing: Pairing


class SeriesFollower:
    """Follows a series frame by frame, as a night goes on.

    Parameters
    ----------
    catalog : Catalog
    hint : Hint, optional
        For full solutions; goes before what the headers say.
    settings : SeriesSettings, optional
    """

    def __init__(
        self, catalog: Catalog, *, hint: Hint | None = None, settings: SeriesSettings | None = None
    ) -> None:
        self._catalog = catalog
        self._hint = hint
        self._settings = settings or SeriesSettings()
        self._anchors: dict[Size, _Anchor] = {}
        self._persistence: dict[Size, Persistence] = {}
        self._ids: dict[int, Index] = {}
        self._most_acknowledged: dict[Size, int] = {}
        self._waiting: dict[Size, list[_Look]] = {}
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

        Parameters
        ----------
        frame : Frame

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
        look = _Look(blank, measurements, sources_of(measurements, self._settings.preliminary))
        return self._done(self._placed(look, frame))

    def add_unread(self, source: str, why: str) -> FrameResult:
        """Take note of a frame that could not be read.

        Parameters
        ----------
        source : str
            The file.
        why : str

        Returns
        -------
        FrameResult
        """
        return self._done(
            FrameResult(len(self._results), source, None, Mode.NONE, notes=(f"{Reason.BAD_FRAME}: {why}",))
        )

    def report(self) -> SeriesReport:
        """Sum up: persistence known from the whole series, segments between jumps, drift."""
        frames = []
        for one in self._results:
            ids = self._ids.get(one.number)
            if ids is not None:
                memory = self._persistence[(one.width_px, one.height_px)]
                one = replace(one, persistent=int(memory.persistent(ids).sum()))
            frames.append(one)
        sizes = [(one.width_px, one.height_px) for one in frames if one.number in self._ids]
        size = max(set(sizes), key=sizes.count) if sizes else None
        return series_report(
            tuple(frames),
            self._settings,
            persistent=self._persistence[size].sources() if size else None,
            anchor=self._anchors[size].number if size else None,
        )

    # -- one frame ------------------------------------------------------------------------------------------

    def _done(self, result: FrameResult) -> FrameResult:
        self._results.append(result)
        return result

    def _placed(self, look: _Look, frame: Frame) -> FrameResult:
        anchor = self._anchors.get(look.size)
        if anchor is None:
            return self._first_of_size(look, frame)
        began = time.perf_counter()
        got = self._follow(anchor, look)
        spent = time.perf_counter() - began
        look = replace(
            look, result=replace(look.result, times=replace(look.result.times, preliminary_s=spent))
        )
        found = got if isinstance(got, _Followed) else None
        why = self._why_full(anchor, got, look.size)
        if why is None:
            assert found is not None
            self._since_full[look.size] += 1
            return self._result(look, anchor, found)
        verdict, spent = self._full(
            frame, look.measurements, found.move.center if found and found.move else None
        )
        look = replace(look, result=replace(look.result, times=replace(look.result.times, full_s=spent)))
        if verdict.solution is None:
            self._failures[look.size] = self._failures.get(look.size, 0) + 1
            told = f"full solution: {verdict.reason}"
            if found is None:
                if anchor.plate is None and len(look.measurements) > MORE_SOURCES * anchor.sources.x_px.size:
                    return self._new_anchor(look, None, (why, told))
                return self._lost(look, (why, told))
            self._since_full[look.size] += 1
            return self._result(look, anchor, found, (why, told))
        self._failures[look.size] = 0
        self._since_full[look.size] = 0
        self._last = verdict.solution
        if found is not None and found.move is not None and self._keeps(found, look.size):
            audited = self._audited(look, anchor, found, verdict.solution)
            if audited is not None:
                return audited
            why += "; it contradicts the shift"
        return self._new_anchor(look, verdict.solution, (why,))

    def _first_of_size(self, look: _Look, frame: Frame) -> FrameResult:
        verdict, spent = self._full(frame, look.measurements, None)
        look = replace(look, result=replace(look.result, times=replace(look.result.times, full_s=spent)))
        notes: tuple[str, ...] = ()
        if self._anchors:
            notes = (f"another size: {look.size[0]} × {look.size[1]} px",)
        if verdict.solution is None:
            notes = (*notes, f"full solution: {verdict.reason}")
            if len(look.measurements) < 1:
                return replace(look.result, notes=notes)
            self._failures[look.size] = 1
        else:
            self._last = verdict.solution
        return self._new_anchor(look, verdict.solution, notes)

    def _follow(self, anchor: _Anchor, look: _Look) -> _Followed | Preliminary:
        """Preliminary identification, and the anchor's plate moved by it."""
        got = find_shift(anchor.sources, look.sources, self._settings.preliminary)
        pairing = got.pairing
        if pairing is None:
            return got
        move = None
        if anchor.plate is not None:
            sky = anchor.ra_deg[pairing.first], anchor.dec_deg[pairing.first]
            x, y = look.sources.x_px[pairing.second], look.sources.y_px[pairing.second]
            move = moved(anchor.plate, *sky, x, y, pairing.weight)
            if self._turns(move):
                move = replace(
                    turned(move, anchor.plate, *sky, x, y, pairing.weight),
                    trend_px=move.trend_px,
                    trend_sigma=move.trend_sigma,
                )
        sigma = pairing.dx_sigma_px, pairing.dy_sigma_px
        if move is not None and anchor.solution is not None:
            x_sigma, y_sigma = move.sigma_px
            # the anchor's own scale and turn are known so well and no better
            lever = float(np.hypot(move.dx_px, move.dy_px)) * _scale_sigma(anchor.solution, look.size)
            sigma = float(np.hypot(x_sigma, lever)), float(np.hypot(y_sigma, lever))
        shift = Shift(
            anchor=anchor.number,
            dx_px=move.dx_px if move else pairing.dx_px,
            dy_px=move.dy_px if move else pairing.dy_px,
            dx_sigma_px=sigma[0],
            dy_sigma_px=sigma[1],
            mean_dx_px=pairing.dx_px,
            mean_dy_px=pairing.dy_px,
            pairs=len(pairing),
            strobes=got.strobes,
            acknowledged=got.acknowledged,
            false_probability=got.false_probability,
        )
        return _Followed(got, shift, move, pairing)

    def _turns(self, move: Moved) -> bool:
        return move.trend_px > self._settings.trend_px and move.trend_sigma > TREND_SIGMAS

    def _why_full(self, anchor: _Anchor, got: _Followed | Preliminary, size: Size) -> str | None:
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
        elif got.move is not None and self._turns(got.move):
            why = (
                f"the field has turned by {got.move.turn_deg:.3f}° and stretched by "
                f"{100 * got.move.stretch:.3f} %"
            )
        elif got.preliminary.acknowledged < self._settings.ack_fall * most:
            why = f"acknowledgements fell from {most} to {got.preliminary.acknowledged}"
        elif self._settings.audit_every and since + 1 >= self._settings.audit_every:
            why = "audit"
        return why if patient or failures == 0 else None

    def _keeps(self, found: _Followed, size: Size) -> bool:
        """Whether the anchor still serves after a full solution."""
        assert found.move is not None
        enough = self._settings.ack_fall * self._most_acknowledged.get(size, 0)
        return not self._turns(found.move) and found.preliminary.acknowledged >= enough

    def _audited(
        self, look: _Look, anchor: _Anchor, found: _Followed, solution: Solution
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
        return self._remembered(look, found.shift, result)

    def _result(
        self, look: _Look, anchor: _Anchor, found: _Followed, notes: tuple[str, ...] = ()
    ) -> FrameResult:
        solution = None
        if found.move is not None and anchor.solution is not None:
            solution = _moved_solution(anchor, found, look)
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
        return self._remembered(look, found.shift, result)

    def _lost(self, look: _Look, notes: tuple[str, ...]) -> FrameResult:
        if self._last is None:
            self._wait(look)
        return replace(look.result, notes=notes)

    def _wait(self, look: _Look) -> None:
        waiting = self._waiting.setdefault(look.size, [])
        if len(waiting) < MOST_WAITING:
            waiting.append(look)

    # -- full solutions and anchors -------------------------------------------------------------------------

    def _full(self, frame: Frame, measurements: Measurements, expected: Icrs | None) -> tuple[Verdict, float]:
        """Solve: near where the series is believed to be, then as the caller and the header say."""
        began = time.perf_counter()
        settings = self._settings.solving
        verdict = None
        near = self._near_hint(frame, expected)
        if near is not None:
            quick = replace(settings, budget_s=min(NEAR_BUDGET_S, settings.budget_s))
            verdict = solve(frame, self._catalog, hint=near, settings=quick, measurements=measurements)
        if verdict is None or not verdict.solved:
            again = solve(frame, self._catalog, hint=self._hint, settings=settings, measurements=measurements)
            verdict = again if again.solved or verdict is None else verdict
        return verdict, time.perf_counter() - began

    def _near_hint(self, frame: Frame, expected: Icrs | None) -> Hint | None:
        last = self._last
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

    def _new_anchor(self, look: _Look, solution: Solution | None, notes: tuple[str, ...]) -> FrameResult:
        size = look.size
        old = self._anchors.get(size)
        plate, ra, dec = None, np.zeros(0), np.zeros(0)
        if solution is not None:
            plate = plate_from_cards(solution.wcs, width_px=size[0], height_px=size[1])
            ra, dec = places(plate, look.sources.x_px, look.sources.y_px)
        anchor = _Anchor(look.result.number, look.sources, plate, solution, ra, dec)
        self._anchors[size] = anchor
        self._most_acknowledged[size] = 0
        self._since_full[size] = 0
        self._carry_persistence(size, old.plate if old else None, plate)
        result = replace(
            look.result,
            mode=Mode.FULL if solution is not None else Mode.NONE,
            solution=solution,
            notes=notes,
        )
        if solution is None:
            self._wait(look)
        result = self._remembered(look, None, result)
        if solution is not None:
            self._place_waiting(anchor, size)
        return result

    def _place_waiting(self, anchor: _Anchor, size: Size) -> None:
        """Place the frames that came before the first solved one."""
        for look in self._waiting.pop(size, []):
            got = self._follow(anchor, look)
            if isinstance(got, _Followed):
                self._results[look.result.number] = self._result(look, anchor, got, ("placed afterwards",))

    # -- persistence ----------------------------------------------------------------------------------------

    def _carry_persistence(self, size: Size, old: Plate | None, new: Plate | None) -> None:
        memory = self._persistence.get(size)
        if memory is None or old is None or new is None:
            self._persistence[size] = Persistence(self._settings.persistent_frames)
            return

        def to_new(x: Array, y: Array) -> tuple[Array, Array]:
            new_x, new_y = pixels(new, *places(old, x, y))
            far = (np.abs(new_x - new.center_x_px) > 1.5 * size[0]) | (
                np.abs(new_y - new.center_y_px) > 1.5 * size[1]
            )
            return np.where(far, np.nan, new_x), np.where(far, np.nan, new_y)

        memory.change_pixels(to_new)

    def _remembered(self, look: _Look, shift: Shift | None, result: FrameResult) -> FrameResult:
        """Add the frame's sources to what is known of the series."""
        m = look.measurements
        chosen = all_finite(m)
        dx, dy = (shift.dx_px, shift.dy_px) if shift else (0.0, 0.0)
        fwhm = m.fwhm_px[chosen]
        fwhm = fwhm[np.isfinite(fwhm)]
        reach = max(1.5, 0.6 * float(np.median(fwhm))) if fwhm.size else 1.5
        memory = self._persistence[look.size]
        ids = memory.add(m.x_px[chosen] + dx, m.y_px[chosen] + dy, m.flux[chosen], reach)
        self._ids[result.number] = ids
        return replace(result, persistent=int(memory.persistent(ids).sum()))


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
    catalog : Catalog
    hint : Hint, optional
        For full solutions; goes before what the headers say.
    settings : SeriesSettings, optional

    Returns
    -------
    SeriesReport
    """
    follower = SeriesFollower(catalog, hint=hint, settings=settings)
    for one in frames:
        if isinstance(one, Path):
            try:
                frame = read_frame(one, raw=True)
            except BadFrame as fault:
                follower.add_unread(str(one), fault.what)
                continue
            follower.add(frame)
        else:
            follower.add(one)
    return follower.report()


def _scale_sigma(solution: Solution, size: Size) -> float:
    """Relative error of a solution's scale, and of its turn in radians: from its residuals and pairs."""
    lever_arcsec = (
        0.3 * float(np.hypot(*size)) * solution.scale_arcsec_px
    )  # RMS radius of evenly spread pairs
    return solution.rms_arcsec / float(np.sqrt(2.0 * max(solution.pairs, 1))) / lever_arcsec


def _moved_solution(anchor: _Anchor, found: _Followed, look: _Look) -> Solution:
    """The anchor's solution with its plate moved."""
    move, pairing, old = found.move, found.pairing, anchor.solution
    assert move is not None
    assert old is not None
    m = look.measurements
    chosen = look.sources.index[pairing.second]
    scale = move.plate.scale_arcsec_px()
    own_arcsec = scale * float(np.hypot(found.shift.dx_sigma_px, found.shift.dy_sigma_px)) / np.sqrt(2.0)
    covariance = old.center_covariance_arcsec2 + own_arcsec**2 * np.eye(2)
    missing = np.full(chosen.size, np.nan)
    turned_plate = abs(move.plate.rotation_deg() - old.rotation_deg) > 1e-9
    if turned_plate:
        cards = wcs_cards(move.plate, width_px=m.width_px, height_px=m.height_px)
    else:
        cards = {**old.wcs, "CRVAL1": move.center.ra_deg, "CRVAL2": move.center.dec_deg}
    return Solution(
        center=move.center,
        center_sigma_arcsec=float(np.sqrt(0.5 * np.trace(covariance))),
        scale_arcsec_px=scale,
        rotation_deg=move.plate.rotation_deg(),
        parity=move.plate.parity,
        rms_arcsec=move.rms_arcsec,
        pairs=len(pairing),
        rejected=0,
        false_probability=min(1.0, old.false_probability + found.preliminary.false_probability),
        mode="preliminary",
        wcs=cards,
        center_covariance_arcsec2=covariance,
        identified=IdentifiedPairs(
            x_px=look.sources.x_px[pairing.second],
            y_px=look.sources.y_px[pairing.second],
            ra_deg=anchor.ra_deg[pairing.first],
            dec_deg=anchor.dec_deg[pairing.first],
            dx_arcsec=move.residual_x_arcsec,
            dy_arcsec=move.residual_y_arcsec,
            flux=m.flux[chosen],
            flux_sigma=m.flux_sigma[chosen],
            mag=missing,
            centroid_sigma_arcsec=look.sources.sigma_px[pairing.second] * scale,
            catalog_sigma_arcsec=anchor.sources.sigma_px[pairing.first] * scale,
            flags=m.flags[chosen],
            used=np.ones(chosen.size, dtype=bool),
            leverage=np.full(chosen.size, 1.0 / max(chosen.size, 1)),  # only the shift was fit
        ),
        catalog=old.catalog,
    )
