"""What memory a frame of 60 megapixels takes to read, in units of its pixels in single precision."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits

SIDES = (6336, 9576)
SINGLE_MB = SIDES[0] * SIDES[1] * 4 / 2**20

# VmHWM is the reader's own; ru_maxrss would begin with what this process had when it started the other
READER = """
import sys
from pathlib import Path
from mountnav.reading import read_frame
def peak_kb():
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM"))
before = peak_kb()
frame = read_frame(Path(sys.argv[1]))
print(peak_kb() - before, frame.pixels.dtype)
"""


@pytest.mark.long
@pytest.mark.skipif(sys.platform != "linux", reason="the peak is read from /proc")
@pytest.mark.parametrize(
    ("kind", "least", "most"),
    [
        ("uint16", 0.48, 0.6),  # the pixels, and some rows of the file
        ("mosaic", 1.4, 1.9),  # the mosaic and its smooth frame of floats
        ("float32", 0.95, 1.2),
        ("tiled", 0.9, 1.9),  # what astropy unpacks, and the pixels
        ("color", 0.95, 1.2),  # one plane of floats, however many the file has
    ],
)
def test_peak_memory(kind: str, least: float, most: float, tmp_path: Path) -> None:
    data = np.random.default_rng(0).integers(900, 1100, SIDES).astype(np.uint16)
    if kind == "mosaic":
        data[::2, ::2] -= 400
        data[1::2, 1::2] -= 200
    if kind == "float32":
        data = data.astype(np.float32)
    if kind == "color":
        data = np.stack([data, data, data])
    file = tmp_path / "large.fits"
    hdus = [fits.PrimaryHDU(), fits.CompImageHDU(data)] if kind == "tiled" else [fits.PrimaryHDU(data)]
    fits.HDUList(hdus).writeto(file)
    told = subprocess.run(
        [sys.executable, "-c", READER, str(file)], capture_output=True, text=True, check=True
    ).stdout.split()
    peak_mb = int(told[0]) / 1024
    print(f"| {kind} | {told[1]} | {peak_mb:.0f} MB | {peak_mb / SINGLE_MB:.2f} |")
    assert least * SINGLE_MB < peak_mb < most * SINGLE_MB
    assert told[1] == ("uint16" if kind in ("uint16", "tiled") else "float32")
    file.unlink()
