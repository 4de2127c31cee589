"""What an iOptron mount shows of itself: who it is, where it points, what it does."""

from __future__ import annotations

from datetime import datetime

from drivers.generic.language import Identity, Readout
from drivers.generic.serial_language import SerialLanguage
from drivers.ioptron import exchange
from drivers.ioptron.codec import v3
from drivers.ioptron.codec.dialect import CommandSet
from drivers.ioptron.codec.greeting import COMMAND_SETS, GREETING, Model, model
from drivers.ioptron.codec.values import MountState, PierSide, Status, TrackingRate
from drivers.ioptron.exchange import IoptronExchange, site_of
from drivers.wire.link import Link
from mountnav import devices
from mountnav.clock import utc_now
from mountnav.devices import Epoch, Skill
from mountnav.errors import DeviceGarbled
from mountnav.sky.coordinates import Apparent, Icrs, Site

_TRACKING = (MountState.TRACKING, MountState.TRACKING_PEC, MountState.GUIDING)
SLEWING = (MountState.SLEWING, MountState.FLIPPING)
_STOPPED = (MountState.STOPPED, MountState.PARKED, MountState.HOME)
_SIDES = {
    PierSide.EAST: devices.PierSide.EAST,
    PierSide.WEST: devices.PierSide.WEST,
    PierSide.UNKNOWN: devices.PierSide.UNKNOWN,
}


class IoptronReading(SerialLanguage):
    """What can be asked of an iOptron mount, and what we hold of it.

    Parameters
    ----------
    epoch : {"apparent", "icrs"}
        Kind of coordinates it is set to speak.
    dialect : {"v2", "v3"}, optional
        Its command set; found out by the greeting, which must agree if it is given.
    """

    def __init__(self, link: Link, *, epoch: Epoch = "apparent", dialect: str | None = None) -> None:
        super().__init__(link)
        self._epoch = epoch
        self._dialect = dialect
        words = COMMAND_SETS[dialect or "v3"]
        self._exchange = IoptronExchange(link, words, model("", words.name))
        self._home_ordered = False
        self._rests_at_home = False
        self._flips_past_deg = 0
        self._tells_time = True

    # -- what it is --------------------------------------------------------------------------------

    @property
    def epoch(self) -> Epoch:
        """Kind of coordinates it is set to speak."""
        return self._epoch

    @property
    def usual_epoch(self) -> Epoch:
        """Of date: INDI publishes its places so, without conversion [INDI ioptronv3]."""
        return "apparent"

    @property
    def resolution_arcsec(self) -> float:
        """The wire's step: 0.01, or 0.015 with the v2 set."""
        return self._words.step_arcsec

    @property
    def _words(self) -> CommandSet:
        return self._exchange.words

    @property
    def _model(self) -> Model:
        return self._exchange.model

    @property
    def dialect(self) -> str:
        """The command set it speaks."""
        return self._words.name

    @property
    def skills(self) -> frozenset[Skill]:
        """What it can do, known after `open`."""
        skills = {
            Skill.HOME,
            Skill.TRACK,
            Skill.TRACKING_RATES,
            Skill.SET_CLOCK,
            Skill.SITE,
            Skill.SET_SITE,
        }
        if self._tells_time:
            skills |= {Skill.CLOCK}
        if self._model.parks:
            skills |= {Skill.PARK, Skill.UNPARK, Skill.SET_PARK}
        if self._model.searches_home:
            skills |= {Skill.FIND_HOME}
        if self._model.equatorial:
            skills |= {Skill.GUIDE}
        if self._follows:
            skills |= {Skill.OFFSET_RATES, Skill.MOVE_AXIS}
        if self._words.has_pier_side and self._model.equatorial:
            skills |= {Skill.PIER_SIDE, Skill.DESTINATION_SIDE}
        return frozenset(skills)

    @property
    def _follows(self) -> bool:
        """Whether it takes a custom rate and says which: what the v2 set means by that is not certain."""
        return (
            self._words.name == "v3"
            and self._model.equatorial
            and not self._exchange.refining.lacks(v3.CUSTOM_RATE)
        )

    # -- the link ----------------------------------------------------------------------------------

    async def open(self) -> Identity:
        """Open the link, ask who is there, and find the command set by the answer to `:GLS#`.

        Raises
        ------
        DeviceMissing
            If there is no such port.
        DeviceSilent, DeviceGarbled
            If nothing on it speaks iOptron's v2 or v3 set.
        """
        identity = await self._greeted(self._identify)
        if self._dialect not in (None, self._words.name):
            await self._link.close()
            raise DeviceGarbled(
                f"its answers are of the command set {self._words.name}, dialect={self._dialect} is set",
                device=self.device,
                advice="leave dialect out",
            )
        return identity

    async def _identify(self) -> Identity:
        self._home_ordered = self._rests_at_home = False
        self._exchange.refining.begin()
        # each session begins with it [IOPTRON310 Initialization]
        number = await self._exchange.known(v3.MODEL) or ""
        words = await self._exchange.ask(GREETING)
        self._exchange.words = words
        status = await self._exchange.ask(self._words.status)
        await self._exchange.ask(self._words.pointing)
        self._exchange.model = model(number, words.name)
        firmware = await self._exchange.known(v3.FIRMWARE)
        meridian = await self._exchange.known(v3.MERIDIAN) if self._model.equatorial else None
        self._flips_past_deg = meridian[1] if meridian is not None else 0
        told = f"iOptron {self._model.name or 'mount'} ({number or 'it gives no model'})"
        text = f"{told}, command set {self._words.name}"
        if firmware is not None:
            text += f", firmware {firmware}"
        if meridian is not None:
            text += f", {'flips' if meridian[0] else 'stops'} {meridian[1]}° past the meridian"
        if words.name == "v3" and self._model.equatorial:
            await self._exchange.known(v3.CUSTOM_RATE)
        self._tells_time = await exchange.read_clock(self._exchange) is not None
        return Identity(text, (*self._problems(status), *self._exchange.refining.notes))

    def _problems(self, status: Status) -> tuple[str, ...]:
        problems = []
        if self._model.number and not self._model.name:
            problems.append(f"its model number {self._model.number} is unknown to us")
        if status.northern != (status.latitude_deg >= 0.0):
            side = "northern" if status.northern else "southern"
            problems.append(f"it is set to the {side} hemisphere at a latitude of {status.latitude_deg:.2f}°")
        if status.rate is not TrackingRate.SIDEREAL:
            problems.append(f"it is set to track at the {status.rate.name.lower()} rate")
        return tuple(problems)

    # -- readings ----------------------------------------------------------------------------------

    async def readout(self) -> Readout:
        """Look at the mount: place, then state.

        A mount that rests at its zero position without an order of ours says what one says that was just
        switched on: it takes the place where it stands for its home, and knows nothing.
        """
        troubles = self._link.troubles
        before = utc_now()
        pointing = await self._exchange.ask(self._words.pointing)
        after = utc_now()
        status = await self._exchange.ask(self._words.status)
        utc = before + (after - before) / 2
        ra_deg, dec_deg = pointing.ra_deg, pointing.dec_deg
        state = status.state
        return Readout(
            Icrs(ra_deg, dec_deg) if self._epoch == "icrs" else Apparent(ra_deg, dec_deg, utc),
            utc,
            span_s=(after - before).total_seconds(),
            slewing=state in SLEWING,
            tracking=True if state in _TRACKING else False if state in _STOPPED else None,
            parked=state is MountState.PARKED,
            at_home=state is MountState.HOME,
            pier_side=_SIDES[pointing.pier] if Skill.PIER_SIDE in self.skills else None,
            fresh=self._fresh(state),
            doubtful=self._link.troubles != troubles,
        )

    def _fresh(self, state: MountState) -> bool:
        if state is MountState.HOME:
            self._rests_at_home = self._rests_at_home or self._home_ordered
            self._home_ordered = False
            return not self._rests_at_home
        if state in _TRACKING or state in SLEWING:
            self._rests_at_home = False
        return False

    # -- clock and site ----------------------------------------------------------------------------

    async def read_clock(self) -> datetime | None:
        """Its clock, aware UTC, corrected for the way."""
        return await exchange.read_clock(self._exchange)

    async def read_site(self) -> Site | None:
        """Where it believes to stand."""
        return site_of(await self._exchange.ask(self._words.status))
