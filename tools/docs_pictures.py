"""Draw the pictures of the docs: terminal recordings of real commands, the web page, and diagrams.

    python tools/docs_pictures.py             # all, into docs/images; two minutes
    python tools/docs_pictures.py diagrams    # one kind alone: diagrams, terminals, page

Recordings and pages are those of a service that is started for them: the same night, mount and orders each
time. The page needs playwright and chromium.
"""

from __future__ import annotations

import argparse
import io
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from html import escape
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.text import Text

if TYPE_CHECKING:
    from playwright.sync_api import Page

ROOT = Path(__file__).resolve().parents[1]
IMAGES = ROOT / "docs" / "images"
RECORDINGS = {
    "terminal-center": ["mountnav status", "mountnav look", "mountnav center Capella"],
    "terminal-refused": ["mountnav center 'Sigma Octantis'", "mountnav stop"],
}
"""Name of the picture, and the commands that it shows."""
SERVICE = ["serve", "--demo", "--at", "2026-12-01T20:00:00Z", "--speed", "2", "--seed", "7"]

_TRIES = 20
"""So many pictures of a page are taken until one is of a page in order: each takes a moment."""

_STYLE = """
  .box { fill: #eef1f8; stroke: #3f51b5; stroke-width: 1.5 }
  .good { fill: #e6f4ea; stroke: #2e7d32 }
  .bad { fill: #fdecea; stroke: #c62828 }
  .line { fill: none; stroke: #555; stroke-width: 1.5 }
  .thin { fill: none; stroke: #999; stroke-width: 1; stroke-dasharray: 4 3 }
  .head { fill: #555 }
  text { font: 13px system-ui, sans-serif; fill: #222 }
  .small { font-size: 11px; fill: #555 }
  @media (prefers-color-scheme: dark) {
    .box { fill: #26293a; stroke: #9fa8da }
    .good { fill: #1d3322; stroke: #81c784 }
    .bad { fill: #3a2020; stroke: #e57373 }
    .line { stroke: #bbb } .thin { stroke: #777 } .head { fill: #bbb }
    text { fill: #eee } .small { fill: #bbb }
  }
"""


class Drawing:
    """An SVG of boxes, arrows and words, light or dark as its reader's browser is."""

    def __init__(self, width: int, height: int, title: str) -> None:
        self._size = width, height
        self._title = title
        self._parts: list[str] = []

    def box(self, x: int, y: int, width: int, lines: list[str], kind: str = "box") -> None:
        """A box with lines of text; the first one is its name."""
        height = 16 + 18 * len(lines)
        classes = "box" if kind == "box" else f"box {kind}"
        self._parts.append(
            f'<rect class="{classes}" x="{x}" y="{y}" width="{width}" height="{height}" rx="6"/>'
        )
        for number, line in enumerate(lines):
            small = ' class="small"' if number else ""
            place = f'x="{x + width / 2}" y="{y + 22 + 18 * number}" text-anchor="middle"'
            self._parts.append(f"<text{small} {place}>{escape(line)}</text>")

    def arrow(
        self, points: list[tuple[int, int]], words: str = "", at: tuple[int, int] | None = None
    ) -> None:
        """A line with a head, and words beside it."""
        path = " ".join(f"{x},{y}" for x, y in points)
        self._parts.append(f'<polyline class="line" points="{path}" marker-end="url(#head)"/>')
        if words and at is not None:
            self._parts.append(f'<text class="small" x="{at[0]}" y="{at[1]}">{escape(words)}</text>')

    def raw(self, part: str) -> None:
        """Any other element."""
        self._parts.append(part)

    def svg(self) -> str:
        """The whole file."""
        width, height = self._size
        head = (
            '<defs><marker id="head" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="7" markerHeight="7" '
            'orient="auto-start-reverse"><path class="head" d="M0 0 10 5 0 10z"/></marker></defs>'
        )
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" role="img">\n'
            f"<title>{escape(self._title)}</title>\n<style>{_STYLE}</style>\n{head}\n"
            + "\n".join(self._parts)
            + "\n</svg>\n"
        )


def guarded_sync() -> str:
    """The way of a sync: what is asked before, during and after it."""
    drawn = Drawing(760, 470, "The guarded sync")
    drawn.box(20, 20, 220, ["a solved frame", "where the tube truly looks"])
    drawn.box(
        20,
        120,
        220,
        [
            "does anything speak against it?",
            "moved, stale, odds, scale, parity,",
            "pier side, pole, too far ...",
        ],
    )
    drawn.box(
        20, 240, 220, ["does the rule want it?", "never, first-of-night, per-target,", "when-off-by, always"]
    )
    drawn.box(20, 360, 220, ["write it down, then send it once"])
    drawn.box(300, 360, 200, ["read back", "did the reading follow?"])
    drawn.box(560, 360, 180, ["committed", "the mount believes", "what was seen"], "good")
    drawn.box(300, 130, 200, ["sync-refused", "all doubts by name; nothing sent"], "bad")
    drawn.box(300, 250, 200, ["by offset", "aim beside the target"], "good")
    drawn.box(560, 130, 180, ["sync-elsewhere", "its position doesn't count"], "bad")
    drawn.box(560, 250, 180, ["sync-ignored", "until noon: by offset"], "bad")
    drawn.arrow([(130, 72), (130, 118)])
    drawn.arrow([(130, 190), (130, 238)], "no", (138, 220))
    drawn.arrow([(130, 310), (130, 358)], "yes", (138, 338))
    drawn.arrow([(240, 155), (298, 155)], "yes", (256, 148))
    drawn.arrow([(240, 275), (298, 275)], "no", (258, 268))
    drawn.arrow([(240, 377), (298, 377)])
    drawn.arrow([(500, 387), (558, 387)], "yes", (516, 380))
    drawn.arrow([(470, 358), (470, 335), (650, 335), (650, 304)], "no", (560, 330))
    drawn.arrow([(440, 358), (440, 320), (530, 320), (530, 160), (558, 160)], "to another place", (444, 232))
    drawn.arrow([(558, 275), (502, 275)])
    drawn.arrow([(400, 182), (400, 248)], "if the look is sound", (290, 232))
    return drawn.svg()


def geometry() -> str:
    """Believed, seen and wanted: what a centering corrects."""
    drawn = Drawing(760, 330, "Where the mount believes to point, where it points, and the target")
    drawn.raw('<rect class="thin" x="60" y="50" width="270" height="180"/>')
    seen = 'x="190" y="110" width="270" height="180" transform="rotate(12 325 200)"'
    drawn.raw(f'<rect class="box" {seen} style="fill-opacity:.35"/>')
    drawn.raw('<circle class="line" cx="195" cy="140" r="7"/><circle class="head" cx="325" cy="200" r="3"/>')
    drawn.raw('<path class="line" d="M313 200h24M325 188v24"/>')
    drawn.raw('<text x="60" y="42">what the mount believes to see: the target in the middle</text>')
    drawn.raw('<text x="190" y="322">what the camera sees, turned by rotation_deg</text>')
    drawn.raw('<text class="small" x="178" y="126">target</text>')
    drawn.raw('<text class="small" x="290" y="228">center, solved: seen</text>')
    drawn.arrow([(202, 143), (315, 196)], "offset: seen minus believed", (258, 160))
    drawn.box(540, 40, 200, ["sync", "tell the mount where it looks:", "believed becomes seen"], "good")
    drawn.box(540, 130, 200, ["then slew again", "the target comes to the center"], "good")
    drawn.box(540, 200, 200, ["or, by offset", "slew beside the target", "by minus the offset"])
    return drawn.svg()


DIAGRAMS = {"guarded-sync": guarded_sync, "geometry": geometry}


def record(commands: list[str], environment: dict[str, str]) -> str:
    """Run commands, and draw what a terminal shows of them."""
    console = Console(record=True, width=100, file=io.StringIO(), force_terminal=True)
    for command in commands:
        console.print(Text.assemble(("$ ", "bold green"), (command, "bold")))
        shown = subprocess.run(
            ["bash", "-c", command.replace("mountnav", f"'{sys.executable}' -m api.main", 1)],
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            check=False,
        ).stdout
        console.print(Text.from_ansi(shown.rstrip()))
    # no font of another host: the reader's own
    drawn = console.export_svg(title="mountnav")
    while "@font-face" in drawn:
        begin = drawn.index("@font-face")
        drawn = drawn[:begin] + drawn[drawn.index("}", begin) + 1 :]
    return drawn.replace("Fira Code", "ui-monospace")


@dataclass(frozen=True)
class Served:
    """A virtual observatory that is running."""

    url: str
    process: subprocess.Popen[bytes]
    environment: dict[str, str]


@contextmanager
def served() -> Iterator[Served]:
    """Start a virtual observatory on a free port, with a journal of its own, and end it afterwards."""
    with socket.create_server(("127.0.0.1", 0)) as bound:
        port = bound.getsockname()[1]
    with TemporaryDirectory() as folder:
        environment = {
            **os.environ,
            "PYTHONPATH": str(ROOT),
            "MOUNTNAV_SERVICE": f"http://127.0.0.1:{port}",
            "MOUNTNAV_JOURNAL": f"{folder}/journal.sqlite",
            "COLUMNS": "100",
        }
        process = subprocess.Popen(
            [sys.executable, "-m", "api.main", *SERVICE, "--port", str(port)],
            env=environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            while True:
                with socket.socket() as asked:
                    if asked.connect_ex(("127.0.0.1", port)) == 0:
                        break
                if process.poll() is not None:
                    raise SystemExit("the service did not start")
                time.sleep(0.2)
            yield Served(environment["MOUNTNAV_SERVICE"], process, environment)
        finally:
            process.terminate()
            process.wait()


def terminals() -> None:
    """Record the commands."""
    with served() as service:
        for name, commands in RECORDINGS.items():
            (IMAGES / f"{name}.svg").write_text(record(commands, service.environment), encoding="utf-8")


def _kept(picture: bytes, name: str) -> None:
    """Write a picture with 256 colors: a third of the bytes, and nobody sees it."""
    from PIL import Image

    image = Image.open(io.BytesIO(picture)).convert("RGB").quantize(256, dither=Image.Dither.NONE)
    image.save(IMAGES / f"{name}.png", optimize=True)


def _in_order(shown: Page, **options: Any) -> bytes:
    """A picture of a page that is connected to a mount in order: on a busy machine answers come late."""
    from playwright.sync_api import TimeoutError as Late

    in_order = (
        "() => !document.body.classList.contains('lost') && !document.body.classList.contains('old')"
        " && document.body.dataset.tone !== 'bad'"
    )
    for _ in range(_TRIES):
        try:
            shown.wait_for_function(in_order)
        except Late:
            break
        picture = shown.screenshot(**options)
        if shown.evaluate(in_order):
            return picture
    raise SystemExit(
        "the page lost the service, or the service its mount: draw when this machine is less busy"
    )


def page() -> None:
    """Take the web page: a star that was centered, by day and by night, on a phone, and without a service."""
    from playwright.sync_api import sync_playwright

    program = shutil.which("chromium") or shutil.which("google-chrome")
    if program is None:
        raise SystemExit("no chromium on this machine: apt-get install chromium")
    known = "() => document.querySelector('#place-list dd').textContent !== '–'"
    with served() as service, sync_playwright() as playwright:
        for target in ("Capella", "Mirach"):
            subprocess.run(
                [sys.executable, "-m", "api.main", "center", target],
                env=service.environment,
                stdout=subprocess.DEVNULL,
                check=True,
            )
        browser = playwright.chromium.launch(
            executable_path=program, args=["--no-sandbox", "--disable-dev-shm-usage"]
        )
        screen = browser.new_page(viewport={"width": 1560, "height": 1330})
        phone = browser.new_context(
            viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True, device_scale_factor=2
        ).new_page()
        for shown in (screen, phone):
            shown.goto(service.url)
            shown.wait_for_function(known)
            shown.wait_for_function("() => !document.body.textContent.includes('No frame yet')")
            shown.wait_for_timeout(3000)  # charts are drawn from several answers
        for name, shown in (("page-centering", screen), ("page-phone", phone)):
            _kept(_in_order(shown), name)
        # for the README: what fits on a screen
        wide = {"x": 0, "y": 0, "width": 1560, "height": 720}
        _kept(_in_order(screen, clip=wide), "page-wide")
        for name, shown in (("page-night", screen), ("page-phone-night", phone)):
            shown.locator("#night-mode").click()
            shown.evaluate("window.scrollTo(0, 0)")
            _kept(_in_order(shown), name)
        screen.locator("#night-mode").click()
        screen.set_viewport_size({"width": 1560, "height": 620})
        # a service that hangs: nothing is heard, nothing is closed
        service.process.send_signal(signal.SIGSTOP)
        try:
            screen.wait_for_function("() => document.title.includes('No connection')")
            screen.evaluate("window.scrollTo(0, 0)")
            _kept(screen.screenshot(), "page-lost")
        finally:
            service.process.send_signal(signal.SIGCONT)
        browser.close()


def diagrams() -> None:
    """Draw the diagrams."""
    for name, draw in DIAGRAMS.items():
        (IMAGES / f"{name}.svg").write_text(draw(), encoding="utf-8")


KINDS = {"diagrams": diagrams, "terminals": terminals, "page": page}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("kinds", nargs="*", help=", ".join(KINDS))
    asked = parser.parse_args()
    unknown = sorted(set(asked.kinds) - set(KINDS))
    if unknown:
        parser.error(f"no kind {unknown[0]}: {', '.join(KINDS)}")
    for name in asked.kinds or KINDS:
        KINDS[name]()


if __name__ == "__main__":
    main()
