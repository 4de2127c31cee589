"""`mountnav site`: the page of all services, served until it is interrupted."""

from __future__ import annotations

import uvicorn

from api.access.log_rates import limit_log_rates
from api.http.connections import Bounds, Gate
from api.http.service_log import begin_log
from api.http.serving import bind
from api.site.app import create_site
from api.site.remote import tls_of
from mountnav.settings.site_file import SiteFile

_BOUNDS = Bounds(most=128, each_address=64, stops=16, fresh=8)
"""Connections at a time; a page holds two."""

_GOODBYE_S = 2
"""How long open requests may take at the end: a stop that was given is answered within that."""


def serve_site(settings: SiteFile) -> int:
    """Serve until interrupted; the exit code.

    Raises
    ------
    BadSettings
        A key or a certificate can't be read, or the address can't be had.
    """
    for one in settings.service:  # what is wrong with a file is told before anything is served
        one.key()
        tls_of(one)
    page = settings.site
    begin_log("auto", "info")
    with bind(page.host, page.port) as listener:
        host, port = listener.getsockname()[:2]
        scheme = "http" if page.tls == "off" else "https"
        print(f"site at {scheme}://{f'[{host}]' if ':' in host else host}:{port}", flush=True)
        config = uvicorn.Config(
            create_site(settings),
            http=Gate(_BOUNDS).protocol(),  # type: ignore[arg-type]
            log_config=None,
            log_level="info",
            loop="asyncio",
            ws="none",
            server_header=False,
            timeout_graceful_shutdown=_GOODBYE_S,
            ssl_certfile=None if page.certificate is None else str(page.certificate),
            ssl_keyfile=None if page.certificate_key is None else str(page.certificate_key),
        )
        limit_log_rates("", "uvicorn", "uvicorn.access")
        server = uvicorn.Server(config)
        server.run(sockets=[listener])
    return 0 if server.started else 1
