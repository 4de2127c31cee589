"""The catalogs of an observatory as one, and which of them suits a frame: enough stars, then precision."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mountnav.catalog.embedded import embedded_catalog
from mountnav.catalog.installed import EMBEDDED_SLUG, Installed, catalogs_folder, installed
from mountnav.catalog.packed import PackedStore
from mountnav.catalog.star_counts import stars_round
from mountnav.catalog.stars import Catalog, Stars
from mountnav.errors import BadCatalog, BadSettings
from mountnav.parsing import repeated
from mountnav.sky.coordinates import Icrs

if TYPE_CHECKING:
    from mountnav.catalog.online import OnlineSource

_log = logging.getLogger(__name__)

ENOUGH = 30.0
"""With so many stars in a field more of them tell no more: the most precise catalog is taken."""
FEWEST = 5.0
"""With fewer than this expected a catalog is asked only if no other has more."""
MOST_CHOICES = 3
"""Catalogs that a frame is matched against one after the other before it is given up; chosen by hand.
Doubled, a frame that no catalog solves takes up to twice as long; at one, a catalog with a gap has no
successor."""
PROBED_FIELDS = 4.0
"""Stars are counted in so many fields about a place: a star more or less means little then."""
UNKNOWN_FIELD_DEG2 = 0.05
"""Where the scale isn't known: a narrow field, since a wide one is served by any catalog."""
WIDEST_PROBE_DEG = 20.0
"""Radius beyond which stars are not counted for a choice, however far the frame may be from where it is
believed; chosen by hand. Doubled, such a count reads four times as many stars."""
MOST_DRAWN = 3000
"""Stars of a drawn frame's cone, brightest first; chosen by hand for pictures of the sky. Doubled, rich
frames are drawn with twice as many stars, in twice the time."""
AS_PRECISE = 1.2
"""Catalogs whose errors differ by less than this factor are equally good: the smaller one is faster."""


@dataclass(frozen=True, slots=True)
class Choice:
    """A catalog for a frame.

    Attributes
    ----------
    expected : float
        How many of its stars a field holds here; what exceeds three times `ENOUGH` isn't counted.
    sigma_arcsec : float
        Median error of these per coordinate, at the epoch asked.
    why : str
        For provenance.
    told : tuple of str
        Which online catalogs were asked, what came and what failed; and which stores are damaged here.
    """

    catalog: Catalog
    expected: float
    sigma_arcsec: float
    why: str
    told: tuple[str, ...] = ()

    @property
    def steps(self) -> tuple[str, ...]:
        """All that provenance should state of the choice."""
        return (*((self.why,) if self.why else ()), *self.told)


class CatalogSet:
    """All catalogs that may be used. Itself a `mountnav.catalog.stars.Catalog`: the one that suits a cone.

    Parameters
    ----------
    indexed : PackedStore
        The catalog of the index for blind solving: the embedded one. It is always there, and asked last.
    stores : sequence of Catalog
        Others on this machine.
    online : sequence of Catalog
        Asked only where nothing on this machine holds enough stars.
    magnitudes : Catalog or None
        Magnitudes are taken from this one, positions from the one chosen.
    use_indexed : bool
        Or let `indexed` serve blind solving alone: frames are found by its index, and never solved with its
        stars.
    """

    def __init__(
        self,
        indexed: PackedStore,
        stores: Sequence[Catalog] = (),
        online: Sequence[Catalog] = (),
        *,
        magnitudes: Catalog | None = None,
        use_indexed: bool = True,
    ) -> None:
        self.indexed = indexed
        self.stores = tuple(stores)
        self.online = tuple(online)
        self.magnitudes = magnitudes
        self._use_indexed = use_indexed

    @property
    def installed(self) -> tuple[Catalog, ...]:
        """All that are on this machine and may be used, the embedded one last; none if only others may."""
        return (*self.stores, self.indexed) if self._use_indexed else self.stores

    @property
    def usable(self) -> tuple[Catalog, ...]:
        """All whose stars a solution may rest on."""
        return (*self.installed, *self.online)

    @property
    def name(self) -> str:
        """Name for provenance."""
        return ", ".join(one.name for one in self.usable)

    def __repr__(self) -> str:
        return f"CatalogSet({self.name})"

    def __reduce__(self) -> tuple[object, tuple[object, ...]]:
        # a process that starts when a store has been removed must start all the same
        stores = tuple(_sent(one) for one in self.stores)
        return _reopened, (self.indexed, stores, self.online, _sent(self.magnitudes), self._use_indexed)

    def cone(
        self, center: Icrs, radius_deg: float, *, epoch_yr: float, mag_limit: float | None = None
    ) -> Stars:
        """Stars of the catalog that suits a field of this size here; see `Catalog`."""
        best = suited(self, center, math.pi * radius_deg**2, epoch_yr=epoch_yr)
        return best.cone(center, radius_deg, epoch_yr=epoch_yr, mag_limit=mag_limit)

    def choices(
        self, center: Icrs | None, field_deg2: float | None, *, epoch_yr: float, radius_deg: float = 0.0
    ) -> tuple[Choice, ...]:
        """Choose catalogs for a frame, the best first.

        Parameters
        ----------
        center : Icrs or None
            Where the frame is believed to be.
        field_deg2 : float or None
            How large it is believed to be.
        epoch_yr : float
            Julian year of the frame.
        radius_deg : float
            How wrong `center` may be.

        Returns
        -------
        tuple of Choice
            At least one, at most `MOST_CHOICES`. Without a place there is nothing to choose by: the embedded
            one, since only its stars can be looked up in the index. Without a size it comes first, and those
            that are richest here after it.

        Raises
        ------
        BadCatalog
            None is left that isn't damaged here.
        """
        if len(self.usable) == 1 and not self.online:
            return (Choice(self.usable[0], math.nan, math.nan, f"{self.usable[0].name} is the only one"),)
        if center is None:
            first = self.indexed if self._use_indexed else self.usable[0]
            return (Choice(first, math.nan, math.nan, "the place is not known"),)
        if field_deg2 is None:
            return self._without_scale(center, radius_deg, epoch_yr)
        found, told = self._probed_here(self.installed, center, field_deg2, radius_deg, epoch_yr)
        for online in self.online:
            if any(one.expected >= ENOUGH for one in found):
                break
            choice, stars = _probed(online, center, field_deg2, radius_deg, epoch_yr)
            told += stars.steps
            # else the stars are another catalog's, which is among the choices itself
            if stars.source == online.name:
                found.append(choice)
        if not found:
            # only online ones may be used, and none has answered: they say so once more where they are asked
            return (Choice(self.online[0], math.nan, math.nan, "nothing came", tuple(told)),)
        best, *others = _ranked(found)[:MOST_CHOICES]
        return (replace(best, told=tuple(told)), *others)

    def _without_scale(self, center: Icrs, radius_deg: float, epoch_yr: float) -> tuple[Choice, ...]:
        """The embedded catalog, where it may be used, and then those with stars for a narrow field."""
        found, damaged = self._probed_here(self.stores, center, UNKNOWN_FIELD_DEG2, radius_deg, epoch_yr)
        rich = [one for one in found if one.expected >= FEWEST]
        why = "the scale is not known"
        if not self._use_indexed and found:
            best, *others = _ranked(found)
            return (replace(best, why=why, told=tuple(damaged)), *others)[:MOST_CHOICES]
        first = (Choice(self.indexed, math.nan, math.nan, why, tuple(damaged)),)
        if not self._use_indexed:
            return (Choice(self.online[0], math.nan, math.nan, why, tuple(damaged)),)
        return (*first, *(_ranked(rich) if rich else ()))[:MOST_CHOICES]

    def _probed_here(
        self,
        catalogs: Sequence[Catalog],
        center: Icrs,
        field_deg2: float,
        radius_deg: float,
        epoch_yr: float,
    ) -> tuple[list[Choice], list[str]]:
        """Count the stars of the catalogs on this machine; of those that prove damaged, what is wrong."""
        found: list[Choice] = []
        damaged: list[str] = []
        for one in catalogs:
            try:
                found.append(_probed(one, center, field_deg2, radius_deg, epoch_yr)[0])
            except BadCatalog as fault:
                if one is self.usable[-1] and not found:  # nothing is left to be used instead
                    raise
                _log.warning("the catalog %s is skipped: %s", one.name, fault)
                damaged.append(f"{one.name} is skipped: {fault}")
        return found, damaged


class DrawnSky:
    """What simulated cameras see: the embedded catalog where it holds enough stars, else the best one here.

    Parameters
    ----------
    catalogs : CatalogSet
        Its online catalogs are not asked.
    """

    def __init__(self, catalogs: CatalogSet) -> None:
        # the sky is there whatever frames are solved with: `use_indexed` and the rest don't matter
        self._catalogs = CatalogSet(catalogs.indexed, catalogs.stores)

    @property
    def name(self) -> str:
        """Name for provenance."""
        return self._catalogs.name

    def cone(
        self, center: Icrs, radius_deg: float, *, epoch_yr: float, mag_limit: float | None = None
    ) -> Stars:
        """See `Catalog`; of a deep catalog the brightest `MOST_DRAWN`, or somewhat more."""
        stars = self._catalogs.indexed.cone(center, radius_deg, epoch_yr=epoch_yr, mag_limit=mag_limit)
        if len(stars) >= ENOUGH or not self._catalogs.stores:
            return stars
        best = suited(self._catalogs, center, math.pi * radius_deg**2, epoch_yr=epoch_yr)
        return stars_round(best, center, radius_deg, MOST_DRAWN, epoch_yr=epoch_yr)


def suited(catalog: Catalog, center: Icrs, field_deg2: float, *, epoch_yr: float) -> Catalog:
    """The one catalog that suits a field, if there are several.

    Parameters
    ----------
    catalog : Catalog
        A `CatalogSet`, or a plain one, which is given back.
    epoch_yr : float
        Julian year.
    """
    if not isinstance(catalog, CatalogSet):
        return catalog
    return catalog.choices(center, field_deg2, epoch_yr=epoch_yr)[0].catalog


_Sent = Catalog | tuple[Path, str | None] | None
"""What another process opens a catalog by: a packed one by its file and its name."""


def _sent(catalog: Catalog | None) -> _Sent:
    return (catalog.path, catalog.name) if isinstance(catalog, PackedStore) else catalog


def _reopened(
    indexed: PackedStore,
    stores: tuple[_Sent, ...],
    online: tuple[Catalog, ...],
    magnitudes: _Sent,
    use_indexed: bool,
) -> CatalogSet:
    opened = (_opened(one) for one in stores)
    return CatalogSet(
        indexed,
        [one for one in opened if one is not None],
        online,
        magnitudes=_opened(magnitudes),
        use_indexed=use_indexed,
    )


def _opened(sent: _Sent) -> Catalog | None:
    if not isinstance(sent, tuple):
        return sent
    try:
        return PackedStore(*sent)
    except BadSettings as gone:
        _log.warning("the catalog %s is skipped: %s", sent[1], gone)
        return None


def _ranked(found: list[Choice]) -> tuple[Choice, ...]:
    """The most precise of those with enough stars, then by number of stars."""
    by_number = sorted(found, key=lambda one: -one.expected)
    rich = [one for one in found if one.expected >= ENOUGH]
    if rich:
        finest = min(one.sigma_arcsec for one in rich)
        as_fine = [one for one in rich if one.sigma_arcsec <= AS_PRECISE * finest]
        best = min(as_fine, key=_size)
        by_number = [best, *(one for one in by_number if one is not best)]
    kept = [one for one in by_number if one.expected >= FEWEST]
    return tuple(kept or by_number[:1])


def _size(choice: Choice) -> float:
    """How many stars a catalog has; what is asked online is the last resort."""
    return float(len(choice.catalog)) if isinstance(choice.catalog, PackedStore) else math.inf


def _probed(
    catalog: Catalog, center: Icrs, field_deg2: float, radius_deg: float, epoch_yr: float
) -> tuple[Choice, Stars]:
    """How many stars a catalog holds around a position, as a choice; and these stars."""
    wide_deg = min(max(radius_deg, math.sqrt(PROBED_FIELDS * field_deg2 / math.pi)), WIDEST_PROBE_DEG)
    fields = max(math.pi * wide_deg**2 / field_deg2, 1.0)
    most = 3.0 * ENOUGH
    # a wide search area in a deep catalog would be read by the million: a part of it tells as much
    if fields > 10.0 * PROBED_FIELDS:
        fields = 10.0 * PROBED_FIELDS
        wide_deg = math.sqrt(fields * field_deg2 / math.pi)
    stars = stars_round(catalog, center, wide_deg, round(most * fields), epoch_yr=epoch_yr)
    expected, number = min(len(stars) / fields, most), ""
    if expected < FEWEST and radius_deg > wide_deg:
        # a catalog of a part of the sky may hold the frame, though not the middle of where it is sought
        whole_deg = min(radius_deg, WIDEST_PROBE_DEG)
        whole = stars_round(catalog, center, whole_deg, round(most * fields), epoch_yr=epoch_yr)
        if len(whole) >= most:
            stars, expected, number = whole, FEWEST, "some"
    sigma = stars.sigma_arcsec[np.isfinite(stars.sigma_arcsec)][: round(most)]
    sigma_arcsec = float(np.median(sigma)) if sigma.size else math.inf
    number = number or (f"more than {most:.0f}" if expected >= most else f"about {expected:.1f}")
    why = f"{number} stars in a field here, known to {sigma_arcsec:.2g}″ at {epoch_yr:.1f}"
    return Choice(catalog, expected, sigma_arcsec, f"{stars.source}: {why}"), stars


@dataclass(frozen=True, slots=True)
class CatalogChoice:
    """Which catalogs are used, as the operator chose them; without a choice all that are in the usual folder.

    Attributes
    ----------
    folder : Path or None
        Of the imported catalogs; None: the usual one (`catalogs_folder`).
    use : tuple of str or None
        Names of those that are used; None: all.
    magnitudes_from : str or None
        Name of the catalog whose magnitudes replace those of the others.
    online : tuple of OnlineSource
        Those that are asked over the network.
    """

    folder: Path | None = None
    use: tuple[str, ...] | None = None
    magnitudes_from: str | None = None
    online: tuple[OnlineSource, ...] = ()


_ALL = CatalogChoice()


def open_catalogs(choice: CatalogChoice = _ALL, *, use: tuple[str, ...] | None = None) -> CatalogSet:
    """Open all catalogs that are chosen.

    Parameters
    ----------
    use : tuple of str, optional
        Only these, in place of `choice.use`.

    Raises
    ------
    BadSettings
        A catalog that is named is not there or is damaged. One that nobody names is passed over,
        and the log tells why.
    """
    folder = catalogs_folder(choice.folder)
    sources = choice.online
    use = use or choice.use
    if choice.folder is not None and not folder.is_dir():
        _log.warning("[catalogs] folder: there is no %s; only the embedded catalog is used", folder)
    found = _told_apart({one.slug: one for one in installed(folder)})
    online = {one.name for one in sources}
    clash = next((name for name in online if name in found or name == EMBEDDED_SLUG), None)
    if clash is not None:
        raise BadSettings(
            f"[catalogs]: the online catalog {clash!r} has the name of one on this machine",
            advice="give it another name",
        )
    for name in use or ():
        if name != EMBEDDED_SLUG and name not in online:
            _require(name, found, str(folder))
    opened = (_usable(one) for one in found.values() if use is None or one.slug in use)
    stores = [one for one in opened if one is not None]
    embedded = embedded_catalog()
    offline: Catalog = CatalogSet(embedded, stores) if stores else embedded

    def asked(name: str) -> Catalog:
        from mountnav.catalog.online import open_online  # only where one is configured

        return open_online(next(one for one in sources if one.name == name), behind=offline)

    magnitudes: Catalog | None = None
    named = choice.magnitudes_from
    if named == EMBEDDED_SLUG:
        magnitudes = embedded
    elif named is not None:
        magnitudes = asked(named) if named in online else _require(named, found, str(folder))
    return CatalogSet(
        embedded,
        stores,
        [asked(one.name) for one in sources if use is None or one.name in use],
        magnitudes=magnitudes,
        use_indexed=use is None or EMBEDDED_SLUG in use,
    )


def _told_apart(found: dict[str, Installed]) -> dict[str, Installed]:
    """Two imports of the same catalog, parts of it perhaps, are called by their own names besides."""
    shared = repeated(one.store.name for one in found.values() if one.store is not None)
    return {
        slug: replace(one, store=PackedStore(one.path, f"{one.store.name} ({slug})"))
        if one.store is not None and one.store.name in shared
        else one
        for slug, one in found.items()
    }


def _require(name: str, found: dict[str, Installed], folder: str) -> Catalog:
    one = found.get(name)
    if one is None:
        there = ", ".join([EMBEDDED_SLUG, *found]) or "none"
        raise BadSettings(
            f"[catalogs]: there is no catalog {name!r} in {folder}",
            advice=f"there is: {there}; `mountnav catalog import` makes others",
        )
    if one.store is None:
        raise BadSettings(f"[catalogs]: {name} can't be used: {one.problem}", device=str(one.path))
    return one.store


def _usable(one: Installed) -> Catalog | None:
    if one.store is None:
        _log.warning("the catalog %s is skipped: %s", one.slug, one.problem)
    return one.store
