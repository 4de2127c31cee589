"""A process: the service with one real port, that follows a moving target until it is killed.

Arguments: the settings file, what goes on ("rates" or "axis"), and "renew" or "once". It prints "in force"
when the first order has come back, and goes on to renew it.
"""

from __future__ import annotations

import asyncio
import sys
from datetime import timedelta
from pathlib import Path

from api.http.app import create_app
from mountnav.clock import utc_now
from mountnav.devices import OffsetRates
from mountnav.settings.observatory import Settings

RATES = OffsetRates(6.0, -4.0)
MOST_DEG_S = 1.0


async def follow(file: Path, what: str, renew: str) -> None:
    """Follow, for ever."""
    app = create_app(Settings.parse(file.read_text()))
    async with app.router.lifespan_context(app):
        telescope = app.state.service.observatory.telescope("east")
        mount = (await telescope.ready()).mount
        mount.trust()
        print("open", flush=True)
        spans = mount.axis_rates_deg_s["secondary"]
        speed_deg_s = max(span.most_deg_s for span in spans if span.most_deg_s <= MOST_DEG_S)
        number = 0
        while True:
            number += 1
            if what == "rates":
                # a little faster each time, so that each goes over the wire
                rates = OffsetRates(RATES.ra_arcsec_s + 0.001 * number, RATES.dec_arcsec_s)
                await mount.set_offset_rates(rates, ends_utc=utc_now() + timedelta(seconds=600.0))
            else:
                await mount.move_axis("secondary", -speed_deg_s, for_s=3.0)
            if number == 1:
                print("in force", flush=True)
            await asyncio.sleep(0.25 if renew == "renew" else 3600.0)


def main() -> None:
    """Follow as the arguments say."""
    asyncio.run(follow(Path(sys.argv[1]), sys.argv[2], sys.argv[3]))


if __name__ == "__main__":
    main()
