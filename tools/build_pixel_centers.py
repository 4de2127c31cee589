"""Write the table of HEALPix pixel centers: python tools/build_pixel_centers.py."""

from __future__ import annotations

import hashlib

import numpy as np

from mountnav.catalog.packed.pixels import TABLE_NSIDE, TABLE_PATH, computed_centers


def main() -> None:
    np.save(TABLE_PATH, computed_centers(TABLE_NSIDE), allow_pickle=False)
    content = TABLE_PATH.read_bytes()
    print(f"{TABLE_PATH}: {len(content)} bytes, sha256 {hashlib.sha256(content).hexdigest()}")


if __name__ == "__main__":
    main()
