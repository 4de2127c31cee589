"""What the README claims is proven by a command, whose page holds the very figure."""

from __future__ import annotations

import re

import pytest

from tests.docs.walk import ROOT

README = (ROOT / "README.md").read_text(encoding="utf-8")
_LINK = re.compile(r"\[(?:`([^`]+)`|[^\]]+)\]\(([^)#\s]+)(?:#([^)\s]+))?\)")
_FIGURE = re.compile(r"\d[\d,.]*\d|\d")


def claims() -> list[tuple[str, str]]:
    """Rows of the table of claims: what, and what proves it."""
    table = README.split("| what | proven by |")[1].split("\n\n")[0]
    return [
        (cells[0].strip(), cells[1].strip())
        for row in table.splitlines()[2:]
        if len(cells := row.strip().strip("|").split("|")) == 2
    ]


def section_of(page: str, anchor: str | None) -> str:
    """The text under a heading, and its page whole where no heading is named."""
    text = (ROOT / page).read_text(encoding="utf-8")
    if anchor is None:
        return text
    parts = re.split(r"^(#{1,6} .+)$", text, flags=re.MULTILINE)
    for heading, body in zip(parts[1::2], parts[2::2], strict=True):
        plain = re.sub(r"[^\w\s-]", "", heading.lstrip("# ").lower()).strip()
        if re.sub(r"[-\s]+", "-", plain) == anchor:
            return body
    pytest.fail(f"{page} has no heading #{anchor}")


def test_there_are_claims() -> None:
    assert len(claims()) >= 7


@pytest.mark.parametrize("row", claims(), ids=lambda row: row[0][:40])
def test_a_claim_names_a_command_that_is_there(row: tuple[str, str]) -> None:
    proof = row[1]
    if proof.startswith("the same"):
        return  # the command of the row above
    command, page, anchor = next(found for found in _LINK.findall(proof) if found[0])
    module = re.fullmatch(r"python -m ([\w.]+).*", command)
    assert module is not None, command
    path = ROOT / module[1].replace(".", "/")
    assert path.with_suffix(".py").is_file() or (path / "__main__.py").is_file(), command
    section_of(page, anchor or None)


def rounds_to(other: str, figure: str) -> bool:
    """Whether a figure of a page is the README's, to the digits that the README has."""
    ours, theirs = figure.replace(",", ""), other.replace(",", "")
    if theirs.count(".") > 1:
        return False
    digits = len(ours.partition(".")[2])
    return f"{round(float(theirs), digits):.{digits}f}" == ours


def test_its_figures_stand_on_the_page_that_is_linked() -> None:
    page, anchor, missing = "", "", []
    for what, proof in claims():
        for command, one_page, one_anchor in _LINK.findall(proof):
            if command:
                page, anchor = one_page, one_anchor
        words = _LINK.sub("", f"{what} {proof}")
        there = (ROOT / page).read_text(encoding="utf-8")
        for figure in _FIGURE.findall(words):
            if not any(rounds_to(other, figure) for other in _FIGURE.findall(there)):
                missing.append(f"{figure} ({what[:30]}): not in {page}#{anchor}")
    assert missing == []
