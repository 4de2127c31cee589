"""From a folder of UCAC4 zone files to columns of stars; each file checked against the catalog's counts.

How many stars each zone file of UCAC4 holds: a file cut short where a record ends can't be told otherwise.

As quoted in Project Pluto's ucac4.c (public domain). They sum up to the 113,780,093 stars of the catalog.
Those of zones 1, 451 and 900 agree with other readers'; in CDS's sample the last stars of zones 448 to 454
have these very numbers.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.malformed import malformed_at
from mountnav.catalog.packed.error_classes import error_curve
from mountnav.catalog.packed.packing import CatalogColumns
from mountnav.catalog.readers.kind import Part
from mountnav.catalog.readers.ucac4.record import RECORD, Ucac4Stars, decoded, with_fast_stars
from mountnav.catalog.readers.zone_files import Zone, files_by_zone, record_count, records_in_order, zone_list
from mountnav.catalog.stars import StarFlag
from mountnav.errors import BadCatalog

ZONES = 900
"""Zone files of the whole catalog, each 0.2° of declination, the south pole's first."""

_COUNTS = """
206 660 1143 1613 1949 2548 2964 3498 3908 4330 4849 5226 5679 6034 6475 6876 7163 8006 8350 8901 9522 9902
10644 10619 10866 11607 11711 12690 12453 12868 13899 13792 14783 14697 15005 15690 15626 16502 16523 17069
17806 17972 19317 18961 19461 20243 19752 21552 22017 23031 23947 24239 25806 25249 26149 28142 27839 29870
29724 30241 30962 30734 32617 31917 33436 34439 34809 37266 37490 39525 41177 41929 44553 44497 46302 47500
47902 52476 52800 55406 57301 57967 63337 63717 66133 66114 66552 71078 71091 76530 76491 76088 80823 80226
83861 88323 88494 98547 99754 105420 107140 108471 117646 114350 117561 120561 119733 127395 125714 130079
129364 128719 135861 133826 142651 146917 144623 155434 154187 162405 171183 171867 183584 178298 181384
186766 178780 181112 175050 181561 180374 178602 187007 179068 179516 181558 180009 194687 192141 202993
209689 207012 218967 213118 227459 235638 232923 236497 221732 225411 228161 215357 226210 221075 223413
216786 210515 220402 215313 222324 221973 212078 217722 209286 214708 216044 207810 218144 208107 211170
211834 207523 218362 210730 219795 224037 223499 232338 223037 229767 221824 218625 226143 217262 220146
217243 208207 212644 203876 208114 209240 200638 206538 197019 199200 198867 191392 195955 185399 193200
195625 190250 194348 184972 188337 188089 185463 193490 183841 190505 192379 188822 204361 192078 195881
198364 192488 198205 188338 192988 189143 184578 194263 189599 192633 201155 198314 202330 192607 192714
187031 179820 189308 184382 189483 185021 176662 182765 177043 184163 188834 184495 194281 187357 191526
190664 185586 193509 185319 191980 196428 191803 197845 187500 194633 196112 193390 202645 194322 201021
199660 196337 202072 190851 197356 196190 192349 200790 192350 199811 198759 198355 209731 204263 215479
218666 217273 232703 222455 226839 224828 220199 227353 214100 223792 223449 216221 227320 218012 226154
228148 223187 236116 230483 241458 238487 234861 247830 249099 267727 275949 276602 279623 272862 286694
286833 275382 278564 266656 267524 265842 259974 264835 252004 249353 245850 239140 245481 232259 233273
234187 223462 225854 219190 221663 209475 201553 208893 204128 209269 214505 214444 225774 220565 221689
209163 205552 210741 201328 205835 206659 201023 208695 202368 205145 198571 193394 197947 192972 196491
195953 190587 196125 194927 203878 203934 201897 210480 207077 214909 207152 203309 201981 187121 192072
187977 183752 191994 187193 190323 187186 182118 188976 180697 184066 180382 174223 175932 167162 169097
171300 164500 166441 159121 162002 153766 147854 149084 139448 139784 135680 130953 136195 129688 132449
136312 133400 139002 135360 139402 133256 131692 139849 134372 136940 142363 139679 146136 140911 145304
138023 136431 148966 144568 147497 152723 149997 155179 148932 149872 143440 138503 142185 134607 133499
134534 126448 126515 119956 122095 120088 118675 123067 119512 121676 120792 118785 125086 124419 126230
129172 129970 135263 132559 137497 141540 137611 141074 137846 138358 133410 124766 126474 120578 122489
124553 122684 129306 126478 130791 132138 128268 135531 132479 137271 138257 135686 141636 136510 137193
133583 130247 134626 128552 132089 134495 131684 138520 133560 137898 137187 134842 141151 135654 137533
140175 138797 145735 142196 145779 152109 148144 152477 145758 147191 148940 145159 150965 146391 149634
148871 145700 150378 146726 148529 148261 146859 152417 148153 149705 144556 139370 145082 142047 143788
147786 142631 147549 144525 146355 147200 145478 152370 149658 150461 152733 150562 154750 150199 152165
149549 146267 149584 144713 148048 151539 148479 153364 151409 153745 150513 148555 151867 147491 149107
148783 144818 149916 147322 149425 144117 140037 140570 132342 137098 141336 138751 145202 143625 144226
143569 140413 140793 134664 138927 132600 130178 135286 131141 131341 133355 130165 136327 133466 136813
133779 132510 136558 127069 129358 133443 131291 134867 132236 133951 132896 131174 136912 134791 140102
140510 139559 144585 138166 140205 143277 140380 142689 139243 143254 142925 139677 142902 137695 138656
138514 135249 141347 135217 137265 133700 130557 137726 132497 135877 138568 137657 142452 134691 137002
138393 133038 135526 130047 131886 131291 130204 133977 130326 134416 137101 134530 136319 129463 131231
128647 126003 126362 121155 124132 128739 125746 127010 124309 125977 120875 117170 121883 117522 117723
120330 118580 122910 119596 118958 116850 115573 118173 115314 116738 119271 116721 121089 120203 122630
122917 118899 122772 119614 121920 122480 120858 126136 125158 130366 129822 129584 135723 132585 134380
135038 134387 138051 132007 133165 133795 131009 132708 130499 131703 129980 127935 132085 128981 130488
130081 127915 130832 126736 129119 126770 123801 125616 120399 122233 120040 119234 123147 120504 122647
121961 118555 121495 116514 117084 117386 116325 118613 114558 115315 115427 114524 117205 112278 112546
110746 107658 110595 105912 107080 104982 103719 109114 105960 106551 107783 105065 104790 98779 98615 98578
95742 93937 88072 88367 89719 86346 89105 85752 86660 85734 84511 87455 83948 85529 83428 80791 81518 77685
78165 77298 75734 77299 76560 77507 76826 74501 73140 68354 67290 65506 63783 63182 58414 56928 55927 52987
52584 49188 48274 46225 44562 44775 43039 43255 42918 41877 43734 42640 42777 45174 44188 44781 42490 42043
40890 39714 41020 39186 39791 40120 38814 40217 38381 39149 37697 36527 37478 36013 36231 35757 34454 34756
32661 32312 31643 30531 31227 30914 31162 30660 29555 29897 27480 27527 26421 25913 26316 25120 25387 24872
23793 23825 22270 22529 22139 21596 22583 21760 21524 21571 21053 20793 19987 20025 19727 19241 19660 18386
18356 17955 17532 16931 16090 15784 14941 14702 14703 13994 13758 13179 12775 12680 11872 11995 11591 11009
10823 10094 9951 9372 9145 9030 8359 8453 7960 7749 7312 6448 6227 5762 5434 5193 4825 4468 4033 3712 3493
3025 2952 2730 2405 2155 1878 1650 1496 1327 834 512 171
"""

STARS_IN_ZONE: tuple[int, ...] = tuple(int(count) for count in _COUNTS.split())
"""Zone 1, at the south pole, first."""


Array = NDArray[np.float64]
Chosen = NDArray[np.bool_]

UNRESOLVED_MOTION_MAS_YR = 3276.7
"""A star that is too fast for the record, and not in the table of these."""
NO_MAGNITUDE_MAG = 20.0
"""The catalog's own stand-in."""
SATURATED_MAG = 10.0
"""Of stars without a usable image: brighter ones are overexposed, fainter ones have some other problem."""
SURE_COLOR_MAG = 0.2
"""A color with a larger error is none."""
UCAC_MINUS = {"r": 0.13, "V": -0.10, "g": -0.44, "i": 0.32, "B": -0.84, "J": 1.29}
"""Median of aperture magnitude less another, mag 10 to 16, in CDS's sample of 1000. The order is
that of the scatter: r 0.06 mag, J 0.27."""
_APASS = {"B": 0, "V": 1, "g": 2, "r": 3, "i": 4}
"""Columns of the APASS magnitudes in a record, in the catalog's order."""


def columns_of(stars: Ucac4Stars) -> CatalogColumns:
    """Choose what the packed form holds.

    Parameters
    ----------
    stars : Ucac4Stars
        With the proper motions of the fastest stars.

    Returns
    -------
    CatalogColumns
        Band "UCAC" (579-642 nm), color B-V.
    """
    mag, mag_flags = magnitudes(stars)
    spread = np.where(stars.pm_elsewhere, UNRESOLVED_MOTION_MAS_YR, 0.0)
    return CatalogColumns(
        ra_deg=stars.ra_deg,
        dec_deg=stars.dec_deg,
        pm_ra_cosdec_mas_yr=stars.pm_ra_cosdec_mas_yr,
        pm_dec_mas_yr=stars.pm_dec_mas_yr,
        mag=mag,
        # without a proper motion sigma grows by the catalog's own 50 mas/yr, as in the errors it prints
        error_curve=error_curve(
            (np.maximum(stars.sigma_ra_mas, 1.0), np.maximum(stars.sigma_dec_mas, 1.0)),
            (
                np.maximum(stars.sigma_pm_ra_mas_yr, spread),
                np.maximum(stars.sigma_pm_dec_mas_yr, spread),
            ),
            (stars.epoch_ra_yr, stars.epoch_dec_yr),
        ),
        color_mag=colors(stars),
        flags=(mag_flags | warnings(stars)).astype(np.uint8),
    )


def magnitudes(stars: Ucac4Stars) -> tuple[Array, NDArray[np.uint8]]:
    """Magnitude in UCAC's band, and what is to be said of it.

    The aperture magnitude: against APASS r and color it scatters by 0.04 to 0.12 mag at magnitudes 12 to 16,
    the fit magnitude by 0.10 to 0.19 (CDS's sample). The fit magnitude stands in. Overexposed stars and those
    without any take another band's, brought to this one by its median difference.

    Returns
    -------
    mag : ndarray, shape (n,)
        Finite.
    flags : ndarray of uint8, shape (n,)
        NO_MAGNITUDE, OTHER_BAND, STAND_IN.
    """
    own = np.where(np.isnan(stars.aperture_mag), stars.fit_mag, stars.aperture_mag)
    overexposed = (stars.object_type == 1) | ((stars.images_used == 0) & (own < SATURATED_MAG))
    other = np.full(len(stars), np.nan)
    johnson = dict(zip("BV", johnson_magnitudes(stars), strict=True))
    for band, offset in UCAC_MINUS.items():
        if band in johnson:
            instead = johnson[band]
        elif band == "J":
            instead = stars.jhk_mag[:, 0]
        else:
            instead = stars.apass_mag[:, _APASS[band]]
        other = np.where(np.isnan(other), instead + offset, other)
    replaced = np.isnan(own) | (overexposed & np.isfinite(other))
    mag = np.where(replaced, other, own)
    nothing = np.isnan(mag)
    flags = np.where(
        nothing,
        int(StarFlag.NO_MAGNITUDE),
        # what an overexposed image gave is of no use for photometry even where nothing better is known
        np.where(replaced | overexposed, int(StarFlag.OTHER_BAND), 0),
    )
    fitted = np.isnan(stars.aperture_mag) & ~replaced & ~nothing
    flags = flags | np.where(fitted, int(StarFlag.STAND_IN), 0)
    return np.where(nothing, NO_MAGNITUDE_MAG, mag), flags.astype(np.uint8)


def johnson_magnitudes(stars: Ucac4Stars) -> tuple[Array, Array]:
    """B and V; Tycho's BT and VT brought to Johnson's system [readme_u4 note 13; CATALOGS, Formats §1].

    Returns
    -------
    b, v : ndarray, shape (n,)
        NaN where unknown; a B that would need the other's system to be told apart is NaN.
    """
    b, v = stars.apass_mag[:, 0], stars.apass_mag[:, 1]
    tycho_b, tycho_v = stars.tycho_magnitudes.T
    both = tycho_b & tycho_v
    color = np.where(both, b - v, 0.0)
    johnson_v = np.where(both, v - 0.090 * color, v)
    johnson_b = np.where(both, johnson_v + 0.850 * color, np.where(tycho_b, np.nan, b))
    return johnson_b, johnson_v


def colors(stars: Ucac4Stars) -> Array:
    """B-V, from one system, with an error of at most 0.2.

    Returns
    -------
    ndarray, shape (n,)
        NaN where unknown.
    """
    b, v = johnson_magnitudes(stars)
    mixed = stars.tycho_magnitudes[:, 0] != stars.tycho_magnitudes[:, 1]
    sigma = np.nan_to_num(np.hypot(stars.apass_sigma[:, 0], stars.apass_sigma[:, 1]), nan=0.0)
    return np.where(mixed | (sigma > SURE_COLOR_MAG), np.nan, b - v)


def warnings(stars: Ucac4Stars) -> NDArray[np.uint8]:
    """What the catalog warns of, but for magnitudes; bits of `StarFlag`.

    Returns
    -------
    ndarray of uint8, shape (n,)
        0: no warning.
    """
    kind = stars.object_type
    strange = (kind == 2) | (kind == 8) | (kind == 9)
    unconfirmed = (stars.twomass_key == 0) & (stars.tycho_source == 0)
    galaxy_flag, source_flag = stars.yale // 10, stars.yale % 10
    extended = (stars.leda > 0) | (stars.twomass_extended > 0)
    extended |= (galaxy_flag == 1) | (galaxy_flag == 2) | (source_flag == 5) | (source_flag == 6)
    flags = np.zeros(len(stars), dtype=np.uint8)
    flags[np.isnan(stars.pm_dec_mas_yr)] |= int(StarFlag.NO_PROPER_MOTION)
    flags[strange | unconfirmed] |= int(StarFlag.DOUBTFUL)
    flags[stars.double > 0] |= int(StarFlag.DOUBLE)
    flags[extended] |= int(StarFlag.EXTENDED)
    return flags


TURN_MAS = 360 * 3_600_000
"""A whole turn in the unit of the files, mas."""
ZONE_MAS = 720_000
"""Height of a zone, 0.2°."""
MARGIN_MAS = 60_000
"""So far outside its zone a star is let pass: enough to tell a file of another zone, or of other bytes."""
_NAME = re.compile(r"z(\d{3})", re.IGNORECASE)


class Ucac4Reader:
    """Reader of UCAC4; see `mountnav.catalog.readers.kind.Reader`.

    Parameters
    ----------
    zones : dict
        Zone number, 1 to 900, to its file.
    counts : sequence of int, optional
        Stars in each zone; those of the catalog if left out.
    """

    name = "UCAC4"
    band = "UCAC"
    color_name = "B-V"
    epoch_yr = 2000.0

    def __init__(self, zones: dict[int, Path], *, counts: Sequence[int] = STARS_IN_ZONE) -> None:
        self._zones = zones
        self._counts = counts
        self.made_from = f"UCAC4 (U.S. Naval Observatory, Zacharias et al. 2013): {_extent(zones)}"

    def parts(self) -> Sequence[Part]:
        """One for each zone file, from the south pole on."""
        return [Part(f"z{zone:03d}", path, path.stat().st_size) for zone, path in sorted(self._zones.items())]

    def dec_range_deg(self, part: Part) -> tuple[float, float]:
        """Declinations of a zone's stars at the catalog's epoch."""
        zone = int(part.name[1:])
        return -90.0 + 0.2 * (zone - 1), -90.0 + 0.2 * zone

    def read(self, part: Part) -> Iterator[CatalogColumns]:
        """The stars of a zone.

        Raises
        ------
        BadCatalog
            The file isn't that zone of UCAC4, whole and in its order; tells the offset.
        """
        zone = int(part.name[1:])
        wanted, count = self._counts[zone - 1], record_count(part.path, RECORD)
        if count != wanted:
            raise malformed_at(
                part.path.name,
                min(count, wanted) * RECORD.itemsize,
                f"{wanted} stars in zone {zone}",
                f"{count}",
            )
        band = Zone(
            TURN_MAS,
            max((zone - 1) * ZONE_MAS - MARGIN_MAS, 0),
            min(zone * ZONE_MAS + MARGIN_MAS, TURN_MAS // 2),
            "mas",
        )
        for _, records in records_in_order(part.path, RECORD, band):
            yield columns_of(with_fast_stars(decoded(records)))


def open_catalog(path: Path) -> Ucac4Reader:
    """Find the zone files.

    Parameters
    ----------
    path : Path
        The folder that holds z001 to z900, or one above it (u4b), or a single zone file.

    Returns
    -------
    Ucac4Reader
        Of the zones that are there.

    Raises
    ------
    BadCatalog
        There is none, or one is there twice.
    """
    found = files_by_zone(path, _NAME, "zone files z001 to z900", range(1, ZONES + 1))
    if not found:
        raise BadCatalog(
            "no zone files of UCAC4 (z001 to z900) here",
            device=str(path),
            advice="give the folder u4b, or the folder above it",
        )
    return Ucac4Reader(found)


def _extent(zones: dict[int, Path]) -> str:
    missing = sorted(set(range(1, ZONES + 1)) - set(zones))
    if not missing:
        return f"all {ZONES} zone files"
    if len(zones) <= len(missing):
        return f"{len(zones)} of {ZONES} zone files ({zone_list(sorted(zones))})"
    return f"{len(zones)} of {ZONES} zone files (missing: {zone_list(missing)})"
