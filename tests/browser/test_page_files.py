"""The page's files, without a browser: headers, caching, nothing from elsewhere, all of it in the package."""

from __future__ import annotations

import json
import random
import re
import subprocess
from collections.abc import AsyncIterator
from importlib.resources import files
from pathlib import Path
from shutil import which

import httpx
import pytest
from fastapi import FastAPI

from api.http.routes import page
from api.problems import install
from mountnav.errors import BadRequest
from mountnav.sky.typed_coordinates import TypedName, read_target

WEB = Path(str(files("api").joinpath("web")))
SERVED = sorted(path for path in WEB.rglob("*") if path.suffix[1:] in page.MEDIA_TYPES)


@pytest.fixture
async def client() -> AsyncIterator[httpx.AsyncClient]:
    app = FastAPI()
    install(app)
    app.include_router(page.router)
    transport = httpx.ASGITransport(app=app)
    async with httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1") as opened:
        yield opened


@pytest.mark.long
async def test_the_page_and_each_of_its_files_are_served_with_type_and_tag(client: httpx.AsyncClient) -> None:
    assert len(SERVED) > 20
    for path in SERVED:
        name = path.relative_to(WEB).as_posix()
        answer = await client.get(f"/web/{name}")
        assert answer.status_code == 200, name
        assert answer.content == path.read_bytes()
        assert answer.headers["content-encoding"] == "gzip"
        plain = await client.get(f"/web/{name}", headers={"Accept-Encoding": "gzip;q=0"})
        assert plain.content == path.read_bytes()
        assert "content-encoding" not in plain.headers
        assert plain.headers["etag"] != answer.headers["etag"]
        assert plain.headers["vary"] == "Accept-Encoding"
        assert answer.headers["content-type"] == page.MEDIA_TYPES[path.suffix[1:]]
        assert answer.headers["x-content-type-options"] == "nosniff"
        again = await client.get(
            f"/web/{name}", headers={"If-None-Match": f'"other", W/{answer.headers["etag"]}'}
        )
        assert (again.status_code, again.content) == (304, b"")
        assert again.headers["etag"] == answer.headers["etag"]
        stale = await client.get(f"/web/{name}", headers={"If-None-Match": '"other"'})
        assert stale.status_code == 200
    assert (await client.get("/")).content == (WEB / "index.html").read_bytes()
    assert (await client.head("/")).status_code == 200
    assert (await client.get("/favicon.ico")).headers["content-type"] == "image/svg+xml"


@pytest.mark.parametrize(
    "path", ["none.js", "", "../routes/page.py", "..%2froutes%2fpage.py", "js", "/etc/passwd"]
)
async def test_nothing_else_is_served(client: httpx.AsyncClient, path: str) -> None:
    answer = await client.get(f"/web/{path}")
    assert answer.status_code == 404
    assert b"router" not in answer.content


async def test_the_policy_lets_nothing_in_from_elsewhere(client: httpx.AsyncClient) -> None:
    policy = (await client.get("/")).headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "frame-ancestors 'none'" in policy
    assert "unsafe" not in policy
    assert "http" not in policy


async def test_the_page_needs_no_inline_code_and_no_network_but_its_own(client: httpx.AsyncClient) -> None:
    html = (WEB / "index.html").read_text()
    assert not re.findall(r"<script(?![^>]*\bsrc=)", html)
    assert not re.findall(r"\s(on[a-z]+|style)=", html)
    assert "<style" not in html
    for path in SERVED:
        if path.parent.name == "vendor" or path.suffix == ".svg":
            continue
        assert not re.findall(r"https?://|//[a-z0-9-]+\.[a-z]{2,}/", path.read_text()), path.name
    named = set(re.findall(r'(?:href|src)="(/[^"]+)"', html)) - {"/docs", "/help"}
    for path in SERVED:
        if path.suffix == ".js" and path.parent.name == "js":
            named |= {f"/web/js/{one}" for one in re.findall(r'from "\./([^"]+)"', path.read_text())}
    for name in named:
        assert (await client.get(name)).status_code == 200, name


def test_ids_are_there_once_and_asked_for_rightly() -> None:
    html = (WEB / "index.html").read_text()
    ids = re.findall(r'\bid="([^"]+)"', html)
    assert len(ids) == len(set(ids))
    for path in WEB.glob("js/*.js"):
        for wanted in re.findall(r'\bby\("([^"]+)"\)', path.read_text()):
            assert wanted in ids, f"{path.name} asks for #{wanted}"
    for name in re.findall(r'aria-(?:labelledby|describedby|controls)="([^"]+)"', html):
        assert set(name.split()) <= set(ids)


def test_the_library_came_with_its_license() -> None:
    assert "MIT License" in (WEB / "vendor" / "uplot-license.txt").read_text()
    assert "uPlot" in (WEB / "vendor" / "uplot.js").read_text()[:100]


TABLE = json.loads((Path(__file__).parents[1] / "sky" / "typed_coordinates.json").read_text(encoding="utf-8"))
"""The same rules as `mountnav.sky.typed_coordinates`, held to the same table."""


def _read(texts: list[str]) -> dict[str, dict[str, object]]:
    node = which("node")
    if node is None:
        pytest.skip("node is not here: tests/browser/test_browser_page.py reads a few of them in the browser")
    script = (
        f"import {{ readTarget }} from {json.dumps((WEB / 'js' / 'angles.js').as_uri())};"
        f"const texts = {json.dumps(texts)};"
        "console.log(JSON.stringify(Object.fromEntries(texts.map((one) => [one, readTarget(one)]))));"
    )
    ran = subprocess.run(
        [node, "--input-type=module"], input=script, capture_output=True, text=True, check=True, timeout=60
    )
    found: dict[str, dict[str, object]] = json.loads(ran.stdout)
    return found


def test_typed_coordinates_are_read_rightly_or_refused_with_the_reason() -> None:
    positions, names, refused, empty = (TABLE[kind] for kind in ("positions", "names", "refused", "empty"))
    found = _read([*positions, *names, *refused, *empty])
    for text, (ra_deg, dec_deg, unit) in positions.items():
        assert found[text]["kind"] == "place", (text, found[text])
        assert found[text]["ra_deg"] == pytest.approx(ra_deg, abs=1e-6), text
        assert found[text]["dec_deg"] == pytest.approx(dec_deg, abs=1e-6), text
        assert found[text]["read"] == unit, text
    for text in names:
        assert found[text] == {"kind": "name", "name": text}
    for text, why in refused.items():
        assert found[text]["kind"] == "wrong", (text, found[text])
        assert why in str(found[text]["why"]), (text, found[text])
    assert all(found[text]["kind"] == "empty" for text in empty)


@pytest.mark.long
def test_the_page_and_the_service_read_alike() -> None:
    """Texts strewn from the characters that count: the same answer, word for word."""
    chance = random.Random(20261123)
    pieces = [
        *"0123456789",
        *"+-.,; :°'\"hmsd",
        "12",
        "30",
        " ",
        "h",
        "m",
        ":",
        "05",
        "22.5",
        "RA",
        "′",
        "\u00a0",
    ]
    texts = ["".join(chance.choices(pieces, k=chance.randint(1, 14))) for _ in range(20_000)]
    for text, found in _read(texts).items():
        try:
            read = read_target(text)
        except BadRequest as wrong:
            said: dict[str, object] = (
                {"kind": "empty"} if found["kind"] == "empty" else {"kind": "wrong", "why": wrong.what}
            )
        else:
            if isinstance(read, TypedName):
                said = {"kind": "name", "name": read.name}
            else:
                said = {
                    "kind": "place",
                    "ra_deg": read.ra_deg,
                    "dec_deg": read.dec_deg,
                    "read": "hours" if read.ra_in_hours else "degrees",
                }
        assert found == said, text


def _luminance(color: str) -> float:
    """Relative luminance of a color as a style sheet writes it [WCAG 2.2]."""
    digits = color.lstrip("#")
    digits = "".join(2 * one for one in digits) if len(digits) == 3 else digits
    parts = [int(digits[at : at + 2], 16) / 255 for at in (0, 2, 4)]
    r, g, b = (one / 12.92 if one <= 0.04045 else ((one + 0.055) / 1.055) ** 2.4 for one in parts)
    return 0.2126 * r + 0.7152 * g + 0.0722 * b


def _contrast(one: str, other: str) -> float:
    low, high = sorted((_luminance(one), _luminance(other)))
    return (high + 0.05) / (low + 0.05)


def test_letters_stand_out_from_what_lies_beneath() -> None:
    css = (WEB / "page.css").read_text()
    day, night = (
        dict(
            re.findall(
                r"--([a-z-]+): (#[0-9a-f]+);", css[css.index(start) : css.index("}", css.index(start))]
            )
        )
        for start in (":root {", ":root[data-night] {")
    )
    for ground in ("bg", "panel", "raised"):
        for letters in ("text", "dim", "faint", "accent", "good", "warn", "bad", "hot"):
            assert _contrast(day[letters], day[ground]) >= 4.5, (letters, ground)
            # red alone reaches 5.25 on black at the very most: what must be read at night comes near to it
            least = 4.4 if letters in ("text", "accent", "warn", "bad", "hot") else 2.9
            assert _contrast(night[letters], night[ground]) >= least, (letters, ground)
    assert _contrast(day["stop-text"], day["stop"]) >= 4.5
    assert _contrast(night["stop-text"], night["stop"]) >= 3.0  # large and bold
    assert _contrast(day["edge"], day["panel"]) >= 3.0  # of fields
