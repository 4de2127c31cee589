"""Names of stars by their places: moved to the epoch, and none where two could be meant."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pc
import pyarrow.parquet as pq
import pytest

from mountnav.archive.identifiers import NamedStars, named_stars, tycho_id
from mountnav.errors import BadRequest

# the first lines of tyc2.dat, as CDS has it; the last one without a mean place
TYC2 = (
    "0001 00008 1| |  2.31750494|  2.23184345|  -16.3|   -9.0| 68| 73| 1.7| 1.8|"
    "1958.89|1951.94| 4|1.0|1.0|0.9|1.0|12.146|0.158|12.146|0.223|999|"
    " |         |  2.31754222|  2.23186444|1.67|1.54| 88.0|100.8| |-0.2",
    "0001 00013 1| |  1.12558209|  2.26739400|   27.7|   -0.5|  9| 12| 1.2| 1.2|"
    "1990.76|1989.25| 8|1.0|0.8|1.0|0.7|10.488|0.038| 8.670|0.015|999|"
    "T|         |  1.12551889|  2.26739556|1.81|1.52|  9.3| 12.7| |-0.2",
    "0001 00016 1|X|            |            |       |       |   |   |    |    |"
    "       |       |  |   |   |   |   |12.921|0.335|12.100|0.243|999|"
    " |         |  1.05686490|  1.89782870|1.61|1.55| 99.9|101.1| | 0.1",
)


def test_a_line_of_tycho_2_is_read_with_its_number_and_place(tmp_path: Path) -> None:
    path = tmp_path / "tyc2.dat.00"
    path.write_text("\n".join(TYC2) + "\n")
    stars = named_stars(path)
    names, apart = stars.named(
        np.array([2.31750494, 1.12558209, 1.0568649, 5.0]),
        np.array([2.23184345, 2.267394, 1.8978287, 5.0]),
        2000.0,
    )
    assert names == ["TYC 1-8-1", "TYC 1-13-1", "TYC 1-16-1", None]
    assert apart[:3].max() < 1e-6
    (tmp_path / "tyc2.dat.01.gz").write_bytes(gzip.compress(path.read_bytes()))
    assert len(named_stars(tmp_path / "tyc2.dat.01.gz")) == 3


def test_fast_stars_are_found_where_they_have_gone(tmp_path: Path) -> None:
    # Barnard's star as Gaia DR3 has it, and two that stand still: near its place of 2016 and that of 2026
    near_deg = 269.4485025 + 0.5 / 3600
    table = {
        "source_id": [4472832130942575872, 1, 2],
        "ra": [269.4485025, near_deg, 269.446],
        "dec": [4.7394201, 4.7394201, 4.7681],
        "pmra": [-801.551, 0.0, 0.0],
        "pmdec": [10362.394, 0.0, 0.0],
        "ref_epoch": [2016.0] * 3,
    }
    pq.write_table(pa.table(table), tmp_path / "gaia.parquet")
    stars = named_stars(tmp_path / "gaia.parquet")
    there = 269.4485025 - 0.801551 * 10 / 3600 / np.cos(np.radians(4.7394)), 4.7394201 + 10.362394 * 10 / 3600
    names, _ = stars.named(np.array([there[0], near_deg]), np.array([there[1], 4.7394201]), 2026.0)
    assert names == ["Gaia DR3 4472832130942575872", "Gaia DR3 1"]


def test_a_doubtful_star_has_no_name() -> None:
    zero = np.zeros(3)
    stars = NamedStars.of(
        np.array([1, 2, 3]),
        np.array([10.0, 10.0 + 1e-4, 20.0]),
        zero,
        zero,
        zero,
        epoch_yr=2016.0,
        prefix="Gaia DR3",
    )
    names, apart = stars.named(np.array([10.0, 20.0, 20.0001, 30.0]), np.zeros(4), 2016.0)
    assert names == [None, None, None, None]  # two could be meant; two would be called 3; nothing is there
    assert np.isnan(apart).all()


def test_tables_of_vizier_and_files_that_are_none(tmp_path: Path) -> None:
    columns = {"TYC1": [5949], "TYC2": [2777], "TYC3": [1], "RAmdeg": [101.2], "DEmdeg": [-16.7]}
    pc.write_csv(pa.table(columns), tmp_path / "tyc.csv")
    (name,) = named_stars(tmp_path / "tyc.csv").named(np.array([101.2]), np.array([-16.7]), 2000.0)[0]
    assert name == "TYC 5949-2777-1"
    assert tycho_id(5949, 2777, 1) == 5949027771
    columns = {"source_id": [1, 2], "ra": [1.0, 2.0], "dec": [1.0, 2.0], "ref_epoch": [2016.0, 2015.5]}
    pc.write_csv(pa.table(columns), tmp_path / "mixed.csv")
    (tmp_path / "odd.csv").write_text("a,b\n1,2\n")
    (tmp_path / "odd.dat").write_text("1|2|3\n")
    (tmp_path / "odd.parquet").write_text("no")
    for word, why in (("mixed.csv", "ref_epoch"), ("odd.csv", "neither"), ("odd.dat", "3 fields")):
        with pytest.raises(BadRequest, match=why):
            named_stars(tmp_path / word)
    with pytest.raises(BadRequest, match="can't be read"):
        named_stars(tmp_path / "odd.parquet")
