"""Write the Python client's orders (`mountnav/client/orders.py`) from the service's own vocabulary.

Run: python -m tools.client_orders
"""

from __future__ import annotations

import subprocess
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic.fields import FieldInfo

from api.orders.targets import Body, Instant, Tagged
from api.orders.vocabulary import KINDS, OrderBody, PixelAt

PATH = Path(__file__).resolve().parents[1] / "mountnav" / "client" / "orders.py"
_WIDTH = 110
_AT = "At"

_HEAD = '''"""Orders, a function for each kind of job; `Client.order` gives them. What is left out is as set.

Made from the orders of the service by `python -m tools.client_orders`: change them in
`api/orders/vocabulary.py`.
"""

from __future__ import annotations

from datetime import datetime
from typing import Any, Literal

from mountnav.client.targets import Target, instant

Order = dict[str, Any]


def _order(kind: str, fields: dict[str, Any]) -> Order:
    """An order of what a caller gave: what is None was left out."""
    given = {name: value for name, value in fields.items() if value is not None}
    return {"kind": kind} | {
        name: instant(value) if isinstance(value, datetime) else value for name, value in given.items()
    }


At = str | dict[str, float]
"""A named point of the telescope, or a pixel: ``{"x_px": 100.0, "y_px": 200.0}``, from 0."""
'''


def _members(annotation: object) -> Iterator[object]:
    """The members of a union, or the one type that it is; constraints are left away, but for an instant's."""
    if annotation == Instant:
        yield Instant
    elif get_origin(annotation) is Annotated:
        yield from _members(get_args(annotation)[0])
    elif get_origin(annotation) in (Union, UnionType):
        for member in get_args(annotation):
            yield from _members(member)
    else:
        yield annotation


def _word(member: object) -> str:
    """One type, as a caller writes it."""
    if member == Instant:
        return "datetime | str"
    origin, arguments = get_origin(member), get_args(member)
    if origin is Literal:
        return f"Literal[{', '.join(repr(one) for one in arguments)}]"
    if origin in (list, tuple):
        return f"{origin.__name__}[{', '.join(_type(one) for one in arguments)}]"
    if member is NoneType:
        return "None"
    assert isinstance(member, type)
    if issubclass(member, PixelAt):
        return _AT
    if issubclass(member, Tagged):
        return "Target"
    assert not issubclass(member, Body), f"{member.__name__} has no word in the client"
    return member.__name__


def _type(annotation: object) -> str:
    words = list(dict.fromkeys(_word(member) for member in _members(annotation)))
    if _AT in words:
        words.remove("str")
    return " | ".join(words)


def _parameters(fields: dict[str, FieldInfo]) -> str:
    needed = [f"{name}: {_type(field.annotation)}" for name, field in fields.items() if field.is_required()]
    others = []
    for name, field in fields.items():
        if not field.is_required():
            word = _type(field.annotation)
            others.append(f"{name}: {word if word.endswith('None') else f'{word} | None'} = None")
    return ", ".join([*needed, *(["*", *others] if others else [])])


def _docstring(order: type[OrderBody], fields: dict[str, FieldInfo]) -> str:
    text = textwrap.dedent(f"    {order.__doc__}").strip()
    if order.overrules:
        text = f"{text}\n\nNeeds the role configure."
    described = [(name, field) for name, field in fields.items() if field.description]
    if not described:
        return text if "\n" not in text else f"{text}\n"
    lines = [text, "", "Parameters", "----------"]
    for name, field in described:
        word = _type(field.annotation).removesuffix(" | None")
        word = word.replace(" | ", " or ").replace("Target", "dict")
        if word.startswith("Literal["):
            word = "{" + word[len("Literal[") : -1].replace("'", '"') + "}"
        lines.append(f"{name} : {word}{'' if field.is_required() else ', optional'}")
        lines += textwrap.wrap(
            f"{field.description}.", _WIDTH - 8, initial_indent="    ", subsequent_indent="    "
        )
    return "\n".join([*lines, ""])


def _function(kind: str, order: type[OrderBody]) -> str:
    """A function that makes one kind of order: what it needs first, a target before all."""
    fields = {name: field for name, field in order.model_fields.items() if name != "kind"}
    fields = dict(sorted(fields.items(), key=lambda item: (not item[1].is_required(), item[0] != "target")))
    docstring = textwrap.indent(f'"""{_docstring(order, fields)}"""', "    ")
    return (
        f"def {kind.replace('-', '_')}({_parameters(fields)}) -> Order:\n"
        f"{docstring}\n"
        f'    return _order("{kind}", locals())\n'
    )


def client_orders() -> str:
    """The text of the client's module."""
    text = "\n\n".join([_HEAD, *(_function(kind, order) for kind, order in KINDS.items())])
    formatting = [sys.executable, "-m", "ruff", "format", "--line-length", str(_WIDTH), "-"]
    done: subprocess.CompletedProcess[Any] = subprocess.run(
        formatting, input=text, capture_output=True, text=True, check=True
    )
    return str(done.stdout)


if __name__ == "__main__":
    PATH.write_text(client_orders(), encoding="utf-8")
