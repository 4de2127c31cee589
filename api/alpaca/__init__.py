"""ASCOM Alpaca: each telescope as an ITelescopeV4, with management, discovery and setup pages."""

from api.alpaca.discovery import Discovery
from api.alpaca.server import alpaca_app, alpaca_routes

__all__ = ["Discovery", "alpaca_app", "alpaca_routes"]
