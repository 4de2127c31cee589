"""The documentation at `/help`: the built site. It tells nothing of the sky, so no key is needed."""

from __future__ import annotations

import base64
import hashlib
import re

from fastapi import APIRouter, Response
from fastapi.responses import PlainTextResponse, RedirectResponse

from api.help.site import HOW_TO_BUILD, NOT_BUILT, site_files
from api.problems import responses
from mountnav.errors import NotFound

__all__ = ["router"]

router = APIRouter(include_in_schema=False)

_MEDIA_TYPES = {
    "html": "text/html; charset=utf-8",
    "css": "text/css; charset=utf-8",
    "js": "text/javascript; charset=utf-8",
    "json": "application/json",
    "svg": "image/svg+xml",
    "png": "image/png",
    "txt": "text/plain; charset=utf-8",
    "py": "text/plain; charset=utf-8",
    "ipynb": "application/json",
    "xml": "application/xml",
}
"""What the site is made of, by the ending of a file's name; nothing else is served."""

_INLINE_SCRIPT = re.compile(r"<script>(.*?)</script>", re.DOTALL)


@router.api_route("/help", methods=["GET", "HEAD"])
@router.api_route("/help/", methods=["GET", "HEAD"])
def get_help() -> Response:
    """The front page of the documentation."""
    if not site_files():
        return PlainTextResponse(f"{NOT_BUILT[0].upper()}{NOT_BUILT[1:]}. {HOW_TO_BUILD}.\n", status_code=404)
    return RedirectResponse("/help/index.html")


@router.api_route("/help/{path:path}", methods=["GET", "HEAD"], responses=responses(404))
def get_help_file(path: str) -> Response:
    """A file of the site; the path is looked up in a list, and never reaches the disk."""
    if not site_files():
        return get_help()
    media_type = _MEDIA_TYPES.get(path.rpartition(".")[2])
    file = site_files().get(path)
    if file is None or media_type is None:
        raise NotFound("the documentation has no such page", advice="GET /help is its front page")
    try:
        content = file.read_bytes()
    except OSError as error:
        raise NotFound("the documentation has changed", advice="start the service again") from error
    headers = {"Cache-Control": "no-cache"}
    if media_type.startswith("text/html"):
        headers["Content-Security-Policy"] = _policy(content.decode("utf-8", "replace"))
    return Response(content, media_type=media_type, headers=headers)


def _policy(html: str) -> str:
    """What a page may load and run: its own files, and the scripts that stand in it, each by its digest."""
    digests = sorted(
        {
            f"'sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}'"
            for script in _INLINE_SCRIPT.findall(html)
        }
    )
    return "; ".join(
        (
            "default-src 'none'",
            " ".join(("script-src 'self'", *digests)),
            "worker-src 'self'",
            # the theme sizes and colors by attributes
            "style-src 'self' 'unsafe-inline'",
            "img-src 'self' data:",
            "connect-src 'self'",
            "font-src 'self'",
            "base-uri 'none'",
            "form-action 'none'",
            "frame-ancestors 'none'",
        )
    )
