"""List every message that a user can read, from the code itself, for an editor to read in one go.

    python tools/messages.py                    # all, by kind and file
    python tools/messages.py --kind errors log  # some kinds
    python tools/messages.py api/cli            # what stands below a folder
    python tools/messages.py --count            # how many of each kind

Kinds: `errors` (what raised errors say: what happened, advice, reasons), `log`, `cli` (commands' help, and
what they print), `api` (fields, parameters, routes), `page` (the web page), `texts` (any other string with
words: reasons, doubts, verdicts). What is computed stands in braces, as in the code.
"""

from __future__ import annotations

import argparse
import ast
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from html.parser import HTMLParser
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("mountnav", "drivers", "api")
KINDS = ("errors", "log", "cli", "api", "page", "texts")
NOT_READ = (
    "mountnav/testing",
    "mountnav/journal/migrations",
    "api/web/vendor",
)
"""Folders whose strings no user reads: other people's files, and code for tests and databases."""
_LOG_CALLS = {"debug", "info", "warning", "error", "exception", "critical"}
_PRINT_CALLS = {"echo", "print", "secho", "confirm", "prompt", "note", "line", "add_row", "add_column"}
_HELP_CALLS = {"Option", "Argument", "Typer"}
_ROUTE_CALLS = {"get", "post", "put", "delete", "patch"}
_API_CALLS = {"Field", "Query", "Path", "Header", "Body", "FormField"}
_WORDS = re.compile(r"[A-Za-zµ]{2,}[,;:.]?\s+\S*[A-Za-z]{2,}")
"""At least two words: a key, a path or a slug is no message."""
_CODE = re.compile(
    r"^(SELECT|INSERT|UPDATE|DELETE|CREATE|PRAGMA|WITH|ALTER|BEGIN)\b|^\s*<[a-z!/]|[{;]\s*$|\\d|\(\?"
)
"""Queries, markup and patterns, which no user reads."""


@dataclass(frozen=True)
class Message:
    """A text, and where it stands."""

    kind: str
    path: str
    line: int
    text: str


def spelled(node: ast.expr) -> str | None:
    """The text of a string in the code, with braces for what is computed; None if it is no string."""
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else None
    if isinstance(node, ast.JoinedStr):
        parts = []
        for part in node.values:
            if isinstance(part, ast.Constant):
                parts.append(str(part.value))
            elif isinstance(part, ast.FormattedValue):
                parts.append("{" + ast.unparse(part.value) + "}")
        return "".join(parts)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        left, right = spelled(node.left), spelled(node.right)
        if left is None and right is None:
            return None
        return (left or "{...}") + (right or "{...}")
    return None


def _called(node: ast.Call) -> str:
    """The last name of what is called."""
    if isinstance(node.func, ast.Attribute):
        return node.func.attr
    return node.func.id if isinstance(node.func, ast.Name) else ""


def _owner(node: ast.Call) -> str:
    """The name of the object whose method is called."""
    if isinstance(node.func, ast.Attribute) and isinstance(node.func.value, ast.Name):
        return node.func.value.id
    return ""


def _error_names() -> set[str]:
    """The names of all error classes of the code: by their name's bases, over all files."""
    bases: dict[str, set[str]] = {}
    for path in _python_files():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef):
                bases.setdefault(node.name, set()).update(
                    ast.unparse(base).split(".")[-1] for base in node.bases
                )
    known = {"Exception", "ValueError", "RuntimeError", "KeyError", "TypeError", "LookupError", "OSError"}
    while True:
        more = {name for name, parents in bases.items() if parents & known} - known
        if not more:
            return known | {"Exit", "BadParameter", "UsageError", "HTTPException", "Problem"}
        known |= more


def _python_files() -> Iterator[Path]:
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            if not path.relative_to(ROOT).as_posix().startswith(NOT_READ):
                yield path


def _docstrings(tree: ast.Module) -> set[int]:
    """The ids of docstrings, and of words below a constant: readers of the code read those."""
    found = set()
    for node in ast.walk(tree):
        for body in (getattr(node, "body", None), getattr(node, "orelse", None)):
            if isinstance(body, list):
                found |= {id(one.value) for one in body if isinstance(one, ast.Expr)}
    return found


class _Reader(ast.NodeVisitor):
    """Collects the messages of a file; a string belongs to the innermost call that says what it is."""

    def __init__(self, path: str, tree: ast.Module, errors: set[str]) -> None:
        self.found: list[Message] = []
        self._path = path
        self._errors = errors
        self._docstrings = _docstrings(tree)
        self._kind = "texts"
        if path.startswith("api/cli/"):
            self._kind = "cli"
        elif path.endswith("field_words.py"):
            self._kind = "api"
        self.visit(tree)

    def _say(self, node: ast.expr, text: str, kind: str | None = None) -> None:
        if id(node) in self._docstrings or not _WORDS.search(text) or _CODE.search(text):
            return
        self.found.append(Message(kind or self._kind, self._path, node.lineno, text))

    def visit_Call(self, node: ast.Call) -> None:
        kind, name, owner = self._kind, _called(node), _owner(node)
        if name in self._errors:
            self._kind = "errors"
        elif name in _LOG_CALLS and "log" in owner:
            self._kind = "log"
        elif name in _HELP_CALLS or name in _PRINT_CALLS:
            self._kind = "cli"
        elif name in _API_CALLS or (name in _ROUTE_CALLS and "rout" in owner):
            self._kind = "api"
        self.generic_visit(node)
        self._kind = kind

    def _visit_function(self, node: ast.FunctionDef | ast.AsyncFunctionDef) -> None:
        """A command's or route's docstring is its help."""
        for decorator in node.decorator_list:
            if not isinstance(decorator, ast.Call):
                continue
            owner, name = _owner(decorator), _called(decorator)
            words = ast.get_docstring(node)
            if words and (name in {"command", "callback"} or (name in _ROUTE_CALLS and "rout" in owner)):
                shown = "cli" if name in {"command", "callback"} else "api"
                self.found.append(Message(shown, self._path, node.lineno, words))
        self.generic_visit(node)

    visit_FunctionDef = visit_AsyncFunctionDef = _visit_function  # noqa: N815 - names of ast.NodeVisitor

    def visit_BinOp(self, node: ast.BinOp) -> None:
        text = spelled(node)
        if text is None:
            self.generic_visit(node)
        else:
            self._say(node, text)

    def visit_JoinedStr(self, node: ast.JoinedStr) -> None:
        self._say(node, spelled(node) or "")

    def visit_Constant(self, node: ast.Constant) -> None:
        if isinstance(node.value, str):
            self._say(node, node.value)


def in_python() -> list[Message]:
    """The messages of the three packages."""
    errors = _error_names()
    found = []
    for path in _python_files():
        tree = ast.parse(path.read_text(encoding="utf-8"))
        found += _Reader(path.relative_to(ROOT).as_posix(), tree, errors).found
    return found


_SCRIPT_STRING = re.compile(r'//[^\n]*|/\*.*?\*/|"((?:[^"\\\n]|\\.)*)"|`((?:[^`\\]|\\.)*)`', re.DOTALL)


class _PageReader(HTMLParser):
    """The words of the page, and those that stand in its attributes."""

    def __init__(self, path: str) -> None:
        super().__init__()
        self.found: list[Message] = []
        self._path = path

    def handle_data(self, data: str) -> None:
        """Words between tags."""
        if data.strip():
            self.found.append(Message("page", self._path, self.getpos()[0], " ".join(data.split())))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Words that a reader sees or hears of an element."""
        for name, value in attrs:
            if name in {"title", "aria-label", "placeholder", "alt"} and value:
                self.found.append(Message("page", self._path, self.getpos()[0], value))


def in_page() -> list[Message]:
    """The messages of the web page and its scripts."""
    found = []
    for path in sorted((ROOT / "api" / "web").rglob("*")):
        name = path.relative_to(ROOT).as_posix()
        if name.startswith(NOT_READ) or path.suffix not in {".js", ".html"}:
            continue
        text = path.read_text(encoding="utf-8")
        if path.suffix == ".html":
            reader = _PageReader(name)
            reader.feed(text)
            found += reader.found
            continue
        for match in _SCRIPT_STRING.finditer(text):
            words = match[1] or match[2] or ""
            if _WORDS.search(words):
                found.append(Message("page", name, text.count("\n", 0, match.start()) + 1, words))
    return found


def messages() -> list[Message]:
    """Everything, by kind, file and line."""
    found = set(in_python() + in_page())
    return sorted(found, key=lambda one: (KINDS.index(one.kind), one.path, one.line, one.text))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("below", nargs="*", help="files or folders; all by default")
    parser.add_argument("--kind", nargs="+", choices=KINDS, default=KINDS)
    parser.add_argument("--count", action="store_true", help="only how many")
    asked = parser.parse_args()
    chosen = [
        one
        for one in messages()
        if one.kind in asked.kind and (not asked.below or one.path.startswith(tuple(asked.below)))
    ]
    if asked.count:
        for kind in KINDS:
            print(f"{sum(one.kind == kind for one in chosen):6d} {kind}")
        return
    shown: tuple[str, str] | None = None
    for one in chosen:
        if (one.kind, one.path) != shown:
            shown = one.kind, one.path
            print(f"\n{one.kind}: {one.path}")
        print(f"  {one.line}: {one.text!r}" if "\n" in one.text else f"  {one.line}: {one.text}")


if __name__ == "__main__":
    sys.exit(main())
