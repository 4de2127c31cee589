"""Addresses and networks in the settings: who may come in where no keys are known."""

from __future__ import annotations

import contextlib
import ipaddress
from collections.abc import Sequence
from typing import Annotated

from pydantic import AfterValidator, Field
from pydantic_core import PydanticCustomError

__all__ = ["Network", "in_networks", "is_everywhere", "is_loopback"]


def _network(text: str) -> str:
    try:
        return str(ipaddress.ip_network(text.strip()))
    except ValueError as wrong:
        fix = 'write an address, "192.168.1.17", or a network, "192.168.1.0/24"; names are not looked up'
        with contextlib.suppress(ValueError):
            fix = f'the network is "{ipaddress.ip_network(text.strip(), strict=False)}"'
        raise PydanticCustomError(
            "no_network", "{text} is neither an address nor a network", {"text": repr(text), "fix": fix}
        ) from wrong


Network = Annotated[str, Field(max_length=64), AfterValidator(_network)]
"""An address or a network, in its shortest form."""


def in_networks(address: str, networks: Sequence[str]) -> bool:
    """Whether an address is this machine's own, or in one of the networks; what is no address is not.

    An IPv4 address that comes in over IPv6 (``::ffff:192.168.1.17``) counts as what it is.
    """
    try:
        found = ipaddress.ip_address(address.partition("%")[0])
    except ValueError:
        return False
    if isinstance(found, ipaddress.IPv6Address) and found.ipv4_mapped is not None:
        found = found.ipv4_mapped
    return found.is_loopback or any(found in ipaddress.ip_network(one) for one in networks)


def is_everywhere(network: str) -> bool:
    """Whether a network has every address of its kind, or half of them."""
    return ipaddress.ip_network(network).prefixlen <= 1


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches what listens at a host: an address, or a name."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
