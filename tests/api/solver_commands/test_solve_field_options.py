"""What `solve-field` understands of its options' values: as C's `atof` reads them."""

from __future__ import annotations

import pytest

from api.solver_commands.solve_field_options import _number


@pytest.mark.parametrize(
    ("text", "value"),
    [("5", 5.0), (" -2.5e1deg", -25.0), ("none", 0.0), ("1e999", 0.0), ("\x1c5", 0.0), ("\u0663", 0.0)],
)
def test_a_number_is_read_as_far_as_it_goes(text: str, value: float) -> None:
    # \x1c is white space to a pattern and none to `float`; no option ends in a traceback
    assert _number(text) == value
