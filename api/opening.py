"""Which doors a service has besides HTTP, by its settings."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from api.listeners import Door, Doors

if TYPE_CHECKING:
    from api.service import Service


def doors_of(service: Service, http_address: tuple[str, int] | None) -> Doors:
    """Make the doors of a service; none is open yet.

    Parameters
    ----------
    service : Service
    http_address : (str, int) or None
        Where HTTP is served, for discovery; None where no socket stands behind the application.
    """
    settings = service.settings
    made: dict[str, Callable[[], Door]] = {}
    # each protocol's code is loaded only where its door is wanted
    if settings.indi_server.enabled:
        made["indi"] = lambda: _indi(service)
    if settings.lx200_server.enabled:
        made["lx200"] = lambda: _lx200(service)
    if settings.stellarium.enabled:
        made["stellarium"] = lambda: _stellarium(service)
    if http_address is not None and settings.alpaca.enabled and settings.alpaca.discovery:
        made["alpaca-discovery"] = lambda: _discovery(service, http_address)
    return Doors(made)


def _indi(service: Service) -> Door:
    from api.indi_server.server import IndiServer

    return IndiServer(service, service.settings.indi_server)


def _lx200(service: Service) -> Door:
    from api.planetarium.lx200_server import Lx200Server

    return Lx200Server(service, service.settings.lx200_server)


def _stellarium(service: Service) -> Door:
    from api.planetarium.stellarium_server import StellariumServer

    return StellariumServer(service, service.settings.stellarium)


def _discovery(service: Service, http_address: tuple[str, int]) -> Door:
    from api.alpaca.discovery import Discovery

    return Discovery(service.settings.alpaca, http_address)


__all__ = ["doors_of"]
