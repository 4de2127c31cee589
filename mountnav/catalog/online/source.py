"""What is asked online: a service, a table and what is to be known of its columns."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal
from urllib.parse import urlsplit

from mountnav.catalog.online.known_tables import KnownTable, known_table, table_proper
from mountnav.settings.catalogs import OnlineSettings

VIZIER_URL = "https://vizier.cds.unistra.fr"
CACHE_FORMAT = 1
"""Raised when tiles are made differently: older ones are then fetched anew."""


@dataclass(frozen=True, slots=True)
class OnlineSource:
    """A catalog on the network. Attributes are those of `[[catalogs.online]]`.

    Attributes
    ----------
    name : str
        What provenance and commands call it.
    protocol : {"vizier", "cone", "tap"}
    url : str
        Base address of the service.
    table : str
    columns : mapping
        Role of `mountnav.settings.catalogs.COLUMN_ROLES` to column, with its unit in brackets where the
        service doesn't tell it: ``"pmRA [mas/yr]"``; empty: not used.
    band : str or None
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

    @classmethod
    def of(cls, settings: OnlineSettings) -> OnlineSource:
        """Make the source that a table of the settings describes."""
        given = settings.model_dump()
        given["url"] = given["url"] or VIZIER_URL
        return cls(**given)

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
        """Twelve characters that tell tiles of one making from others under the same name.

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
