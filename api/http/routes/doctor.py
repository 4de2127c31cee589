"""GET /v1/telescopes/{id}/doctor: whether a telescope is fit for the night, told before it begins."""

from __future__ import annotations

import asyncio
from collections.abc import Hashable
from dataclasses import dataclass, field
from typing import Annotated

from fastapi import APIRouter, Depends, Request

from api.http.doctor_record import DoctorRecord, doctor_record
from api.problems import responses
from api.service import TheService, TheTelescope
from mountnav.catalog.doctor.cameras import camera_facts
from mountnav.catalog.doctor.counts import Reach
from mountnav.catalog.doctor.diagnosis import (
    CameraFacts,
    Diagnosis,
    NamedCatalog,
    diagnose,
    julian_year_now,
    named_catalogs,
    reach_of,
)
from mountnav.settings.described_cameras import described_camera

router = APIRouter(prefix="/telescopes", tags=["telescopes"])

_KEPT = 64
"""Diagnoses that are kept, of what was asked last; chosen by hand. Halved, more are made again."""


@dataclass(slots=True)
class _Doctor:
    """What was found, as long as the service lives: the same camera and catalogs are looked at once."""

    found: dict[Hashable, Diagnosis] = field(default_factory=dict)
    # one at a time: a second of CPU each, and nobody is in a hurry
    turn: asyncio.Lock = field(default_factory=asyncio.Lock)

    async def diagnosis(
        self, camera: CameraFacts, reach: Reach, stores: tuple[NamedCatalog, ...], epoch_yr: float
    ) -> Diagnosis:
        """Look it up, or count the stars in a thread."""
        key = (camera, reach, tuple((store.slug, store.catalog.name, id(store.catalog)) for store in stores))
        async with self.turn:
            if key not in self.found:
                while len(self.found) >= _KEPT:
                    del self.found[next(iter(self.found))]
                self.found[key] = await asyncio.to_thread(diagnose, camera, reach, stores, epoch_yr=epoch_yr)
            return self.found[key]


async def _doctor(request: Request) -> _Doctor:
    state = request.app.state
    if not hasattr(state, "doctor"):
        state.doctor = _Doctor()
    doctor: _Doctor = state.doctor
    return doctor


@router.get("/{telescope_id}/doctor", responses=responses(404))
async def doctor_telescope(
    service: TheService, telescope: TheTelescope, doctor: Annotated[_Doctor, Depends(_doctor)]
) -> DoctorRecord:
    """Before the night: stars in a frame of this camera over the sky, whether they suffice, what would help.

    The first time it takes a second or two for each catalog on the machine; nothing is moved or exposed.
    """
    settings = service.settings
    one = next(one for one in settings.telescope if one.id == telescope.id)
    reach = reach_of(settings.site.latitude_deg, one.limits.min_altitude_deg)
    camera = await asyncio.to_thread(camera_facts, described_camera(one))
    found = await doctor.diagnosis(camera, reach, named_catalogs(service.catalog), julian_year_now())
    return doctor_record(found, [online.name for online in settings.catalogs.online])
