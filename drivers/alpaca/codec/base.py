"""Alpaca's addresses, forms, envelopes, values and error numbers; no I/O [Alpaca].

Whatever does not match fully is `Malformed`: a page of a proxy, the answer to another question, a NaN, a
number where a truth value belongs. None of it is ever taken for a place [Alpaca §2].
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, NoReturn

from drivers.generic.refusal_words import ADVICE, OF_HORIZON, OF_LIMITS, OF_PARKING
from mountnav.errors import DeviceRefused, Refusal


@dataclass(frozen=True, slots=True)
class DeviceAddress:
    """A device's address.

    Attributes
    ----------
    server : str
        ``http://host:port`` or ``https://host:port``.
    kind : str
        ``telescope`` or ``camera``.
    number : int
        Of the device among its kind.
    user, password : str
        For HTTP Basic; empty for none.
    ca : str or None
        File of certificates to trust besides the system's.
    """

    server: str
    kind: str
    number: int
    user: str = ""
    password: str = ""
    ca: str | None = None

    @property
    def address(self) -> str:
        """For messages; without the password."""
        return f"alpaca+{self.server}/{self.kind}/{self.number}"

    def url(self, member: str) -> str:
        """Of one of its members [Alpaca §1]."""
        return f"{self.server}/api/v1/{self.kind}/{self.number}/{member}"


# error numbers [Alpaca §3]; those from FIRST_OF_DRIVER on are each driver's own
NOT_IMPLEMENTED = 0x400  # a property or method that the device doesn't have
INVALID_VALUE = 0x401  # an argument out of range
VALUE_NOT_SET = 0x402  # read before it was written: a target, say
NOT_CONNECTED = 0x407  # Connected is false
PARKED = 0x408  # not while AtPark
SLAVED = 0x409  # not while a dome follows: busy, for us
INVALID_OPERATION = 0x40B  # not now: slewing, not tracking
ACTION_NOT_IMPLEMENTED = 0x40C  # no such Action
CANCELLED = 0x40E  # ended by another order (ITelescopeV4)
FIRST_OF_DRIVER = 0x500  # up to 0xFFF each driver's own

_NUMBERS = {
    NOT_IMPLEMENTED: Refusal.UNSUPPORTED,
    ACTION_NOT_IMPLEMENTED: Refusal.UNSUPPORTED,
    PARKED: Refusal.PARKED,
    SLAVED: Refusal.BUSY,
}
_WORDS = (
    OF_HORIZON,
    (re.compile(r"not tracking|tracking (is|must)|(enable|requires) tracking", re.I), Refusal.NOT_TRACKING),
    OF_PARKING,
    OF_LIMITS,
    (re.compile(r"not aligned|align(ment)? (is|not)|star sync|initiali[sz]e", re.I), Refusal.NOT_ALIGNED),
    (re.compile(r"busy|in progress|already|is slewing|while slewing|is moving", re.I), Refusal.BUSY),
    (re.compile(r"not support|unsupported|not implemented", re.I), Refusal.UNSUPPORTED),
)  # fmt: skip
_ADVICE = ADVICE | {Refusal.UNSUPPORTED: "its driver has no such thing"}


class AlpacaRefused(DeviceRefused):
    """The device said no, with a number.

    Parameters
    ----------
    what, device, advice, reason
        As of every refusal.
    number : int
        Alpaca's; 0 where HTTP itself said no.
    words : str
        The driver's.
    """

    def __init__(
        self,
        what: str,
        *,
        device: str | None = None,
        advice: str | None = None,
        reason: Refusal = Refusal.OTHER,
        number: int = 0,
        words: str = "",
    ) -> None:
        super().__init__(what, device=device, advice=advice, reason=reason)
        self.number = number
        self.words = words

    @property
    def unsupported(self) -> bool:
        """Whether the device has no such thing at all: HTTP itself says no to members it does not know."""
        return self.reason is Refusal.UNSUPPORTED or not self.number


def reason_of(number: int, words: str) -> Refusal:
    """Which refusal a number and its words mean, as far as they say."""
    known = _NUMBERS.get(number)
    if known is not None:
        return known
    by_words = next((reason for pattern, reason in _WORDS if pattern.search(words)), None)
    if by_words is not None:
        return by_words
    return Refusal.LIMIT if number == INVALID_VALUE else Refusal.OTHER


def refusal(what: str, number: int, words: str, device: str) -> AlpacaRefused:
    """Make the refusal of an order or a question."""
    words = " ".join(words.split())
    reason = reason_of(number, words)
    return AlpacaRefused(
        f"refused {what}: {words or 'its driver does not say why'} (Alpaca error 0x{number:X})",
        device=device,
        advice=_ADVICE.get(reason, "see what its driver says"),
        reason=reason,
        number=number,
        words=words,
    )


Parameter = str | int | float | bool
Parameters = Mapping[str, Parameter]
_EXCERPT = 120
"""Characters of a server's words that are quoted in a message. Chosen by hand: about one line of a
terminal."""
_LONGEST_TEXT = 1000
"""Characters kept of a device's own words: names and versions have some 50."""
EARLIEST, LATEST = datetime(1900, 1, 1, tzinfo=UTC), datetime(2200, 1, 1, tzinfo=UTC)
"""Instants that are one: sums with those beyond them leave the calendar."""
_LARGEST_ID = 0xFFFFFFFF
"""ClientTransactionID is a 32-bit unsigned number [Alpaca §1]."""


class Malformed(ValueError):
    """An answer that matches nothing the question allows; its text says why."""


@dataclass(frozen=True, slots=True)
class Answer:
    """The content of an envelope.

    Attributes
    ----------
    value : object
        None where there is none.
    error_number : int
        0 for none; without the upper half in which COM drivers wrap it.
    """

    value: object
    error_number: int = 0
    error_message: str = ""


def form(parameters: Parameters, client_id: int, transaction_id: int) -> dict[str, str]:
    """Say parameters as a form or a query has them, with who asks and which question it is."""
    said = {name: _said(value) for name, value in parameters.items()}
    return said | {"ClientID": str(client_id), "ClientTransactionID": str(transaction_id)}


def _said(value: Parameter) -> str:
    if isinstance(value, bool):
        return "True" if value else "False"
    if isinstance(value, float):
        if not math.isfinite(value):
            raise ValueError(f"{value} can't be said")
        # no exponents: not every server's reader knows them
        return f"{value:.10f}".rstrip("0").rstrip(".")
    return str(value)


def read_answer(body: bytes, content_type: str, transaction_id: int) -> Answer:
    """Read an envelope.

    Parameters
    ----------
    content_type : str
        As the answer's header says.
    transaction_id : int
        Of the question. A server that keeps no ids answers 0 or none; another one is of another question.

    Raises
    ------
    Malformed
        If it is no JSON, no envelope, or of another question.
    """
    try:
        told = json.loads(body, parse_constant=_no_number)
    except (ValueError, RecursionError) as fault:
        page = "a page" if "html" in content_type.lower() or body[:1] == b"<" else "no JSON"
        raise Malformed(f"{page} instead of an answer ({fault}): {excerpt(body)}") from fault
    if not isinstance(told, dict) or not ({"ErrorNumber", "Value", "ServerTransactionID"} & set(told)):
        raise Malformed(f"no Alpaca answer: {excerpt(body)}")
    echoed = told.get("ClientTransactionID")
    if echoed not in (None, 0, transaction_id):
        raise Malformed(f"the answer to question {shortened(echoed)}, not to {transaction_id}")
    number = told.get("ErrorNumber") or 0
    message = told.get("ErrorMessage") or ""
    if type(number) is not int or not isinstance(message, str):
        raise Malformed(f"an error number that is not an error: {excerpt(body)}")
    return Answer(told.get("Value"), alpaca_number(number), message)


def _no_number(text: str) -> NoReturn:
    raise ValueError(f"{text} is not a number")


def alpaca_number(number: int) -> int:
    """Take COM's 0x80040400 for Alpaca's 0x400, signed or not."""
    number &= 0xFFFFFFFF
    return number & 0xFFF if number & 0xFFFFF000 == 0x80040000 else number


def excerpt(body: bytes) -> str:
    """Show the beginning of an answer, on one line."""
    text = " ".join(body[: 4 * _EXCERPT].decode("utf-8", "replace").split())
    return repr(text[:_EXCERPT] + ("…" if len(text) > _EXCERPT else ""))


def shortened(value: object) -> str:
    """A stranger's value as it stands in our messages: no longer than a line."""
    try:
        text = repr(value)
    except (ValueError, RecursionError):
        # Python writes no number of more than 4,300 digits
        return f"a {type(value).__name__} beyond all bounds"
    return text if len(text) <= _EXCERPT else text[:_EXCERPT] + "…"


# -- values ----------------------------------------------------------------------------------------


def number(value: object, low: float = -math.inf, high: float = math.inf) -> float:
    """Read a number from `low` to `high`. Raises `Malformed`."""
    if not isinstance(value, int | float) or isinstance(value, bool):
        raise Malformed(f"{shortened(value)} where a number belongs")
    try:
        read = float(value)
    except OverflowError as fault:
        raise Malformed("a number beyond all bounds") from fault
    if not (math.isfinite(read) and low <= read <= high):
        raise Malformed(f"{value!r} is not between {low:g} and {high:g}")
    return read


def integer(value: object, low: int = -(2**63), high: int = 2**64) -> int:
    """Read a whole number from `low` to `high`. Raises `Malformed`."""
    read = number(value, low, high)
    if read != math.floor(read):
        raise Malformed(f"{shortened(value)} where a whole number belongs")
    return int(read)


def truth(value: object) -> bool:
    """Read a truth value. Raises `Malformed`."""
    if not isinstance(value, bool):
        raise Malformed(f"{shortened(value)} where true or false belongs")
    return value


def text(value: object) -> str:
    """Read a text. Raises `Malformed`."""
    if not isinstance(value, str):
        raise Malformed(f"{shortened(value)} where a text belongs")
    return value[:_LONGEST_TEXT]


def instant(value: object) -> datetime:
    """Read an instant, UTC whether it says so or not; seven digits of a second are fine.

    Raises
    ------
    Malformed
        If it is none.
    """
    said = text(value).strip()
    try:
        read = datetime.fromisoformat(said)
        utc = read.replace(tzinfo=UTC) if read.tzinfo is None else read.astimezone(UTC)
    except (ValueError, OverflowError) as fault:
        raise Malformed(f"{shortened(said)} where an instant belongs") from fault
    if not EARLIEST <= utc <= LATEST:
        # .NET's DateTime.MinValue is what drivers say of an instant that they don't know
        raise Malformed(f"{shortened(said)} is not an instant of this age")
    return utc


def said_instant(utc: datetime) -> str:
    """Say an aware instant as UTCDate wants it, the Z compulsory [Alpaca §5]."""
    return utc.astimezone(UTC).replace(tzinfo=None).isoformat(timespec="microseconds") + "0Z"


def named_values(value: object) -> dict[str, Any]:
    """Read a device state: what is there by name, in lower case; names may be written any way.

    Raises
    ------
    Malformed
        If it is no list of names and values.
    """
    if not isinstance(value, list):
        raise Malformed(f"{value!r:.80} where a device's state belongs")
    state = {}
    for member in value:
        if not isinstance(member, dict) or not isinstance(member.get("Name"), str):
            raise Malformed(f"{member!r:.80} in a device's state")
        state[member["Name"].lower()] = member.get("Value")
    return state


def next_id(last: int) -> int:
    """Count questions: from 1, within 32 bits."""
    return 1 if last >= _LARGEST_ID else last + 1
