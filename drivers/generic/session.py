"""A language with a link that is kept, readings that are judged, and a position that counts or doesn't.

Connecting asks and compares, and sets nothing unless the configuration says so. A position that may be wrong
(power-up, reboot, lost link) doesn't count until a sync on the sky was seen or the mount has found its home.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from drivers.generic.comparison import compare, implausible
from drivers.generic.coordinates import apart_arcsec
from drivers.generic.language import Identity, Language, Readout
from drivers.generic.link_supervisor import LinkSupervisor
from drivers.generic.options import Timing
from drivers.generic.reading_filter import HAND_DEG, HAND_DEG_S, Believed, ReadingFilter
from mountnav.clock import real_s, utc_now
from mountnav.devices import ConnectReport, PierSide, SlewState, moved_arcsec
from mountnav.errors import Busy, DeviceError, DeviceMissing, DeviceRefused, Refusal
from mountnav.sky.coordinates import Apparent, Icrs, Site

Listener = Callable[[str, Mapping[str, object]], None]
_SAME_CLOCK_S = 5.0
_ON_THE_WAY = (SlewState.ACCEPTED, SlewState.UNDER_WAY, SlewState.LOST)


@dataclass(frozen=True, slots=True)
class ConnectSettings:
    """What connecting may do.

    Attributes
    ----------
    site : Site or None
        Ours, to compare with the mount's.
    set_clock, set_site : bool
        Whether the mount's clock and site are set to ours.
    trust : bool
        Whether the position counts at the first connecting, unless the mount was just switched on.
    swap_sides : bool or None
        Whether it tells the other side of the pier than the one on which the tube hangs; None: nobody has
        looked.
    """

    site: Site | None = None
    set_clock: bool = False
    set_site: bool = False
    trust: bool = True
    swap_sides: bool | None = None


@dataclass(frozen=True, slots=True)
class LateSync:
    """A sync that was given up, and may yet show: where, how near to it, and until when (loop time)."""

    place: Apparent | Icrs
    near_arcsec: float
    until_s: float


class Session:
    """What moving, syncing and all other orders of one mount share.

    Parameters
    ----------
    language : Language
    name : str
        For messages.
    timing : Timing
    connecting : Connecting

    Attributes
    ----------
    job : str or None
        The order to move that runs.
    sent_out : bool
        Whether that has gone out, or is about to: until then nothing of ours moves the mount.
    state : SlewState
        What the last order to move has come to.
    stops : int
        How many stops were ordered.
    stopping : int
        How many of them are being carried out: the mount was not yet seen at rest.
    no_stop : asyncio.Event
        Set while that is none.
    pulses : int
        How many guide pulses run.
    links : int
        How often the link was made or lost: what began under another count goes on no longer.
    stop_owed : bool
        Something may be moving that nobody has seen at rest since.
    ordering : asyncio.Lock
        Held while an order of several commands goes out.
    in_motion : bool
        Whether it moved between the last two looks.
    doubt : str
        What was odd on its way: a silence, a leap. It may have been switched off and on then; unless it comes
        to where it was sent its position counts no more.
    silent_on_its_way : bool
        Then the flags "parked" and "at home" prove nothing either: it may have woken up with them.
    """

    def __init__(self, language: Language, name: str, timing: Timing, connecting: ConnectSettings) -> None:
        self.language = language
        self.name = name
        self.timing = timing
        self.judge = ReadingFilter(timing, name)
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
        self.keeper = LinkSupervisor(
            language,
            timing,
            beat=self.look,
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
        """Whether it has been silent since the last look."""
        self._since: Readout | None = None
        """The look from which on it rests."""

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
        self.keeper.start()

    async def close(self) -> None:
        """Release the link; closing twice is fine."""
        self._wanted_open = self._connected = False
        await self.keeper.end()
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
            self.judge.forget()
            self.judge.resolution_arcsec = language.resolution_arcsec
            readout = (await self.judge.read(language.readout)).readout
            self._was_fresh = readout.fresh
            found = None
            if self._connecting.set_site or self._connecting.set_clock:
                # what it is set from tells by how much its sky is turned
                found = await compare(language, identity, self._connecting.site, trusted=self.trusted)
            done, refused = await self._set(site=self._connecting.set_site, clock=self._connecting.set_clock)
            identity = replace(identity, problems=(*identity.problems, *refused))
            # whoever closes and opens it again must not have trusted it for that
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
        self.tell("link-back" if again else "connected", facts)
        if not trusted:
            self._why_untrusted = "nobody has looked at the sky since it was connected"
            if readout.fresh:
                self._why_untrusted = "it was just switched on"
            elif again:
                self._why_untrusted = "its link was lost"
            elif doubt:
                self._why_untrusted = doubt
            self.tell("untrusted", {"why": self._why_untrusted})

    async def compare(self) -> ConnectReport:
        """Ask for clock and site again, and compare them with ours. Raises `DeviceError`."""
        await self.ready()
        assert self._identity is not None
        assert self.report is not None
        site, done = self._connecting.site, self.report.done
        self.report = await compare(self.language, self._identity, site, trusted=self.trusted, done=done)
        return self.report

    async def set_site_and_time(self) -> ConnectReport:
        """Set clock and site to ours, as far as it takes them; what they are then.

        Its place among the stars may change by that: it counts no more then, as after any jump.

        Raises
        ------
        DeviceRefused
            It takes neither, or moves.
        DeviceError
        """
        if self.job is not None:
            raise Busy(f"a {self.job} is running", device=self.name, advice="wait for it, or stop it")
        await self.ready()
        async with self.ordering:
            done, refused = await self._set(site=True, clock=True)
        if not done:
            raise DeviceRefused(
                "; ".join(refused) or "no site is known that it could be told",
                device=self.name,
                advice="set it at its hand control, or by its own program",
                reason=Refusal.UNSUPPORTED,
            )
        if self.report is not None:
            self.report = replace(self.report, done=tuple(dict.fromkeys((*self.report.done, *done))))
        report = await self.compare()
        await self.look()
        return report

    async def _set(self, *, site: bool, clock: bool) -> tuple[list[str], list[str]]:
        """Set site and clock if that is asked for: what was done, and what it refused."""
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
            # another caller may have done it meanwhile
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
        self.tell("link-silent", {"for_s": round(for_s, 1)})

    async def _on_lost(self, why: str) -> None:
        self.language.log.note("event", meaning=f"link lost: {why}")
        self.links += 1
        self.lost_why = why
        self._since = None
        self._connected = False
        if self.job is not None or self.state in _ON_THE_WAY:
            self.state = SlewState.LOST
            self.stop_owed = True
        self.tell("link-lost", {"why": why})
        self.distrust("its link was lost")
        # a silent line is still open: it is opened anew, the greeting tells who is there now. A caller may be
        # doing that already: its new line isn't closed under it, unless a stop has still to be sent over it
        async with self._opening:
            if self.stop_owed or not self._connected:
                await self.language.close()

    async def _on_back(self, after_s: float) -> None:
        self.tell("link-back", {"after_s": round(after_s, 1)})
        before = None if self.report is None else self.report.clock_off_s
        try:
            clock = await self.language.read_clock()
        except DeviceError:
            return
        if clock is not None and before is not None:
            jump_s = (clock - utc_now()).total_seconds() - before
            if abs(jump_s) > _SAME_CLOCK_S:
                self.distrust(f"its clock has jumped by {jump_s:.0f} s: it was switched off and on")

    # -- trust -------------------------------------------------------------------------------------

    def trust(self, why: str) -> None:
        """Let the position count from now on."""
        if not self.trusted:
            self.trusted = True
            self.tell("trusted", {"why": why})

    def distrust(self, why: str) -> None:
        """Let the position not count any more."""
        self._why_untrusted = why
        if self.trusted:
            self.trusted = False
            self.language.log.note("event", meaning=f"untrusted: {why}")
            self.tell("untrusted", {"why": why})

    def require_trust(self, what: str) -> None:
        """Raise `DeviceRefused` if the position doesn't count."""
        if not self.trusted:
            raise DeviceRefused(
                f"{what} refused: its position can't be trusted ({self._why_untrusted})",
                device=self.name,
                advice="order first light if it was just set up, else recover: both look at the sky; or let "
                "it find its home",
                reason=Refusal.UNTRUSTED,
            )

    def tell(self, what: str, facts: Mapping[str, object]) -> None:
        """Tell all who listen."""
        for listener in self.listeners:
            listener(what, facts)

    # -- readings ----------------------------------------------------------------------------------

    async def look(self) -> Readout:
        """Read the mount until a reading can be believed, and take note of what it shows.

        Raises
        ------
        DeviceSilent, DeviceGarbled, DeviceMissing
            If there is no answer, none that makes sense, or no link.
        """
        async with self._reading:
            self.judge.moving = self.sent_out or self.state is SlewState.UNDER_WAY
            before = self.judge.last
            believed = await self.judge.read(self._readout)
        readout = believed.readout
        self.keeper.heard()
        self.judge.resolution_arcsec = self.language.resolution_arcsec
        if readout.fresh and not self._was_fresh:
            self.distrust("it was switched off and on")
        self._was_fresh = readout.fresh
        if before is not None and not self._late_sync_shows(before, readout):
            self._watch_for_jumps(before, believed)
        self._muted = False
        await self._see_whether_it_rests(readout)
        return readout

    async def glimpse(self) -> Readout:
        """Read the mount once, and neither judge nor publish it: enough for a suspicion. Raises as `look`."""
        readout = await self._readout()
        self.keeper.heard()
        return readout

    async def _readout(self) -> Readout:
        readout = await self.language.readout()
        return replace(readout, pier_side=self.side(readout.pier_side))

    @property
    def sides_stated(self) -> bool:
        """Whether somebody has looked on which side the tube hangs, and said so in the settings."""
        return self._connecting.swap_sides is not None

    def side(self, told: PierSide | None) -> PierSide | None:
        """On which side of the pier the tube hangs, by what the mount tells."""
        return told.other if told is not None and self._connecting.swap_sides else told

    def went_elsewhere(self, miss_arcsec: float) -> None:
        """A sync has changed what it believes, and not to what it was told."""
        self.tell("sync-elsewhere", {"miss_arcsec": round(miss_arcsec, 1)})
        self.distrust(f"it took a sync for another place: it believes to be {miss_arcsec:.0f}″ from there")

    def restless(self) -> None:
        """An order to move goes out, or the place gets another name: rest has to be seen anew."""
        self._since = None

    async def _see_whether_it_rests(self, readout: Readout) -> None:
        since = self._since
        self.in_motion = since is not None and not self.judge.still(since, readout)
        if since is None or self.in_motion:
            self._since = readout
            if since is not None and self.stop_owed and self.job is None and not self.stopping:
                # the stop that was sent didn't reach it, and whoever sent it is gone
                await self.language.send_stop(1)
            return
        # two looks in a moment are alike on a mount that moves as well
        for_s = (readout.utc - since.utc).total_seconds()
        if for_s >= max(self.timing.poll_s, 1.0):
            # what it may drift grows with time: an old look would call a motion rest
            self._since = readout
        if self.job is None and for_s >= 0.5 * self.timing.poll_s:
            self.stop_owed = False
            if self.state in _ON_THE_WAY:
                # nobody followed it to its end: it rests, wherever that is
                self.state = SlewState.STOPPED

    def _late_sync_shows(self, before: Readout, after: Readout) -> bool:
        late = self.late_sync
        if late is None or self.sent_out:
            return False
        if asyncio.get_running_loop().time() > late.until_s:
            self.late_sync = None
            return False
        off_arcsec = apart_arcsec(after.place, late.place)
        if off_arcsec > late.near_arcsec and self._took_elsewhere(before, after):
            self.late_sync = None
            self.went_elsewhere(off_arcsec)
            return True
        if off_arcsec > late.near_arcsec or apart_arcsec(before.place, late.place) <= late.near_arcsec:
            return False
        self.late_sync = None
        self.tell("sync-late", {"miss_arcsec": round(off_arcsec, 1)})
        self.trust("a sync was seen, late")
        return True

    def _took_elsewhere(self, before: Readout, after: Readout) -> bool:
        """Whether a resting mount believes something else at once: so a sync shows, and no motion."""
        if before.slewing or after.slewing or self.in_motion or self.state in _ON_THE_WAY or self.pulses:
            return False
        moved = moved_arcsec(before.reading, after.reading)
        return moved > self.timing.resting_arcsec + 2.0 * self.language.resolution_arcsec

    def _watch_for_jumps(self, before: Readout, believed: Believed) -> None:
        """A place that changed while nobody moved the mount means that it believes something else now."""
        after = believed.readout
        if believed.jump_arcsec > 0.0:
            self._jumped(believed.jump_arcsec)
        if self.sent_out:
            # where it comes to rest tells what that was
            if believed.leap_arcsec > 0.0:
                leap_deg = believed.leap_arcsec / 3600.0
                self.doubt = f"its reading leapt by {leap_deg:.2f}° on its way, and it didn't arrive"
            return
        elapsed_s = max(0.0, (after.utc - before.utc).total_seconds())
        free_arcsec = self.timing.resting_arcsec + 2.0 * self.language.resolution_arcsec
        moved_arcsec = apart_arcsec(before.place, after.place) - free_arcsec
        if self.state in _ON_THE_WAY or before.slewing or after.slewing:
            # a motion that nobody follows: one that goes on is seen on its way
            if believed.leap_arcsec > 0.0:
                self._jumped(moved_arcsec)
            elif self._muted and not after.slewing and moved_arcsec > self.timing.drift_arcsec_s * elapsed_s:
                self._changed_in_silence(moved_arcsec)
            return
        # the mount's seconds are the sky's, our patience is the machine's
        silent = real_s(elapsed_s) > self.timing.silence_s
        if self.timing.heartbeat_s <= 0.0 and silent:
            # nobody looked in between, which is no silence: a hand may have been at work
            return
        if silent and moved_arcsec > self.timing.drift_arcsec_s * elapsed_s:
            # what a hand control does is seen on its way; this was not
            self._changed_in_silence(moved_arcsec)
        elif moved_arcsec > (HAND_DEG + HAND_DEG_S * elapsed_s) * 3600.0:
            self._jumped(moved_arcsec)

    def _jumped(self, by_arcsec: float) -> None:
        self.distrust(f"its reading jumped by {by_arcsec / 3600.0:.2f}° without an order of ours")

    def _changed_in_silence(self, by_arcsec: float) -> None:
        self.distrust(f"its reading changed by {by_arcsec / 3600.0:.2f}° while it was silent")

    def near_arcsec(self) -> float:
        """How near to its place a mount has arrived."""
        return max(self.timing.near_arcsec, 2.0 * self.language.resolution_arcsec)
