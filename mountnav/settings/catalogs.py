"""`[catalogs]`: which star catalogs there are beside the embedded one, on disk and online."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal, Self

from pydantic import Field, field_validator, model_validator
from pydantic_core import PydanticCustomError

from mountnav.settings.section import Section, require_unique

if TYPE_CHECKING:
    from mountnav.catalog.catalog_set import CatalogChoice
    from mountnav.catalog.online.source import OnlineSource


class OnlineSettings(Section):
    """`[[catalogs.online]]`: a catalog that is asked over the network. Nothing is asked that isn't here."""

    name: str = Field(pattern=r"^[a-z0-9][a-z0-9_-]{0,39}$")
    protocol: Literal["vizier", "cone", "tap"] = "vizier"
    url: str = Field(default="", pattern=r"^(https?://[^\s/?#]+.*)?$", max_length=500)
    table: str = Field(default="", max_length=200, pattern=r"^[\w./+*-]*$")
    columns: dict[str, str] = Field(default_factory=dict)
    band: str | None = Field(default=None, min_length=1, max_length=20)
    epoch_yr: float | None = Field(default=None, gt=1800, lt=2100)
    sigma_mas: float | None = Field(default=None, gt=0, le=10000)
    timeout_s: float = Field(default=8.0, gt=0, le=300)
    mag_limit: float | None = Field(default=None, gt=0, lt=30)
    max_radius_deg: float = Field(default=2.5, gt=0, le=10)
    max_age_days: float = Field(default=365.0, gt=0)
    ask: Literal["live", "never"] = "live"

    @field_validator("columns")
    @classmethod
    def _columns_are_known(cls, columns: dict[str, str]) -> dict[str, str]:
        from mountnav.catalog.online.source import COLUMN_ROLES  # only where a table's columns are named

        for role in columns:
            if role not in COLUMN_ROLES:
                raise PydanticCustomError(
                    "no_such_column_role",
                    "a star has no {role}",
                    {"role": role, "fix": f"columns may name: {', '.join(COLUMN_ROLES)}"},
                )
        return columns

    @model_validator(mode="after")
    def _can_be_asked(self) -> Self:
        if self.protocol != "vizier" and not self.url:
            raise PydanticCustomError(
                "no_address",
                "a {protocol} service has no default address",
                {"protocol": self.protocol, "key": "url", "fix": "give the service's base url"},
            )
        if self.protocol != "cone" and not self.table:
            raise PydanticCustomError(
                "no_table",
                "which table is to be asked",
                {"key": "table", "fix": 'such as table = "I/355/gaiadr3"'},
            )
        return self

    def source(self) -> OnlineSource:
        """The source as the catalog takes it."""
        from mountnav.catalog.online.source import VIZIER_URL, OnlineSource  # only where one is configured

        given = self.model_dump()
        given["url"] = given["url"] or VIZIER_URL
        return OnlineSource(**given)


class CatalogsSettings(Section):
    """`[catalogs]`: where imported catalogs lie, which of them are used, what is asked online."""

    folder: Path | None = None
    use: tuple[str, ...] | None = None
    magnitudes_from: str | None = None
    online: tuple[OnlineSettings, ...] = ()

    @field_validator("use")
    @classmethod
    def _something_is_used(cls, use: tuple[str, ...] | None) -> tuple[str, ...] | None:
        if use is not None and not use:
            raise PydanticCustomError(
                "no_catalog", "no catalog is left", {"fix": 'name some, such as ["tycho2"], or remove `use`'}
            )
        return use

    @model_validator(mode="after")
    def _names_differ(self) -> Self:
        fix = "give each [[catalogs.online]] a name of its own"
        names = (one.name for one in self.online)
        require_unique(names, "name_twice", "two online catalogs have the name {name}", fix=fix, key="online")
        return self

    def choice(self) -> CatalogChoice:
        """The choice as `mountnav.catalog.catalog_set.open_catalogs` takes it."""
        from mountnav.catalog.catalog_set import CatalogChoice

        return CatalogChoice(
            folder=self.folder,
            use=self.use,
            magnitudes_from=self.magnitudes_from,
            online=tuple(one.source() for one in self.online),
        )
