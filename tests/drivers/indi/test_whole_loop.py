"""The whole loop against INDI's own parts: expose, solve, sync, slew; judged by where the sky was drawn."""

from __future__ import annotations

import os
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from drivers.registry import open_camera, open_mount
from mountnav.catalog.embedded import embedded_catalog
from mountnav.clock import utc_now
from mountnav.navigation.equipment import equip
from mountnav.navigation.navigator import Navigator
from mountnav.navigation.policy import CenteringPolicy
from mountnav.navigation.reports import CenterOutcome
from mountnav.sky.chain import hour_angle_to_icrs
from mountnav.sky.coordinates import Air, HourAngle, Icrs, Site
from mountnav.sky.sphere import separation_arcsec
from tests.drivers.indi.real_server import CCD, IndiServer
from tests.drivers.indi.real_sky import GscSky, SkyUnderSyncs

SITE = Site(48.93, 22.27, 700.0)
AIR = Air()
# the simulator's chip has pixels of 5.2 µm, 1280 × 1024: a field of 60′ × 48′
FOCAL_MM = 380.0
POLICY = CenteringPolicy(
    exposure_s=1.0,
    settle_s=0.3,
    scale_arcsec_px=206.264806 * 5.2 / FOCAL_MM,
    tolerance_arcsec=12.0,
    timeout_s=240.0,
    max_tries=5,
)


@pytest.fixture
def target() -> Icrs:
    return hour_angle_to_icrs(HourAngle(-35.0, 42.0, utc_now()), SITE, AIR)


@pytest.fixture
async def rig(tmp_path: Path, target: Icrs) -> AsyncIterator[tuple[Navigator, GscSky, SkyUnderSyncs]]:
    sky = GscSky(tmp_path / "sky", target)
    server = IndiServer(
        ("indi_simulator_telescope", "indi_simulator_ccd"),
        tmp_path / "home",
        sky.environment(os.environ["PATH"]),
    )
    await server.start()
    try:
        await server.set_numbers(CCD, "SCOPE_INFO", FOCAL_LENGTH=FOCAL_MM, APERTURE=80.0)
        base = f"indi://127.0.0.1:{server.port}"
        mount = SkyUnderSyncs(
            open_mount(f"{base}/Telescope%20Simulator?set_site=yes&poll_s=0.25", site=SITE), sky
        )
        camera = open_camera(f"{base}/CCD%20Simulator?mount=Telescope%20Simulator")
        navigator = Navigator(
            equip(
                name="indi",
                mount=mount,
                camera=camera,
                catalog=embedded_catalog(),
                site=SITE,
                air=AIR,
                policy=POLICY,
                listen=lambda kind, data: print(kind, data),
            )
        )
        await navigator.open()
        await mount.set_tracking(True)
        yield navigator, sky, mount
        await navigator.close()
    finally:
        await server.kill()


@pytest.mark.long
async def test_a_mount_behind_indi_is_centered(
    rig: tuple[Navigator, GscSky, SkyUnderSyncs], target: Icrs
) -> None:
    navigator, sky, mount = rig
    sky.point(600.0, -300.0)
    report = await navigator.center(target)
    assert report.outcome is CenterOutcome.CENTERED
    # the judge is not our solver but the program that served the stars
    looked = sky.looked_at()
    print([separation_arcsec(one, target) for one in looked], report)
    assert separation_arcsec(looked[0], target) > 500.0
    assert separation_arcsec(looked[-1], target) < 15.0
    assert mount.syncs >= 1
