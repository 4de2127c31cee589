"""What a telescope is called as an INDI device; what ON_COORD_SET is for whom: pure."""

from __future__ import annotations

from api.indi_server.device import device_names
from api.indi_server.parser import Asked
from api.indi_server.publisher import LeftSelections, Publisher, Selections
from mountnav.settings.observatory import Settings
from tests.api.indi_server.face_rig import OBSERVATORY


def test_what_was_left_behind_counts_for_its_machine_and_for_a_while() -> None:
    now_s = 0.0
    left = LeftSelections(lambda: now_s)
    one, there, elsewhere = (Selections(left, host) for host in ("10.0.0.1", "10.0.0.1", "10.0.0.2"))
    one.choose("east", "SYNC")
    assert there.of("east") == "TRACK"
    one.leave()
    assert (there.of("east"), there.of("west"), elsewhere.of("east")) == ("SYNC", "TRACK", "TRACK")
    # somebody there has chosen since
    there.choose("east", "TRACK")
    assert Selections(left, "10.0.0.1").of("east") == "TRACK"
    there.choose("east", "SYNC")
    there.leave()
    assert there.of("east") == "SYNC"
    now_s = 301.0
    assert there.of("east") == "TRACK"
    # SLEW and TRACK are not worth keeping: both are gotos
    one.choose("east", "SLEW")
    one.leave()
    assert there.of("east") == "TRACK"


def test_two_telescopes_of_one_name_are_two_devices() -> None:
    def names(east: str, gone: str) -> dict[str, str]:
        named = OBSERVATORY.replace('id = "east"', f'id = "east"\n{east}')
        return device_names(Settings.parse(named.replace('id = "gone"', f'id = "gone"\n{gone}')).telescope)

    assert names("", 'name = "Far"') == {"east": "east", "gone": "Far"}
    assert names('name = "Tube"', 'name = "Tube"') == {"east": "Tube (east)", "gone": "Tube (gone)"}
    assert names('name = "gone"', "") == {"east": "gone (east)", "gone": "gone (gone)"}


def test_questions_about_nothing_are_not_remembered_without_end() -> None:
    telling = Publisher({}, Selections(LeftSelections(), "10.0.0.1"))
    for which in range(3000):
        telling.ask(Asked("nobody", f"NOTHING_{which}"))
    assert len(telling._asked) == 1000
