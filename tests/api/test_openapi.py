"""The interface is frozen: a change of it is a decision, not an accident."""

from __future__ import annotations

import json

from api.openapi import FROZEN_PATH, openapi_text


def test_the_interface_is_as_frozen() -> None:
    frozen = FROZEN_PATH.read_text(encoding="utf-8")
    assert openapi_text() == frozen, "meant? then run: python -m api.openapi"


def test_operation_ids_are_plain_names_and_differ() -> None:
    paths = json.loads(openapi_text())["paths"]
    names = [operation["operationId"] for path in paths.values() for operation in path.values()]
    assert len(set(names)) == len(names)
    assert {
        "center_telescope",
        "stop_telescope",
        "get_job",
        "cancel_job",
        "follow_events",
        "solve_upload",
    } <= set(names)


def test_every_problem_is_described_as_problem_json() -> None:
    paths = json.loads(openapi_text())["paths"]
    for path in paths.values():
        for operation in path.values():
            for status, answer in operation["responses"].items():
                if int(status) >= 400:
                    assert list(answer["content"]) == ["application/problem+json"], operation["operationId"]
