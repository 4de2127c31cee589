"""Count the words of the docs, by section: now, and at a commit to compare with.

    python tools/docs_words.py                  # now
    python tools/docs_words.py --against REF    # beside a commit, a branch or a tag
    python tools/docs_words.py --pages          # the longest pages too

A table's words count as a table's: they say how much of a section is figures. Code blocks count as neither.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

ROOT = Path(__file__).resolve().parents[1]
LONGEST_PAGES = 15
"""So many pages does --pages list."""
_CODE = re.compile(r"^(```|~~~).*?^\1\s*$", re.MULTILINE | re.DOTALL)
_ROW = re.compile(r"^\s*\|.*\|\s*$", re.MULTILINE)
_WORD = re.compile(r"\w[\w'’.,-]*")


def counted(text: str) -> tuple[int, int]:
    """Words of a page's prose, and of its tables."""
    plain = _CODE.sub("", text)
    in_tables = sum(len(_WORD.findall(row)) for row in _ROW.findall(plain))
    return len(_WORD.findall(_ROW.sub("", plain))), in_tables


def pages_now() -> Iterator[tuple[str, str]]:
    """Path below docs/ and text of each page of this checkout."""
    for page in sorted((ROOT / "docs").rglob("*.md")):
        yield page.relative_to(ROOT / "docs").as_posix(), page.read_text(encoding="utf-8")


def pages_at(commit: str) -> Iterator[tuple[str, str]]:
    """The same of a commit."""
    names = _git("ls-tree", "-r", "--name-only", "-z", commit, "docs").split("\0")
    for name in names:
        if name.endswith(".md"):
            yield name.removeprefix("docs/"), _git("show", f"{commit}:{name}")


def by_section(pages: Iterator[tuple[str, str]]) -> tuple[dict[str, Counter[str]], Counter[str]]:
    """Pages, words of prose and words of tables by section; words by page."""
    sections: dict[str, Counter[str]] = defaultdict(Counter)
    words: Counter[str] = Counter()
    for name, text in pages:
        section = PurePosixPath(name).parts[0] if "/" in name else "front page"
        prose, tables = counted(text)
        sections[section].update(pages=1, prose=prose, tables=tables)
        words[name] = prose + tables
    return sections, words


def _git(*arguments: str) -> str:
    ran = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, check=False)
    if ran.returncode:
        sys.exit(ran.stderr.decode("utf-8", "replace").strip())
    return ran.stdout.decode("utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--against", metavar="REF", help="a commit, branch or tag to compare with")
    parser.add_argument("--pages", action="store_true", help="list the longest pages too")
    asked = parser.parse_args()
    now, words = by_section(pages_now())
    before = by_section(pages_at(asked.against))[0] if asked.against else {}
    print(f"{'section':14}{'pages':>7}{'prose':>9}{'tables':>9}", end="")
    print(f"{'before:':>10}{'pages':>7}{'prose':>9}{'tables':>9}" if before else "")
    total: Counter[str] = Counter()
    total_before: Counter[str] = Counter()
    for section in [*sorted({*now, *before}), "all"]:
        here = total if section == "all" else now.get(section, Counter())
        there = total_before if section == "all" else before.get(section, Counter())
        print(f"{section:14}{here['pages']:7}{here['prose']:9}{here['tables']:9}", end="")
        print(
            f"{'':10}{there['pages']:7}{there['prose']:9}{there['tables']:9}" if before else "",
        )
        if section != "all":
            total.update(here)
            total_before.update(there)
    if asked.pages:
        print()
        for name, count in words.most_common(LONGEST_PAGES):
            print(f"{count:7} {name}")


if __name__ == "__main__":
    main()
