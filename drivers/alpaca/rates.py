"""Rates of an Alpaca telescope: offset rates ordered and read back, axes moved by hand.

`MoveAxis` suspends tracking on its axis, and which way is positive is each driver's own. So tracking is put
into the speed, and the way an axis goes is seen in the readings once: what it did then holds from then on.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping

from drivers.alpaca.client import understood
from drivers.alpaca.codec import base, rates, state
from drivers.alpaca.codec.base import AlpacaRefused, Malformed
from drivers.alpaca.device import AlpacaDevice
from drivers.generic.language import Sent, Wanted
from mountnav.devices import MountAxis, OffsetRates, PierSide, RateSpan, TrackingRate
from mountnav.errors import DeviceError, DeviceGarbled, DeviceSilent
from mountnav.sky.coordinates import SIDEREAL_DEG_S
from mountnav.tasks import both

_SIDEREAL = state.RATES[TrackingRate.SIDEREAL]
CAN_OFFSET = ("cansetrightascensionrate", "cansetdeclinationrate")
"""A telescope takes offset rates when it says yes to both: a comet moves in both coordinates."""


class OffsetRateOrders:
    """Orders offset rates of one telescope."""

    def __init__(self, device: AlpacaDevice) -> None:
        self._device = device

    async def order(self, wanted: OffsetRates) -> None:
        """Order both rates; one that was taken before the other was refused is taken back.

        The rate beside which they count is the sidereal one: others are refused [ASCOM ITelescopeV4]. So it
        is set before if it is another.

        Raises
        ------
        AlpacaRefused, DeviceSilent, DeviceGarbled, DeviceMissing
        """
        client = self._device.client
        await self._track_as_for_a_star()
        before = None if wanted.none else await self.read()
        ra, dec = rates.said_ra_rate(wanted.ra_arcsec_s), wanted.dec_arcsec_s
        refused: AlpacaRefused | None = None
        try:
            await client.put("rightascensionrate", {"RightAscensionRate": ra})
        except AlpacaRefused as refusal:
            if not wanted.none:
                raise
            # what is to end ends as far as it can
            refused = refusal
        try:
            await client.put("declinationrate", {"DeclinationRate": dec})
        except AlpacaRefused:
            if before is not None:
                with contextlib.suppress(DeviceError):
                    again = rates.said_ra_rate(before.ra_arcsec_s)
                    await client.put("rightascensionrate", {"RightAscensionRate": again})
            raise
        if refused is not None:
            raise refused

    async def _track_as_for_a_star(self) -> None:
        told = await self._device.maybe("trackingrate", base.integer)
        if told is not None and told != _SIDEREAL:
            await self._device.client.put("trackingrate", {"TrackingRate": _SIDEREAL})

    async def read(self) -> OffsetRates | None:
        """What it says; None where it can't just now.

        Raises
        ------
        DeviceSilent, DeviceGarbled, DeviceMissing
        """
        client = self._device.client
        try:
            ra, dec = await both(client.get("rightascensionrate"), client.get("declinationrate"))
        except AlpacaRefused:
            return None
        try:
            return rates.told_rates(ra, dec)
        except Malformed as fault:
            raise understood("offset rates", fault, self._device.address) from fault


class AxisOrders:
    """Moves the axes of one telescope by hand.

    Parameters
    ----------
    signs : mapping of MountAxis to float
        Which sign moves each axis to greater coordinates on the normal side of the pier, as the settings say.
    """

    def __init__(self, device: AlpacaDevice, signs: Mapping[MountAxis, float]) -> None:
        self._device = device
        self._stated = dict(signs)
        self._seen: dict[tuple[MountAxis, PierSide | None], float] = {}
        """What was seen of an axis, by the side of the pier."""
        self._moved: set[MountAxis] = set()
        self._side: PierSide | None = None
        self._tracked = False
        self._alt_az = False
        self.spans: dict[MountAxis, tuple[RateSpan, ...]] = {}

    async def begin(self) -> list[str]:
        """Find out which axes it can move, and how fast; return what an operator should know."""
        self._moved.clear()
        self.spans, problems = {}, []
        mode = await self._device.maybe("alignmentmode", base.integer)
        self._alt_az = mode == rates.ALIGNED_ALT_AZ
        for axis, number in rates.AXES.items():
            which = {"Axis": number}
            try:
                if not await self._device.maybe("canmoveaxis", base.truth, which):
                    continue
                spans = await self._device.maybe("axisrates", rates.spans, which)
            except (AlpacaRefused, DeviceGarbled) as trouble:
                problems.append(f"its {axis} axis can't be moved by hand: {trouble.what}")
                continue
            if spans:
                self.spans[axis] = spans
        return problems

    def unsure(self, axis: MountAxis) -> bool:
        """Whether which way is positive is a guess that readings can prove or refute."""
        return not self._alt_az and axis not in self._stated and (axis, self._side) not in self._seen

    def seen(self, axis: MountAxis, *, rightly: bool) -> None:
        """It was seen to move as ordered, or the other way."""
        self._seen[axis, self._side] = self._sign(axis) * (1.0 if rightly else -1.0)

    def _sign(self, axis: MountAxis) -> float:
        if (axis, self._side) in self._seen:
            return self._seen[axis, self._side]
        usual = rates.usual_sign(axis, self._side, alt_az=self._alt_az)
        stated = self._stated.get(axis)
        if stated is None:
            return usual
        # stated for the normal side: the secondary axis turns its sense beyond the pole
        beyond = axis == "secondary" and self._side is PierSide.WEST and not self._alt_az
        return -stated if beyond else stated

    async def order(self, axis: MountAxis, rate_deg_s: float, wanted: Wanted) -> Sent:
        """Move an axis on, on top of tracking, or end that.

        Raises
        ------
        AlpacaRefused, DeviceMissing
        """
        if rate_deg_s and not self._moved:
            # while an axis is moved a driver may say anything of both
            self._tracked = await self._device.maybe("tracking", base.truth) is True
            self._side = await self._side_now()
        rate = self._said(axis, rate_deg_s)
        if not wanted():
            return Sent(wire=False)
        if rate_deg_s:
            self._moved.add(axis)
        else:
            self._moved.discard(axis)
        try:
            await self._device.client.put("moveaxis", {"Axis": rates.AXES[axis], "Rate": rate})
        except (DeviceSilent, DeviceGarbled) as failure:
            return Sent(lost=failure)
        return Sent()

    def stopped(self) -> None:
        """A stop has ended all of it."""
        self._moved.clear()

    async def _side_now(self) -> PierSide | None:
        try:
            return await self._device.maybe("sideofpier", state.pier_side)
        except (AlpacaRefused, DeviceGarbled):
            return None

    def _said(self, axis: MountAxis, rate_deg_s: float) -> float:
        """The driver's speed for ours; tracking, which it suspends, is put in where that can be."""
        if rate_deg_s == 0.0:
            return 0.0
        sign = self._sign(axis)
        if axis == "primary" and self._tracked and not self._alt_az:
            with_tracking = rate_deg_s - SIDEREAL_DEG_S
            if self._can(axis, with_tracking):
                return sign * with_tracking
        return sign * rate_deg_s

    def _can(self, axis: MountAxis, rate_deg_s: float) -> bool:
        spans = self.spans.get(axis, ())
        return any(span.least_deg_s <= abs(rate_deg_s) <= span.most_deg_s for span in spans)
