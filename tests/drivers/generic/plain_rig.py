"""A generic mount on a language without a wire, quick enough for tests, with all events it sends."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

from drivers.generic.mount import GenericMount
from drivers.generic.options import Timing
from mountnav.clock import utc_now
from mountnav.simulation.mechanics import Mechanics, PointingErrors
from mountnav.sky.coordinates import Air, Apparent, Site
from tests.drivers.generic.plain_language import PlainLanguage

HERE = Site(49.6, 36.9)


QUICK = Timing(
    poll_s=0.05,
    start_grace_s=0.4,
    rest_s=0.2,
    stall_s=1.0,
    sync_wait_s=0.6,
    late_s=0.3,
    heartbeat_s=0.1,
    silence_s=0.3,
    lost_after_s=1.0,
    backoff_s=0.05,
    near_arcsec=5.0,
)


class Rig:
    """A generic mount, its language, and all events that it sent."""

    def __init__(self, language: PlainLanguage, mount: GenericMount) -> None:
        self.language, self.mount = language, mount
        self.told: list[tuple[str, dict[str, object]]] = []
        mount.listen(lambda what, facts: self.told.append((what, dict(facts))))

    def heard(self, what: str) -> list[dict[str, object]]:
        return [facts for said, facts in self.told if said == what]

    async def until(self, true: Callable[[], object]) -> None:
        async with asyncio.timeout(30.0):
            while not true():
                await asyncio.sleep(0.01)

    async def beside(self, ra_deg: float, dec_deg: float) -> Apparent:
        place = (await self.mount.reading()).place
        return Apparent((place.ra_deg + ra_deg) % 360.0, place.dec_deg + dec_deg, utc_now())


def plain(*, slew_rate_deg_s: float = 20.0) -> PlainLanguage:
    mechanics = Mechanics(
        HERE, Air(), PointingErrors(), slew_rate_deg_s=slew_rate_deg_s, acceleration_deg_s2=40.0
    )
    return PlainLanguage(mechanics)


@asynccontextmanager
async def rigged(
    language: PlainLanguage | None = None, timing: Timing = QUICK, **given: object
) -> AsyncIterator[Rig]:
    language = language or plain()
    rig = Rig(language, GenericMount(language, timing=timing, site=HERE, **given))  # type: ignore[arg-type]
    await rig.mount.open()
    try:
        yield rig
    finally:
        await rig.mount.close()
