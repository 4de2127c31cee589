"""A pointing model as a value: what it holds, where it came from, and its file."""

from __future__ import annotations

import json
import math
import os
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy as np

from mountnav.errors import BadRequest, MountnavError
from mountnav.files import read_text, require_replaceable
from mountnav.parsing import json_of
from mountnav.pointing.model.fit import Fit
from mountnav.pointing.model.rigorous import Geometry, geometry
from mountnav.pointing.model.terms import ZERO_POINTS, Array, Kind, term

FORMAT = "mountnav pointing model"
# Version of the file's format; a file of another one is refused.
VERSION = 1


@dataclass(frozen=True, slots=True)
class PointingModel:
    """Coefficients with their errors, and all that must be known to apply and to judge them.

    Attributes
    ----------
    id : str
        Names the model in the journal and the API.
    kind : {"equatorial", "altaz"}
        Which axes the coefficients belong to.
    site_latitude_deg : float
        Geodetic, north positive.
    does_refraction : bool
        Whether it was made for a mount that allows for refraction itself; it is not applied otherwise.
    terms : tuple of str
        TPOINT names, zero points first; *observed = axis reading + Σ c f*.
    coefficients_arcsec, sigma_arcsec : tuple of float
        In the order of the terms; one sigma.
    covariance_arcsec2 : tuple of tuple of float
        Of the coefficients, in the order of the terms.
    scatter_arcsec : float
        What single looks scatter by, per coordinate, besides.
    made_utc : datetime
        When it was fitted.
    n, n_used : int
        Observations, and those that count.
    sky_rms_arcsec, population_rms_arcsec, loo_arcsec, before_arcsec : float or None
        See `fit.Fit`; `before_arcsec` is the sky RMS with zero points alone. None if unknown (imported).
    condition : float or None
        Condition number of the fit; None: not known.
    telescope, source : str
        Whose it is; what it was made from.
    notes : tuple of str
        What its user should know, in sentences.
    """

    id: str
    kind: Kind
    site_latitude_deg: float
    does_refraction: bool
    terms: tuple[str, ...]
    coefficients_arcsec: tuple[float, ...]
    sigma_arcsec: tuple[float, ...]
    covariance_arcsec2: tuple[tuple[float, ...], ...]
    scatter_arcsec: float
    made_utc: datetime
    n: int = 0
    n_used: int = 0
    sky_rms_arcsec: float | None = None
    population_rms_arcsec: float | None = None
    loo_arcsec: float | None = None
    before_arcsec: float | None = None
    condition: float | None = None
    telescope: str = ""
    source: str = ""
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.kind not in ("equatorial", "altaz"):
            raise BadRequest(f"{self.kind!r} is not a kind of pointing model", advice="equatorial or altaz")
        k = len(self.terms)
        if self.terms[:2] != ZERO_POINTS[self.kind] or len(set(self.terms)) != k:
            raise BadRequest(
                f"the terms {', '.join(self.terms)} don't begin with {', '.join(ZERO_POINTS[self.kind])}, "
                "or name one twice"
            )
        for name in self.terms:
            term(self.kind, name)
        rows = (len(self.coefficients_arcsec), len(self.sigma_arcsec), len(self.covariance_arcsec2))
        numbers = [*self.coefficients_arcsec, *self.sigma_arcsec, self.scatter_arcsec, self.site_latitude_deg]
        numbers += [value for row in self.covariance_arcsec2 for value in row]
        if rows != (k, k, k) or any(len(row) != k for row in self.covariance_arcsec2):
            raise BadRequest(f"{k} terms need as many coefficients, sigmas and rows of the covariance")
        if not all(math.isfinite(one) for one in numbers) or min(self.sigma_arcsec, default=0.0) < 0.0:
            raise BadRequest("a coefficient, sigma or covariance of the model is not a number")
        if not -90.0 <= self.site_latitude_deg <= 90.0 or self.made_utc.utcoffset() is None:
            raise BadRequest("the model's latitude is invalid, or its date has no time zone")
        if k and float(np.min(np.linalg.eigvalsh(self.covariance))) < -1e-6 * (
            1.0 + float(np.max(np.abs(self.covariance)))
        ):
            raise BadRequest("the model's covariance can't be one: it is not positive")

    @property
    def covariance(self) -> Array:
        """Shape (k, k), arcsec²."""
        return np.array(self.covariance_arcsec2, dtype=np.float64)

    @property
    def coefficients(self) -> dict[str, float]:
        """Of all terms, arcsec."""
        return dict(zip(self.terms, self.coefficients_arcsec, strict=True))

    @property
    def geometry_terms(self) -> tuple[str, ...]:
        """Without zero points."""
        return self.terms[2:]

    def rotations(self, *, with_zero_points: bool = True) -> Geometry:
        """The model as rotations."""
        values = self.coefficients
        if not with_zero_points:
            values = {name: values[name] for name in self.geometry_terms}
        return geometry(self.kind, math.radians(self.site_latitude_deg), values)

    def to_json(self) -> str:
        """Write as JSON text."""
        record: dict[str, Any] = {"format": FORMAT, "version": VERSION}
        for name in self.__slots__:
            record[name] = getattr(self, name)
        record["made_utc"] = self.made_utc.isoformat()
        return json.dumps(record, indent=1, ensure_ascii=False, allow_nan=False) + "\n"

    @classmethod
    def from_json(cls, text: str, *, name: str = "model") -> PointingModel:
        """Read JSON text; `name` stands in the messages.

        Raises
        ------
        BadRequest
            It is no such text, of a later version, or its values make no model.
        """
        try:
            record = json_of(text)
            if not isinstance(record, dict) or record.pop("format", None) != FORMAT:
                raise BadRequest(
                    f"{name} is not a pointing model of mountnav", advice="`mountnav model import` it"
                )
            if (version := record.pop("version", None)) != VERSION:
                raise BadRequest(f"{name} is of version {version}", advice="get a newer mountnav")
            return cls(**_typed(record))
        except BadRequest as cause:
            raise BadRequest(f"{name}: {cause.what}", advice=cause.advice) from cause
        except (ValueError, TypeError, KeyError) as cause:
            raise BadRequest(f"{name} is not a pointing model: {cause}") from cause

    @classmethod
    def load(cls, path: Path) -> PointingModel:
        """Read a file. Raises `BadRequest`."""
        try:
            text = read_text(Path(path))
        except (OSError, UnicodeDecodeError) as cause:
            raise BadRequest(f"the pointing model {path} can't be read: {cause}") from cause
        return cls.from_json(text, name=str(path))

    def save(self, path: Path) -> None:
        """Write a file; the old one is replaced at once or not at all. Raises `MountnavError`."""
        path = Path(path)
        handle, waiting = -1, ""
        try:
            require_replaceable(path)
            handle, waiting = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
            with os.fdopen(handle, "w", encoding="utf-8") as out:
                out.write(self.to_json())
                out.flush()
                os.fsync(out.fileno())
            Path(waiting).chmod(0o644)
            Path(waiting).replace(path)
        except OSError as cause:
            if waiting:
                Path(waiting).unlink(missing_ok=True)
            raise MountnavError(f"the pointing model can't be written to {path}: {cause}") from cause


def _typed(record: Mapping[str, Any]) -> dict[str, Any]:
    told = dict(record)
    for name in ("terms", "notes"):
        told[name] = tuple(str(one) for one in told.get(name, ()))
    for name in ("coefficients_arcsec", "sigma_arcsec"):
        told[name] = tuple(float(one) for one in told[name])
    told["covariance_arcsec2"] = tuple(tuple(float(one) for one in row) for row in told["covariance_arcsec2"])
    told["made_utc"] = datetime.fromisoformat(told["made_utc"])
    for name in ("site_latitude_deg", "scatter_arcsec"):
        told[name] = float(told[name])
    if not isinstance(told["does_refraction"], bool):
        raise BadRequest(f"does_refraction = {told['does_refraction']!r}", advice="true or false")
    return told


def model_of(
    fitted: Fit,
    *,
    made_utc: datetime,
    does_refraction: bool = False,
    telescope: str = "",
    source: str = "",
    model_id: str | None = None,
) -> PointingModel:
    """Make the value of a fit."""
    after = fitted.after
    return PointingModel(
        id=model_id or uuid4().hex,
        kind=fitted.observations.kind,
        site_latitude_deg=math.degrees(fitted.observations.site_latitude_rad),
        does_refraction=does_refraction,
        terms=fitted.terms,
        coefficients_arcsec=tuple(fitted.coefficients_arcsec.tolist()),
        sigma_arcsec=tuple(fitted.sigma_arcsec.tolist()),
        covariance_arcsec2=tuple(tuple(row) for row in fitted.covariance_arcsec2.tolist()),
        scatter_arcsec=fitted.scatter_arcsec,
        made_utc=made_utc,
        n=len(fitted.observations),
        n_used=int(np.sum(fitted.used)),
        sky_rms_arcsec=_known(after.sky_rms_arcsec),
        population_rms_arcsec=_known(after.population_rms_arcsec),
        loo_arcsec=_known(fitted.loo_arcsec),
        before_arcsec=_known(fitted.before.sky_rms_arcsec),
        condition=_known(fitted.condition),
        telescope=telescope,
        source=source,
        notes=fitted.notes,
    )


def _known(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None


def noted(model: PointingModel, *more: str) -> PointingModel:
    """The same model with notes added."""
    return replace(model, notes=(*model.notes, *more))
