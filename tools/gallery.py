"""Run the notebooks of docs/gallery and write their pages: text, code, what it printed, and its plots.

    python tools/gallery.py             # all of them
    python tools/gallery.py accuracy    # one
    python tools/gallery.py --out DIR   # elsewhere, to compare

A notebook is a script of cells: `# %% [markdown]` and `# %%`, as Jupyter (with jupytext), VS Code and Spyder
open them. The docstring of the script is the page's title.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import re
import sys
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
GALLERY = ROOT / "docs" / "gallery"
_MARK = re.compile(r"^# %%( \[markdown\])?\n", re.MULTILINE)
_DOTS_PER_INCH = 80
"""Of the plots: as wide as a page shows them."""


@dataclass(frozen=True)
class Cell:
    """A piece of a notebook: words or code."""

    markdown: bool
    text: str
    line: int


def cells_of(script: str) -> tuple[str, list[Cell]]:
    """Cut a script into its title and its cells."""
    marks = list(_MARK.finditer(script))
    title = script[: marks[0].start()].strip().strip('"').rstrip(".")
    cells = []
    for mark, after in zip(marks, [*marks[1:], None], strict=True):
        body = script[mark.end() : after.start() if after else len(script)].strip("\n")
        line = script.count("\n", 0, mark.end())
        if mark[1]:
            body = "\n".join(one.removeprefix("#").removeprefix(" ") for one in body.split("\n"))
        cells.append(Cell(bool(mark[1]), body, line))
    return title, cells


def run(path: Path, out: Path) -> str:
    """Execute a notebook, write its plots below `out`, and return its page.

    Parameters
    ----------
    path : Path
        The script.
    out : Path
        Folder of the page; plots go to `images` in it.

    Returns
    -------
    str
        Markdown.
    """
    import matplotlib as mpl

    mpl.use("agg")
    import matplotlib.pyplot as plt

    title, cells = cells_of(path.read_text(encoding="utf-8"))
    (out / "images").mkdir(parents=True, exist_ok=True)
    shown = os.path.relpath(path, ROOT)
    parts = [f"# {title}", f"*A notebook: `{shown}`, run by `python tools/gallery.py {path.stem}`.*"]
    space: dict[str, object] = {"__name__": "__main__"}
    plots = 0
    for cell in cells:
        if cell.markdown:
            parts.append(cell.text)
            continue
        printed = io.StringIO()
        # as many lines before it as in the script, so that a fault names its line there
        code = compile("\n" * cell.line + cell.text, str(path), "exec")
        with contextlib.redirect_stdout(printed):
            exec(code, space)
        parts.append(f"```python\n{cell.text}\n```")
        if printed.getvalue():
            parts.append(f"```text\n{printed.getvalue().rstrip()}\n```")
        for number in plt.get_fignums():
            plots += 1
            name = f"images/{path.stem}-{plots}.png"
            figure = plt.figure(number)
            words = figure.get_label() or f"{title}, plot {plots}"
            figure.savefig(out / name, dpi=_DOTS_PER_INCH, bbox_inches="tight", metadata={"Software": None})
            plt.close(figure)
            parts.append(f"![{words}]({name})")
    return "\n\n".join(parts) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", help="of the notebooks; all by default")
    parser.add_argument("--out", type=Path, default=GALLERY, help="folder of the pages")
    asked = parser.parse_args()
    sys.path.insert(0, str(ROOT))
    for path in sorted(GALLERY.glob("*.py")):
        if not asked.names or path.stem in asked.names:
            (asked.out / f"{path.stem}.md").write_text(run(path, asked.out), encoding="utf-8")


if __name__ == "__main__":
    main()
