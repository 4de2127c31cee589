"""The interface is frozen: a change of it is a decision, not an accident."""

from __future__ import annotations

import json
import re
from functools import cache
from typing import Any

import pytest

from api.http import field_words, openapi
from api.http.openapi import FROZEN_PATH
from api.http.operation_words import OPERATIONS

openapi_text = cache(openapi.openapi_text)  # a second of CPU each time


@pytest.mark.long
def test_the_interface_is_as_frozen() -> None:
    frozen = FROZEN_PATH.read_text(encoding="utf-8")
    assert openapi_text() == frozen, "meant? then run: python -m api.http.openapi"


@pytest.mark.long
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


def test_what_generators_of_clients_need_to_keep_every_route() -> None:
    """Of two schemas with one name they keep one, and lose all routes that speak of the other.

    A route whose body has a content type that they don't know is lost as well.
    """
    description = json.loads(openapi_text())
    schemas = description["components"]["schemas"]
    assert [name for name in schemas if "__" in name] == []
    titles = [schema.get("title", name) for name, schema in schemas.items()]
    assert len(set(titles)) == len(titles)
    known = {"application/json", "application/octet-stream", "multipart/form-data"}
    for path, operations in description["paths"].items():
        for method, operation in operations.items():
            content = operation.get("requestBody", {}).get("content", {})
            assert set(content) <= known, (method, path, set(content))
            for of_one in re.findall(r'"\$ref": "#/components/schemas/([^"]+)"', json.dumps(operation)):
                assert of_one in schemas, (method, path, of_one)


def test_every_reference_leads_somewhere() -> None:
    """Generators of other languages give up at the first one that doesn't."""
    text = FROZEN_PATH.read_text(encoding="utf-8")
    description = json.loads(text)
    led = set(re.findall(r'"(#/[^"]+)"', text))
    assert len(led) > 100
    for reference in led:
        at = description
        for part in reference[2:].split("/"):
            assert part in at, reference
            at = at[part]


def test_each_operation_field_and_parameter_is_described() -> None:
    description = json.loads(openapi_text())
    bare = [
        f"{name}.{field}"
        for name, schema in description["components"]["schemas"].items()
        for field, about in schema.get("properties", {}).items()
        if not about.get("description", "").strip()
    ]
    operations = [one for path in description["paths"].values() for one in path.values()]
    assert len(operations) > 60
    for operation in operations:
        bare += [operation["operationId"]] * (
            not operation.get("summary") or not operation.get("description")
        )
        for parameter in operation.get("parameters", ()):
            if not parameter.get("description", "").strip():
                bare.append(f"{operation['operationId']}({parameter['name']})")
    assert bare == []


def test_each_operation_says_in_words_what_it_does_and_what_comes_back() -> None:
    description = json.loads(openapi_text())
    summaries = []
    for path, operations in description["paths"].items():
        for method, operation in operations.items():
            name = operation["operationId"]
            assert name in OPERATIONS, f"{method} {path}: no words in api/http/operation_words.py"
            summaries.append(operation["summary"])
            assert operation["summary"].lower().replace(" ", "_") != name
            assert len(operation["description"]) > 60, name
            assert re.search(r"Needs (no key|the role `[a-z]+`)\.$", operation["description"]), name
            for status, answer in operation["responses"].items():
                assert answer["description"] not in ("", "Successful Response"), (name, status)
            if "requestBody" in operation:
                assert operation["requestBody"]["description"], name
            for parameter in operation.get("parameters", ()):
                schema = parameter["schema"]
                told = "example" in parameter or {"boolean", "enum"} & {schema.get("type"), *schema}
                assert told or "anyOf" in schema, f"{name}({parameter['name']}) has no example"
    assert len(set(summaries)) == len(summaries)


@pytest.mark.long
def test_the_example_of_each_parameter_is_one() -> None:
    description = json.loads(openapi_text())
    for operations in description["paths"].values():
        for operation in operations.values():
            for parameter in operation.get("parameters", ()):
                if "example" in parameter:
                    kinds = parameter["schema"].get("anyOf", [parameter["schema"]])
                    assert any(fits(parameter["example"], kind) for kind in kinds), (
                        operation["operationId"],
                        parameter["name"],
                    )


def fits(value: Any, schema: dict[str, Any]) -> bool:
    """Whether a value is as a parameter's schema wants it: of the words that ours use."""
    kinds: dict[str, type | tuple[type, ...]] = {
        "string": str,
        "number": (int, float),
        "integer": int,
        "array": list,
    }
    if schema["type"] not in kinds or not isinstance(value, kinds[schema["type"]]):
        return False
    if isinstance(value, str):
        return bool(re.search(schema.get("pattern", ""), value)) and len(value) <= schema.get(
            "maxLength", 999
        )
    if isinstance(value, list):
        return all(fits(one, schema["items"]) for one in value)
    least = value > schema.get("exclusiveMinimum", -1e9) and value >= schema.get("minimum", -1e9)
    return bool(least and value < schema.get("exclusiveMaximum", 1e9) and value <= schema.get("maximum", 1e9))


def test_no_word_about_an_operation_that_is_gone() -> None:
    paths = json.loads(openapi_text())["paths"]
    there = {operation["operationId"] for path in paths.values() for operation in path.values()}
    # those of a virtual observatory, which the frozen description has not
    assert set(OPERATIONS) - there == {"get_truth", "skip_time"}


def test_no_word_about_a_field_that_is_gone() -> None:
    schemas = json.loads(openapi_text())["components"]["schemas"]
    there = {field for schema in schemas.values() for field in schema.get("properties", {})}
    there |= {f"{name}.{field}" for name, schema in schemas.items() for field in schema.get("properties", {})}
    assert sorted(set(field_words._FIELDS) - there) == []
