"""Stands in for the `gsc` program that INDI's CCD simulator asks for stars, once per exposure.

Called as ``gsc -c RA +DEC -r ARCMIN -m 0 MAG -n 3000`` (degrees, J2000). It must start fast, so it imports
nothing but the standard library's smallest and reads stars that a test has put into $GSC_FOLDER/stars, one
"ra dec mag" a line. $GSC_FOLDER/pointing holds "east north": by how many seconds of arc the telescope truly
looks beside where it says it does. Each call is noted in $GSC_FOLDER/calls: what was asked, where it looked.
"""

import os
import sys
from math import asin, atan2, cos, degrees, hypot, radians, sin, sqrt


def displaced(ra_deg, dec_deg, east_arcsec, north_arcsec):
    """A place beside a place, on the great circle."""
    distance = radians(hypot(east_arcsec, north_arcsec) / 3600.0)
    angle = atan2(east_arcsec, north_arcsec)
    dec = radians(dec_deg)
    dec_there = asin(sin(dec) * cos(distance) + cos(dec) * sin(distance) * cos(angle))
    ra_there = atan2(sin(angle) * sin(distance) * cos(dec), cos(distance) - sin(dec) * sin(dec_there))
    return (ra_deg + degrees(ra_there)) % 360.0, degrees(dec_there)


def plane(ra_deg, dec_deg, ra0_deg, dec0_deg):
    """Gnomonic coordinates round a center, radians; None beyond a right angle."""
    ra, dec, dec0 = radians(ra_deg - ra0_deg), radians(dec_deg), radians(dec0_deg)
    depth = sin(dec0) * sin(dec) + cos(dec0) * cos(dec) * cos(ra)
    if depth <= 0.1:
        return None
    return cos(dec) * sin(ra) / depth, (cos(dec0) * sin(dec) - sin(dec0) * cos(dec) * cos(ra)) / depth


def sphere(x, y, ra0_deg, dec0_deg):
    """The place at gnomonic coordinates."""
    dec0 = radians(dec0_deg)
    ra = atan2(x, cos(dec0) - y * sin(dec0))
    dec = asin((sin(dec0) + y * cos(dec0)) / sqrt(1.0 + x * x + y * y))
    return (ra0_deg + degrees(ra)) % 360.0, degrees(dec)


def main(arguments):
    folder = os.environ["GSC_FOLDER"]
    at = arguments.index("-c")
    ra_deg, dec_deg = float(arguments[at + 1]), float(arguments[at + 2])
    radius = radians(float(arguments[arguments.index("-r") + 1]) / 60.0)
    faintest = float(arguments[arguments.index("-m") + 2])
    most = int(arguments[arguments.index("-n") + 1])
    with open(os.path.join(folder, "pointing")) as file:
        east_arcsec, north_arcsec = map(float, file.read().split())
    true_ra_deg, true_dec_deg = displaced(ra_deg, dec_deg, east_arcsec, north_arcsec)
    with open(os.path.join(folder, "calls"), "a") as file:
        file.write(f"{ra_deg} {dec_deg} {true_ra_deg} {true_dec_deg}\n")
    lines: list[str] = []
    with open(os.path.join(folder, "stars")) as file:
        for line in file:
            star_ra_deg, star_dec_deg, mag = map(float, line.split())
            if mag > faintest:
                break
            flat = plane(star_ra_deg, star_dec_deg, true_ra_deg, true_dec_deg)
            if flat is None or hypot(*flat) > radius:
                continue
            # what stands there is drawn where the telescope says it looks
            drawn_ra_deg, drawn_dec_deg = sphere(flat[0], flat[1], ra_deg, dec_deg)
            dist = degrees(hypot(*flat)) * 60.0
            lines.append(
                f"{len(lines):010d} {drawn_ra_deg:.7f} {drawn_dec_deg:.7f} 0.2 {mag:.2f} 0.2 1 0 A000 N "
                f"{dist:.2f} 0\n"
            )
            if len(lines) == most:
                break
    sys.stdout.write("".join(lines))


if __name__ == "__main__":
    main(sys.argv[1:])
