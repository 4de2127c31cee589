"""A plate's or a lens's cards as a GWCS: what ASDF files hold, and pipelines of JWST and Roman read.

A GWCS is a chain of transforms of astropy.modeling from pixels to the sky, each of which ASDF can write. TAN
and SIP are such a chain as they stand. FITS's ZPN is not among them: it gives r(θ), and the chain needs
θ(r). With s = r² the factor θ/r is smooth, so that a Chebyshev series in s stands for it; ARC, which has
r = θ, does the rest. The way back from the sky is r(θ) itself.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mountnav.errors import BadRequest
from mountnav.extras import extra
from mountnav.sky.wcs import is_zpn, rising_to_deg

Array = NDArray[np.float64]

SERIES_WITHIN = 1e-11
"""A share of θ: the series is as near to the lens as that. At a corner 10⁴ px from the axis it is 10⁻⁷ px."""
MOST_DEGREE = 160
"""Of the series. Where that isn't enough, the lens is refused; halved, fewer lenses whose edge is near are
written."""
SHORT_OF_TURN = 0.99
"""Where r turns back with growing θ, θ(r) ends with an upright tangent, which no series follows: beyond this
share of that r there is no position. All but the last hundredth of an image circle."""

_HALVINGS = 50
"""Of the bracket of an angle: 180° / 2⁵⁰ are a double's last digits."""


def require_gwcs() -> None:
    """Check that what writes GWCS is installed. Raises `BadRequest`."""
    with extra("gwcs", "GWCS and ASDF files"):
        import asdf  # noqa: F401
        import asdf_astropy  # noqa: F401
        import gwcs.wcs  # noqa: F401


def gwcs_of(cards: Mapping[str, str | int | float]) -> Any:
    """Make a `gwcs.wcs.WCS` of cards.

    Parameters
    ----------
    cards : mapping
        TAN, TAN-SIP or ZPN, as a `mountnav.solution.Solution` has them.

    Returns
    -------
    gwcs.wcs.WCS
        From pixels, 0-based, to ICRS in degrees; NaN where a lens shows no sky. Its inverse is exact for TAN
        and ZPN; that of TAN-SIP is as good as AP and BP.

    Raises
    ------
    BadRequest
        The package gwcs is missing, a card is, or no series stands for the lens.
    """
    require_gwcs()
    from astropy import coordinates, units
    from gwcs import coordinate_frames
    from gwcs.wcs import WCS

    try:
        chain = _lens(cards) if is_zpn(cards) else _plate(cards)
        width, height = int(cards["IMAGEW"]), int(cards["IMAGEH"])
    except KeyError as missing:
        raise BadRequest(f"the WCS has no card {missing}", advice="give the cards of a solution") from None
    pixels = coordinate_frames.Frame2D(name="detector", axes_order=(0, 1), unit=(units.pix, units.pix))
    sky = coordinate_frames.CelestialFrame(
        name="icrs", reference_frame=coordinates.ICRS(), unit=(units.deg, units.deg)
    )
    found = WCS([(pixels, chain), (sky, None)])
    found.pixel_shape = (width, height)
    found.bounding_box = ((-0.5, width - 0.5), (-0.5, height - 0.5))
    return found


def asdf_bytes(cards: Mapping[str, str | int | float], told: Mapping[str, object]) -> bytes:
    """An ASDF file of a GWCS.

    Parameters
    ----------
    told : mapping
        Plain values, kept beside it under ``mountnav``.

    Returns
    -------
    bytes
        With the GWCS under ``wcs``.

    Raises
    ------
    BadRequest
        As `gwcs_of`.
    """
    require_gwcs()
    import asdf

    wcs = gwcs_of(cards)
    written = io.BytesIO()
    asdf.AsdfFile({"wcs": wcs, "mountnav": dict(told)}).write_to(written)
    return written.getvalue()


def _moved(cards: Mapping[str, str | int | float]) -> Any:
    """From 0-based pixels to those from CRPIX."""
    from astropy.modeling import models

    return models.Shift(1.0 - float(cards["CRPIX1"])) & models.Shift(1.0 - float(cards["CRPIX2"]))


def _linear(cards: Mapping[str, str | int | float]) -> Any:
    from astropy.modeling import models

    matrix = [[float(cards[f"CD{i}_{j}"]) for j in (1, 2)] for i in (1, 2)]
    return models.AffineTransformation2D(matrix=np.array(matrix), translation=np.zeros(2))


def _turned(cards: Mapping[str, str | int | float]) -> Any:
    """From the plane's own sphere to the sky; the pole is that of a FITS header that names none."""
    from astropy.modeling import models

    return models.RotateNative2Celestial(float(cards["CRVAL1"]), float(cards["CRVAL2"]), 180.0)


def _plate(cards: Mapping[str, str | int | float]) -> Any:
    from astropy.modeling import models

    if str(cards["CTYPE1"]) not in ("RA---TAN", "RA---TAN-SIP"):
        raise BadRequest(f"CTYPE1 is {cards['CTYPE1']!r}", advice="only TAN, TAN-SIP and ZPN are made a GWCS")
    chain = _moved(cards)
    if "A_ORDER" in cards:
        bent = _bent(cards, "A", "B")
        # gwcs 1.0.3 finds none by itself where a projection follows
        bent.inverse = _bent(cards, "AP", "BP")
        chain = chain | bent
    return chain | _linear(cards) | models.Pix2Sky_TAN() | _turned(cards)


def _bent(cards: Mapping[str, str | int | float], along: str, across: str) -> Any:
    """(u, v) to (u + A(u, v), v + B(u, v)); AP and BP are written in the same way."""
    from astropy.modeling import models

    both = []
    for name, own in ((along, "c1_0"), (across, "c0_1")):
        order = int(cards[f"{name}_ORDER"])
        powers = [(i, j) for i in range(order + 1) for j in range(order + 1 - i)]
        factors = {f"c{i}_{j}": float(cards.get(f"{name}_{i}_{j}", 0.0)) for i, j in powers}
        factors[own] += 1.0
        both.append(models.Polynomial2D(order, **factors))
    return models.Mapping((0, 1, 0, 1)) | (both[0] & both[1])


def _lens(cards: Mapping[str, str | int | float]) -> Any:
    from astropy.modeling import models

    terms = {int(name[4:]): float(value) for name, value in cards.items() if name.startswith("PV2_")}
    if any(value and not number % 2 for number, value in terms.items()):
        raise BadRequest("the lens has even terms", advice="give the cards of a solution")
    # r/θ as a polynomial of t = θ², both in degrees
    even = np.zeros(max(terms) // 2 + 1)
    for number, value in terms.items():
        if number % 2:
            even[number // 2] = value * np.radians(1.0) ** (number - 1)
    turn_deg = rising_to_deg(cards)
    turn_r = turn_deg * float(np.polynomial.polynomial.polyval(turn_deg**2, even))
    corner_r = _corner_r(cards)
    most_r = min(SHORT_OF_TURN * turn_r, 1.001 * corner_r)
    series = _theta_by_r(even, most_r, turn_deg)
    most_t = _theta(even, np.array([most_r]), turn_deg)[0] ** 2
    # a Chebyshev series beyond its domain says anything: NaN there
    there = models.Chebyshev1D(
        series.size - 1, domain=[0.0, most_r**2], **{f"c{n}": float(c) for n, c in enumerate(series)}
    ) * _within(most_r**2)
    back = models.Polynomial1D(even.size - 1, **{f"c{n}": float(c) for n, c in enumerate(even)}) * _within(
        most_t
    )
    onto = _stretched(there)
    onto.inverse = _stretched(back)
    return _moved(cards) | _linear(cards) | onto | models.Pix2Sky_ARC() | _turned(cards)


def _stretched(factor: Any) -> Any:
    """(x, y) times a factor that depends on x² + y²."""
    from astropy.modeling import models

    square = models.Polynomial2D(2, c2_0=1.0, c0_2=1.0)
    with_factor = models.Mapping((0, 1, 0, 1)) | (models.Identity(2) & (square | factor))
    return with_factor | models.Mapping((0, 2, 1, 2)) | (_product() & _product())


def _product() -> Any:
    """One number times another."""
    from astropy.modeling import models

    return models.Mapping((0,), n_inputs=2) * models.Mapping((1,), n_inputs=2)


def _within(most: float) -> Any:
    """1 from 0 to the most, else NaN."""
    from astropy.modeling import models

    return models.Tabular1D(
        points=np.array([0.0, most]), lookup_table=np.ones(2), bounds_error=False, fill_value=np.nan
    )


def _corner_r(cards: Mapping[str, str | int | float]) -> float:
    """Distance of the farthest corner from the axis on the lens's plane, degrees."""
    x, y = np.meshgrid([-0.5, float(cards["IMAGEW"]) - 0.5], [-0.5, float(cards["IMAGEH"]) - 0.5])
    u, v = x + 1.0 - float(cards["CRPIX1"]), y + 1.0 - float(cards["CRPIX2"])
    east = float(cards["CD1_1"]) * u + float(cards["CD1_2"]) * v
    north = float(cards["CD2_1"]) * u + float(cards["CD2_2"]) * v
    return float(np.hypot(east, north).max())


def _theta(even: Array, r: Array, turn_deg: float) -> Array:
    """θ of r, degrees."""
    low, high = np.zeros_like(r), np.full_like(r, turn_deg)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        below = middle * np.polynomial.polynomial.polyval(middle**2, even) < r
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return np.asarray(0.5 * (low + high))


def _theta_by_r(even: Array, most_r: float, turn_deg: float) -> Array:
    """Chebyshev's factors of θ/r on s from 0 to its most.

    Raises
    ------
    BadRequest
        No series of `MOST_DEGREE` is near enough.
    """
    from numpy.polynomial import chebyshev

    # between the knots of every series that is tried, and at both ends
    held = most_r * np.sqrt(np.linspace(1e-6, 1.0, 2001))
    truth = _theta(even, held, turn_deg) / held
    degree = 10
    while degree <= MOST_DEGREE:
        knots = chebyshev.chebpts1(4 * degree)
        r = most_r * np.sqrt(0.5 * (knots + 1.0))
        factors = chebyshev.chebfit(knots, _theta(even, r, turn_deg) / r, degree)
        off = chebyshev.chebval(2.0 * (held / most_r) ** 2 - 1.0, factors) / truth - 1.0
        if np.abs(off).max() <= SERIES_WITHIN:
            return np.asarray(factors, dtype=np.float64)
        degree += 10
    raise BadRequest(
        "no series stands for this lens so near to where it turns back", advice="keep its FITS cards, ZPN"
    )
