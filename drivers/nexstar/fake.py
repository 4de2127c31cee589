"""The other end of a hand control's cable, over the mechanics of a telescope that points wrong.

It answers as the hand control of an AVX did in the recorded dialogues: every order with ``#``, carried out or
not, an absent board with silence. A SynScan differs in how it tells its version, in its tracking modes, in
what it passes on to its motors, and in speaking J2000. It does no I/O: `drivers.fakes.bench` puts it on a
wire.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from datetime import UTC, datetime, timedelta

from drivers.fakes.faults import Fault
from drivers.fakes.wire_fake import WireFake
from drivers.nexstar.angles import pair_from_text, pair_to_text
from drivers.nexstar.fake_horizon import believed_horizon, point_at_horizon
from drivers.nexstar.fake_motors import FakeMotors
from drivers.nexstar.handsets import Handset, Tracking, Version
from drivers.nexstar.passthrough import pass_through_from_bytes
from drivers.nexstar.site_and_time import (
    WireSite,
    WireTime,
    fine_time_from_bytes,
    site_from_bytes,
    site_to_bytes,
    time_from_bytes,
    time_to_bytes,
)
from drivers.wire.command import Unreadable
from mountnav.devices import Epoch, PierSide
from mountnav.simulation.mechanics import Mechanics
from mountnav.sky.chain import apparent_to_icrs, icrs_to_apparent
from mountnav.sky.coordinates import Apparent, Icrs, Site, utc_now
from mountnav.sky.sphere import separation_arcsec

AVX = Handset(Version(5, 31), 0x11, 20, Version(7, 11))
"""As in the recorded dialogues."""

# a command's first byte tells how long it is [NexStar table]
_LENGTHS = {
    **dict.fromkeys(b"VvmeEzZLJMtphwiu", 1),
    **dict.fromkeys(b"KT", 2),
    **dict.fromkeys(b"WHI", 9),
    ord("P"): 8,
    **dict.fromkeys(b"rsb", 18),
    **dict.fromkeys(b"RSB", 10),
}


_STANDS_ARCSEC = 1.0


class FakeNexstar(WireFake):
    """A hand control on the wire, with a mount behind it.

    Parameters
    ----------
    mechanics : Mechanics
        What moves, and what it believes of itself.
    handset : Handset
        Which one it is; what it can't do for its age, it doesn't know.
    version : tuple of int, optional
        Another firmware: major, minor.
    epoch : {"apparent", "icrs"}, optional
        What its coordinates mean: JNow for Celestron, J2000 for SynScan [NexStar SynScan differences].
    aligned : bool
        Whether its alignment is done; if not, no goto to a place on the sky is carried out, nor a sync.
    lowest_altitude_deg : float
        A goto below is answered and not carried out.
    sync_reach_deg : float or None
        A sync further off is answered and not carried out.
    coarse : bool
        Whether the last two of eight digits are 00, as of real ones.
    faults, clock, monotonic
        As of `WireFake`; its own clock is that of the mechanics.
    """

    IDENTITY = (b"V", b"v", b"m", b"P\x01\x10\xfe", b"P\x01\x11\xfe")

    def __init__(
        self,
        mechanics: Mechanics,
        *,
        handset: Handset = AVX,
        version: tuple[int, int] | None = None,
        epoch: Epoch | None = None,
        aligned: bool = True,
        lowest_altitude_deg: float = 0.0,
        sync_reach_deg: float | None = None,
        coarse: bool = True,
        faults: Iterable[Fault] = (),
        clock: Callable[[], datetime] = utc_now,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(mechanics, faults=faults, clock=clock, monotonic=monotonic)
        if version is not None:
            handset = replace(handset, version=Version(*version))
        self.handset = handset
        self.aligned = aligned
        self.motors = FakeMotors(mechanics, None if handset.synscan else handset.motors, monotonic)
        self._epoch: Epoch = epoch or ("icrs" if handset.synscan else "apparent")
        self._lowest_altitude_deg = lowest_altitude_deg
        self._sync_reach_deg = sync_reach_deg
        self._coarse = coarse
        self._goto = False
        self._sent_to: tuple[float, float] | None = None
        self._mode = handset.usual_mode(mechanics.site.latitude_deg) or Tracking.EQUATORIAL_NORTH
        self._zone_h, self._daylight_saving = 0.0, False
        self._knows = self._letters()

    # -- the wire --------------------------------------------------------------------------------

    def cut(self, buffer: bytes) -> tuple[bytes | None, bytes]:
        """Cut off the next command; half of one waits for its rest, whatever that is [NexStar s]."""
        while buffer:
            length = _LENGTHS.get(buffer[0])
            if length is not None:
                return (buffer[:length], buffer[length:]) if len(buffer) >= length else (None, buffer)
            self.unknown.append(buffer[:1])
            buffer = buffer[1:]
        return None, b""

    def deaf_reply(self, command: bytes) -> bytes:
        """Answer as to every order."""
        return b"#"

    def reboot(self) -> None:
        """Forget alignment, goto and tracking; clock and site as the mechanics do."""
        super().reboot()
        self.motors.reboot()
        self.aligned = self._goto = False
        self.mechanics.tracking = False

    def dues(self) -> list[float]:
        """Ends of guide pulses."""
        return self.motors.dues()

    def tick(self) -> None:
        """End guide pulses."""
        self.motors.end_pulses()

    def carry_out(self, command: bytes) -> bytes | None:
        """Do what a command says."""
        letter, rest = command[:1], command[1:]
        if letter not in self._knows:
            return None
        if letter == b"K":
            return rest + b"#"
        if letter == b"P":
            return self._pass_through(command)
        try:
            return (self._order(letter, rest) if rest else self._question(letter)) + b"#"
        except (Unreadable, ValueError, IndexError):
            # what a real one says to digits that are none has not been seen: silence
            return None

    def _letters(self) -> frozenset[bytes]:
        """Those that a hand control of this age knows."""
        handset = self.handset
        letters = "KVERZBLJM"
        if not handset.short_places:
            letters += "erTP"
        if handset.tells_model:
            letters += "mzb"
        if handset.tells_tracking:
            letters += "twWhH"
        if handset.variant is not None:
            letters += "v"
        if handset.quarter_zones:
            # `u` is sent before a park and answered so: it takes syncs back [INDI unsync]
            letters += "iIu"
        if handset.knows_sync:
            letters += "sS"
        if handset.tells_pier_side:
            letters += "p"
        return frozenset(letter.encode() for letter in letters)

    def _pass_through(self, command: bytes) -> bytes | None:
        try:
            message = pass_through_from_bytes(command)
        except Unreadable:
            return None
        answer = self.motors.answer(message)
        if answer is None:
            # neither does an absent board answer, nor the hand control for it [NexStar P]
            return None
        self._goto = self._goto and self.mechanics.slewing()
        return answer[: message.answer_length].ljust(message.answer_length, b"\0") + b"#"

    # -- the meaning -----------------------------------------------------------------------------

    def _question(self, letter: bytes) -> bytes:
        if letter in b"eEzZ":
            return self._pair(letter)
        if letter == b"M":
            if self._goto:
                self.mechanics.stop()
            self._goto = False
            return b""
        self._goto = self._goto and self.mechanics.slewing()
        handset, version = self.handset, self.handset.version
        answers: dict[bytes, Callable[[], bytes]] = {
            b"V": lambda: (
                b"%02X%02X%02X" % (version.major, version.minor, version.build)
                if handset.synscan
                else bytes([version.major, version.minor])
            ),
            b"v": lambda: bytes([handset.variant or 0]),
            b"m": lambda: bytes([handset.model or 0]),
            b"L": lambda: b"1" if self._goto else b"0",
            b"J": lambda: bytes([self.aligned]),
            b"t": lambda: bytes([handset.number(self._mode) if self.mechanics.tracking else 0]),
            b"p": self._pier_side,
            b"w": self._site,
            b"h": lambda: self._time(fine=False),
            b"i": lambda: self._time(fine=True),
            b"u": lambda: b"",
        }
        return answers[letter]()

    def _order(self, letter: bytes, rest: bytes) -> bytes:
        if letter in b"rRsSbB":
            pair = pair_from_text(rest)
            if letter in b"bB":
                self._sent_to = (pair.first_deg, pair.second_deg)
                point_at_horizon(self.mechanics, *self._sent_to)
                self._goto = True
            elif self.aligned and letter in b"sS":
                self._sync(self._from_wire(pair.first_deg, pair.second_deg))
            elif self.aligned:
                self._slew(self._from_wire(pair.first_deg, pair.second_deg))
        elif letter == b"T":
            mode = self.handset.mode(rest[0])
            self.motors.southern = mode is Tracking.EQUATORIAL_SOUTH
            self.mechanics.tracking = mode is not Tracking.OFF
            self._mode = mode or self._mode
        elif letter == b"W":
            site = site_from_bytes(rest)
            height_m = self.mechanics.believed_site.height_m
            self.mechanics.set_believed_site(Site(site.latitude_deg, site.longitude_deg, height_m))
        else:
            self._set_time(fine_time_from_bytes(rest) if letter == b"I" else time_from_bytes(rest))
        return b""

    def _slew(self, target: Apparent) -> None:
        mechanics, tracking = self.mechanics, self.mechanics.tracking
        if mechanics.believed_altitude_deg(target) < self._lowest_altitude_deg:
            return
        if mechanics.refusal(target) is None and mechanics.slew(target) is None:
            # a goto leaves the tracking mode as it is
            mechanics.tracking = tracking
            self._goto = True

    def _sync(self, place: Apparent) -> None:
        if self._sync_reach_deg is not None:
            off_deg = separation_arcsec(self.mechanics.reported(), place) / 3600.0
            if off_deg > self._sync_reach_deg:
                return
        self.mechanics.sync(place)

    def _pier_side(self) -> bytes:
        """Where the tube looks: W for one that hangs in the east."""
        letter = b"E" if self.mechanics.pier_side() is PierSide.WEST else b"W"
        southern = self.mechanics.believed_site.latitude_deg < 0.0
        if self.handset.mirrors_pier_side and southern:
            return b"W" if letter == b"E" else b"E"
        return letter

    # -- places ----------------------------------------------------------------------------------

    def _pair(self, letter: bytes) -> bytes:
        short = letter.isupper()
        if letter in b"eE":
            place = self.mechanics.reported()
            told = apparent_to_icrs(place) if self._epoch == "icrs" else place
            return pair_to_text(told.ra_deg, told.dec_deg, short=short, coarse=self._coarse)
        az_deg, alt_deg = self._horizon()
        return pair_to_text(az_deg, alt_deg, short=short, coarse=self._coarse)

    def _horizon(self) -> tuple[float, float]:
        az_deg, alt_deg = believed_horizon(self.mechanics)
        if self._sent_to is not None and not (self.mechanics.tracking or self.mechanics.slewing()):
            # at the zenith the azimuth is any number on the sky, but the axes stand where they were sent
            near = Icrs(az_deg, alt_deg), Icrs(self._sent_to[0] % 360.0, self._sent_to[1])
            if separation_arcsec(*near) < _STANDS_ARCSEC:
                return self._sent_to
        return az_deg, alt_deg

    def _from_wire(self, ra_deg: float, dec_deg: float) -> Apparent:
        now = self.mechanics.reported().utc
        if self._epoch == "icrs":
            return icrs_to_apparent(Icrs(ra_deg, dec_deg), now)
        return Apparent(ra_deg, dec_deg, now)

    # -- clock and site, as the mechanics believe them ---------------------------------------------

    def _site(self) -> bytes:
        site = self.mechanics.believed_site
        east_deg = (site.longitude_deg + 180.0) % 360.0 - 180.0
        return site_to_bytes(WireSite(site.latitude_deg, east_deg))

    def _time(self, *, fine: bool) -> bytes:
        utc = self.mechanics.believed_utc().replace(microsecond=0, tzinfo=None)
        local = utc + timedelta(hours=self._zone_h + int(self._daylight_saving))
        zone_h = self._zone_h if fine else float(int(self._zone_h))
        return time_to_bytes(WireTime(local, zone_h, self._daylight_saving), fine=fine)

    def _set_time(self, given: WireTime) -> None:
        self._zone_h, self._daylight_saving = given.zone_h, given.daylight_saving
        self.mechanics.set_believed_utc(given.utc.replace(tzinfo=UTC))
