"""The error tree: one name each, and what each says."""

from __future__ import annotations

import re
from collections.abc import Iterator

import pytest

from mountnav.errors import DeviceError, MountnavError, SkyError, UserError


def _below(kind: type[MountnavError]) -> Iterator[type[MountnavError]]:
    for one in kind.__subclasses__():
        if one.__module__ == "mountnav.errors":
            yield one
            yield from _below(one)


# a kind of another error may share its slug (`JournalDamaged` is a journal that failed)
KINDS = sorted(
    {kind for kind in _below(MountnavError) if "slug" in vars(kind)}, key=lambda kind: kind.__name__
)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_an_error_has_one_name_in_code_and_on_the_web(kind: type[MountnavError]) -> None:
    assert kind.slug == re.sub(r"(?<!^)(?=[A-Z])", "-", kind.__name__).lower()


def test_no_two_errors_share_a_name() -> None:
    assert len({kind.slug for kind in KINDS}) == len(KINDS) >= 25


def test_the_tree_at_the_head_of_the_file_names_each_error() -> None:
    import mountnav.errors

    text = mountnav.errors.__doc__ or ""
    told = dict(re.findall(r"── (\w+) +([a-z-]+) +(?:yes|no) ", text))
    named = {kind.__name__: kind.slug for kind in KINDS if kind not in (DeviceError, SkyError, UserError)}
    assert named == told
