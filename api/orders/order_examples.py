"""Examples of orders, as the API's description shows them."""

from __future__ import annotations

from typing import Any


def _example(summary: str, **value: Any) -> dict[str, Any]:
    return {"summary": summary, "value": value}


def _kind(kind: str, summary: str, **value: Any) -> dict[str, Any]:
    return _example(summary, kind=kind, **value)


_BARNARD = {
    "kind": "icrs",
    "ra_deg": 269.452,
    "dec_deg": 4.693,
    "pm_ra_cosdec_masyr": -798.6,
    "pm_dec_masyr": 10328.1,
    "parallax_mas": 548.3,
    "epoch_yr": 2000.0,
}

JOB_EXAMPLES: dict[str, Any] = {
    "center": _kind(
        "center",
        "Center an object by its name",
        target={"kind": "name", "name": "M31"},
        tolerance_arcsec=20.0,
    ),
    "slew": _kind("slew", "Go to a star that moves", target=_BARNARD),
    "slew-apparent": _kind(
        "slew", "Go to a place of date", target={"kind": "apparent", "ra_deg": 83.9, "dec_deg": -5.4}
    ),
    "slew-altaz": _kind(
        "slew", "Go to a direction", target={"kind": "altaz", "alt_deg": 60.0, "az_deg": 170.0}
    ),
    "look": _kind("look", "Where does it truly point?", exposure_s=2.0),
    "sync": _kind("sync", "Look, and tell the mount"),
    "solve": _kind("solve", "Expose and solve", exposure_s=2.0),
    "series": _kind("series", "Twenty looks, one a minute: the drift", looks=20, every_s=60.0),
    "model-run": _kind("model-run", "A pointing model of thirty points", points=30),
    "tracking": _kind("tracking", "Follow the Moon", on=True, rate="lunar"),
    "park": _kind("park", "Park"),
    "home": _kind("home", "Go home"),
    "unpark": _kind("unpark", "Be ready to move again"),
}

PLACE_EXAMPLES: dict[str, Any] = {
    "icrs": _example("A place in the ICRS", ra_deg=10.6847, dec_deg=41.2688),
    "apparent": _example("A place of date", ra_deg=11.05, dec_deg=41.41, frame="jnow-apparent"),
    "target": _example("A target", target={"kind": "name", "name": "Vega"}),
}


__all__ = ["JOB_EXAMPLES", "PLACE_EXAMPLES"]
