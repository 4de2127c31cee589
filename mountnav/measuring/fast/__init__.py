"""The fast measurement: a frame's brightest sources roughly, and precise fits only where asked for."""

from mountnav.measuring.fast.measure import FastMeasurement, measure_fast

__all__ = ["FastMeasurement", "measure_fast"]
