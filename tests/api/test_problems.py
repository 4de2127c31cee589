"""Problems: each error of ours has a slug that is told, a status, and where it may pass a time to wait."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from api.problems import RETRY_AFTER_S, SLUGS, STATUS_OF_SLUG, problem, problem_of, problem_response
from mountnav import errors
from mountnav.errors import Busy, DeviceSilent, LimitKind, MountnavError, OutsideLimits

ROOT = Path(__file__).parents[2]
FAMILIES = {"error", "sky-error", "user-error"}
"""Raised by nobody: their children are."""


def _kinds(base: type[MountnavError]) -> Iterator[type[MountnavError]]:
    for one in base.__subclasses__():
        if one.__module__.startswith(("mountnav.errors", "mountnav.navigation", "mountnav.journal")):
            yield one
        yield from _kinds(one)


def test_each_error_has_a_status_and_a_title() -> None:
    slugs = {one.slug for one in _kinds(MountnavError)} - FAMILIES
    assert len(slugs) > 15
    assert slugs <= set(STATUS_OF_SLUG), slugs - set(STATUS_OF_SLUG)
    assert set(STATUS_OF_SLUG) <= SLUGS
    assert set(RETRY_AFTER_S) <= SLUGS


def test_every_slug_that_the_code_names_is_known_and_described() -> None:
    named = set()
    for file in (ROOT / "api").rglob("*.py"):
        named |= set(re.findall(r'problem\(\s*"([a-z-]+)"', file.read_text(encoding="utf-8")))
    assert {"busy", "unauthorized", "leased", "not-ready"} - named == {"busy"}, "the pattern finds them"
    assert named <= SLUGS, named - SLUGS
    told = (ROOT / "docs" / "reference" / "api.md").read_text(encoding="utf-8")
    missing = sorted(slug for slug in SLUGS if f"`{slug}`" not in told)
    assert missing == []


@pytest.mark.parametrize("slug", sorted(STATUS_OF_SLUG))
def test_what_may_pass_says_when_to_ask_again_and_the_rest_does_not(slug: str) -> None:
    passing = problem(slug, 409, "it happened", retryable=True)
    assert passing.retry_after_s is not None
    assert passing.retry_after_s > 0
    answer = problem_response(passing)
    assert int(answer.headers["retry-after"]) >= passing.retry_after_s
    lasting = problem(slug, 409, "it happened", retry_after_s=3.0)
    assert lasting.retry_after_s is None
    assert "retry-after" not in problem_response(lasting).headers


def test_a_problem_names_the_device_what_to_do_and_for_programs_why() -> None:
    found = problem_of(OutsideLimits("too low", device="east", advice="wait", limit=LimitKind.HORIZON))
    assert (found.type, found.status, found.retryable) == ("urn:mountnav:problem:outside-limits", 422, False)
    assert (found.device, found.advice, found.reasons) == ("east", "wait", ["horizon"])
    assert problem_of(DeviceSilent("nothing")).retry_after_s == RETRY_AFTER_S["device-silent"]
    assert problem_of(Busy("a job runs")).retryable is True
    assert errors.BadSettings.slug in SLUGS
