"""A morning report as Markdown, and as HTML in one file that needs nothing else: no script, no network."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from html import escape

from mountnav.night.morning_report import Centered, MorningReport
from mountnav.units import duration_text

__all__ = ["as_html", "as_markdown"]

_WIDTH, _HEIGHT, _LEFT, _TOP, _BOTTOM = 880, 230, 64, 14, 26
"""Of the plot and its margins, px."""
_LEAST_ARCSEC, _MOST_ARCSEC = 0.1, 1e5
"""Ends of the plot's scale beyond which no error is drawn, ″."""

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem;
  color: #1c2330; background: #fff; }
h1 { font-size: 1.5rem; margin: 0 0 .2rem; } h2 { font-size: 1.1rem; margin: 2rem 0 .5rem; }
p.when { color: #5b6472; margin: 0 0 1.5rem; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th, td { text-align: left; padding: .3rem .8rem .3rem 0; border-bottom: 1px solid #dde2ea;
  vertical-align: top; }
tr.failed td { color: #a3210f; }
ul.advice li { margin-bottom: .4rem; }
.tiles { display: grid; grid-template-columns: repeat(auto-fit, minmax(9rem, 1fr)); gap: .8rem; }
.tiles div { border: 1px solid #dde2ea; border-radius: .5rem; padding: .6rem .8rem; }
.tiles b { display: block; font-size: 1.35rem; font-weight: 600; }
.tiles span { color: #5b6472; font-size: .85rem; }
svg { width: 100%; height: auto; }
.scroll { overflow-x: auto; }
@media (prefers-color-scheme: dark) {
  body { background: #11151c; color: #dfe5ee; } p.when, .tiles span { color: #97a2b3; }
  th, td, .tiles div { border-color: #2b3442; } tr.failed td { color: #ff9c8a; }
}
"""


def _arcsec(value: float | None) -> str:
    """An angle as a person reads it."""
    if value is None:
        return "–"
    if value >= 7200.0:
        return f"{value / 3600.0:.1f}°"
    if value >= 300.0:
        return f"{value / 60.0:.1f}′"
    return f"{value:.1f}″" if value < 10.0 else f"{value:.0f}″"


def _clock(utc: datetime | None) -> str:
    return "–" if utc is None else utc.astimezone(UTC).strftime("%H:%M")


def _place(one: Centered) -> str:
    if one.ra_deg is None or one.dec_deg is None:
        return "–"
    seconds = round(one.ra_deg * 240.0) % 86_400
    sign, minutes = ("-" if one.dec_deg < 0 else "+"), round(abs(one.dec_deg) * 60.0)
    return (
        f"{seconds // 3600:02d}h{seconds // 60 % 60:02d}m{seconds % 60:02d}s {sign}{minutes // 60:02d}°"
        f"{minutes % 60:02d}′"
    )


def _when(report: MorningReport) -> str:
    evening = report.since_utc.astimezone(UTC).date().isoformat()
    if report.first_utc is None:
        return f"Night of {evening}: nothing was done"
    return f"Night of {evening}, {_clock(report.first_utc)} to {_clock(report.last_utc)} UTC"


def _figures(report: MorningReport) -> list[tuple[str, str]]:
    """What is told first: a value, and what it is."""
    return [
        (f"{report.centered} of {len(report.centerings)}", "targets centered"),
        (_arcsec(report.error_before_arcsec), "off at the first look (median)"),
        (_arcsec(report.error_after_arcsec), "off at the end (median)"),
        (f"{report.solved} of {report.looks}", "looks solved"),
        ("–" if report.fwhm_arcsec is None else f"{report.fwhm_arcsec:.1f}″", "star width (median FWHM)"),
        (
            "–" if report.limiting_mag is None else f"{report.limiting_mag:.1f} mag",
            "faintest stars (median)",
        ),
        (duration_text(report.centering_s, "–"), "spent centering"),
        (duration_text(report.lost_s, "–"), "lost: failed centerings, lost links"),
    ]


def as_markdown(report: MorningReport) -> str:
    """The report as Markdown."""
    return "\n".join(_markdown(report)) + "\n"


def _markdown(report: MorningReport) -> Iterator[str]:
    yield f"# {report.telescope}\n\n{_when(report)}\n"
    for value, what in _figures(report):
        yield f"- **{value}** {what}"
    yield "\n## What to do\n"
    yield from (f"- {one}" for one in report.advice)
    if not report.advice:
        yield "Nothing: no advice follows from this night."
    if report.centerings:
        heads = ("ended", "target", "outcome", "first look", "end", "looks", "took")
        yield f"\n## Targets\n\n| {' | '.join(heads)} |\n{'|---' * len(heads)}|"
        for one in report.centerings:
            flipped = ", flipped" if one.flipped else ""
            yield (
                f"| {_clock(one.utc)} | {_place(one)} | {_plain(one.outcome)}{flipped} | "
                f"{_arcsec(one.error_before_arcsec)} | {_arcsec(one.error_after_arcsec)} | {one.tries} | "
                f"{duration_text(one.elapsed_s, '–')} |"
            )
    for title, counts in (("Looks that were not solved", report.unsolved), ("Syncs", report.syncs)):
        if counts:
            yield f"\n## {title}\n"
            yield from (f"- {times} × {_plain(what)}" for what, times in counts.items())
    if report.troubles:
        yield "\n## Troubles\n\n| first | last | times | what |\n|---|---|---|---|"
        for trouble in report.troubles:
            yield (
                f"| {_clock(trouble.first_utc)} | {_clock(trouble.last_utc)} | {trouble.times} | "
                f"{_plain(trouble.kind)}: {_plain(trouble.what)} |"
            )
    if report.pauses:
        yield "\n## Pauses\n"
        yield from (
            f"- {_clock(since)} to {_clock(until)}: {duration_text((until - since).total_seconds())}"
            for since, until in report.pauses
        )


def _plain(text: str) -> str:
    """Words of a device as Markdown shows them: on one line, and no table's bars or tags in them."""
    plain = " ".join(text.split())
    for letter in "\\`*_[]<>|":
        plain = plain.replace(letter, f"\\{letter}")
    return plain


def as_html(report: MorningReport) -> str:
    """The report as one HTML file, for a browser by day or at night."""
    return "\n".join(_html(report)) + "\n"


def _html(report: MorningReport) -> Iterator[str]:
    title = escape(f"{report.telescope}: {_when(report)}")
    yield f'<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n<title>{title}</title>'
    yield '<meta name="viewport" content="width=device-width, initial-scale=1">'
    yield f"<style>{_STYLE}</style>\n</head>\n<body>"
    yield f'<h1>{escape(report.telescope)}</h1>\n<p class="when">{escape(_when(report))}</p>'
    yield '<div class="tiles">'
    for value, what in _figures(report):
        yield f"<div><b>{escape(value)}</b><span>{escape(what)}</span></div>"
    yield "</div>\n<h2>What to do</h2>"
    if report.advice:
        yield '<ul class="advice">'
        yield from (f"<li>{escape(one)}</li>" for one in report.advice)
        yield "</ul>"
    else:
        yield "<p>Nothing: no advice follows from this night.</p>"
    if report.centerings:
        yield "<h2>Targets</h2>"
        yield from _plot(report.centerings)
        yield from _table(
            ("ended", "target", "outcome", "first look", "end", "looks", "took"),
            [
                (
                    _clock(one.utc),
                    _place(one),
                    one.outcome + (", flipped" if one.flipped else ""),
                    _arcsec(one.error_before_arcsec),
                    _arcsec(one.error_after_arcsec),
                    str(one.tries),
                    duration_text(one.elapsed_s, "–"),
                )
                for one in report.centerings
            ],
            failed=[not one.succeeded for one in report.centerings],
        )
    for heading, counts in (("Looks that were not solved", report.unsolved), ("Syncs", report.syncs)):
        if counts:
            yield f"<h2>{heading}</h2>"
            yield from _table(("times", "what"), [(str(times), what) for what, times in counts.items()])
    if report.troubles:
        yield "<h2>Troubles</h2>"
        yield from _table(
            ("first", "last", "times", "what"),
            [
                (_clock(one.first_utc), _clock(one.last_utc), str(one.times), f"{one.kind}: {one.what}")
                for one in report.troubles
            ],
        )
    if report.pauses:
        yield "<h2>Pauses</h2>"
        yield from _table(
            ("from", "to", "lasted"),
            [
                (_clock(since), _clock(until), duration_text((until - since).total_seconds()))
                for since, until in report.pauses
            ],
        )
    yield "</body>\n</html>"


def _table(
    heads: Sequence[str], rows: Sequence[Sequence[str]], *, failed: Sequence[bool] = ()
) -> Iterator[str]:
    yield '<div class="scroll"><table><thead><tr>'
    yield "".join(f"<th>{escape(head)}</th>" for head in heads) + "</tr></thead><tbody>"
    for number, row in enumerate(rows):
        kind = ' class="failed"' if number < len(failed) and failed[number] else ""
        yield f"<tr{kind}>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>"
    yield "</tbody></table></div>"


def _plot(centerings: Sequence[Centered]) -> Iterator[str]:
    """Errors before and after, by time, on a logarithmic scale."""
    values = [
        value
        for one in centerings
        for value in (one.error_before_arcsec, one.error_after_arcsec)
        if value is not None
    ]
    if not values:
        return
    low = math.floor(math.log10(max(min(values), _LEAST_ARCSEC)))
    high = max(math.ceil(math.log10(min(max(values), _MOST_ARCSEC))), low + 1)
    begin, end = centerings[0].utc, centerings[-1].utc
    span_s = max((end - begin).total_seconds(), 1.0)

    def x(utc: datetime) -> float:
        return _LEFT + (_WIDTH - _LEFT - 16) * (utc - begin).total_seconds() / span_s

    def y(value: float) -> float:
        share = (math.log10(min(max(value, 10.0**low), 10.0**high)) - low) / (high - low)
        return _HEIGHT - _BOTTOM - (_HEIGHT - _TOP - _BOTTOM) * share

    yield (
        f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img" aria-label="Pointing errors before and after each '
        f'centering" font-size="12" fill="currentColor">'
    )
    for power in range(low, high + 1):
        at = y(10.0**power)
        yield (
            f'<line x1="{_LEFT}" x2="{_WIDTH}" y1="{at:.1f}" y2="{at:.1f}" stroke="currentColor" '
            f'opacity=".15"/>'
        )
        yield f'<text x="{_LEFT - 8}" y="{at + 4:.1f}" text-anchor="end">{10.0**power:g}″</text>'
    yield f'<text x="{_LEFT}" y="{_HEIGHT - 6}">{_clock(begin)}</text>'
    yield f'<text x="{_WIDTH - 16}" y="{_HEIGHT - 6}" text-anchor="end">{_clock(end)} UTC</text>'
    for one in centerings:
        at, before, after = x(one.utc), one.error_before_arcsec, one.error_after_arcsec
        if before is not None and after is not None:
            yield (
                f'<line x1="{at:.1f}" x2="{at:.1f}" y1="{y(before):.1f}" y2="{y(after):.1f}" '
                f'stroke="currentColor" opacity=".35"/>'
            )
        if before is not None:
            yield (
                f'<circle cx="{at:.1f}" cy="{y(before):.1f}" r="4" fill="none" stroke="#2a6fdb" '
                f'stroke-width="2"/>'
            )
        if after is not None:
            color = "#1d8a4e" if one.succeeded else "#c43d22"
            yield f'<circle cx="{at:.1f}" cy="{y(after):.1f}" r="4" fill="{color}"/>'
    yield "</svg>\n<p>Hollow: at the first look. Filled: at the end.</p>"
