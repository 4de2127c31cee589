"""A whole telescope in virtual time: mechanics that point wrong, no wire, frames that carry their truth."""

from __future__ import annotations

import math
from collections.abc import Callable, Coroutine
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any, TypeVar

from drivers.simulated.behavior import MountBehavior
from drivers.simulated.mount import SimulatedMount
from drivers.simulated.rotator import simulated_rotator
from drivers.simulated.truth_camera import TruthCamera
from mountnav.catalog.embedded import embedded_catalog
from mountnav.devices import Mount
from mountnav.journal.memory import MemoryJournal
from mountnav.journal.records import EntryKind
from mountnav.navigation.equipment import equip
from mountnav.navigation.navigator import Navigator
from mountnav.navigation.policy import CenteringPolicy
from mountnav.simulation.machine import Machine
from mountnav.simulation.mechanics import Mechanics, PointingErrors
from mountnav.simulation.rotator_mechanics import RotatorBehavior, RotatorMechanics
from mountnav.simulation.sky_script import SkyScript
from mountnav.simulation.sky_seen import SeenThrough, SkySeen
from mountnav.simulation.virtual_time import VirtualClock, run_virtually
from mountnav.sky.chain import hour_angle_to_icrs, icrs_to_hour_angle
from mountnav.sky.coordinates import Air, HourAngle, Icrs, Site
from mountnav.sky.sphere import separation_arcsec

Result = TypeVar("Result")

SITE = Site(48.93, 22.27, 700.0)
AIR = Air(pressure_hpa=930.0, temperature_c=5.0, relative_humidity=0.7)
START = datetime(2026, 11, 21, 20, 0, tzinfo=UTC)
ERRORS = PointingErrors(
    ih_arcsec=700.0,
    id_arcsec=-500.0,
    ch_arcsec=120.0,
    np_arcsec=60.0,
    me_arcsec=200.0,
    ma_arcsec=-150.0,
    tf_arcsec=30.0,
)
POLICY = CenteringPolicy(exposure_s=5.0, scale_arcsec_px=2.0, timeout_s=1800.0, max_tries=8)


@dataclass
class VirtualRig:
    """A navigator, and the truth that it may not see."""

    navigator: Navigator
    mount: SimulatedMount
    mechanics: Mechanics
    camera: TruthCamera
    sky: SkySeen
    journal: MemoryJournal
    clock: VirtualClock
    events: list[tuple[str, dict[str, object]]] = field(default_factory=list)
    rotates: RotatorMechanics | None = None
    altaz: bool = False

    @property
    def turned_deg(self) -> float:
        """How the camera truly stands on the sky: position angle of its +y."""
        assert self.rotates is not None
        field_deg = parallactic_deg(self.mechanics, self.clock.utc()) if self.altaz else 0.0
        tube_deg = self.mechanics.tube_angle_deg(self.clock.utc())
        return (tube_deg + field_deg + self.rotates.camera_deg()) % 360.0

    def up(self, ha_deg: float, dec_deg: float) -> Icrs:
        """A place that stands at this hour angle now."""
        return hour_angle_to_icrs(HourAngle(ha_deg, dec_deg, self.clock.utc()), SITE, AIR)

    def off_arcsec(self, target: Icrs) -> float:
        """How far the tube truly looks from the target."""
        return separation_arcsec(self.mechanics.truth(self.clock.utc()), target)

    def told(self, kind: str) -> list[dict[str, object]]:
        """Facts of the events of a kind."""
        return [facts for one, facts in self.events if one == kind]

    def entries(self, kind: EntryKind) -> list[Any]:
        """What the journal holds of a kind."""
        return [one for one in self.journal.entries if one.kind is kind]


def parallactic_deg(mechanics: Mechanics, utc: datetime) -> float:
    """Position angle of the zenith where the tube looks [Meeus 1998, 14.1]."""
    here = icrs_to_hour_angle(mechanics.truth(utc), utc, SITE, AIR)
    ha, dec, phi = (math.radians(one) for one in (here.ha_deg, here.dec_deg, SITE.latitude_deg))
    return math.degrees(
        math.atan2(math.sin(ha), math.tan(phi) * math.cos(dec) - math.sin(dec) * math.cos(ha))
    )


def in_virtual_time(
    work: Callable[[VirtualRig], Coroutine[Any, Any, Result]],
    *,
    errors: PointingErrors = ERRORS,
    machine: Machine | None = None,
    behavior: MountBehavior | None = None,
    script: SkyScript | None = None,
    through: SeenThrough | None = None,
    policy: CenteringPolicy = POLICY,
    turned_deg: float = 33.0,
    wrap: Callable[[Mount], Mount] = lambda mount: mount,
    rotates: RotatorBehavior | None = None,
    rotator_starts_deg: float = 0.0,
    altaz: bool = False,
    made: type[SimulatedMount] = SimulatedMount,
    **given: Any,
) -> Result:
    """Open a rig, let `work` have it, close it; hours take moments.

    Parameters
    ----------
    altaz : bool
        The field turns as on an alt-azimuth mount, by the textbook's parallactic angle.
    """
    clock = VirtualClock(START)
    mechanics = Mechanics(SITE, AIR, errors, machine=machine, clock=clock)
    mount = made(mechanics, clock, behavior or MountBehavior())
    script = script or SkyScript()
    rotator = None
    if rotates is not None:
        rotator = RotatorMechanics(clock, rotates, starts_deg=rotator_starts_deg, zero_deg=turned_deg)
        given["rotator"] = simulated_rotator(rotator, clock)
    fixed = turned_deg if rotator is None else rotator.camera_deg

    def stands(utc: datetime) -> float:
        camera_deg = fixed(utc) if callable(fixed) else fixed
        return camera_deg + (parallactic_deg(mechanics, utc) if altaz else 0.0)

    camera = TruthCamera(mechanics, clock, script, through, turned_deg=stands)
    sky = SkySeen(script, clock, through)
    journal = MemoryJournal()
    events: list[tuple[str, dict[str, object]]] = []

    async def run() -> Result:
        navigator = Navigator(
            equip(
                name="rig",
                mount=wrap(mount),
                camera=camera,
                catalog=embedded_catalog(),
                site=SITE,
                air=AIR,
                policy=policy,
                listen=lambda kind, facts: events.append((kind, facts)),
                solve=sky,
                journal=journal,
                clock=clock,
                mounting="altaz" if altaz else mechanics.machine.mounting,
                **given,
            )
        )
        await navigator.open()
        try:
            rig = VirtualRig(navigator, mount, mechanics, camera, sky, journal, clock, events, rotator, altaz)
            return await work(rig)
        finally:
            await navigator.close()

    return run_virtually(run(), clock)
