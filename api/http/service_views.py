"""What the service says of itself: health, version, what it can do, its stops, and whether it is ready.

No device is asked.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Literal

from pydantic import BaseModel, Field

from api.observatory.virtual import VirtualView
from api.orders.results import Finite
from api.service import Service
from mountnav.sky.iers import iers_status

__all__ = [
    "AcknowledgedView",
    "CapabilitiesView",
    "DoorView",
    "EarthRotationView",
    "HealthView",
    "KindView",
    "LiveView",
    "Readiness",
    "ReadyView",
    "StopAllView",
    "StopView",
    "StoppedView",
    "TelescopeSkillsView",
    "VersionView",
    "readiness",
]


class StopView(BaseModel):
    """A stop that was given."""

    telescope: str
    stopped: Literal[True] | None = Field(
        default=True,
        description="true: it was sent. null (202): not known yet; the event `stop-settled` tells",
    )
    cancelled_job_id: str | None


class StoppedView(BaseModel):
    """What came of stopping one of all telescopes."""

    telescope: str
    stopped: bool | None = Field(
        description="Whether the stop was sent; null: not known yet, the event `stop-settled` tells"
    )
    cancelled_job_id: str | None = None
    problem: str | None = Field(default=None, description="Why it could not be sent")


class StopAllView(BaseModel):
    """What came of stopping all telescopes."""

    stopped: bool | None = Field(
        description="Whether the stop was sent to each telescope; null: of one or more it is not known yet"
    )
    telescopes: list[StoppedView]


class AcknowledgedView(BaseModel):
    """A notice that an operator has seen."""

    telescope: str
    notice: str | None = Field(description="What it was; null if there was none")


class EarthRotationView(BaseModel):
    """What the bundled table of Earth rotation knows, and for how long."""

    dut1_s: Finite
    dut1_overridden: bool
    table_ends_utc: datetime
    table_days_left: Finite
    warning: str | None


class DoorView(BaseModel):
    """A door for other programs."""

    enabled: bool
    host: str | None = Field(default=None, description="null while it is shut")
    port: int | None = None
    problem: str | None = Field(default=None, description="Why it could not be opened")


class LiveView(BaseModel):
    """That the service lives."""

    live: Literal[True] = True
    version: str


class ReadyView(BaseModel):
    """That orders are taken and can be carried out."""

    ready: Literal[True] = True
    concerns: list[str] = Field(description="What an operator should look into all the same")


class HealthView(BaseModel):
    """That the service lives, whether it is ready, and if not, why not."""

    status: Literal["ok", "degraded"]
    live: Literal[True] = True
    ready: bool = Field(description="Whether orders are taken and can be carried out")
    why_not: list[str] = Field(description="Why it is not ready")
    concerns: list[str] = Field(description="What is wrong besides: why it is degraded")
    version: str
    telescopes: dict[str, bool]
    solver: str = Field(
        description='"starting", "ready", "solving", "failed: ..." (why); "in this process" without a worker'
    )
    solver_engine: str = Field(
        default="process",
        description='Where frames are solved: "process", "pool: 2 of 4 processes, 0 frames wait", or '
        '"dask: 3 workers"; "dask: away: ..." (why) while the service solves them itself',
    )
    journal: str = Field(default="ok", description='"ok", or why nothing can be written down just now')
    blind_index: str = Field(description='"ready", "building 40 %", or "none: ..." (why)')
    earth_rotation: EarthRotationView
    doors: dict[str, DoorView] = Field(
        default_factory=dict, description="alpaca-discovery, indi, lx200, stellarium, solver-commands"
    )
    virtual: VirtualView | None = Field(
        default=None, description="In a virtual observatory: its time and speed; null under the real sky"
    )


class VersionView(BaseModel):
    """What runs here."""

    name: str
    version: str


class KindView(BaseModel):
    """A kind of job that telescopes take."""

    kind: str
    body: str = Field(description="Name of its body's schema in openapi.json")
    moves: bool = Field(description="Whether it slews the mount")
    role: Literal["view", "operate", "configure"] = Field(description="What a key needs for it")
    what: str


class TelescopeSkillsView(BaseModel):
    """What a telescope is and can do."""

    id: str
    mount: str
    mounting: str | None
    frame: Literal["icrs", "jnow-apparent"] = Field(description="The mount's own")
    skills: list[str] = Field(description="Besides slew, sync, stop and reading; known once it was connected")
    nights: bool = Field(description="Whether it has nights")
    axis_speeds_deg_s: dict[str, list[float]] = Field(
        default_factory=dict,
        description="Four speeds at which each axis can be moved by hand, slow to fast; none where it can't",
    )
    most_offset_arcsec_s: list[float] | None = Field(
        default=None,
        description="Largest rates beside the sidereal one, RA and Dec; null where it isn't told",
    )


class CapabilitiesView(BaseModel):
    """What this service can do, for programs that want to know before they try."""

    name: Literal["mountnav"] = "mountnav"
    version: str
    api: Literal["v1"] = "v1"
    kinds: list[KindView]
    targets: list[str] = Field(description="Kinds of targets")
    telescopes: list[TelescopeSkillsView]
    faces: dict[str, DoorView] = Field(description="http and the doors for other programs, with their ports")
    roles: list[str] = Field(description="Each includes those before it")
    your_role: str
    your_telescopes: list[str] | None = Field(
        default=None, description="Those that your key is for; null: all of the service"
    )
    your_key_ends_utc: datetime | None = Field(default=None, description="null: it has no end")
    problems: list[str] = Field(description="Slugs of all problems that may be answered")
    virtual: VirtualView | None = None


@dataclass(frozen=True, slots=True)
class Readiness:
    """What stands against taking orders, and what else is wrong.

    Attributes
    ----------
    why_not : tuple of str
        Nothing: it is ready.
    concerns : tuple of str
        What an operator should look into besides.
    """

    why_not: tuple[str, ...]
    concerns: tuple[str, ...]

    @property
    def ready(self) -> bool:
        """Whether orders are taken and can be carried out."""
        return not self.why_not

    @property
    def well(self) -> bool:
        """Whether there is nothing to look into."""
        return not self.why_not and not self.concerns


def readiness(service: Service) -> Readiness:
    """Look at what is known."""
    why_not: list[str] = []
    concerns: list[str] = []
    if (problem := service.restored.problem) is not None:
        why_not.append(f"journal: {problem}")
    solver = service.solver.state
    if solver.startswith("failed"):
        why_not.append(f"solver: {solver}")
    elif solver == "starting":
        why_not.append("solver: it is starting")
    if (concern := service.solver.concern) is not None:
        concerns.append(f"solver: {concern}")
    telescopes = service.observatory.telescopes
    missing = [telescope for telescope in telescopes if not telescope.is_open]
    # one of several that is missing costs the others nothing
    to = why_not if telescopes and len(missing) == len(telescopes) else concerns
    to.extend(
        f"{telescope.id}: not connected" + (f": {telescope.problem}" if telescope.problem else "")
        for telescope in missing
    )
    told = {
        telescope.id: telescope.problem or telescope.restart.fault
        for telescope in telescopes
        if telescope.is_open
    }
    concerns.extend(f"{one}: {words}" for one, words in told.items() if words)
    for one in telescopes:
        if one.is_open and (words := one.navigator.mount.contradiction) is not None:
            concerns.append(f"{one.id}: mount and settings contradict each other, nothing is slewed: {words}")
    if service.mornings is not None:
        concerns.extend(service.mornings.failed.values())
    if service.keys is not None:
        concerns.extend(service.keys.concerns())
    warning = iers_status().warning
    if warning is not None:
        concerns.append(f"Earth rotation: {warning}")
    if service.solver.blind_index.failed:
        concerns.append(f"blind index: {service.solver.blind_index.state}")
    for name, listener in service.listeners.states.items():
        if listener.problem is not None:
            concerns.append(f"{name}: {listener.problem}")
    return Readiness(tuple(why_not), tuple(concerns))
