"""From the settings to a navigator: limits, policies, pointing model, all as the operator wrote them."""

from __future__ import annotations

from dataclasses import replace

from api.solver.solve_settings import solve_settings
from mountnav.catalog.stars import Catalog
from mountnav.clock import Clock
from mountnav.devices import Camera, Mount, Rotator
from mountnav.journal.records import Journal
from mountnav.mount import Deadman
from mountnav.navigation.equipment import Listener, Solve, equip
from mountnav.navigation.learned import Learned
from mountnav.navigation.navigator import Navigator
from mountnav.navigation.policy import CenteringPolicy
from mountnav.pointing.limits import Limits
from mountnav.settings.observatory import Settings
from mountnav.settings.telescope import SimulatedCameraSettings, TelescopeSettings

_OF_THE_SUN = ("sun_cone_deg", "daylight")


def make_navigator(
    one: TelescopeSettings,
    settings: Settings,
    *,
    mount: Mount,
    camera: Camera,
    catalog: Catalog,
    solve: Solve | None,
    listen: Listener,
    journal: Journal,
    clock: Clock | None = None,
    dead_man: Deadman | None = None,
    rotator: Rotator | None = None,
) -> Navigator:
    """Put a telescope's navigator together.

    Parameters
    ----------
    settings : Settings
        Of the whole service, for site, air and solving.
    mount : Mount
        The driver; from now on only the navigator may use it.
    dead_man : Deadman, optional
        Who ends what goes on by itself at the mount when the service is dead.
    rotator : Rotator, optional
        The driver of what turns the camera; from now on only the navigator may use it.

    Raises
    ------
    BadSettings, ModelRefused
        The pointing model can't be read, or is for another kind of mount.
    """
    mounting = one.mount.mounting
    return Navigator(
        equip(
            name=one.id,
            mount=mount,
            camera=camera,
            catalog=catalog,
            site=settings.site.site,
            air=settings.air.air,
            policy=centering_policy(one),
            listen=listen,
            solving=solve_settings(settings.solving, calibration=one.calibration),
            solve=solve,
            limits=limits_of(one),
            sync=one.sync.policy,
            journal=journal,
            clock=clock,
            pointing=one.model.pointing(
                site=settings.site.site,
                air=settings.air.air,
                mounting=mounting,
                resolution_arcsec=mount.resolution_arcsec,
            ),
            apply_model=one.model.apply,
            learned=Learned(mounting=mounting, policy=one.sync.policy),
            mounting=mounting,
            following=one.following.policy,
            dead_man=dead_man,
            points=tuple(point.point for point in one.point),
            rotator=rotator,
            rotator_rules=None if one.rotator is None else one.rotator.rules,
        )
    )


def limits_of(one: TelescopeSettings) -> Limits:
    """The telescope's limits. The Sun harms no fake: there it counts only if the settings speak of it."""
    limits = one.limits.limits
    if one.mount.is_fake and not one.limits.model_fields_set.intersection(_OF_THE_SUN):
        return replace(limits, sun_cone_deg=0.0, daylight="allow")
    return limits


def centering_policy(one: TelescopeSettings) -> CenteringPolicy:
    """How the telescope is centered; the scale is the simulated camera's own where nothing else is set."""
    scale_arcsec_px = one.scale_arcsec_px
    if scale_arcsec_px is None and isinstance(one.camera, SimulatedCameraSettings):
        scale_arcsec_px = one.camera.scale_arcsec_px
    return one.centering.policy(
        exposure_s=one.exposure_s,
        scale_arcsec_px=scale_arcsec_px,
        scale_tolerance=one.scale_tolerance,
        min_altitude_deg=one.limits.min_altitude_deg,
    )
