"""What is remembered, whose it is, and when it is forgotten."""

from __future__ import annotations

import tempfile
from datetime import UTC, datetime
from typing import Any

import pytest

from api.access.callers import Caller, Face, Role
from api.nova import submissions as room
from api.nova.codec import Asked, NovaError
from api.nova.submissions import Session, Sessions, Submission, Submissions

NOW = datetime(2026, 11, 22, tzinfo=UTC)
KEEP_S = 3600.0


class Clock:
    def __init__(self) -> None:
        self.s = 0.0

    def __call__(self) -> float:
        return self.s


def session(address: str = "10.0.0.1", key: str | None = None) -> Session:
    return Session("secret", Caller("somebody", Role.SOLVE, Face.NOVA, address), key, 0.0)


def added(store: Submissions, by: Session, size: int = 10) -> Submission:
    image = tempfile.TemporaryFile()  # noqa: SIM115
    image.write(b"x" * size)
    image.flush()
    return store.add(by, Asked(), name="a", sha256="", picture=False, image=image)


def test_ids_are_random_fit_31_bits_and_are_never_given_twice() -> None:
    store = Submissions(KEEP_S, 4, Clock())
    made = [added(store, session()) for _ in range(100)]
    ids = [number for one in made for number in (one.id, one.job_id, one.image_id, one.calibration_id)]
    assert len(set(ids)) == len(ids)
    assert all(0 < number < 2**31 for number in ids)
    assert max(ids) > 2**28
    assert ids != sorted(ids)
    store.close()


def test_somebody_elses_is_not_there() -> None:
    store = Submissions(KEEP_S, 4, Clock())
    one = added(store, session("10.0.0.1"))
    keyed = added(store, session("10.0.0.1", "ab" * 32))
    assert store.of(one.id, None, "10.0.0.1") is store.of_job(one.job_id, None, "10.0.0.1") is one
    # by its key a client finds it from elsewhere too, in another session
    assert store.of(keyed.id, session("10.9.9.9", "ab" * 32), "10.9.9.9") is keyed
    assert store.of_session(session("10.9.9.9", "ab" * 32)) == [keyed]
    for number, by, address in (
        (one.id, None, "10.0.0.2"),
        (one.id, session("10.0.0.2"), "10.0.0.2"),
        # the session counts, where one is shown, and not the address
        (keyed.id, session("10.0.0.1", "cd" * 32), "10.0.0.1"),
        (keyed.id, session("10.0.0.1"), "10.0.0.1"),
        (one.id + 1, None, "10.0.0.1"),
        (one.job_id, None, "10.0.0.1"),
    ):
        with pytest.raises(NovaError) as refused:
            store.of(number, by, address)
        assert refused.value.status == 404
    store.close()


def test_all_is_forgotten_in_time_but_what_is_under_way() -> None:
    clock = Clock()
    store = Submissions(KEEP_S, 4, clock)
    done, under_way = added(store, session()), added(store, session())
    done.fail("no stars", NOW, "")
    image = done.image
    clock.s = KEEP_S + 1
    with pytest.raises(NovaError):
        store.of(done.id, None, "10.0.0.1")
    store.forget()
    assert list(store) == [under_way]
    assert image is not None
    assert image.closed
    store.close()
    assert under_way.image is None


def test_images_are_bounded_in_number_and_in_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    store = Submissions(KEEP_S, 3, Clock())
    made = [added(store, session()) for _ in range(6)]
    for one in made:
        one.fail("", NOW, "")
    store.forget()
    assert [one.image is not None for one in made] == [False] * 3 + [True] * 3
    monkeypatch.setattr(room, "_IMAGES_BYTES", 15)
    store.forget()
    assert [one.image is not None for one in made] == [False] * 5 + [True]
    # what came of them is still known
    assert len(store) == 6
    store.close()


def test_submissions_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(room, "_SUBMISSIONS_MOST", 5)
    store = Submissions(KEEP_S, 3, Clock())
    for _ in range(20):
        added(store, session()).fail("", NOW, "")
    assert len(store) == 5
    store.close()


def test_sessions_end_with_their_time_their_key_and_their_number(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, good = Clock(), {"yes"}
    kept = Sessions(KEEP_S, lambda one: one.key_sha256 in good, clock)
    caller = Caller("somebody", Role.SOLVE, Face.NOVA, "10.0.0.1")
    one = kept.begin(caller, "yes")
    assert kept.of(one.secret) is one
    nothings: tuple[Any, ...] = (None, 5, "", "x", [one.secret], {})
    for nothing in nothings:
        assert kept.of(nothing) is None
    clock.s += KEEP_S - 1
    assert kept.of(one.secret) is one
    clock.s += KEEP_S - 1
    assert kept.of(one.secret) is one, "its time counts from its last use"
    good.clear()
    assert kept.of(one.secret) is None, "its key was revoked"
    good.add("yes")
    late = kept.begin(caller, "yes")
    clock.s += KEEP_S + 1
    kept.forget()
    assert len(kept) == 0
    assert kept.of(late.secret) is None
    monkeypatch.setattr(room, "_SESSIONS_MOST", 3)
    secrets = [kept.begin(caller, "yes").secret for _ in range(5)]
    assert [kept.of(secret) is not None for secret in secrets] == [False, False, True, True, True]
