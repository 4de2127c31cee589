"""GET /v1/capabilities: what this service can do, for programs that want to know before they try."""

from __future__ import annotations

from fastapi import APIRouter, Request

from api.access.callers import Role
from api.access.security import TheCaller
from api.http.routes.health import listener_views
from api.http.service_views import CapabilitiesView, DoorView, KindView, TelescopeSkillsView
from api.observatory.virtual import virtual_view
from api.orders.vocabulary import KINDS, ModelRunOrder
from api.problems import SLUGS, responses
from api.service import TheService
from mountnav import __version__

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
        targets=["icrs", "apparent", "altaz", "name"],
        telescopes=[
            TelescopeSkillsView(
                id=telescope.id,
                mount=telescope.mount_address,
                mounting=telescope.navigator.mount.mounting,
                frame="icrs" if telescope.navigator.mount.epoch == "icrs" else "jnow-apparent",
                skills=sorted(str(skill) for skill in telescope.navigator.mount.skills),
                nights=telescope.id in nights,
            )
            for telescope in service.dispatcher.telescopes
        ],
        faces={"http": http, "alpaca": alpaca, **listener_views(service)},
        roles=[str(role) for role in Role],
        your_role=str(caller.role),
        problems=sorted(SLUGS),
        virtual=virtual_view(),
    )
