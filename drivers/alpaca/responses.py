"""What an HTTP response means before its envelope is read, and what nonsense becomes [Alpaca §1, §2]."""

from __future__ import annotations

import httpx

from drivers.alpaca.codec import Malformed, excerpt
from drivers.alpaca.refusals import AlpacaRefused
from mountnav.errors import DeviceGarbled, DeviceMissing, DeviceRefused, DeviceSilent, Refusal

_NO_ACCESS = (401, 403)
_LATER = (408, 429)
"""What a busy server says; all else between 400 and 499 is a no."""
_UNKNOWN = ": whether it was taken up is not known"


def require_understood(response: httpx.Response, what: str, device: str, *, order: bool = False) -> None:
    """Raise what any status but 200 means.

    Raises
    ------
    DeviceMissing
        If the server wants to know who asks, or sends elsewhere.
    AlpacaRefused
        If it says no.
    DeviceSilent
        If it failed over it.
    """
    status = response.status_code
    if status == httpx.codes.OK:
        return
    said = excerpt(response.content)
    if status in _NO_ACCESS:
        raise DeviceMissing(
            f"the server wants to know who we are (HTTP status {status})",
            device=device,
            advice="put user:password@ before the host in its URL",
        )
    if 300 <= status < 400:
        raise DeviceMissing(
            f"the server sends us elsewhere (HTTP status {status}, {response.headers.get('location')!r})",
            device=device,
            advice="put the address it names into the URL",
        )
    if 400 <= status < 500 and status not in _LATER:
        raise AlpacaRefused(
            f"refused {what}: HTTP status {status}, {said}",
            device=device,
            advice="is it the right device?",
            reason=Refusal.OTHER if order else Refusal.UNSUPPORTED,
            words=said,
        )
    raise DeviceSilent(
        f"the server failed over {what} (HTTP status {status}, {said}){_UNKNOWN if order else ''}",
        device=device,
        advice="see the server's own log",
    )


def garbled(what: str, fault: Exception, device: str, *, order: bool = False) -> DeviceGarbled:
    """Make the error of an answer that makes no sense."""
    return DeviceGarbled(
        f"answered {what} with nonsense: {fault}{_UNKNOWN if order else ''}",
        device=device,
        advice="is it an Alpaca server, without a proxy between?",
    )


def understood(what: str, fault: Malformed, device: str) -> DeviceGarbled:
    """Make the error of a value that makes no sense."""
    return DeviceGarbled(f"told nonsense of its {what}: {fault}", device=device, advice="see its driver")


def require_known(one: DeviceRefused) -> None:
    """Pass over what a device doesn't have; raise any other refusal."""
    if not (isinstance(one, AlpacaRefused) and one.unsupported):
        raise one
