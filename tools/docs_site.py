"""What the site of the docs needs beside its pages: the files of the repository that they link to."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

_ROOT = Path(__file__).resolve().parents[1]
_FOREIGN_SHIM = "https://unpkg.com/iframe-worker/shim"
_LINK = re.compile(r"(?<!!)\[([^\]]*)\]\(((?:\.\./)+[^)\s#]+)(#[^)\s]*)?\)")


def _outside(page: Path, target: str, docs: Path) -> Path | None:
    """Path from the root of what a page links to outside of docs/; None if it is inside, or isn't there."""
    led = Path(os.path.normpath(page.parent / target))
    if led.is_relative_to(docs) or not led.is_relative_to(_ROOT) or not led.exists():
        return None
    return led.relative_to(_ROOT)


def on_files(files: Files, config: Any) -> Files:
    """Add the files outside of docs/ that pages link to, below `source/`, as plain text."""
    docs = Path(config["docs_dir"])
    wanted = set()
    for file in files.documentation_pages():
        page = Path(file.abs_src_path)
        for match in _LINK.finditer(page.read_text(encoding="utf-8")):
            led = _outside(page, match[2], docs)
            if led is not None and (_ROOT / led).is_file():
                wanted.add(led)
    for led in sorted(wanted):
        content = (_ROOT / led).read_text(encoding="utf-8")
        files.append(File.generated(config, f"source/{led}.txt", content=content))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Files) -> str:
    """Lead links to files outside of docs/ to their copies; a link to a folder becomes its name."""
    docs = Path(config["docs_dir"])
    source = Path(page.file.abs_src_path)

    def led(match: re.Match[str]) -> str:
        path = _outside(source, match[2], docs)
        if path is None:
            return match[0]
        if not (_ROOT / path).is_file():
            return match[1]
        back = os.path.relpath(f"source/{path}.txt", Path(page.file.src_uri).parent)
        return f"[{match[1]}]({back})"

    return _LINK.sub(led, markdown)


def on_post_page(output: str, page: Any, config: Any) -> str:
    """Take the theme's shim for searching opened files from the site itself, not from a network."""
    depth = Path(page.file.dest_uri).parent
    shim = os.path.relpath("site/iframe-worker.js", depth)
    return output.replace(_FOREIGN_SHIM, shim)


def on_post_template(output_content: str, template_name: str, config: Any) -> str:
    """The same for the page that says that there is none."""
    return output_content.replace(_FOREIGN_SHIM, "site/iframe-worker.js")


def on_post_build(config: Any) -> None:
    """Remove what no reader needs: maps of the theme's code, stemmers of other languages."""
    site = Path(config["site_dir"])
    for file in [
        *site.rglob("*.map"),
        *site.glob("assets/javascripts/lunr/**/*.js"),
        *site.glob("sitemap.xml*"),
    ]:
        file.unlink()
