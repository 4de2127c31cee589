"""What docs and docstrings name is there: files, modules, and the targets of relative links."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGES = [
    *sorted(ROOT.glob("docs/**/*.md")),
    *(ROOT / one for one in ("README.md", "CONTRIBUTING.md", "SECURITY.md")),
]
SOURCES = [
    one
    for folder in ("mountnav", "drivers", "api", "benchmarks", "tools")
    for one in sorted((ROOT / folder).rglob("*.py"))
]
TOPS = ("mountnav", "drivers", "api", "tests", "benchmarks", "tools", "docs", "deploy")
NOT_FILES = {
    # entry point groups, and what how-to pages invent
    "mountnav.mounts",
    "mountnav.devices",
}
INVENTED = "docs/how-to/add-"
"""How the paths of pages begin that name files which a reader is to make."""

_TICKED = re.compile(r"`+([^`\n]+?)`+")
_LINK = re.compile(r"\]\(([^)\s]+)\)")


def missing(page: Path) -> list[str]:
    """What a page names in backticks by a path or a dotted name of ours, and isn't there."""
    text = page.read_text(encoding="utf-8")
    found = []
    for match in _TICKED.finditer(text):
        name = match[1].strip()
        line = text[: match.start()].count("\n") + 1
        if re.fullmatch(r"[\w./-]+", name) and "/" in name and name.split("/")[0] in TOPS:
            if not (ROOT / name).exists():
                found.append(f"{line}: {name}")
        elif (
            re.fullmatch(r"(mountnav|drivers|api|tests|benchmarks)(\.\w+)+", name)
            and name not in NOT_FILES
            and not _is_module_or_name(name)
        ):
            found.append(f"{line}: {name}")
    return found


def _is_module_or_name(dotted: str) -> bool:
    """Whether the longest part of a dotted name that is a module has the rest in its text."""
    place = ROOT
    for part in dotted.split("."):
        if (place / part).is_dir():
            place = place / part
            continue
        file = place / f"{part}.py"
        if file.is_file():
            rest = dotted.split(f"{part}.", 1)
            return len(rest) == 1 or re.search(rf"\b{rest[1].split('.')[0]}\b", file.read_text()) is not None
        init = place / "__init__.py"
        return init.is_file() and re.search(rf"\b{re.escape(part)}\b", init.read_text()) is not None
    return True


@pytest.mark.long
@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_the_files_that_a_page_names_are_there(page: Path) -> None:
    if str(page.relative_to(ROOT)).startswith(INVENTED):
        pytest.skip("it names files that its reader is to make")
    assert missing(page) == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_the_relative_links_of_a_page_lead_somewhere(page: Path) -> None:
    targets = [target.split("#")[0] for target in _LINK.findall(page.read_text(encoding="utf-8"))]
    dead = [
        target
        for target in targets
        if target
        and "://" not in target
        and not target.startswith("mailto:")
        and not (page.parent / target).exists()
    ]
    assert dead == []


def test_the_modules_that_docstrings_name_are_there() -> None:
    gone = [f"{file.relative_to(ROOT)}:{one}" for file in SOURCES for one in missing(file)]
    assert gone == []


def test_what_is_not_there_is_found(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("`mountnav/no_such.py` and `mountnav.sky.no_such` and `mountnav/errors.py`\n")
    assert missing(page) == ["1: mountnav/no_such.py", "1: mountnav.sky.no_such"]
