"""What a caller's key is for, asked without any server: telescopes, roles, folders of files."""

from __future__ import annotations

from pathlib import Path

import pytest

from api.access.callers import Caller, Face, Role
from api.access.security import allowed_file, require_all_telescopes, require_role, require_telescope
from api.problems import Refused
from mountnav.errors import BadRequest, NotFound


def caller(
    role: Role = Role.OPERATE, face: Face = Face.REST, telescopes: tuple[str, ...] | None = None
) -> Caller:
    return Caller("ann", role, face, telescopes=None if telescopes is None else frozenset(telescopes))


def test_a_key_for_one_telescope_is_for_no_other_and_not_for_all() -> None:
    of_east = caller(telescopes=("east",))
    require_telescope(of_east, "east")
    with pytest.raises(Refused) as other:
        require_telescope(of_east, "west")
    with pytest.raises(Refused) as every:
        require_all_telescopes(of_east)
    assert {one.value.problem.status for one in (other, every)} == {403}
    assert "for other telescopes" in other.value.problem.detail
    assert "for some telescopes only" in every.value.problem.detail
    require_telescope(caller(), "west")
    require_all_telescopes(caller())


@pytest.mark.parametrize(("face", "advice"), [(Face.REST, "use a key"), (Face.LX200, "read_only")])
def test_a_role_that_is_too_low_is_told_with_what_would_do(face: Face, advice: str) -> None:
    require_role(caller(Role.CONFIGURE, face), Role.OPERATE)
    with pytest.raises(Refused) as low:
        require_role(caller(Role.VIEW, face), Role.OPERATE)
    assert low.value.problem.type.endswith(":role-too-low")
    assert advice in str(low.value.problem.advice)


def test_files_are_taken_from_the_folders_alone(tmp_path: Path) -> None:
    inside, outside = tmp_path / "frames", tmp_path / "secret"
    inside.mkdir()
    outside.write_text("key")
    (inside / "a.fits").write_text("a")
    (inside / "link").symlink_to(outside)
    loop = inside / "loop"
    loop.symlink_to(loop)

    def asked(name: str) -> Path:
        return allowed_file(inside / name, [tmp_path / "none", inside], telescope_id="east")

    assert asked("a.fits") == (inside / "a.fits").resolve()
    for name in ("../secret", "link"):
        with pytest.raises(BadRequest, match="not in a folder"):
            asked(name)
    with pytest.raises(NotFound):
        asked("b.fits")
    with pytest.raises(BadRequest, match="empty or invalid"):
        asked("a\0b")
    with pytest.raises((BadRequest, NotFound)):
        # resolved by Python 3.13, refused by those before
        asked("loop")
