"""GET /v1/capabilities: what this service can do, for programs that want to know before they try."""

from __future__ import annotations

from typing import get_args

from fastapi import APIRouter, Request

from api.access.callers import Role
from api.access.security import TheCaller
from api.http.routes.health import listener_views
from api.http.service_views import CapabilitiesView, DoorView, KindView, TelescopeSkillsView
from api.observatory.virtual import virtual_view
from api.orders.kept_motions import ladder
from api.orders.targets import AnyTarget
from api.orders.vocabulary import KINDS, ModelRunOrder
from api.problems import SLUGS, responses
from api.service import TheService
from mountnav import __version__
from mountnav.mount import CheckedMount

router = APIRouter(tags=["service"])


@router.get("/capabilities", responses=responses())
async def get_capabilities(request: Request, service: TheService, caller: TheCaller) -> CapabilitiesView:
    """Kinds of jobs, skills of telescopes, faces with their ports, roles, problems. Asks no device."""
    nights = {telescope.id for telescope in service.settings.telescope if telescope.night.enabled}
    host, port = getattr(request.app.state, "http_address", None) or (None, None)
    http = DoorView(enabled=True, host=host, port=port)
    alpaca = DoorView(enabled=service.settings.alpaca.enabled, host=host, port=port)
    return CapabilitiesView(
        version=__version__,
        kinds=[
            KindView(
                kind=kind,
                body=body.__name__,
                moves=body.moves,
                role="configure" if body.overrules else "operate",
                what=(body.__doc__ or "").partition("\n")[0]
                + (" To put it in force needs configure." if body is ModelRunOrder else ""),
            )
            for kind, body in KINDS.items()
        ],
        targets=[kind.model_fields["kind"].default for kind in get_args(AnyTarget)],
        telescopes=[
            TelescopeSkillsView(
                id=telescope.id,
                mount=telescope.mount_address,
                mounting=telescope.navigator.mount.mounting,
                frame="icrs" if telescope.navigator.mount.epoch == "icrs" else "jnow-apparent",
                skills=sorted(str(skill) for skill in telescope.navigator.mount.skills),
                nights=telescope.id in nights,
                axis_speeds_deg_s=_speeds(telescope.navigator.mount),
                most_offset_arcsec_s=_most_offset(telescope.navigator.mount),
            )
            for telescope in service.dispatcher.telescopes
            if caller.reaches(telescope.id)
        ],
        faces={"http": http, "alpaca": alpaca, **listener_views(service)},
        roles=[str(role) for role in Role],
        your_role=str(caller.role),
        your_telescopes=None if caller.telescopes is None else sorted(caller.telescopes),
        your_key_ends_utc=caller.key_ends_utc,
        problems=sorted(SLUGS),
        virtual=virtual_view(),
    )


def _speeds(mount: CheckedMount) -> dict[str, list[float]]:
    most_deg_s = mount.following_policy.most_axis_deg_s
    return {axis: list(ladder(spans, most_deg_s)) for axis, spans in mount.axis_rates_deg_s.items()}


def _most_offset(mount: CheckedMount) -> list[float] | None:
    most = mount.most_offset_arcsec_s
    return None if most is None else [most.ra_arcsec_s, most.dec_arcsec_s]
