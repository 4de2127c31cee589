"""The built site of the documentation, in a folder of the package: its files and its pages.

`make docs` builds it there, and a wheel that is built afterwards carries it. A checkout that has not built it
has none, nor has a wheel of such a checkout.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from functools import cache
from html import unescape
from pathlib import Path

from mountnav.errors import BadRequest, NotFound

__all__ = ["FOLDER", "NOT_BUILT", "Page", "find_page", "pages", "site_files"]

FOLDER = Path(__file__).parent / "site"
"""Where `make docs` puts the site."""

NOT_BUILT = "this installation has no documentation: it was built without"
HOW_TO_BUILD = (
    "`make docs` in the checkout builds it; the same pages are the .md files in the checkout's docs/"
)

_LONGEST_TOPIC = 200
"""Longest text, in characters, that is searched for. Doubled, a search takes twice as long."""
_TITLE_WEIGHT = 20
"""A word in a title counts as much as so many in the text: pages named for a thing come before pages that
speak of it. Chosen by hand; halved or doubled, the first pages of the topics in the test stay the same."""
_RECORDS = ("figures/", "decisions/")
"""Folders of what was measured and decided: they speak of everything, and few search for them."""
_RECORD_WEIGHT = 0.4
"""A page of records counts so much of another one. Chosen by hand: doubled, the list of proofs comes before
the pages on centering for "meridian flip"."""
_MOST_OF_ONE_WORD = 10
"""A word of the text counts at most so many times. Doubled, long pages win more topics."""


@dataclass(frozen=True, slots=True)
class Page:
    """A page of the site."""

    path: str
    """Inside the site, as `how-to/night.html`."""
    title: str
    text: str
    """Without markup."""
    headings: frozenset[str] = frozenset()
    """Those below the title, in small letters: a topic that is one of them, as a problem's name, is there."""

    @property
    def name(self) -> str:
        """What a user types for it: `how-to/night`."""
        return self.path.removesuffix(".html").removesuffix("/index")


@cache
def site_files() -> dict[str, Path]:
    """All files of the site by their path in it; empty if it is not built. Read once for the process."""
    if not (FOLDER / "index.html").is_file():
        return {}
    return {one.relative_to(FOLDER).as_posix(): one for one in sorted(FOLDER.rglob("*")) if one.is_file()}


@cache
def pages() -> tuple[Page, ...]:
    """All pages, from the index that the site's own search uses.

    Raises
    ------
    NotFound
        The site is not built.
    """
    index = site_files().get("search/search_index.json")
    if index is None:
        raise NotFound(NOT_BUILT, advice=HOW_TO_BUILD)
    titles: dict[str, str] = {}
    texts: dict[str, list[str]] = {}
    headings: dict[str, set[str]] = {}
    for entry in json.loads(index.read_text(encoding="utf-8"))["docs"]:
        path, _, anchor = entry["location"].partition("#")
        path = path or "index.html"
        if not anchor:
            titles[path] = _plain(entry["title"])
        else:
            headings.setdefault(path, set()).add(_plain(entry["title"]).lower())
        texts.setdefault(path, []).append(_plain(f"{entry['title']} {entry['text']}"))
    return tuple(
        Page(path, titles.get(path, path), " ".join(texts[path]), frozenset(headings.get(path, ())))
        for path in sorted(texts)
    )


def _plain(markup: str) -> str:
    return unescape(re.sub(r"<[^>]+>", " ", markup)).strip()


def find_page(topic: str) -> list[Page]:
    """The pages for a topic, best first: of that name, else those that have all of its words, headings first.

    Raises
    ------
    BadRequest
        A topic of no letters, or of more than 200.
    NotFound
        No page has these words, or the site is not built.
    """
    words = re.findall(r"\w+", topic.lower())
    if not words or len(topic) > _LONGEST_TOPIC:
        raise BadRequest(
            f"a topic is 1 to {_LONGEST_TOPIC} characters", advice="mountnav docs --list has all pages"
        )
    known = pages()
    wanted = topic.lower().strip().strip("/").removeprefix("docs/").removesuffix(".md").removesuffix(".html")
    named = [one for one in known if wanted in (one.name, one.name.rpartition("/")[2])]
    if named:
        return named
    scored = [
        (score + (_TITLE_WEIGHT * len(words) if wanted in one.headings else 0), one)
        for one in known
        if (score := _score(one, words))
    ]
    found = sorted(scored, key=lambda one: (-one[0], one[1].path))
    if not found:
        raise NotFound(
            f"no page has the words {' '.join(words)!r}", advice="mountnav docs --list has all pages"
        )
    return [one for _, one in found]


def _score(page: Page, words: list[str]) -> float:
    """How much a page has of all of the words; 0 if one is missing."""
    title, text = f"{page.name} {page.title}".lower(), page.text.lower()
    total = 0
    for word in words:
        # from its beginning: "log" is not in "catalog"
        begun = re.compile(rf"\b{re.escape(word)}")
        count = min(len(begun.findall(text)), _MOST_OF_ONE_WORD)
        count += _TITLE_WEIGHT * bool(begun.search(title))
        if count == 0:
            return 0
        total += count
    return total * (_RECORD_WEIGHT if page.path.startswith(_RECORDS) else 1.0)
