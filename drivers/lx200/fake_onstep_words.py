"""What OnStep says of itself without thinking: the questions that INDI's driver asks twenty times a second.

Shapes as its source has them [ONSTEP], of a controller without focuser, rotator, weather and features.
"""

from __future__ import annotations

STANDING: dict[str, bytes] = {
    "GVP": b"On-Step#",
    "GVN": b"10.28b#",
    "GVD": b"Jul 14 2026#",
    "GVT": b"07:36:40#",
    "GVM": b"On-Step 10.28b#",
    # focusers, rotator, auxiliary features: none
    "FA": b"0",
    "fA": b"0",
    **{f"F{number}A": b"0" for number in range(1, 10)},
    "GX98": b"N#",
    "GXY0": b"00000000#",
    # backlash (arcsec), pulse guide rate, automatic flip, preferred side, meridian limits (min)
    "%BD": b"0#",
    "%BR": b"0#",
    "GX90": b"0.50#",
    "GX95": b"0#",
    "GX96": b"B#",
    "GXE9": b"60#",
    "GXEA": b"60#",
    # temperature, pressure, humidity, dew point, its own temperature
    "GX9A": b"10.0#",
    "GX9B": b"1013.2#",
    "GX9C": b"50.0#",
    "GX9E": b"0.1#",
    "GX9F": b"35.0#",
    # drivers of the two motors: no flag up
    "GXU1": b"#",
    "GXU2": b"#",
    # six alignment stars at most, none in progress; altitude and azimuth of the polar axis
    "A?": b"600#",
    "GX02": b"0#",
    "GX03": b"0#",
    "$QZ?": b"I#",
    "Gc": b"24#",
    "GM": b"None#",
    "GN": b"None#",
    "GO": b"None#",
    "GP": b"None#",
    "W?": b"0#",
    "h?": b"0,0,0#",
}
"""Words and their answers."""

SILENT: frozenset[str] = frozenset({"U", "B+", "B-", "$QZ+", "$QZ-", "$QZ/", "$QZZ", "$QZ!"})
"""Words that are taken without an answer and change nothing here."""

TAKEN: frozenset[str] = frozenset(
    {"Tr", "Tn", "To", "T1", "T2", "SX95,0", "SX95,1", "SX96,E", "SX96,W", "SX96,B"}
)
"""Words that are answered by a bare 1 and change nothing here."""
