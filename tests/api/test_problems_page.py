"""The page of problems has each slug with its status, cause and cure, and each reason."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from api.problems import SLUGS, STATUS_OF_SLUG
from mountnav import errors
from mountnav.errors import LimitKind, MountnavError, NotReached, Refusal, SyncDoubt
from mountnav.solution import Reason

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "reference" / "problems.md").read_text(encoding="utf-8")
SECTIONS = {
    section.partition("`")[0]: section
    for section in re.split(r"^### `(?=[a-z-]+`$)", PAGE, flags=re.MULTILINE)[1:]
}


def test_each_problem_has_its_section_and_no_other() -> None:
    assert set(SECTIONS) == SLUGS


@pytest.mark.parametrize("slug", sorted(SLUGS))
def test_a_section_tells_status_cause_and_cure(slug: str) -> None:
    section = SECTIONS[slug]
    if slug in STATUS_OF_SLUG:
        assert f"Status {STATUS_OF_SLUG[slug]}" in section
    for word in ("Cause", "Cure"):
        told = re.search(rf"^\*\*{word}\.\*\* (.+)$", section, re.MULTILINE)
        assert told is not None, word
        assert len(told[1]) > 10


def test_what_may_be_tried_again_is_said_to_be_retryable() -> None:
    kinds = [one for one in vars(errors).values() if isinstance(one, type) and issubclass(one, MountnavError)]
    passing = {one.slug for one in kinds if one.retryable}
    lasting = {one.slug for one in kinds} - passing
    assert len(passing) > 5
    told = {slug for slug, section in SECTIONS.items() if re.search(r"Status .*retryable", section)}
    assert passing - told == set()
    assert lasting & told == set()


def test_each_reason_is_told() -> None:
    reasons = PAGE[PAGE.index("\n## Reasons") :]
    for kind in (Refusal, LimitKind, NotReached):
        assert [one.value for one in kind if f"`{one.value}`" not in reasons] == [], kind
    assert [one.value for one in Reason if f"| {one.value} |" not in reasons] == []
    syncing = (DOCS / "explanation" / "syncing.md").read_text(encoding="utf-8")
    assert [one.value for one in SyncDoubt if f"`{one.value}`" not in syncing] == []


def test_the_api_s_table_leads_to_the_page() -> None:
    assert "(problems.md)" in (DOCS / "reference" / "api.md").read_text(encoding="utf-8")
