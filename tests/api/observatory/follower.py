"""A process: the service with one real port, that follows a moving target until it is killed.

Arguments: the settings file, what goes on ("rates" in both coordinates, "ra" in the first alone, or "axis"),
"renew" or "once", and "slew" to slew first to where all mounts can follow. It prints "in force" when the
first order has come back, and goes on to renew it.
"""

from __future__ import annotations

import asyncio
import sys
from datetime import timedelta
from pathlib import Path

from api.http.app import create_app
from mountnav.clock import utc_now
from mountnav.devices import MountAxis, OffsetRates
from mountnav.settings.observatory import Settings
from mountnav.sky.chain import apparent_to_icrs, sidereal_time_deg
from mountnav.sky.coordinates import Apparent, Site

RATES = OffsetRates(6.0, -4.0)
MOST_DEG_S = 1.0
SITE = Site(47.0, 11.0)


async def follow(file: Path, what: str, renew: str, first: str = "") -> None:
    """Follow, for ever."""
    app = create_app(Settings.parse(file.read_text()))
    async with app.router.lifespan_context(app):
        telescope = app.state.service.observatory.telescope("east")
        mount = (await telescope.ready()).mount
        mount.trust()
        if first == "slew":
            if not (await mount.reading()).tracking:
                await mount.set_tracking(True)
            now = utc_now()
            place = Apparent((sidereal_time_deg(now, SITE) - 30.0) % 360.0, 30.0, now)
            await mount.slew(place if mount.epoch == "apparent" else apparent_to_icrs(place))
        print("open", flush=True)
        axis: MountAxis = "secondary" if mount.axis_rates_deg_s.get("secondary") else "primary"
        spans = mount.axis_rates_deg_s.get(axis, ())
        speeds = [min(MOST_DEG_S, one.most_deg_s) for one in spans if one.least_deg_s <= MOST_DEG_S]
        speed_deg_s = max(speeds, default=0.0)
        number = 0
        while True:
            number += 1
            if what != "axis":
                # a little faster each time, so that each goes over the wire
                dec_arcsec_s = RATES.dec_arcsec_s if what == "rates" else 0.0
                rates = OffsetRates(RATES.ra_arcsec_s + 0.001 * number, dec_arcsec_s)
                await mount.set_offset_rates(rates, ends_utc=utc_now() + timedelta(seconds=600.0))
            else:
                await mount.move_axis(axis, -speed_deg_s, for_s=3.0)
            if number == 1:
                print("in force", flush=True)
            await asyncio.sleep(0.25 if renew == "renew" else 3600.0)


def main() -> None:
    """Follow as the arguments say."""
    asyncio.run(follow(Path(sys.argv[1]), *sys.argv[2:]))


if __name__ == "__main__":
    main()
