"""The report of a run: one HTML file that needs nothing else, no script and no network."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import Any

from mountnav.archive.accounting import status_of
from mountnav.archive.folder import Folder, RunFolder
from mountnav.archive.recipe import recipe_in
from mountnav.archive.store import Counts
from mountnav.archive.tables import read_rows
from mountnav.errors import MountnavError

GROUPS_SHOWN = 50
"""Rows of a table by field or instrument, the largest groups first; the rest is added up."""
ASIDE_SHOWN = 100
"""Frames that were set aside, one by one."""
SLOWEST_SHOWN = 20
"""Frames that the report names as those that took longest; more would not be read."""

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem;
  color: #1c2330; background: #fff; }
h1 { font-size: 1.5rem; margin: 0 0 .2rem; } h2 { font-size: 1.1rem; margin: 2rem 0 .5rem; }
p.what, td.small { color: #5b6472; } td.small { overflow-wrap: anywhere; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th, td { text-align: left; padding: .3rem .8rem .3rem 0; border-bottom: 1px solid #dde2ea;
  vertical-align: top; } td.n, th.n { text-align: right; }
.tiles { display: grid; grid-template-columns: repeat(auto-fit, minmax(9rem, 1fr)); gap: .8rem; }
.tiles div { border: 1px solid #dde2ea; border-radius: .5rem; padding: .6rem .8rem; }
.tiles b { display: block; font-size: 1.35rem; font-weight: 600; } .tiles span { color: #5b6472; }
.bar { background: #e4e8ef; height: .7rem; min-width: 8rem; } .bar i { display: block; height: 100%;
  background: #2d7d46; } .scroll { overflow-x: auto; }
@media (prefers-color-scheme: dark) { body { background: #11151c; color: #dfe5ee; }
  p.what, td.small, .tiles span { color: #97a2b3; } th, td, .tiles div { border-color: #2b3442; }
  .bar { background: #2b3442; } }
"""


@dataclass(slots=True)
class Group:
    """Frames of one instrument, field or year."""

    frames: int = 0
    solved: int = 0
    contradicted: int = 0


COSTS = ("read", "measure", "identify", "total", "fetch", "waited")

LIMITED = 0.5
"""Share of their time that processes wait for frames, from which on reading is what limits a run; chosen by
hand: more of them would wait more."""


@dataclass(slots=True)
class Report:
    """What a run came to.

    Attributes
    ----------
    instruments, fields, years : dict
        Groups by name; "" where the header doesn't tell.
    priors : Counter
        Frames that were searched with a learned scale, by what came of it.
    contradictions : Counter
        Frames with a wrong hint, by what was wrong and whose word it was.
    odds : Counter
        Solved frames by the whole part of log10 of their false probability.
    expected_false : float
        Sum of all false probabilities.
    aside : list of dict
        Frames that were set aside: number, file, code, reason.
    costs : dict
        Seconds: read (decoding), measure, identify, total; fetch, and waited: of archives made before these
        were kept, none.
    """

    run: str
    decides: Mapping[str, Any]
    frames_listed: int
    complete: bool
    counts: Counts = field(default_factory=Counts)
    instruments: dict[str, Group] = field(default_factory=lambda: defaultdict(Group))
    fields: dict[str, Group] = field(default_factory=lambda: defaultdict(Group))
    years: dict[str, Group] = field(default_factory=lambda: defaultdict(Group))
    reasons: Counter[str] = field(default_factory=Counter)
    modes: Counter[str] = field(default_factory=Counter)
    contradictions: Counter[str] = field(default_factory=Counter)
    priors: Counter[str] = field(default_factory=Counter)
    odds: Counter[int] = field(default_factory=Counter)
    expected_false: float = 0.0
    aside: list[dict[str, Any]] = field(default_factory=list)
    costs: dict[str, float] = field(default_factory=lambda: dict.fromkeys(COSTS, 0.0))
    costed: int = 0
    slowest: list[tuple[float, int]] = field(default_factory=list)
    megabytes: float = 0.0


def reported(folder: Folder, run: RunFolder) -> Report:
    """Go through a run, chunk by chunk.

    Raises
    ------
    NotFound, BadRequest
        A chunk is damaged.
    """
    status = status_of(folder, run)
    found = Report(run.name, recipe_in(run).decides, status.frames, status.complete, status.counts)
    for number in sorted(run.done()):
        path = run.chunk(number)
        _add_frames(found, read_rows(path / "frames.parquet", _OF_FRAMES))
        for row in read_rows(path / "solutions.parquet", ["false_probability", "mode"]):
            chance = row["false_probability"]
            if isinstance(chance, float):
                found.expected_false += chance
                found.odds[math.floor(math.log10(chance)) if chance > 0.0 else _NEVER] += 1
            found.modes[str(row["mode"])] += 1
        for row in read_rows(path / "refusals.parquet"):
            found.reasons[str(row["reason_code"])] += 1
            if row["set_aside"] and len(found.aside) < ASIDE_SHOWN:
                found.aside.append(row)
        _add_costs(found, run, number)
    if found.aside:
        _name_files(found, run)
    return found


_OF_FRAMES = [
    "number",
    "solved",
    "instrument",
    "field",
    "mid_exposure_utc",
    "contradictions",
    "bytes",
    "prior",
]
_PRIORS = {
    "held": "solved at the scale of their camera: the odds take that scale for granted",
    "failed": "not found at that scale, and then treated as without it",
}
_NEVER = -400
"""Below the least of Python's numbers: a chance that was too small for them."""


def _add_frames(found: Report, rows: Iterable[Mapping[str, Any]]) -> None:
    for row in rows:
        solved = bool(row["solved"])
        wrong = _wrong(row["contradictions"])
        found.contradictions.update(wrong)
        if row["prior"]:
            found.priors[_PRIORS[str(row["prior"])]] += 1
        found.megabytes += (row["bytes"] or 0) / 1e6
        year = (row["mid_exposure_utc"] or "")[:4]
        for groups, name in (
            (found.instruments, row["instrument"]),
            (found.fields, row["field"]),
            (found.years, year),
        ):
            group = groups[name or ""]
            group.frames += 1
            group.solved += solved
            group.contradicted += bool(wrong)


def _wrong(text: str | None) -> set[str]:
    """What was contradicted, without the numbers: "center by OBJCTRA"."""
    return {part.split(":")[0].strip()[:60] for part in (text or "").split(" | ") if part}


def _add_costs(found: Report, run: RunFolder, chunk: int) -> None:
    try:
        for row in read_rows(run.cost(chunk)):
            found.costed += 1
            for name in found.costs:
                found.costs[name] += float(row.get(f"{name}_s") or 0.0)
            found.slowest.append((float(row["total_s"] or 0.0), int(row["number"] or 0)))
    except MountnavError:
        return  # a worker was killed between the results and their account
    found.slowest = sorted(found.slowest, reverse=True)[:SLOWEST_SHOWN]


def _name_files(found: Report, run: RunFolder) -> None:
    wanted = {row["number"]: row for row in found.aside}
    for number in sorted(run.done()):
        for row in read_rows(run.chunk(number) / "frames.parquet", ["number", "file"]):
            if row["number"] in wanted:
                wanted[row["number"]]["file"] = row["file"]


def as_html(report: Report) -> str:
    """Write the report as a page; every text in it is escaped, for headers come from strangers."""
    counts, decides = report.counts, report.decides
    share = _percent(counts.solved, counts.frames)
    catalogs = ", ".join(decides.get("usable", []))
    unfinished = "" if report.complete else f" of {report.frames_listed} listed; not all is done yet"
    tiles = [
        (f"{counts.frames}", f"frames{unfinished}"),
        (f"{counts.solved}", f"solved, {share}"),
        (f"{counts.refused}", "refused, with a reason"),
        (f"{counts.set_aside}", "set aside after two tries"),
        (f"{report.expected_false:.2g}", "false ones expected, by the odds"),
    ]
    parts = [
        "<!doctype html><html lang=en><meta charset=utf-8>",
        '<meta name=viewport content="width=device-width, initial-scale=1">',
        f"<title>Archive, run {escape(report.run)}</title><style>{_STYLE}</style>",
        f"<h1>Run {escape(report.run)}</h1>",
        f"<p class=what>mountnav {escape(str(decides.get('mountnav')))}; {escape(catalogs)}</p>",
        "<div class=tiles>",
        *(f"<div><b>{escape(value)}</b><span>{escape(what)}</span></div>" for value, what in tiles),
        "</div>",
        _groups("By instrument", report.instruments),
        _groups("By field", report.fields),
        _groups("By year", report.years, by_name=True),
        _counted("Why frames were not solved", report.reasons, counts.refused + counts.set_aside),
        _counted("How frames were solved", report.modes, counts.solved),
        _counted("Headers and hints that turned out wrong", report.contradictions, counts.frames),
        _counted("Frames for which a learned scale was tried", report.priors, counts.frames),
        _odds(report),
        _cost(report),
    ]
    if report.aside:
        rows = [
            (str(row["number"]), str(row.get("file", "")), str(row["reason_code"]), str(row["reason"]))
            for row in report.aside
        ]
        parts.append(_table("Set aside", ("number", "file", "code", "why"), rows))
    return "\n".join(part for part in parts if part) + "\n</html>\n"


def _groups(title: str, groups: Mapping[str, Group], *, by_name: bool = False) -> str:
    names = sorted(groups) if by_name else sorted(groups, key=lambda name: (-groups[name].frames, name))
    shown, rest = (names, []) if by_name else (names[:GROUPS_SHOWN], names[GROUPS_SHOWN:])
    rows = [(name or "not told", groups[name]) for name in shown]
    if rest:
        others = Group(*(sum(getattr(groups[name], what) for name in rest) for what in Group.__slots__))
        rows.append((f"{len(rest)} others", others))
    cells = [
        (name, str(one.frames), str(one.solved), _bar(one.solved, one.frames), str(one.contradicted))
        for name, one in rows
    ]
    return _table(title, ("", "#frames", "#solved", "", "#wrong headers"), cells) if cells else ""


def _counted(title: str, counts: Counter[str], of: int) -> str:
    rows = [(name, str(count), _bar(count, of)) for name, count in counts.most_common()]
    return _table(title, ("", "#frames", ""), rows) if rows else ""


def _odds(report: Report) -> str:
    if not report.odds:
        return ""
    rows = []
    for power in sorted(report.odds, reverse=True):
        name = "less than 1e-308" if power == _NEVER else f"1e{power} to 1e{power + 1}"
        rows.append((name, str(report.odds[power]), _bar(report.odds[power], report.counts.solved)))
    return _table("Chance of a solution to be false", ("", "#frames", ""), rows)


def _cost(report: Report) -> str:
    costs = report.costs
    if not report.costed or not costs["total"]:
        return ""
    others = max(0.0, costs["total"] - costs["read"] - costs["measure"] - costs["identify"])
    named = (
        ("decoding", costs["read"]),
        ("measuring", costs["measure"]),
        ("identifying", costs["identify"]),
        ("handing over, starting, tries that failed", others),
    )
    rows = [(name, f"{seconds:.1f}", _bar(seconds, costs["total"])) for name, seconds in named]
    rows.append(("all, of one process", f"{costs['total']:.1f}", _Html("")))
    whole_s = costs["total"] + costs["waited"]
    rows.append(("besides: waiting for a frame to be read", f"{costs['waited']:.1f}", _Html("")))
    if costs["waited"] > LIMITED * whole_s:
        limit = "<b>Reading is the limit</b>: more processes that read from there would only wait."
    else:
        limit = "Reading is not the limit."
    rate = report.costed / whole_s
    text = (
        f"<p>{report.costed} frames with an account, {rate:.2f} a second of one process; "
        f"{report.megabytes:.0f} MB read, {_percent(costs['waited'], whole_s)} of the time waiting for them. "
        f"{limit}</p>"
    )
    slow = [(str(number), f"{seconds:.2f}") for seconds, number in report.slowest]
    return (
        _table("Cost", ("", "#seconds", ""), rows)
        + text
        + _table("The slowest frames", ("number", "#seconds"), slow)
    )


def _percent(part: float, of: float) -> str:
    return f"{100.0 * part / of:.1f} %" if of else "–"


def _bar(part: float, of: float) -> _Html:
    share = 100.0 * part / of if of else 0.0
    return _Html(f'<div class=bar title="{_percent(part, of)}"><i style="width:{share:.1f}%"></i></div>')


class _Html(str):
    """Text that is HTML already."""


def _table(title: str, heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    number = [head.startswith("#") for head in heads]
    top = "".join(
        f"<th{' class=n' if right else ''}>{escape(head.lstrip('#'))}</th>"
        for head, right in zip(heads, number, strict=True)
    )
    body = "".join(
        "<tr>"
        + "".join(
            f"<td{' class=n' if right else ''}>{cell if isinstance(cell, _Html) else escape(cell)}</td>"
            for cell, right in zip(row, number, strict=True)
        )
        + "</tr>"
        for row in rows
    )
    return f"<h2>{escape(title)}</h2><div class=scroll><table><tr>{top}</tr>{body}</table></div>"
