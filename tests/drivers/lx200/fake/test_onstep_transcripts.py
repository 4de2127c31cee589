"""The fake OnStep against the recorded dialogue of INDI's driver: all is answered, in the recorded shape."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from drivers.lx200.codec.onstep import STATUS
from tests.drivers.lx200.german_fakes import german

# what the firmware's source has otherwise than the mount of the recording
_OTHER_IN_SOURCE = {
    b":GX98#": b"N#",
    b":GXY0#": b"00000000#",
    b":GXU1#": b"#",
    b":GXU2#": b"#",
    b":GX96#": b"B#",
    b":A?#": b"600#",
    b":GM#": b"None#",
}


def shape(reply: bytes) -> str:
    """Nothing, a bare character, or a text with its end."""
    if not reply:
        return "nothing"
    return "text" if reply.endswith(b"#") else f"{len(reply)} bare"


@pytest.mark.shared
def test_everything_the_real_driver_said_is_answered_in_shape(shared: Path) -> None:
    fake = german("onstep", lowest_altitude_deg=-90.0)
    entries = (shared / "protocols" / "transcripts" / "lx200_OnStep.jsonl").read_text("utf-8").splitlines()
    pairs: list[tuple[bytes, bytes]] = []
    for entry in map(json.loads, entries):
        if entry["dir"] == "driver->mount":
            pairs.append((bytes.fromhex(entry["hex"]), b""))
        elif entry["dir"] == "mount->driver":
            pairs[-1] = (pairs[-1][0], pairs[-1][1] + bytes.fromhex(entry["hex"]))
    assert len(pairs) > 800
    exact = set()
    for command, recorded in pairs:
        answer = fake.feed(command)
        assert shape(answer) == shape(recorded), command
        if command == b":GU#":
            assert STATUS.read(answer, False) is not None
            assert STATUS.read(recorded, False) is not None
        elif command in _OTHER_IN_SOURCE:
            assert answer == _OTHER_IN_SOURCE[command]
        elif command[:2] == b":S" or command[:2] == b":M" or command in (b":CM#", b":Te#", b":Td#"):
            # orders may be refused: the recorded mount stood elsewhere, and slewed at once
            exact.add((command, answer == recorded))
    assert fake.unknown == []
    assert {command for command, same in exact if same} >= {b":Te#", b":Td#", b":SG-02:00#", b":SC11/21/26#"}


@pytest.mark.shared
def test_site_and_zone_are_told_as_recorded(shared: Path) -> None:
    fake = german("onstep")
    assert fake.feed(b":GtH#") == b"+49*36:00.000#"
    assert fake.feed(b":GgH#") == b"-036*54:00.000#"
    assert fake.feed(b":Gt#:Gg#:Gc#") == b"+49*36#-036*54#24#"
    assert fake.feed(b":Sg323:06:0.00#:St+49:36:0.00#:SG-02:00#:GG#") == b"111-02:00#"
    assert fake.feed(b":GgH#") == b"-036*54:00.000#"
