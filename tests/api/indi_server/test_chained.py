"""INDI's own programs and our server: a stock `indiserver` chains it, `indi_setprop` orders, a CCD snoops."""

from __future__ import annotations

import asyncio
import os
import shutil
import sys
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
import pytest_asyncio

from api.indi_server.server import IndiServer
from api.service import Service
from drivers.indi.codec import messages
from drivers.registry import open_camera
from mountnav.clock import utc_now
from mountnav.sky.chain import apparent_to_icrs
from mountnav.sky.coordinates import Apparent
from mountnav.sky.sphere import separation_arcsec
from tests.api.indi_server.face_rig import OBSERVATORY, apart_arcsec, indi_observatory, mechanics_of, up_now
from tests.drivers.indi.real_server import CCD
from tests.drivers.indi.real_server import IndiServer as StockServer
from tests.drivers.indi.real_sky import GscSky
from tests.waiting import until

pytestmark = pytest.mark.asyncio(loop_scope="module")
Rig = tuple[Service, IndiServer, StockServer]
NAME = "East of two"
EOD = "EQUATORIAL_EOD_COORD"


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def rig(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[tuple[Rig, GscSky]]:
    folder = tmp_path_factory.mktemp("chained")
    for program in ("indiserver", "indi_simulator_ccd", "indi_getprop", "indi_setprop"):
        if shutil.which(program) is None:
            pytest.skip(f"{program} is not installed: it comes with the package indi-bin")
    named = OBSERVATORY.replace(
        'id = "east"', f'id = "east"\nname = "{NAME}"\nfocal_length_mm = 380.0\naperture_mm = 80.0'
    )
    async with indi_observatory(folder, named) as (service, ours):
        sky = GscSky(folder / "sky", apparent_to_icrs(Apparent(*_place(), utc_now())))
        host, port = ours.address
        stock = StockServer((), folder / "home", sky.environment(os.environ["PATH"]))
        stock.drivers = (f"{NAME}@{host}:{port}", "indi_simulator_ccd")
        await start(stock)
        try:
            yield (service, ours, stock), sky
        finally:
            await stock.kill()


def _place() -> tuple[float, float]:
    there = up_now(2.0, 45.0)
    return there.ra_deg, there.dec_deg


_EXPOSURES = 20
"""Within so many of half a second the simulator has heard of the mount."""


async def start(stock: StockServer) -> None:
    """Run it though its first driver is no program but a remote device."""
    which = shutil.which
    try:
        shutil.which = lambda name, *rest, **more: name if "@" in name else which(name, *rest, **more)  # type: ignore[assignment]
        await stock.start()
    finally:
        shutil.which = which


async def run(*command: str) -> str:
    """What a program says."""
    process = await asyncio.create_subprocess_exec(
        *command, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.STDOUT
    )
    said, _ = await asyncio.wait_for(process.communicate(), 60.0)
    return said.decode()


@pytest.mark.long
async def test_indis_own_client_reads_and_orders_through_a_stock_server(rig: tuple[Rig, GscSky]) -> None:
    (service, _, stock), _ = rig
    at = ("-h", "127.0.0.1", "-p", str(stock.port))
    read = await run("indi_getprop", *at, "-t", "20", f"{NAME}.GEOGRAPHIC_COORD.LAT")
    assert read.strip() == f"{NAME}.GEOGRAPHIC_COORD.LAT=47.0000000000"
    there = up_now(2.0, 45.0)
    await run("indi_setprop", *at, f"{NAME}.ON_COORD_SET.TRACK=On")
    await run("indi_setprop", *at, "-n", f"{NAME}.{EOD}.RA;DEC={there.ra_deg / 15.0:.9f};{there.dec_deg:.9f}")
    await until(lambda: any(job.kind == "slew" for job in service.jobs.all()), "ordered")
    job = service.jobs.all()[0]
    await job.ended.wait()
    assert job.state == "succeeded", job.problem
    assert apart_arcsec(mechanics_of(service).reported(utc_now()), there) < 3.0
    state = await run("indi_getprop", *at, "-1", "-t", "20", f"{NAME}.{EOD}._STATE")
    assert state.strip() == "Ok"


@pytest.mark.long
async def test_a_stock_server_chains_all_our_devices_without_their_names(
    rig: tuple[Rig, GscSky], tmp_path: Path
) -> None:
    """It asks for ``*`` once, and for a device's properties only when it has heard of that device."""
    (_, ours, _), _ = rig
    host, port = ours.address
    stock = StockServer((f"@{host}:{port}",), tmp_path / "home")
    await start(stock)
    try:
        question = ("-h", "127.0.0.1", "-p", str(stock.port), "-t", "20", f"{NAME}.GEOGRAPHIC_COORD.LAT")
        read = await run("indi_getprop", *question)
        assert read.strip() == f"{NAME}.GEOGRAPHIC_COORD.LAT=47.0000000000"
    finally:
        await stock.kill()


@pytest.mark.long
async def test_indi_setprop_chooses_sync_and_sends_the_place_with_the_next_call(
    rig: tuple[Rig, GscSky],
) -> None:
    (service, ours, _), _ = rig
    host, port = ours.address
    job = service.jobs.running_on("east")
    if job is not None:
        await job.ended.wait()
    here, jobs = mechanics_of(service).reported(utc_now()), len(service.jobs.all())
    order = ("indi_setprop", "-h", host, "-p", str(port))
    await run(*order, f"{NAME}.ON_COORD_SET.SYNC=On")
    await run(*order, "-n", f"{NAME}.{EOD}.RA;DEC={here.ra_deg / 15.0:.9f};{here.dec_deg - 0.1:.9f}")
    await until(lambda: len(service.jobs.all()) > jobs, "ordered")
    job = service.jobs.all()[0]
    await job.ended.wait()
    assert (job.kind, job.state) == ("sync-to", "succeeded")


@pytest.mark.long
async def test_the_real_ccd_simulator_snoops_and_draws_where_the_mount_points(
    rig: tuple[Rig, GscSky],
) -> None:
    (service, _, stock), sky = rig
    camera = open_camera(
        f"indi://127.0.0.1:{stock.port}/{CCD.replace(' ', '%20')}?mount={NAME.replace(' ', '%20')}"
    )
    await camera.open()
    try:
        # it draws the zero point of the sky until the first place has come to it
        for _ in range(_EXPOSURES):
            frame = await camera.expose(0.5)
            if abs(sky.looked_at()[-1].dec_deg) > 1.0:
                break
    finally:
        await camera.close()
    reported = mechanics_of(service).reported(utc_now())
    assert isinstance(reported, Apparent)
    # the judge is the program that served the stars: INDI's own, asked by the simulator, J2000
    assert separation_arcsec(sky.looked_at()[-1], apparent_to_icrs(reported)) < 40.0
    # and the frame's scale is that of the telescope's focal length: it was snooped too
    header = frame.header
    assert float(header["FOCALLEN"]) == pytest.approx(380.0)


@pytest.mark.long
async def test_a_stock_server_runs_us_as_a_driver(rig: tuple[Rig, GscSky], tmp_path: Path) -> None:
    (service, ours, _), _ = rig
    host, port = ours.address
    driver = tmp_path / "mountnav_driver"
    driver.write_text(
        f"#!{sys.executable}\nimport sys\nfrom api.indi_server.relay import relay\n"
        f"sys.exit(relay('{host}', {port}))\n"
    )
    driver.chmod(0o755)
    root = str(Path(__file__).resolve().parents[3])
    stock = StockServer((str(driver),), tmp_path / "home", {"PYTHONPATH": root})
    await stock.start()
    try:
        device = stock.device(NAME)
        await device.bring_up(may_connect=True, needed=(EOD,))
        await device.set_switches("ON_COORD_SET", {"TRACK": False, "SLEW": True, "SYNC": False})
        device.client.send(messages.new_switches(NAME, "TELESCOPE_ABORT_MOTION", {"ABORT": True}))
        await until(lambda: any("stopped" in words for words in device.words_since(0)), "stopped")
        assert service.jobs.running_on("east") is None
        await device.client.close()
    finally:
        await stock.kill()
