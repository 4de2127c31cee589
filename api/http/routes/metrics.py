"""Figures for Prometheus, as text."""

from __future__ import annotations

from fastapi import APIRouter, Request, Response
from prometheus_client import CONTENT_TYPE_LATEST

from api.http.request_metrics import HttpMetrics
from api.metrics import Metrics
from api.problems import responses

router = APIRouter(tags=["service"])


@router.get(
    "/metrics",
    response_class=Response,
    responses={**responses(), 200: {"content": {"text/plain": {"schema": {"type": "string"}}}}},
)
async def get_metrics(request: Request) -> Response:
    """All figures of the service in Prometheus' text format. Asks no device."""
    metrics: Metrics = request.app.state.service.metrics
    http: HttpMetrics = request.app.state.http_metrics
    return Response(metrics.text(http.registry), media_type=CONTENT_TYPE_LATEST)
