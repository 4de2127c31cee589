"""An online source: its service, its table, and the tables whose columns need no configuration.

Tables whose columns are known: nothing needs to be configured for them but the name of the table.

Column names and units are those of VizieR's tables (ReadMe files of CDS I/259, I/284, I/322A, I/355) and of
the Gaia archive's data model. What only some servers have is in `may_lack`.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Literal
from urllib.parse import urlsplit

from mountnav.catalog.stars import StarFlag

COLUMN_ROLES = (
    "ra",
    "dec",
    "e_ra",
    "e_dec",
    "pm_ra",
    "pm_dec",
    "e_pm_ra",
    "e_pm_dec",
    "mean_epoch_ra",
    "mean_epoch_dec",
    "mag",
    "color",
)
"""What a column of an online table may be: the keys of `OnlineSource.columns`."""


@dataclass(frozen=True, slots=True)
class FlagRule:
    """Which value of a column is a warning.

    Attributes
    ----------
    test : {"above", "below", "in", "has"}
        "has": the text contains `value`.
    """

    column: str
    test: Literal["above", "below", "in", "has"]
    value: float | tuple[float, ...] | str
    flag: StarFlag


@dataclass(frozen=True, slots=True)
class KnownTable:
    """What is known of a table.

    Attributes
    ----------
    epoch_yr : float
        Julian year of the positions.
    faintest_mag : float
        In `band`: hardly a star is fainter.
    roles : mapping
        Role to column names, the first that has a value counts. Beside those of
        `COLUMN_ROLES`: ``mag_other`` (another band), ``color_blue`` and
        ``color_red`` (the color is their difference), ``e_total`` (error of both coordinates together).
    may_lack : frozenset of str
        Columns that a server needn't have; never asked for by TAP, where an unknown column is an error.
    limit_column : str
        The column by which the server can be asked for bright stars only; empty if that would lose stars.
    other_shift_mag : float
        What is added to ``mag_other`` to bring it to `band` roughly.
    sigma_mas, added_sigma_mas : float
        Position error of a star whose row has none, and what is added (in quadrature) to those that have one.
    no_error_mas : float
        Errors from here on say that there is none.
    sigma_pm_mas_yr, least_sigma_pm_mas_yr : float
        Error of a proper motion that comes without one, and the least that is believed.
    no_magnitude_mag : float
        Stand-in for an unknown magnitude.
    zero_motion_is_none : bool
        A proper motion of exactly (0, 0) says that there is none.
    is_tycho_photometry : bool
        V and B-V are to be made of VT and BT [Tycho-2 ReadMe, note 7].
    """

    band: str
    epoch_yr: float
    faintest_mag: float
    roles: Mapping[str, tuple[str, ...]]
    color_name: str = ""
    may_lack: frozenset[str] = frozenset()
    flags: tuple[FlagRule, ...] = ()
    limit_column: str = ""
    other_shift_mag: float = 0.0
    sigma_mas: float = 100.0
    added_sigma_mas: float = 0.0
    no_error_mas: float = float("inf")
    sigma_pm_mas_yr: float = 5.0
    least_sigma_pm_mas_yr: float = 0.0
    no_magnitude_mag: float = 30.0
    zero_motion_is_none: bool = False
    is_tycho_photometry: bool = False
    columns: tuple[str, ...] = field(init=False, default=())

    def __post_init__(self) -> None:
        wanted = [name for names in self.roles.values() for name in names]
        wanted += [rule.column for rule in self.flags]
        object.__setattr__(self, "columns", tuple(dict.fromkeys(wanted)))


UCAC4 = KnownTable(
    band="UCAC",
    epoch_yr=2000.0,
    faintest_mag=17.0,
    color_name="B-V",
    roles=MappingProxyType(
        {
            "ra": ("RAJ2000",),
            "dec": ("DEJ2000",),
            "e_total": ("ePos",),
            "mean_epoch_ra": ("EpRA",),
            "mean_epoch_dec": ("EpDE",),
            "pm_ra": ("pmRA",),
            "pm_dec": ("pmDE",),
            "e_pm_ra": ("e_pmRA",),
            "e_pm_dec": ("e_pmDE",),
            "mag": ("a.mag", "f.mag"),
            "mag_other": ("Vmag",),
            "color_blue": ("Bmag",),
            "color_red": ("Vmag",),
        }
    ),
    flags=(
        FlagRule("of", "in", (1.0,), StarFlag.OTHER_BAND),
        FlagRule("of", "in", (2.0, 8.0, 9.0), StarFlag.DOUBTFUL),
        FlagRule("db", "above", 0.0, StarFlag.DOUBLE),
    ),
    # as the reader of the zone files has it: median in CDS's sample of 1000 stars
    other_shift_mag=-0.10,
    no_magnitude_mag=20.0,
    sigma_pm_mas_yr=10.0,
    zero_motion_is_none=True,
)
"""CDS I/322A. Bright stars have no magnitude of the telescope's own: no column by which to limit."""

USNO_B1 = KnownTable(
    band="R",
    epoch_yr=2000.0,
    faintest_mag=21.5,
    color_name="B-R",
    roles=MappingProxyType(
        {
            "ra": ("RAJ2000",),
            "dec": ("DEJ2000",),
            "e_ra": ("e_RAJ2000",),
            "e_dec": ("e_DEJ2000",),
            "mean_epoch_ra": ("Epoch",),
            "mean_epoch_dec": ("Epoch",),
            "pm_ra": ("pmRA",),
            "pm_dec": ("pmDE",),
            "e_pm_ra": ("e_pmRA",),
            "e_pm_dec": ("e_pmDE",),
            "mag": ("R2mag", "R1mag"),
            "mag_other": ("B2mag", "B1mag"),
            "color_blue": ("B2mag", "B1mag"),
            "color_red": ("R2mag", "R1mag"),
        }
    ),
    flags=(
        FlagRule("Ndet", "below", 2.0, StarFlag.DOUBTFUL),
        FlagRule("Flags", "has", "s", StarFlag.DOUBTFUL),
    ),
    may_lack=frozenset({"Flags"}),
    other_shift_mag=-0.9,
    no_magnitude_mag=21.0,
    least_sigma_pm_mas_yr=4.0,
    sigma_mas=300.0,
    # the ReadMe: "the estimated accuracies are 0.2arcsec for the positions at J2000"
    added_sigma_mas=200.0,
    no_error_mas=999.0,
    sigma_pm_mas_yr=10.0,
    zero_motion_is_none=True,
)
"""CDS I/284. Of the two red plates either may be missing: no column by which to limit."""

TYCHO2 = KnownTable(
    band="V",
    epoch_yr=2000.0,
    faintest_mag=13.0,
    color_name="B-V",
    roles=MappingProxyType(
        {
            # stars without a mean position stand where they were observed
            "ra": ("RAmdeg", "RA(ICRS)"),
            "dec": ("DEmdeg", "DE(ICRS)"),
            "e_ra": ("e_RAmdeg",),
            "e_dec": ("e_DEmdeg",),
            "mean_epoch_ra": ("EpRAm",),
            "mean_epoch_dec": ("EpDEm",),
            "pm_ra": ("pmRA",),
            "pm_dec": ("pmDE",),
            "e_pm_ra": ("e_pmRA",),
            "e_pm_dec": ("e_pmDE",),
            "mag": ("VTmag",),
            "color_blue": ("BTmag",),
        }
    ),
    may_lack=frozenset({"RA(ICRS)", "DE(ICRS)"}),
    flags=(FlagRule("pflag", "has", "P", StarFlag.DOUBLE),),
    sigma_mas=100.0,
    sigma_pm_mas_yr=3.0,
    is_tycho_photometry=True,
)
"""CDS I/259, main table; the brightest stars are in its supplement."""

GAIA_DR3 = KnownTable(
    band="G",
    epoch_yr=2016.0,
    faintest_mag=21.5,
    color_name="BP-RP",
    roles=MappingProxyType(
        {
            "ra": ("RA_ICRS",),
            "dec": ("DE_ICRS",),
            "e_ra": ("e_RA_ICRS",),
            "e_dec": ("e_DE_ICRS",),
            "pm_ra": ("pmRA",),
            "pm_dec": ("pmDE",),
            "e_pm_ra": ("e_pmRA",),
            "e_pm_dec": ("e_pmDE",),
            "mag": ("Gmag",),
            "color": ("BP-RP",),
        }
    ),
    flags=(FlagRule("RUWE", "above", 1.4, StarFlag.DOUBLE),),
    limit_column="Gmag",
    sigma_mas=5.0,
    sigma_pm_mas_yr=3.0,
)
"""CDS I/355."""

GAIA_ARCHIVE = KnownTable(
    band="G",
    epoch_yr=2016.0,
    faintest_mag=21.5,
    color_name="BP-RP",
    roles=MappingProxyType(
        {
            "ra": ("ra",),
            "dec": ("dec",),
            "e_ra": ("ra_error",),
            "e_dec": ("dec_error",),
            "pm_ra": ("pmra",),
            "pm_dec": ("pmdec",),
            "e_pm_ra": ("pmra_error",),
            "e_pm_dec": ("pmdec_error",),
            "mag": ("phot_g_mean_mag",),
            "color": ("bp_rp",),
        }
    ),
    flags=(FlagRule("ruwe", "above", 1.4, StarFlag.DOUBLE),),
    limit_column="phot_g_mean_mag",
    sigma_mas=5.0,
    sigma_pm_mas_yr=3.0,
)
"""The Gaia archive's own table, of data release 3 (ref_epoch 2016.0)."""

_BY_NAME = {
    "I/322A": UCAC4,
    "I/322A/out": UCAC4,
    "I/284": USNO_B1,
    "I/284/out": USNO_B1,
    "I/259": TYCHO2,
    "I/259/tyc2": TYCHO2,
    "I/355": GAIA_DR3,
    "I/355/gaiadr3": GAIA_DR3,
    "gaiadr3.gaia_source": GAIA_ARCHIVE,
}
_WHOLE_NAME = {"I/322A": "I/322A/out", "I/284": "I/284/out", "I/259": "I/259/tyc2", "I/355": "I/355/gaiadr3"}


def known_table(table: str) -> KnownTable | None:
    """What is known of a table.

    Parameters
    ----------
    table : str
        Such as "I/355" or "I/355/gaiadr3".
    """
    return _BY_NAME.get(table)


def table_proper(table: str) -> str:
    """The table of a catalog: "I/355/gaiadr3" for "I/355"; others as they are."""
    return _WHOLE_NAME.get(table, table)


VIZIER_URL = "https://vizier.cds.unistra.fr"
CACHE_FORMAT = 1
"""Raised when tiles are made differently: older ones are then fetched again."""


@dataclass(frozen=True, slots=True)
class OnlineSource:
    """A catalog on the network. Attributes are those of `[[catalogs.online]]`.

    Attributes
    ----------
    name : str
        What provenance and commands call it.
    url : str
        Base address of the service.
    columns : mapping
        Role of `COLUMN_ROLES` to column, with its unit in brackets where the
        service doesn't tell it: ``"pmRA [mas/yr]"``; empty: not used.
    band : str or None
        None: the table's own.
    epoch_yr : float or None
        Julian year of the positions.
    sigma_mas : float or None
        Position error per coordinate where the table has none.
    timeout_s : float
        How long one cone may wait for the network in all.
    mag_limit : float or None
        How deep tiles are fetched. None: as deep as asked for.
    max_radius_deg : float
        Wider cones aren't asked for online.
    max_age_days : float
        Older tiles are fetched again, and used if that fails.
    ask : {"live", "never"}
        "never": only what is in the cache; no socket is opened.
    """

    name: str
    protocol: Literal["vizier", "cone", "tap"] = "vizier"
    url: str = VIZIER_URL
    table: str = ""
    columns: Mapping[str, str] = field(default_factory=dict)
    band: str | None = None
    epoch_yr: float | None = None
    sigma_mas: float | None = None
    timeout_s: float = 8.0
    mag_limit: float | None = None
    max_radius_deg: float = 2.5
    max_age_days: float = 365.0
    ask: Literal["live", "never"] = "live"

    @property
    def known(self) -> KnownTable | None:
        """What is known of the table without being configured; None for others, and for cone searches."""
        return None if self.protocol == "cone" else known_table(self.table)

    @property
    def faintest_mag(self) -> float:
        """Magnitude of the faintest stars that it can give; infinite if that isn't known."""
        known = self.known
        of_table = float("inf") if known is None else known.faintest_mag
        return of_table if self.mag_limit is None else min(of_table, self.mag_limit)

    @property
    def host(self) -> str:
        """Name of the server."""
        return urlsplit(self.url).hostname or self.url

    def fingerprint(self) -> str:
        """Twelve characters that distinguish tiles made in one way from others under the same name.

        Mirrors of VizieR are alike, other services aren't. Depth, age and patience are no part of it.
        """
        made_of = {
            "format": CACHE_FORMAT,
            "protocol": self.protocol,
            "url": "" if self.protocol == "vizier" else self.url,
            "table": table_proper(self.table),
            "columns": dict(self.columns),
            "band": self.band,
            "epoch_yr": self.epoch_yr,
            "sigma_mas": self.sigma_mas,
        }
        text = json.dumps(made_of, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:12]
