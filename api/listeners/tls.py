"""TLS of the ports that speak HTTP: certificates renewed while they serve, handshakes bounded.

asyncio gives a client a minute to shake hands, uncounted: enough of them would hold every file descriptor,
and keep a stop out.
"""

from __future__ import annotations

import asyncio
import logging
import ssl
from asyncio.sslproto import SSLProtocol
from pathlib import Path
from typing import Literal

from api.listeners.certificate import own_certificate
from mountnav.errors import BadSettings
from mountnav.journal.database import database_url, file_of, state_folder
from mountnav.tasks import begun, fault_words

__all__ = ["HANDSHAKES", "Certificate", "Handshakes", "ShakingHands"]

_log = logging.getLogger(__name__)

_HANDSHAKE_S = 5
"""A client of TLS has so long to shake hands, s; half a second is long already. Doubled, those that never do
hold their place twice as long."""
HANDSHAKES = 32
"""Clients of the service's port that shake hands at a time, each a file descriptor beside those of its share
(`api.listeners.admission`, whose own 96 have room for them). Halved, a page's seven connections and a few
slow phones keep each other out."""
_LOOKED_AT_S = 6 * 3600.0
"""Between two looks at a certificate's end and files, s; it is made again a month before. Doubled, files that
an ACME client has renewed are taken up to half a day later."""


class Certificate:
    """The certificate of a port, its own or an operator's.

    Parameters
    ----------
    files : (Path or None, Path or None)
        Certificate and key of ``files``.
    journal : str
        Path or URL: one of its own lies beside it, else in the folder of the user's state.
    host : str
        Where the port listens.
    name : str
        Of the port, for messages and the name of the file.
    """

    def __init__(
        self,
        tls: Literal["off", "self", "files"],
        files: tuple[Path | None, Path | None],
        journal: str,
        host: str,
        name: str,
    ) -> None:
        self._tls, self._files, self._journal = tls, files, journal
        self._host, self._name = host, name
        self._context: ssl.SSLContext | None = None
        self._taken: object = None

    def context(self) -> ssl.SSLContext | None:
        """What connections are wrapped by; None without TLS. Blocks.

        Raises
        ------
        BadSettings
            The certificate can't be had, or used.
        """
        if self._tls == "off":
            return None
        self._context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        self._context.minimum_version = ssl.TLSVersion.TLSv1_2
        self.refresh()
        return self._context

    def refresh(self) -> bool:
        """Take the certificate again if it is another one now, for all who shake hands from now on. Blocks.

        Raises
        ------
        BadSettings
            It can't be had, or used; the one before goes on.
        """
        assert self._context is not None
        if self._tls == "files":
            certificate, key = self._files
            assert certificate is not None
            seen: object = tuple(_mark(one) for one in (certificate, key) if one is not None)
            words = ""
        else:
            file = file_of(database_url(self._journal))
            folder = state_folder() if file is None else file.parent
            certificate, fingerprint = own_certificate(folder, self._host, self._name)
            key, seen = None, fingerprint
            words = f", SHA-256 fingerprint {fingerprint}"
        if seen == self._taken:
            return False
        try:
            # first by another: a certificate without its key would take the one in force with it
            ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(certificate, key, password=_no_password)
            self._context.load_cert_chain(certificate, key, password=_no_password)
        except (OSError, ValueError) as fault:
            raise BadSettings(
                f"the certificate can't be used: {getattr(fault, 'strerror', None) or fault}",
                device=str(certificate),
                advice="PEM files of certificate and key, the key without a password",
            ) from fault
        self._taken = seen
        whose = "its own certificate" if self._tls == "self" else "the certificate"
        _log.info("%s: %s %s%s", self._name, whose, certificate, words)
        return True

    @property
    def fingerprint(self) -> str:
        """SHA-256 of one of its own, as browsers show it; empty for files."""
        return self._taken if isinstance(self._taken, str) else ""

    def kept_up(self) -> asyncio.Task[None] | None:
        """Begin to look after it; None without TLS."""
        if self._context is None:
            return None
        return begun(self._keep_up(), f"certificate of {self._name}", died=self._died)

    async def _keep_up(self) -> None:
        while True:
            await asyncio.sleep(_LOOKED_AT_S)
            try:
                await asyncio.to_thread(self.refresh)
            except BadSettings as fault:
                _log.error("%s: the present certificate stays in use: %s", self._name, fault)

    def _died(self, fault: Exception) -> None:
        _log.error("%s: its certificate is not renewed any more: %s", self._name, fault_words(fault))


def _mark(path: Path) -> object:
    try:
        found = path.stat()
    except OSError:
        return path
    return path, found.st_mtime_ns, found.st_size, found.st_ino


def _no_password() -> str:
    """OpenSSL would ask on the terminal, and the service would wait there."""
    return ""


class Handshakes:
    """Clients that haven't shaken hands yet: beyond so many, who has waited longest goes."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._waiting: dict[ShakingHands, asyncio.BaseTransport] = {}

    def began(self, one: ShakingHands, transport: asyncio.BaseTransport) -> None:
        """A client is there."""
        if len(self._waiting) >= self._most:
            oldest = next(iter(self._waiting))
            self._abort(self._waiting.pop(oldest))
        self._waiting[one] = transport

    def ended(self, one: ShakingHands) -> None:
        """It has shaken hands, or is gone. Twice is fine."""
        self._waiting.pop(one, None)

    def end(self) -> None:
        """Let all go."""
        for transport in [*self._waiting.values()]:
            self._abort(transport)
        self._waiting.clear()

    @staticmethod
    def _abort(transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        transport.abort()


class ShakingHands(SSLProtocol):
    """A client of TLS before its connection: it counts until it has shaken hands."""

    def __init__(
        self,
        handshakes: Handshakes,
        loop: asyncio.AbstractEventLoop,
        beyond: asyncio.Protocol,
        context: ssl.SSLContext,
    ) -> None:
        super().__init__(
            loop,
            beyond,
            context,
            None,  # type: ignore[arg-type]  # nobody waits for the handshake
            server_side=True,
            ssl_handshake_timeout=_HANDSHAKE_S,
        )
        self._counted = handshakes
        meet = beyond.connection_made

        def met(transport: asyncio.BaseTransport) -> None:
            handshakes.ended(self)
            meet(transport)

        # asyncio tells the connection of its being made when hands are shaken
        beyond.connection_made = met  # type: ignore[method-assign]

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """It is there, and shakes hands now."""
        self._counted.began(self, transport)
        super().connection_made(transport)

    def connection_lost(self, exc: BaseException | None) -> None:
        """It is gone."""
        self._counted.ended(self)
        super().connection_lost(exc)
