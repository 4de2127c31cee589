"""What the tests of ephemerides share: sites, real elements, tables that other people's programs made."""

from __future__ import annotations

from importlib.resources import files

from mountnav.ephemeris.tle import checksum
from mountnav.sky.coordinates import Site

SITE = Site(40.0, -105.0, 1600.0)
GEOCENTER = Site(0.0, 0.0, -6378137.0)
"""The Earth's center, as a site on the equator that deep below it."""

# lines of MPCORB.DAT of five years, as the MPC published them
CERES_2023 = (
    "00001    3.33  0.15 K232P  17.21569   73.47045   80.26013   10.58634  0.0788175  0.21411523   2.7671817"
    "  0 MPO719049  7258 123 1801-2022 0.65 M-v 30l MPCLINUX   0000      (1) Ceres              20220916"
)
CERES_2024 = (
    "00001    3.34  0.15 K243V 102.95074   73.36090   80.25352   10.58760  0.0790273  0.21412733   2.7670775"
    "  0 E2024-C06  7335 124 1801-2023 0.65 M-v 30k MPCLINUX   0000      (1) Ceres              20230618"
)
CERES_2025 = (
    "00001    3.34  0.15 K2555 188.70269   73.27343   80.25221   10.58780  0.0794013  0.21424651   2.7660512"
    "  0 E2024-V47  7330 125 1801-2024 0.80 M-v 30k MPCLINUX   4000      (1) Ceres              20241101"
)
PALLAS_2024 = (
    "00002    4.12  0.15 K243V  83.32723  310.88725  172.91472   34.92284  0.2303399  0.21373952   2.7704235"
    "  0 E2024-DC2  8902 123 1804-2024 0.59 M-c 28k MPCLINUX   0000      (2) Pallas             20240223"
)
HALLEY = (
    "0001P         2061 08 31.8266  0.583972  0.967311  112.5470   59.6368  162.2146  20250501   4.0  6.0"
    "  1P/Halley                                                 98, 1083"
)
HOWELL = (
    "0088P         2020 09 26.6239  1.353073  0.564333  235.9158   56.6855    4.3838  20200724  11.0  6.0"
    "  88P/Howell                                               MPEC 2019-JE2"
)


def astroquery_file(package: str, name: str) -> str:
    """An answer of JPL or the MPC that astroquery keeps for its own tests."""
    return (files("astroquery") / package / "tests" / "data" / name).read_text(encoding="utf-8")


def with_checksum(line: str) -> str:
    """A line of elements with its last digit right."""
    return line.ljust(68)[:68] + str(checksum(line.ljust(68)))


ISS_1 = with_checksum("1 25544U 98067A   24170.53020833  .00016717  00000-0  30000-3 0  999")
ISS_2 = with_checksum("2 25544  51.6400 208.9163 0006317  69.9862 290.2231 15.4981557145")
ISS = f"ISS (ZARYA)\n{ISS_1}\n{ISS_2}\n"
