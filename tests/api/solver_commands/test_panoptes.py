"""POCS' way to solve (`panoptes.utils.images.fits.get_solve_field`), the real one, with our `solve-field`.

It brings matplotlib along, and pins nothing of ours: so it may live in another environment, whose interpreter
`MOUNTNAV_PANOPTES_PYTHON` names.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec
from tests.api.solver_commands.fields import (
    CENTER,
    SCALE_ARCSEC_PX,
    environment,
    executables,
    fits_field,
    pixels,
)

PYTHON = os.environ.get("MOUNTNAV_PANOPTES_PYTHON", sys.executable)
SCRIPT = """
import json, sys
from panoptes.utils.images.fits import get_solve_field
found = get_solve_field(sys.argv[1], timeout=300, **json.loads(sys.argv[2]))
print(json.dumps({key: found[key] for key in ("CRVAL1", "CRVAL2", "solved_fits_file")}))
"""


def solved(field: Path, folder: Path, **options: object) -> dict[str, object]:
    """What `get_solve_field` returns."""
    commands = executables(folder / "bin", "solve-field")
    done = subprocess.run(
        [PYTHON, "-c", SCRIPT, str(field), json.dumps(options)],
        env={key: value for key, value in environment(commands).items() if key != "PYTHONPATH"},
        capture_output=True,
        text=True,
        check=False,
        cwd=folder,
    )
    assert done.returncode == 0, done.stderr
    found: dict[str, object] = json.loads(done.stdout.splitlines()[-1])
    return found


@pytest.mark.long
@pytest.mark.parametrize("options", [{}, {"ra": 83.0, "dec": 21.5, "radius": 5}])
def test_get_solve_field_puts_the_plate_into_the_file(tmp_path: Path, options: dict[str, object]) -> None:
    there = subprocess.run(
        [PYTHON, "-c", "import panoptes.utils.images.fits"], capture_output=True, check=False
    )
    if there.returncode != 0:
        pytest.skip(
            "panoptes-utils is not installed; MOUNTNAV_PANOPTES_PYTHON names an interpreter that has it"
        )
    field = fits_field(tmp_path / "field.fits", pixels())
    found = solved(field, tmp_path, **options)
    assert found["solved_fits_file"] == str(field)
    center = Icrs(float(str(found["CRVAL1"])), float(str(found["CRVAL2"])))
    assert separation_arcsec(center, CENTER) < 0.02 * SCALE_ARCSEC_PX
    # the new file has taken the place of the old one, and nothing else is left
    assert {path.name for path in tmp_path.iterdir()} == {"field.fits", "bin"}
