"""The session with one mount: its language and link, filtered readings, trust in its position.

Connecting asks and compares, and sets nothing unless the configuration says so. A position that may be wrong
(power-up, reboot, lost link) is not trusted until a sync on the sky was seen or the mount has found its home.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from datetime import datetime

from drivers.generic.comparison import compare, implausible
from drivers.generic.drift import Drift
from drivers.generic.language import Identity, Language, Readout
from drivers.generic.link_supervisor import LinkSupervisor
from drivers.generic.options import Timing
from drivers.generic.reading_filter import HAND_DEG, HAND_DEG_S, Believed, ReadingFilter
from drivers.generic.refusal_words import rates_text, untrusted
from mountnav.clock import real_s, sky_s, utc_now
from mountnav.devices import (
    STARS_RATES,
    ConnectReport,
    MountAxis,
    OffsetRates,
    PierSide,
    Skill,
    SlewState,
    moved_arcsec,
)
from mountnav.errors import (
    Busy,
    DeviceError,
    DeviceGarbled,
    DeviceMissing,
    DeviceRefused,
    DeviceSilent,
    Refusal,
)
from mountnav.sky.coordinates import Apparent, Icrs, Site

Listener = Callable[[str, Mapping[str, object]], None]
"""Takes the name of an event and its facts."""

_SAME_CLOCK_S = 3.0
"""s. A mount's clock that changed by more against ours during a silence shows that the mount was switched
off. Chosen: clocks carry whole seconds. Doubled, a mount whose clock starts 8 s behind after a reset passes
for one that was only silent."""
_LATE_CLOCK_S = 2.0
"""s of the machine. So late an answer may come, on top; under a faster sky that is more of its seconds."""
_NO_RATE_ARCSEC_S = 1e-6
"""″/s. A rate that is read back and is below this is none: what converting units leaves of 0. Doubled or
halved, nothing shows: it is 4 milliarcseconds in an hour."""
_ON_THE_WAY = (SlewState.ACCEPTED, SlewState.UNDER_WAY, SlewState.LOST)
"""States of the last order in which the mount may still be moving."""


@dataclass(frozen=True, slots=True)
class ConnectSettings:
    """What the settings say about connecting.

    Attributes
    ----------
    site : Site or None
        Ours, to compare with the mount's.
    set_clock, set_site : bool
        Whether the mount's clock and site are set to ours.
    trust : bool
        Whether the position is trusted at the first connecting, unless the mount was just switched on.
    swap_sides : bool or None
        Whether the mount reports the side of the pier opposite to the one on which the tube hangs; None: it
        was not checked.
    """

    site: Site | None = None
    set_clock: bool = False
    set_site: bool = False
    trust: bool = True
    swap_sides: bool | None = None


@dataclass(frozen=True, slots=True)
class LateSync:
    """A sync that was given up and may still show.

    Attributes
    ----------
    near_arcsec : float
        How near to its place counts.
    until_s : float
        Loop time.
    utc : datetime
        When it was sent.
    """

    place: Apparent | Icrs
    near_arcsec: float
    until_s: float
    utc: datetime


class Session:
    """What all orders to one mount share: the state of its link and motion, and the trust in its position.

    Parameters
    ----------
    name : str
        For messages.

    Attributes
    ----------
    filter : ReadingFilter
        Decides which readings are believed.
    supervisor : LinkSupervisor
        Keeps the link.
    trusted : bool
        Whether the mount's own position counts. Drivers keep this here only; `mountnav.mount` asks for it and
        adds what it knows of the sky.
    job : str or None
        The order to move that runs: one at a time, since the readings that follow an order say only whether
        the mount moves, not by whose order.
    sent_out : bool
        Whether that has gone out, or is about to: until then nothing of ours moves the mount.
    state : SlewState
        What the last order to move has come to.
    stops : int
        How many stops were ordered.
    stopping : int
        How many of them are being carried out: the mount was not yet seen at rest.
    no_stop : asyncio.Event
        Set while no stop is being carried out.
    pulses : int
        How many guide pulses run.
    axes : dict of MountAxis to float
        Axes that are moved on by hand, and at which speed (°/s): until the mount was seen at rest again.
    drift : Drift
        The offset rates that it tracks at, as far as they are known.
    links : int
        How often the link was made or lost: what began under another count is given up.
    stop_owed : bool
        Something may be moving, and no reading since has shown the mount at rest.
    ordering : asyncio.Lock
        Held while an order of several commands goes out.
    in_motion : bool
        Whether it moved between the last two readings.
    doubt : str
        What was odd on the way of the present motion (a silence, a leap of the readings): the mount may have
        been switched off and on. Unless it arrives where it was sent, its position is not trusted any more.
    silent_on_its_way : bool
        It was silent during the present motion: then the flags "parked" and "at home" prove nothing either,
        it may have woken up with them.
    late_sync : LateSync or None
        The last sync that was given up.
    report : ConnectReport or None
        What the last connecting found.
    lost_why : str
        Why the link was lost last.
    """

    def __init__(self, language: Language, name: str, timing: Timing, connecting: ConnectSettings) -> None:
        self.language = language
        self.name = name
        self.timing = timing
        self.filter = ReadingFilter(timing, name)
        self.drift: Drift = self.filter.drift
        self.ordering = asyncio.Lock()
        self.job: str | None = None
        self.sent_out = False
        self.state = SlewState.NONE
        self.stops = 0
        self.links = 0
        self.stopping = 0
        self.no_stop = asyncio.Event()
        self.no_stop.set()
        self.pulses = 0
        self.axes: dict[MountAxis, float] = {}
        self.stop_owed = False
        self.in_motion = False
        self.doubt = ""
        self.silent_on_its_way = False
        self.trusted = False
        self.report: ConnectReport | None = None
        self._identity: Identity | None = None
        self.late_sync: LateSync | None = None
        self.listeners: list[Listener] = []
        self._connecting = connecting
        self.supervisor = LinkSupervisor(
            language,
            timing,
            beat=self.read,
            reopen=self._reopen,
            silent=self._on_silent,
            lost=self._on_lost,
            back=self._on_back,
        )
        self._opening = asyncio.Lock()
        self._reading = asyncio.Lock()
        self._wanted_open = False
        self._connected = False
        self.lost_why = ""
        self._why_untrusted = "not connected"
        self._was_fresh = False
        self._muted = False
        """Whether it has been silent since the last reading."""
        self._since: Readout | None = None
        """The reading since which it rests."""

    # -- the link ----------------------------------------------------------------------------------

    async def open(self) -> None:
        """Connect, find out who is there, read the state and compare clock, site and epoch with ours.

        Moves and syncs nothing; sets the clock or the site only if the configuration says so.

        Raises
        ------
        DeviceMissing
            If there is no such port or link.
        DeviceSilent, DeviceGarbled
            If nothing on it speaks the language.
        """
        async with self._opening:
            await self._connect(again=False)
        self._wanted_open = True
        self.supervisor.start()

    async def close(self) -> None:
        """Release the link; closing twice is fine."""
        self._wanted_open = self._connected = False
        await self.supervisor.end()
        await self.language.close()

    async def _connect(self, *, again: bool) -> None:
        language = self.language
        self._connected = False
        try:
            identity = await language.open()
            self.links += 1
            if self.stop_owed:
                # when the link broke something was moving, or was being stopped
                await language.send_stop(0)
            told = await self._find_rates()
            self.filter.forget()
            self.filter.resolution_arcsec = language.resolution_arcsec
            readout = (await self.filter.read(language.readout)).readout
            self._was_fresh = readout.fresh
            found = None
            if self._connecting.set_site or self._connecting.set_clock:
                # compared before anything is set: the difference says by how much its sky was turned
                found = await compare(language, identity, self._connecting.site, trusted=self.trusted)
            done, refused = await self._set(site=self._connecting.set_site, clock=self._connecting.set_clock)
            identity = replace(identity, problems=(*identity.problems, *told, *refused))
            # closing and opening again must not turn a mistrusted position into a trusted one
            counted = self._connecting.trust if self.report is None else self.trusted
            doubt = identity.doubt or implausible(readout, self._connecting.site)
            if doubt and doubt != identity.doubt:
                identity = replace(identity, problems=(*identity.problems, doubt))
            trusted = counted and not again and not readout.fresh and not doubt
            report = await compare(
                language, identity, self._connecting.site, trusted=trusted, done=tuple(done)
            )
            report = replace(report, found=found if done else None)
        except BaseException:
            await language.close()
            raise
        if again and self.report is not None and self.report.identity != report.identity:
            language.log.note("event", meaning=f"another mount answers: {report.identity}")
        self.report, self._identity = report, identity
        self.trusted = trusted
        self._connected = True
        facts = {"identity": report.identity, "trusted": trusted, "problems": list(report.problems)}
        self.emit("link-back" if again else "connected", facts)
        if not trusted:
            self._why_untrusted = "no look at the sky was made since it was connected"
            if readout.fresh:
                self._why_untrusted = "it was just switched on"
            elif again:
                self._why_untrusted = "its link was lost"
            elif doubt:
                self._why_untrusted = doubt
            self.emit("untrusted", {"why": self._why_untrusted})

    async def _find_rates(self) -> list[str]:
        """Find out at which offset rates it tracks; ours, that a broken link left behind, are ended."""
        language, drift = self.language, self.drift
        if Skill.OFFSET_RATES not in language.skills:
            return []
        try:
            if drift.ours:
                now = await language.readout()
                if now.tracking is False or now.parked:
                    # to be told a star's rates might set it going
                    drift.unknown()
                    return []
                drift.going_out(STARS_RATES)
                await language.send_offset_rates(STARS_RATES)
            found = await self.told_rates()
        except (DeviceRefused, DeviceSilent, DeviceGarbled) as trouble:
            language.log.note("event", meaning=f"its offset rates are not known: {trouble.what}")
            drift.unknown()
            return [f"at which offset rates it tracks is not known: {trouble.what}"]
        if found is None and drift.ours:
            drift.settled(STARS_RATES)
        elif found is None or not drift.ours:
            drift.found(found)
        else:
            drift.settled(found)
        if found is None or found.none:
            return []
        return [f"it tracks at offset rates: {rates_text(found)}"]

    async def told_rates(self) -> OffsetRates | None:
        """At which offset rates it says to track; None where it can't say, or refuses to.

        Raises
        ------
        DeviceSilent, DeviceGarbled, DeviceMissing
        """
        try:
            told = await self.language.read_offset_rates()
        except DeviceRefused:
            return None
        if told is None:
            return None
        if not (math.isfinite(told.ra_arcsec_s) and math.isfinite(told.dec_arcsec_s)):
            raise DeviceGarbled("its offset rates are not numbers", device=self.name)
        ra, dec = (
            0.0 if abs(rate) < _NO_RATE_ARCSEC_S else rate for rate in (told.ra_arcsec_s, told.dec_arcsec_s)
        )
        return OffsetRates(ra, dec)

    async def compare(self) -> ConnectReport:
        """Ask for clock and site again, and compare them with ours. Raises `DeviceError`."""
        await self.ready()
        assert self._identity is not None
        assert self.report is not None
        site, done = self._connecting.site, self.report.done
        self.report = await compare(self.language, self._identity, site, trusted=self.trusted, done=done)
        return self.report

    async def set_site_and_time(self) -> ConnectReport:
        """Set clock and site to ours, as far as the mount takes them; return the comparison afterwards.

        The right ascension that it reports may change by that: the position is not trusted then, as after any
        jump.

        Raises
        ------
        Busy
            If an order to move runs.
        DeviceRefused
            If it takes neither.
        DeviceError
            If the link fails.
        """
        self.require_no_job()
        await self.ready()
        async with self.ordering:
            done, refused = await self._set(site=True, clock=True)
        if not done:
            raise DeviceRefused(
                "; ".join(refused) or "no site is known to send to it",
                device=self.name,
                advice="set it at its hand control, or by its own program",
                reason=Refusal.UNSUPPORTED,
            )
        if self.report is not None:
            self.report = replace(self.report, done=tuple(dict.fromkeys((*self.report.done, *done))))
        report = await self.compare()
        await self.read()
        return report

    async def _set(self, *, site: bool, clock: bool) -> tuple[list[str], list[str]]:
        """Set site and clock where asked; return what was done, and what was refused."""
        done, refused = [], []
        ours = self._connecting.site
        try:
            if site and ours is not None:
                await self.language.write_site(ours)
                done.append("site set")
        except DeviceRefused as refusal:
            refused.append(f"its site was to be set, and it said no: {refusal.what}")
        try:
            if clock:
                await self.language.write_clock(utc_now())
                done.append("clock set")
        except DeviceRefused as refusal:
            refused.append(f"its clock was to be set, and it said no: {refusal.what}")
        return done, refused

    async def _reopen(self) -> None:
        async with self._opening:
            # another caller may have opened it meanwhile
            if not (self._connected and self.language.usable):
                if not self._wanted_open:
                    raise DeviceMissing("not connected", device=self.name, advice="open the mount first")
                await self._connect(again=True)

    async def ready(self) -> None:
        """Wait for a connecting that is going on, and open a link again that was lost since `open`."""
        if self._connected and self.language.usable:
            return
        if not (self._wanted_open or self._opening.locked()):
            raise DeviceMissing("not connected", device=self.name, advice="open the mount first")
        await self._reopen()

    def _on_silent(self, for_s: float) -> None:
        self.language.log.note("event", meaning=f"silent for {for_s:.1f} s")
        self._muted = True
        if self.job is not None:
            self.silent_on_its_way = True
            self.doubt = "it was silent on its way, and didn't come to where it was sent"
        self.emit("link-silent", {"for_s": round(for_s, 1)})

    async def _on_lost(self, why: str) -> None:
        self.language.log.note("event", meaning=f"link lost: {why}")
        self.links += 1
        self.lost_why = why
        self._since = None
        self._connected = False
        if self.job is not None or self.axes or self.state in _ON_THE_WAY:
            self.state = SlewState.LOST
            self.stop_owed = True
        # whatever moved on goes on, or not: it is stopped as soon as it can be
        self.axes.clear()
        self.drift.unknown()
        self.emit("link-lost", {"why": why})
        self.distrust("its link was lost")
        # a silent line is still open: close it, so that it is opened again and the greeting says who is there
        # now. A caller may have reopened it already: that new line is left open, unless a stop has still to
        # be sent over it
        async with self._opening:
            if self.stop_owed or not self._connected:
                await self.language.close()

    async def _on_back(self, after_s: float) -> None:
        self.emit("link-back", {"after_s": round(after_s, 1)})
        before = None if self.report is None else self.report.clock_off_s
        try:
            clock = await self.language.read_clock()
        except DeviceError:
            return
        if clock is not None and before is not None:
            jump_s = (clock - utc_now()).total_seconds() - before
            if abs(jump_s) > _SAME_CLOCK_S + sky_s(_LATE_CLOCK_S):
                self.distrust(f"its clock has jumped by {jump_s:.0f} s: it was switched off and on")

    # -- trust -------------------------------------------------------------------------------------

    def trust(self, why: str) -> None:
        """Trust the position from now on."""
        if not self.trusted:
            self.trusted = True
            self.emit("trusted", {"why": why})

    def distrust(self, why: str) -> None:
        """Stop trusting the position."""
        self._why_untrusted = why
        if self.trusted:
            self.trusted = False
            self.language.log.note("event", meaning=f"untrusted: {why}")
            self.emit("untrusted", {"why": why})

    def require_trust(self, what: str) -> None:
        """Raise `DeviceRefused` if the position is not trusted.

        Asked also while an order goes out: a reset between two commands of one order is seen only here.
        """
        if not self.trusted:
            raise untrusted(what, self._why_untrusted, device=self.name)

    def require_no_job(self, advice: str = "wait for it, or stop it", *, by_hand: bool = False) -> None:
        """Raise `Busy` if an order to move runs, or an axis is moved unless that is to be done."""
        if self.job is not None:
            raise Busy(f"a {self.job} is running", device=self.name, advice=advice)
        if self.axes and not by_hand:
            raise Busy(
                f"its {' and '.join(sorted(self.axes))} axis is moved by hand",
                device=self.name,
                advice="end that, or stop it",
            )

    def emit(self, what: str, facts: Mapping[str, object]) -> None:
        """Send an event to all listeners."""
        for listener in self.listeners:
            listener(what, facts)

    # -- readings ----------------------------------------------------------------------------------

    async def read(self) -> Readout:
        """Read the mount until a reading is believed, and draw conclusions on trust, rest and late syncs.

        Raises
        ------
        DeviceSilent, DeviceGarbled, DeviceMissing
            If there is no answer, none that makes sense, or no link.
        """
        async with self._reading:
            self.filter.moving = self.sent_out or self.state is SlewState.UNDER_WAY or bool(self.axes)
            before = self.filter.last
            believed = await self.filter.read(self._readout)
        readout = believed.readout
        self.supervisor.heard()
        self.filter.resolution_arcsec = self.language.resolution_arcsec
        if readout.fresh and not self._was_fresh:
            self.drift.unknown()
            self.distrust("it was switched off and on")
        self._was_fresh = readout.fresh
        if before is not None and not self._late_sync_shows(before, readout):
            self._watch_for_jumps(before, believed)
        self._muted = False
        self.drift.read(readout.utc)
        await self._note_rest(readout)
        return readout

    async def read_once(self) -> Readout:
        """Read the mount once, unfiltered and unpublished: enough for a suspicion. Raises as `read` does."""
        readout = await self._readout()
        self.supervisor.heard()
        return readout

    async def _readout(self) -> Readout:
        readout = await self.language.readout()
        return replace(readout, pier_side=self.side(readout.pier_side))

    @property
    def sides_stated(self) -> bool:
        """Whether the settings say on which side the tube hangs, by inspection."""
        return self._connecting.swap_sides is not None

    def side(self, reported: PierSide | None) -> PierSide | None:
        """On which side of the pier the tube hangs, given the side that the mount reports."""
        return reported.other if reported is not None and self._connecting.swap_sides else reported

    def went_elsewhere(self, miss_arcsec: float) -> None:
        """Report that a sync changed what the mount believes, but not to the place that was sent."""
        self.emit("sync-elsewhere", {"miss_arcsec": round(miss_arcsec, 1)})
        self.distrust(f"it synced to another place: it believes that it is {miss_arcsec:.0f}″ from there")

    def forget_rest(self) -> None:
        """Forget since when it rests: an order to move goes out, or a sync renames the place."""
        self._since = None

    async def _note_rest(self, readout: Readout) -> None:
        since = self._since
        self.in_motion = since is not None and not self.filter.still(since, readout)
        if since is None or self.in_motion:
            self._since = readout
            if since is not None and self.stop_owed and self.job is None and not self.stopping:
                # the stop that was sent didn't reach it, and its sender has given up
                await self.language.send_stop(1)
            return
        # two readings at nearly the same instant are alike on a moving mount too
        for_s = (readout.utc - since.utc).total_seconds()
        if for_s >= max(self.timing.poll_s, 1.0):
            # the drift that is allowed grows with time: measured from an old reading, a motion looks like
            # rest
            self._since = readout
        if self.job is None and for_s >= 0.5 * self.timing.poll_s:
            self.stop_owed = False
            if self.state in _ON_THE_WAY:
                # nobody followed that motion to its end: all that is known is that the mount rests
                self.state = SlewState.STOPPED

    def _late_sync_shows(self, before: Readout, after: Readout) -> bool:
        late = self.late_sync
        if late is None or self.sent_out:
            return False
        if asyncio.get_running_loop().time() > late.until_s:
            self.late_sync = None
            return False
        # one that tracks at rates of its own has gone on since, from whenever it took the sync
        since_s = max(0.0, (after.utc - late.utc).total_seconds())
        off_arcsec = self.drift.beyond_arcsec(late.place, after.place, since_s)
        if off_arcsec > late.near_arcsec and self._took_elsewhere(before, after):
            self.late_sync = None
            self.went_elsewhere(off_arcsec)
            return True
        if off_arcsec > late.near_arcsec:
            return False
        if self.drift.beyond_arcsec(late.place, before.place, since_s) <= late.near_arcsec:
            return False
        self.late_sync = None
        self.emit("sync-late", {"miss_arcsec": round(off_arcsec, 1)})
        self.trust("a sync was seen, late")
        return True

    def _took_elsewhere(self, before: Readout, after: Readout) -> bool:
        """Whether a resting mount changed its place at once: a sync shows like that, a motion doesn't."""
        if before.slewing or after.slewing or self.in_motion or self.state in _ON_THE_WAY or self.pulses:
            return False
        if self.axes:
            return False
        moved = moved_arcsec(before.reading, after.reading, self.drift.may)
        return moved > self.timing.resting_free_arcsec(self.language.resolution_arcsec)

    def _watch_for_jumps(self, before: Readout, believed: Believed) -> None:
        """Distrust the position when the reading changed though nobody moved the mount."""
        after = believed.readout
        if believed.jump_arcsec > 0.0:
            self._jumped(believed.jump_arcsec)
        if self.sent_out:
            # where it comes to rest decides whether that was an error or a restart
            if believed.leap_arcsec > 0.0:
                leap_deg = believed.leap_arcsec / 3600.0
                self.doubt = f"its reading leapt by {leap_deg:.2f}° on its way, and it didn't arrive"
            return
        elapsed_s = max(0.0, (after.utc - before.utc).total_seconds())
        free_arcsec = self.timing.resting_free_arcsec(self.language.resolution_arcsec)
        moved_arcsec = self.filter.beyond_drift_arcsec(before, after) - free_arcsec
        if self.state in _ON_THE_WAY or self.axes or before.slewing or after.slewing:
            # a motion that no order of ours follows; while it lasts the readings show it
            if believed.leap_arcsec > 0.0:
                self._jumped(moved_arcsec)
            elif (
                self._muted
                and not (after.slewing or self.axes)
                and moved_arcsec > self.timing.drift_arcsec_s * elapsed_s
            ):
                self._changed_in_silence(moved_arcsec)
            return
        # readings are timed by the sky's clock (which may run fast), `silence_s` is real seconds
        silent = real_s(elapsed_s) > self.timing.silence_s
        if self.timing.heartbeat_s <= 0.0 and silent:
            # without a heartbeat nobody read in between; that is no silence, somebody may have moved it by
            # hand
            return
        if silent and moved_arcsec > self.timing.drift_arcsec_s * elapsed_s:
            # a motion by hand control would have been seen on its way; this was not
            self._changed_in_silence(moved_arcsec)
        elif moved_arcsec > (HAND_DEG + HAND_DEG_S * elapsed_s) * 3600.0:
            self._jumped(moved_arcsec)

    def _jumped(self, by_arcsec: float) -> None:
        self.distrust(f"its reading jumped by {by_arcsec / 3600.0:.2f}° without an order from mountnav")

    def _changed_in_silence(self, by_arcsec: float) -> None:
        self.distrust(f"its reading changed by {by_arcsec / 3600.0:.2f}° while it was silent")

    def near_arcsec(self) -> float:
        """How near to its place a mount must rest to have arrived."""
        return max(self.timing.near_arcsec, 2.0 * self.language.resolution_arcsec)
