"""`[traces]`: what orders did and how long it took, for OpenTelemetry."""

from __future__ import annotations

from pydantic import Field

from mountnav.settings.section import Section

__all__ = ["TracesSettings"]


class TracesSettings(Section):
    """`[traces]`: the way of each order as OpenTelemetry traces; needs the extra ``otel``.

    Attributes
    ----------
    endpoint : str
        Where they go, by OTLP over HTTP: ``http://127.0.0.1:4318/v1/traces``. Empty: nowhere. A key that it
        wants stands in the environment, OTEL_EXPORTER_OTLP_HEADERS.
    service_name : str
        What this service is called there.
    """

    # no user and password in it: settings are written into the journal
    endpoint: str = Field(default="", pattern=r"^(https?://[^\s/?#@]+(/[^\s?#]*)?)?$", max_length=1000)
    service_name: str = Field(default="mountnav", min_length=1, max_length=100)
