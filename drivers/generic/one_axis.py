"""Mounts that take rates of their own in one axis only: rates with a part in the other one are refused."""

from __future__ import annotations

from mountnav.devices import OffsetRates
from mountnav.errors import DeviceRefused, Refusal


def refuse_lame_axis(rates: OffsetRates, most_arcsec_s: OffsetRates, why: str, *, device: str) -> None:
    """Refuse rates with a part in an axis whose greatest rate is 0.

    Parameters
    ----------
    why : str
        Why that axis takes none, for the operator.

    Raises
    ------
    DeviceRefused
    """
    for axis, rate, most in (
        ("right ascension", rates.ra_arcsec_s, most_arcsec_s.ra_arcsec_s),
        ("declination", rates.dec_arcsec_s, most_arcsec_s.dec_arcsec_s),
    ):
        if rate != 0.0 and most == 0.0:
            raise DeviceRefused(
                f"can't track at {rate:+.4f}″/s in {axis}: {why or 'it has no rate of its own there'}",
                device=device,
                advice="follow by rates in the other axis and pulses in this one, or by small slews",
                reason=Refusal.UNSUPPORTED,
            )
