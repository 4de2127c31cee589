"""The page: static files of the package, served at `/`; all that it shows and does are calls of `/v1`."""

from __future__ import annotations

import gzip
import hashlib
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from importlib.resources.abc import Traversable
from typing import Annotated

from fastapi import APIRouter, Header, Response

from api.problems import responses
from mountnav.errors import NotFound

router = APIRouter(include_in_schema=False)

MEDIA_TYPES = {
    "html": "text/html; charset=utf-8",
    "css": "text/css; charset=utf-8",
    "js": "text/javascript; charset=utf-8",
    "svg": "image/svg+xml",
    "webmanifest": "application/manifest+json",
    "txt": "text/plain; charset=utf-8",
}
"""What the page is made of, by the ending of a file's name; nothing else is served."""

POLICY = "; ".join(
    (
        "default-src 'none'",
        "script-src 'self'",
        "style-src 'self'",
        "img-src 'self' blob:",
        "connect-src 'self'",
        "manifest-src 'self'",
        "base-uri 'none'",
        "form-action 'none'",
        "frame-ancestors 'none'",
    )
)
"""Nothing from elsewhere is loaded or run, and no other page can frame this one with its buttons."""

_HEADERS = {
    "Content-Security-Policy": POLICY,
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    # asked again each time, answered by 304: after an update nobody steers with yesterday's page
    "Cache-Control": "no-cache",
    "Vary": "Accept-Encoding",
}

IfNoneMatch = Annotated[str | None, Header(alias="If-None-Match", max_length=500)]
Encodings = Annotated[str, Header(alias="Accept-Encoding", max_length=500)]


@dataclass(frozen=True, slots=True)
class _Asset:
    content: bytes
    packed: bytes
    media_type: str
    digest: str


@cache
def _assets(package: str) -> dict[str, _Asset]:
    """All files of a page by their path; read once, so that no path of a request ever reaches a disk."""
    found: dict[str, _Asset] = {}

    def gather(folder: Traversable, path: str) -> None:
        for file in folder.iterdir():
            if file.is_dir():
                gather(file, f"{path}{file.name}/")
                continue
            media_type = MEDIA_TYPES.get(file.name.rpartition(".")[2])
            if media_type is not None:
                content = file.read_bytes()
                digest = hashlib.sha256(content).hexdigest()[:20]
                packed = gzip.compress(content, 9, mtime=0)
                found[f"{path}{file.name}"] = _Asset(content, packed, media_type, digest)

    gather(files(package).joinpath("web"), "")
    return found


@router.api_route("/", methods=["GET", "HEAD"])
def get_page(if_none_match: IfNoneMatch = None, accepted: Encodings = "") -> Response:
    """The page itself."""
    return asset_answer("api", "index.html", if_none_match, accepted)


@router.api_route("/web/{path:path}", methods=["GET", "HEAD"], responses=responses(404))
def get_asset(path: str, if_none_match: IfNoneMatch = None, accepted: Encodings = "") -> Response:
    """One of its files."""
    return asset_answer("api", path, if_none_match, accepted)


@router.api_route("/favicon.ico", methods=["GET", "HEAD"])
def get_icon(if_none_match: IfNoneMatch = None, accepted: Encodings = "") -> Response:
    """The icon where browsers look for one."""
    return asset_answer("api", "icon.svg", if_none_match, accepted)


def asset_answer(package: str, path: str, if_none_match: str | None, accepted: str) -> Response:
    """A file of the page in a package's folder ``web``. Raises `NotFound`."""
    asset = _assets(package).get(path)
    if asset is None:
        raise NotFound("the page has no such file", advice="GET / is the page")
    packed = _takes_gzip(accepted)
    headers = {**_HEADERS, "ETag": f'"{asset.digest}{"-gz" if packed else ""}"'}
    known = (
        []
        if if_none_match is None
        else [part.strip().removeprefix("W/") for part in if_none_match.split(",")]
    )
    if headers["ETag"] in known:
        return Response(status_code=304, headers=headers)
    if packed:
        headers["Content-Encoding"] = "gzip"
    return Response(asset.packed if packed else asset.content, media_type=asset.media_type, headers=headers)


def _takes_gzip(accepted: str) -> bool:
    for part in accepted.lower().split(","):
        name, _, parameters = part.partition(";")
        if name.strip() == "gzip":
            return parameters.replace(" ", "") not in ("q=0", "q=0.0", "q=0.00", "q=0.000")
    return False


__all__ = ["MEDIA_TYPES", "POLICY", "asset_answer", "router"]
