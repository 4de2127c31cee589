"""Several catalogs on the shelf: the one that suits a frame is taken, and the solution says so."""

from __future__ import annotations

import pickle
import time
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from mountnav.catalog.catalog_set import ENOUGH, CatalogSet, DrawnSky, suited
from mountnav.catalog.combined import with_magnitudes
from mountnav.catalog.embedded import embedded_catalog
from mountnav.catalog.packed import PackedStore
from mountnav.catalog.packed.format import decode_header
from mountnav.catalog.stars import StarFlag, Stars
from mountnav.errors import BadCatalog
from mountnav.frames import Frame, Hint
from mountnav.simulation.deep_sky import DeepSky
from mountnav.simulation.optics import PRESETS, SimulatedOptics
from mountnav.simulation.render import draw_frame
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec
from mountnav.solution import Reason
from mountnav.solving.solve import SolveSettings, solve
from tests.simulation.sky_stores import write_store

CENTER = Icrs(150.0, 40.0)
BELIEVED = Icrs(150.03, 40.02)
WHEN = datetime(2026, 3, 1, tzinfo=UTC)
EPOCH_YR = 2026.16
WIDE = SimulatedOptics(900, 700, 5.0)


@pytest.fixture(scope="module")
def sky() -> DeepSky:
    return DeepSky(1)


@pytest.fixture(scope="module")
def stores(sky: DeepSky, tmp_path_factory: pytest.TempPathFactory) -> dict[str, PackedStore]:
    folder = tmp_path_factory.mktemp("stores")
    for kind in ("gaia", "ucac4", "usno-b1"):
        write_store(folder / f"{kind}.mnc", sky.as_catalog(kind), [(CENTER, 1.2)])
    return {path.stem: PackedStore(path) for path in folder.glob("*.mnc")}


@pytest.fixture(scope="module")
def shelf(stores: dict[str, PackedStore]) -> CatalogSet:
    return CatalogSet(embedded_catalog(), [stores["ucac4"], stores["gaia"]])


def drawn(sky: DeepSky, optics: SimulatedOptics, exposure_s: float, center: Icrs = CENTER) -> Frame:
    return draw_frame(center, optics, sky, exposure_s=exposure_s, mid_exposure_utc=WHEN, seed=3)


def hinted(optics: SimulatedOptics, center: Icrs = BELIEVED) -> Hint:
    return Hint(center, 0.25, 0.97 * optics.scale_arcsec_px, 1.03 * optics.scale_arcsec_px)


@pytest.mark.long
@pytest.mark.parametrize(("preset", "exposure_s"), [("prompt-8", 30.0), ("mayaki-azt-3", 30.0)])
def test_a_narrow_frame_gets_the_most_precise_catalog(sky, shelf, preset, exposure_s):
    optics = PRESETS[preset]
    verdict = solve(drawn(sky, optics, exposure_s), shelf, hint=hinted(optics))
    assert verdict.solution is not None
    assert "Gaia" in verdict.solution.catalog
    assert "stars in a field here, known to" in verdict.solution.catalog_steps[0]
    assert separation_arcsec(verdict.solution.center, CENTER) < 0.1 * optics.scale_arcsec_px
    assert verdict.solution.identified.band == "G"


@pytest.mark.long
def test_with_the_embedded_catalog_alone_the_field_is_too_narrow(sky):
    optics = PRESETS["vihorlat-vnt"]
    shelf = CatalogSet(embedded_catalog())
    verdict = solve(drawn(sky, optics, 60.0), shelf, hint=hinted(optics))
    assert verdict.reason is Reason.CATALOG_TOO_SHALLOW
    assert str(verdict.reason) == "field too narrow for the installed catalogs"
    assert "Tycho-2" in verdict.detail
    assert "mountnav catalog import" in verdict.detail
    assert "to fetch" in verdict.detail


def test_where_a_store_ends_the_embedded_catalog_goes_on(sky, shelf):
    far = Icrs(200.0, 40.0)
    verdict = solve(drawn(sky, WIDE, 5.0, far), shelf, hint=hinted(WIDE, Icrs(200.03, 40.02)))
    assert verdict.solution is not None
    assert verdict.solution.catalog == "Tycho-2"


@pytest.mark.long
def test_a_frame_found_blind_rests_on_the_better_stars_of_where_it_is(sky, shelf, sky_index):
    settings = SolveSettings(index=sky_index, blind="only")
    found = solve(drawn(sky, WIDE, 5.0), shelf, settings=settings)
    plain = solve(drawn(sky, WIDE, 5.0), embedded_catalog(), settings=settings)
    assert found.solution is not None
    assert plain.solution is not None
    assert "Gaia" in found.solution.catalog
    assert plain.solution.catalog == "Tycho-2"
    assert found.solution.mode.startswith("blind")
    assert found.solution.rms_arcsec < plain.solution.rms_arcsec
    assert separation_arcsec(found.solution.center, CENTER) < 0.1


class Scrambled:
    """A catalog that claims to be precise, and whose stars stand elsewhere."""

    name = "scrambled"

    def __init__(self, true: PackedStore) -> None:
        self._true = true

    def cone(self, center: Icrs, radius_deg: float, *, epoch_yr: float, mag_limit=None) -> Stars:
        off = Icrs((center.ra_deg + 2.0) % 360.0, center.dec_deg)
        stars = self._true.cone(off, radius_deg, epoch_yr=epoch_yr, mag_limit=mag_limit)
        return replace(
            stars,
            ra_deg=(stars.ra_deg - 2.0) % 360.0,
            sigma_arcsec=np.full(len(stars), 1e-6),
            source=self.name,
        )


@pytest.mark.long
def test_a_catalog_that_is_wrong_gives_way_to_the_next_one(sky, stores, tmp_path):
    optics = PRESETS["mayaki-azt-3"]
    elsewhere = Icrs(152.0, 40.0)
    write_store(tmp_path / "off.mnc", sky.as_catalog("gaia"), [(elsewhere, 0.9)])
    wrong = Scrambled(PackedStore(tmp_path / "off.mnc"))
    shelf = CatalogSet(embedded_catalog(), [wrong, stores["gaia"]])
    choices = shelf.choices(BELIEVED, 0.054, epoch_yr=EPOCH_YR, radius_deg=0.25)
    assert choices[0].catalog is wrong
    verdict = solve(drawn(sky, optics, 30.0), shelf, hint=hinted(optics))
    assert verdict.solution is not None
    assert "Gaia" in verdict.solution.catalog
    assert separation_arcsec(verdict.solution.center, CENTER) < 0.1 * optics.scale_arcsec_px
    alone = solve(drawn(sky, optics, 30.0), wrong, hint=hinted(optics), settings=SolveSettings(budget_s=2.0))
    assert alone.solution is None


@pytest.mark.long
def test_magnitudes_of_one_catalog_positions_of_another(sky, stores):
    optics = PRESETS["prompt-8"]
    shelf = CatalogSet(embedded_catalog(), [stores["gaia"]], magnitudes=stores["usno-b1"])
    frame = drawn(sky, optics, 30.0)
    mixed = solve(frame, shelf, hint=hinted(optics)).solution
    plain = solve(frame, stores["gaia"], hint=hinted(optics)).solution
    assert mixed is not None
    assert plain is not None
    assert mixed.identified.band == "R"
    assert np.array_equal(mixed.identified.ra_deg, plain.identified.ra_deg)
    assert any("magnitudes of invented USNO-B1.0" in step for step in mixed.catalog_steps)
    measured = (mixed.identified.star_flags & int(StarFlag.OTHER_BAND)) == 0
    assert measured.mean() > 0.7


def test_magnitudes_are_matched_star_by_star(stores):
    stars = stores["gaia"].cone(CENTER, 0.2, epoch_yr=EPOCH_YR, mag_limit=17.0)
    other = stores["usno-b1"].cone(CENTER, 0.25, epoch_yr=EPOCH_YR)
    mixed = with_magnitudes(stars, stores["usno-b1"])
    taken = np.flatnonzero((mixed.flags & int(StarFlag.OTHER_BAND)) == 0)
    assert taken.size > 0.7 * len(stars)
    for one in taken[:50]:
        near = np.hypot(
            (other.ra_deg - stars.ra_deg[one]) * np.cos(np.radians(stars.dec_deg[one])),
            other.dec_deg - stars.dec_deg[one],
        )
        assert near.min() * 3600.0 < 4.0
        assert mixed.mag[one] == pytest.approx(other.mag[near.argmin()], abs=1e-6)
    kept = np.flatnonzero(mixed.flags & int(StarFlag.OTHER_BAND))
    shift = mixed.mag[kept] - stars.mag[kept]
    assert np.ptp(shift) < 1e-9


def test_a_catalog_without_these_stars_leaves_the_magnitudes(stores):
    stars = stores["gaia"].cone(CENTER, 0.1, epoch_yr=EPOCH_YR, mag_limit=16.0)
    far = embedded_catalog()
    only_two = stars.only(np.arange(2))
    mixed = with_magnitudes(only_two, far)
    assert np.array_equal(mixed.mag, only_two.mag)
    assert mixed.band == only_two.band
    assert "too few" in mixed.steps[-1]


def test_choices_are_ranked_by_stars_and_precision(shelf, stores):
    rich = shelf.choices(CENTER, 0.14, epoch_yr=EPOCH_YR)
    assert rich[0].catalog is stores["gaia"]
    assert rich[0].expected >= ENOUGH
    assert rich[0].sigma_arcsec < rich[1].sigma_arcsec
    tiny = shelf.choices(CENTER, 0.0062, epoch_yr=EPOCH_YR)
    assert tiny[0].catalog is stores["gaia"]
    assert tiny[0].expected < ENOUGH
    nowhere = shelf.choices(None, 0.14, epoch_yr=EPOCH_YR)
    assert [one.catalog for one in nowhere] == [embedded_catalog()]
    unscaled = shelf.choices(CENTER, None, epoch_yr=EPOCH_YR)
    assert unscaled[0].catalog is embedded_catalog()
    assert [one.catalog for one in unscaled[1:]] == [stores["gaia"], stores["ucac4"]]
    far = Icrs(200.0, 40.0)
    assert [one.catalog for one in shelf.choices(far, None, epoch_yr=EPOCH_YR)] == [embedded_catalog()]
    alone = CatalogSet(embedded_catalog(), [stores["ucac4"], stores["gaia"]], use_indexed=False)
    assert alone.choices(CENTER, None, epoch_yr=EPOCH_YR)[0].catalog is stores["gaia"]


@pytest.mark.long
def test_a_narrow_frame_of_unknown_scale_is_solved_with_an_imported_catalog(sky, shelf):
    optics = PRESETS["vihorlat-vnt"]
    frame = replace(drawn(sky, optics, 60.0), hint=Hint())
    verdict = solve(frame, shelf, hint=Hint(BELIEVED, 0.1))
    assert verdict.solution is not None
    assert "Gaia" in verdict.solution.catalog
    assert separation_arcsec(verdict.solution.center, CENTER) < 0.2 * optics.scale_arcsec_px


class Counting:
    """An online catalog: tells how often it was asked."""

    name = "counting"

    def __init__(self, behind: PackedStore) -> None:
        self._behind = behind
        self.asked = 0

    def cone(self, center: Icrs, radius_deg: float, *, epoch_yr: float, mag_limit=None) -> Stars:
        self.asked += 1
        stars = self._behind.cone(center, radius_deg, epoch_yr=epoch_yr, mag_limit=mag_limit)
        return replace(stars, source=self.name)


class Late(Counting):
    """An online catalog that lets its first caller wait."""

    def cone(self, center: Icrs, radius_deg: float, *, epoch_yr: float, mag_limit=None) -> Stars:
        if self.asked == 0:
            time.sleep(2.0)
        return super().cone(center, radius_deg, epoch_yr=epoch_yr, mag_limit=mag_limit)


@pytest.mark.long
def test_waiting_for_the_network_leaves_the_search_its_time(sky, stores):
    late = Late(stores["gaia"])
    optics = PRESETS["prompt-8"]
    settings = SolveSettings(budget_s=1.5, glance=False)
    shelf = CatalogSet(embedded_catalog(), [], [late])
    verdict = solve(drawn(sky, optics, 30.0), shelf, hint=hinted(optics), settings=settings)
    assert late.asked > 1
    assert verdict.solution is not None
    assert verdict.solution.catalog == "counting"


def test_online_catalogs_are_asked_only_where_nothing_here_suffices(stores):
    online = Counting(stores["gaia"])
    shelf = CatalogSet(embedded_catalog(), [], [online])
    assert shelf.choices(CENTER, 3.0, epoch_yr=EPOCH_YR)[0].catalog is embedded_catalog()
    assert online.asked == 0
    assert shelf.choices(CENTER, 0.05, epoch_yr=EPOCH_YR)[0].catalog is online
    assert online.asked > 0


def test_a_shelf_is_a_catalog_and_goes_to_another_process(shelf):
    again = pickle.loads(pickle.dumps(shelf))
    here = shelf.cone(CENTER, 0.1, epoch_yr=EPOCH_YR, mag_limit=16.0)
    there = again.cone(CENTER, 0.1, epoch_yr=EPOCH_YR, mag_limit=16.0)
    assert len(here) > 5
    assert np.array_equal(here.ra_deg, there.ra_deg)
    assert suited(shelf, CENTER, 0.05, epoch_yr=EPOCH_YR) is shelf.stores[1]


def test_a_process_that_starts_after_a_store_was_removed_does_without_it(stores, tmp_path, caplog):
    copy = tmp_path / "gaia.mnc"
    copy.write_bytes(stores["gaia"].path.read_bytes())
    gone = PackedStore(copy)
    shelf = CatalogSet(embedded_catalog(), [stores["ucac4"], gone], [Counting(gone)], magnitudes=gone)
    kept = pickle.loads(pickle.dumps(shelf))
    assert [one.name for one in kept.installed] == [one.name for one in shelf.installed]
    assert kept.magnitudes.name == gone.name
    sent = pickle.dumps(CatalogSet(embedded_catalog(), [stores["ucac4"], gone], magnitudes=gone))
    copy.unlink()
    left = pickle.loads(sent)
    assert [one.name for one in left.installed] == [stores["ucac4"].name, "Tycho-2"]
    assert left.magnitudes is None
    assert "is skipped" in caplog.text
    assert str(copy) in caplog.text


def test_a_store_that_proves_damaged_is_passed_over_and_told(sky, stores, tmp_path, caplog):
    content = bytearray(stores["gaia"].path.read_bytes())
    header, start = decode_header(bytes(content), file="gaia")
    at = start + header.layout()["stars"][0]
    content[at + 14 : at + 15 * header.count : 15] = b"\xff" * header.count  # no such error class
    path = tmp_path / "damaged.mnc"
    path.write_bytes(content)
    optics = PRESETS["prompt-8"]
    shelf = CatalogSet(embedded_catalog(), [PackedStore(path), stores["ucac4"]])
    verdict = solve(drawn(sky, optics, 30.0), shelf, hint=hinted(optics))
    assert verdict.solution is not None
    assert verdict.solution.catalog == stores["ucac4"].name
    assert any(
        str(path) in step and "expected error classes" in step for step in verdict.solution.catalog_steps
    )
    assert f"{path}: at byte" in caplog.text
    with pytest.raises(BadCatalog, match="expected error classes"):
        CatalogSet(embedded_catalog(), [PackedStore(path)] * 2, use_indexed=False).cone(
            CENTER, 0.2, epoch_yr=EPOCH_YR
        )


def test_drawn_frames_have_the_embedded_stars_where_these_suffice(shelf, stores):
    drawn_sky = DrawnSky(shelf)
    assert drawn_sky.cone(CENTER, 1.0, epoch_yr=EPOCH_YR).source == "Tycho-2"
    assert drawn_sky.cone(CENTER, 0.05, epoch_yr=EPOCH_YR).source == stores["gaia"].name


class Failing:
    """An online catalog whose server is gone: the stars are of the catalog behind it."""

    name = "deep"

    def cone(self, center: Icrs, radius_deg: float, *, epoch_yr: float, mag_limit=None) -> Stars:
        stars = embedded_catalog().cone(center, radius_deg, epoch_yr=epoch_yr, mag_limit=mag_limit)
        return replace(stars, steps=("deep: no answer within 8 s; Tycho-2 taken instead",))


@pytest.mark.long
def test_what_was_asked_in_vain_is_told_whether_the_frame_is_solved_or_not(sky):
    shelf = CatalogSet(embedded_catalog(), [], [Failing()])
    optics = PRESETS["vihorlat-vnt"]
    refused = solve(drawn(sky, optics, 60.0), shelf, hint=hinted(optics))
    assert refused.solution is None
    assert any("deep: no answer within 8 s" in note for note in refused.notes)
    few = SimulatedOptics(1100, 900, 2.0)
    solved = solve(drawn(sky, few, 30.0), shelf, hint=hinted(few))
    assert solved.solution is not None
    assert solved.solution.catalog == "Tycho-2"
    assert any("deep: no answer within 8 s" in step for step in solved.solution.catalog_steps)


class BrokenDeepDown(Counting):
    """A catalog whose damage shows only where it is read a second time."""

    def cone(self, center: Icrs, radius_deg: float, *, epoch_yr: float, mag_limit=None) -> Stars:
        if self.asked:
            raise BadCatalog("at byte 299456: expected error classes below 32, found 255", device="b.mnc")
        return super().cone(center, radius_deg, epoch_yr=epoch_yr, mag_limit=mag_limit)


@pytest.mark.long
def test_damage_that_shows_in_the_search_costs_the_catalog_and_not_the_frame(sky, stores):
    optics = PRESETS["mayaki-azt-3"]
    shelf = CatalogSet(embedded_catalog(), [BrokenDeepDown(stores["gaia"]), stores["ucac4"]])
    verdict = solve(drawn(sky, optics, 30.0), shelf, hint=hinted(optics))
    assert verdict.solution is not None
    assert "UCAC4" in verdict.solution.catalog
    alone = BrokenDeepDown(stores["gaia"])
    alone.asked = 1
    frame = drawn(sky, optics, 30.0)
    with pytest.raises(BadCatalog, match="byte 299456"):
        solve(frame, alone, hint=hinted(optics))


def test_a_store_that_holds_the_frame_but_not_the_middle_of_a_wide_hint_is_tried(sky, tmp_path):
    optics = PRESETS["mayaki-azt-3"]
    write_store(tmp_path / "small.mnc", sky.as_catalog("gaia"), [(CENTER, 0.5)])
    shelf = CatalogSet(embedded_catalog(), [PackedStore(tmp_path / "small.mnc")])
    scale = optics.scale_arcsec_px
    off = Hint(Icrs(CENTER.ra_deg, CENTER.dec_deg + 1.5), 1.7, 0.97 * scale, 1.03 * scale)
    verdict = solve(drawn(sky, optics, 30.0), shelf, hint=off)
    assert verdict.solution is not None
    assert "Gaia" in verdict.solution.catalog
    assert separation_arcsec(verdict.solution.center, CENTER) < 0.1 * scale


class Fetching(Counting):
    """An online catalog: fetched at first, from the cache afterwards."""

    name = "deep"

    def cone(self, center: Icrs, radius_deg: float, *, epoch_yr: float, mag_limit=None) -> Stars:
        how = "2 tiles from its cache" if self.asked else "2 tiles fetched from example.org"
        stars = super().cone(center, radius_deg, epoch_yr=epoch_yr, mag_limit=mag_limit)
        return replace(stars, steps=(f"deep: {how}",))


def test_the_solution_tells_that_its_stars_were_fetched_just_now(sky, stores):
    optics = PRESETS["mayaki-azt-3"]
    shelf = CatalogSet(embedded_catalog(), [], [Fetching(stores["gaia"])])
    verdict = solve(drawn(sky, optics, 30.0), shelf, hint=hinted(optics))
    assert verdict.solution is not None
    assert "deep: 2 tiles fetched from example.org" in verdict.solution.catalog_steps
    assert "deep: 2 tiles from its cache" in verdict.solution.catalog_steps


def test_a_narrow_frame_with_a_wide_hint_is_not_sought_over_the_whole_sky(sky, shelf, sky_index, monkeypatch):
    from mountnav.identification.blind import search

    asked: list[object] = []

    def watched(*args, **how):
        asked.append(how["center"])
        return real(*args, **how)

    real = search.blind_hypotheses
    monkeypatch.setattr(search, "blind_hypotheses", watched)
    optics = PRESETS["mayaki-azt-3"]
    wide = replace(hinted(optics), radius_deg=1.0)
    verdict = solve(drawn(sky, optics, 30.0), shelf, hint=wide, settings=SolveSettings(index=sky_index))
    assert verdict.solution is not None
    assert "Gaia" in verdict.solution.catalog
    assert None not in asked


@pytest.mark.long
def test_a_frame_wrongly_believed_narrow_is_still_found_over_the_whole_sky(sky, shelf, sky_index):
    believed_narrow = Hint(BELIEVED, 0.05, 0.5, 0.55)
    far = Icrs(200.0, 40.0)
    frame = drawn(sky, WIDE, 5.0, far)
    settings = SolveSettings(index=sky_index)
    verdict = solve(replace(frame, hint=Hint()), shelf, hint=believed_narrow, settings=settings)
    assert verdict.solution is not None
    assert verdict.solution.mode.startswith("blind")
    assert separation_arcsec(verdict.solution.center, far) < 0.5


@pytest.mark.long
@pytest.mark.parametrize("hint", [None, "here", "no scale"])
def test_what_was_ordered_is_used_or_the_frame_is_not_solved(sky, stores, sky_index, tmp_path, hint):
    """The index of Tycho-2 answers first, and its stars were taken though Gaia alone was ordered."""
    frame = drawn(sky, WIDE, 5.0)
    believed = {None: None, "here": hinted(WIDE), "no scale": Hint(BELIEVED, 0.25)}[hint]
    if hint is None:
        frame = replace(frame, hint=Hint())
    settings = SolveSettings(index=sky_index)
    ordered = CatalogSet(embedded_catalog(), [stores["gaia"]], use_indexed=False)
    solved = solve(frame, ordered, hint=believed, settings=settings).solution
    assert solved is not None
    assert solved.catalog == stores["gaia"].name
    assert separation_arcsec(solved.center, CENTER) < 0.5
    # a catalog that holds nothing there: of the pole only
    write_store(tmp_path / "pole.mnc", sky.as_catalog("gaia"), [(Icrs(0.0, 90.0), 0.5)])
    pole = CatalogSet(embedded_catalog(), [PackedStore(tmp_path / "pole.mnc")], use_indexed=False)
    refused = solve(frame, pole, hint=believed, settings=settings)
    assert refused.solution is None
    assert refused.reason is Reason.OTHER_CATALOG
    assert "finds it at RA 1" in refused.detail
    assert pole.stores[0].name in refused.detail


@pytest.mark.long
@pytest.mark.parametrize("hint", [None, "here"])
def test_an_online_catalog_alone_is_asked_or_the_frame_is_not_solved(sky, stores, sky_index, hint):
    frame = drawn(sky, WIDE, 5.0)
    believed = hinted(WIDE) if hint else None
    if hint is None:
        frame = replace(frame, hint=Hint())
    settings = SolveSettings(index=sky_index)
    online = Fetching(stores["gaia"])
    ordered = CatalogSet(embedded_catalog(), [], [online], use_indexed=False)
    assert ordered.installed == ()
    solved = solve(frame, ordered, hint=believed, settings=settings).solution
    assert solved is not None
    assert solved.catalog == "deep"
    assert any(step.startswith("deep: 2 tiles") for step in solved.catalog_steps)


@pytest.mark.long
def test_without_an_index_an_ordered_catalog_of_elsewhere_solves_nothing(sky, stores):
    pole = CatalogSet(embedded_catalog(), [stores["gaia"]], use_indexed=False)
    far = Icrs(200.0, 40.0)
    frame = drawn(sky, WIDE, 5.0, far)
    assert solve(frame, pole, hint=hinted(WIDE, far)).solution is None
