"""The examples in the description of the interface are what the models take and give."""

from __future__ import annotations

import json
from collections.abc import Iterator

import pytest
from pydantic import BaseModel, TypeAdapter

import api.http.app  # every model of the interface is loaded with it
from api.http.examples import BODIES, answers
from api.http.night_views import FramePathBody
from api.http.openapi import FROZEN_PATH
from api.http.routes.frames import PATH_EXAMPLE
from api.orders.vocabulary import JOB_EXAMPLES, Order

assert api.http.app
LARGEST_BYTES = 6000
"""Of an example: what a reader of the description still scrolls through."""


def _models(of: type[BaseModel] = BaseModel) -> Iterator[type[BaseModel]]:
    for model in of.__subclasses__():
        yield model
        yield from _models(model)


MODELS = {model.__name__: model for model in _models()}


@pytest.mark.parametrize("name", sorted({**BODIES, **answers()}))
def test_an_example_is_what_its_model_takes(name: str) -> None:
    example = {**answers(), **BODIES}[name]
    assert isinstance(MODELS[name].model_validate_json(json.dumps(example)), MODELS[name])
    assert len(json.dumps(example)) < LARGEST_BYTES


@pytest.mark.parametrize("name", sorted(JOB_EXAMPLES))
def test_an_order_s_example_is_an_order(name: str) -> None:
    order = TypeAdapter(Order).validate_python(JOB_EXAMPLES[name]["value"])
    assert order.kind == JOB_EXAMPLES[name]["value"]["kind"]


def test_the_example_of_a_frame_s_path_is_one() -> None:
    assert FramePathBody.model_validate(PATH_EXAMPLE).path == PATH_EXAMPLE["path"]


def test_every_json_body_and_the_main_answers_have_an_example() -> None:
    described = json.loads(FROZEN_PATH.read_text(encoding="utf-8"))
    schemas = described["components"]["schemas"]
    bare, answered = [], set()
    for path, operations in described["paths"].items():
        for method, operation in operations.items():
            about = operation.get("requestBody", {}).get("content", {}).get("application/json")
            if about is not None and "examples" not in about:
                name = about["schema"].get("$ref", "").rsplit("/", 1)[-1]
                if "examples" not in schemas.get(name, about["schema"]):
                    bare.append(f"{method} {path}")
            for status, answer in operation["responses"].items():
                if status.startswith("2"):
                    about = answer.get("content", {}).get("application/json", {})
                    answered.add(about.get("schema", {}).get("$ref", "").rsplit("/", 1)[-1])
    assert bare == []
    shown = {name for name in answered if "examples" in schemas.get(name, {})}
    assert {"JobView", "TelescopeView", "StopView", "StopAllView", "LeaseView", "HealthView"} <= shown
    assert len(shown) >= 15
