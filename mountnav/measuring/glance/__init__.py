"""A glance at a frame: its brightest sources roughly, fast, and precise fits only where they are wanted."""

from mountnav.measuring.glance.looking import glance
from mountnav.measuring.glance.seen import Glance

__all__ = ["Glance", "glance"]
