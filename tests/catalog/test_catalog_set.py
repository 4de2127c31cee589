"""Which catalogs are opened for a choice, and what is refused (which suits a frame: tests/solving)."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest

from mountnav.catalog.catalog_set import CatalogChoice, open_catalogs
from mountnav.catalog.online import OnlineSource
from mountnav.catalog.packed.error_classes import error_curve
from mountnav.catalog.packed.packing import CatalogColumns, pack
from mountnav.errors import BadSettings
from mountnav.settings.catalogs import CatalogsSettings


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two imports of one catalog, and a damaged file."""
    sigma, epoch = np.full(3, 30.0), np.full(3, 2016.0)
    columns = CatalogColumns(
        np.array([10.0, 20.0, 30.0]),
        np.array([0.0, 10.0, -10.0]),
        np.zeros(3),
        np.zeros(3),
        np.array([5.0, 6.0, 7.0]),
        error_curve((sigma, sigma), (sigma / 10, sigma / 10), (epoch, epoch)),
    )
    for slug in ("north", "south"):
        pack(columns, tmp_path / f"{slug}.mnc", name="Deep", band="V", epoch_yr=2016.0, nside=1)
    (tmp_path / "damaged.mnc").write_bytes(b"MNAV")
    return tmp_path


def names(choice: CatalogChoice, use: tuple[str, ...] | None = None) -> list[str]:
    return [one.name for one in open_catalogs(choice, use=use).usable]


def test_all_that_are_sound_are_used_and_like_names_are_made_different(
    folder: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        assert names(CatalogChoice(folder)) == ["Deep (north)", "Deep (south)", "Tycho-2"]
    assert "damaged is skipped" in caplog.text


def test_what_is_named_is_used_alone(folder: Path) -> None:
    assert names(CatalogChoice(folder, use=("south",))) == ["Deep (south)"]
    assert names(CatalogChoice(folder, use=("south",)), use=("tycho2",)) == ["Tycho-2"]


@pytest.mark.parametrize(
    ("choice", "said"),
    [
        ({"use": ("nosuch",)}, "there is no catalog 'nosuch'"),
        ({"use": ("damaged",)}, "damaged can't be used"),
        ({"magnitudes_from": "nosuch"}, "there is no catalog 'nosuch'"),
        ({"online": (OnlineSource("north", table="I/355"),)}, "'north' has the name of one on this machine"),
        (
            {"online": (OnlineSource("tycho2", table="I/355"),)},
            "'tycho2' has the name of one on this machine",
        ),
    ],
)
def test_what_cannot_be_used_is_refused(folder: Path, choice: dict[str, object], said: str) -> None:
    with pytest.raises(BadSettings, match=said):
        open_catalogs(CatalogChoice(folder, **choice))  # type: ignore[arg-type]


def test_a_folder_that_is_configured_and_missing_is_said_to_be(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        assert names(CatalogChoice(tmp_path / "none")) == ["Tycho-2"]
    assert "only the embedded catalog is used" in caplog.text


def test_the_settings_make_the_choice(folder: Path) -> None:
    settings = CatalogsSettings.model_validate(
        {
            "folder": str(folder),
            "use": ["north", "gaia"],
            "magnitudes_from": "tycho2",
            "online": [{"name": "gaia", "table": "I/355", "mag_limit": 16.0}],
        }
    )
    source = OnlineSource("gaia", table="I/355", mag_limit=16.0)
    assert settings.choice() == CatalogChoice(folder, ("north", "gaia"), "tycho2", (source,))
    assert CatalogsSettings().choice() == CatalogChoice()
