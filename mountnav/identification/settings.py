"""Every number that identification goes by: the paper's values, and our measured ones beside them."""

from __future__ import annotations

from dataclasses import dataclass

from mountnav.errors import BadSettings

Stage = tuple[int, int]


@dataclass(frozen=True, slots=True)
class IdentificationSettings:
    """Parameters of full identification and of the plate fit; the defaults are the "measured" profile.

    `IdentificationSettings.paper()` gives the values of [S23 app. A]; docs/explanation/identification.md says
    what the defaults gain over them.

    Attributes
    ----------
    m_reg : int
        The frame is cut in m_reg × m_reg regions for the even spread [S23 §2.2, M_reg].
    region_cap : float
        A region may hold at most this many times its fair share of a selection. 1 is the paper's strict
        evenness; more keeps the order of brightness, which poor catalogs need.
    stages : tuple of (int, int)
        Rounds of triangle search: brightest measurements (N_bl50), brightest stars of a tile (N_star100).
    n_confirm_measurements, n_confirm_stars : int
        Sizes of Ω_bl100 and Ω_star200 (the latter in a tile).
    k_height : float
        Least side and height of a triangle, in mean frame sizes (k_h).
    angle_arcmin : float
        How far corner angles may differ (Δγ).
    match_px : float
        Radius of confirmation Δr_ident; never more than `match_share` of the frame's shorter side.
    match_share : float
        See `match_px`.
    v_min_ident : float or None
        Share of Ω_bl100 that must pair with stars for a hypothesis to hold: the paper's rule. None: the odds
        decide alone.
    min_share : float
        A final plate rests on at least half this share of the pairs that could be (of at most 100).
    frame_triangles : int
        At most this many of the frame's triangles are tried per stage, brightest first.
    skew_max : float
        Largest departure of the six constants from a similarity, |q|/|p| of w = p·z + q·conj(z).
    tile_step : float
        Distance of neighboring search tiles in shorter frame sides.
    tile_radius : float
        Radius of a tile's stars in frame diagonals.
    corner_radius : float
        In costly rounds over wide areas triangles are made of the stars within so many diagonals, and of as
        many fewer as that part is smaller; as large as `tile_radius`, of all of a tile's.
    outward_fields, outward_max_deg : float
        When nothing is found within the hinted radius, the center is sought so many shorter frame sides
        farther out, and at most so many degrees.
    false_probability_max : float
        A solution whose odds of being chance exceed this is refused.
    min_pairs : int
        Fewest pairs a solution may rest on.
    k_rej : float
        Pairs deviating more than this times the mean deviation modulus are rejected (K_rej).
    star_group_fwhm, measurement_group_fwhm : float
        r_star_group and r_mea_group in widths of a star's image.
    group_magnitudes : float
        Neighbors fainter by more than this make no group.
    floor_px : float
        Position error per coordinate that neither centroid nor catalog knows of, as expected before any pair
        is seen; the pairs then show what it is.
    fragments : int
        The frame is cut in fragments × fragments parts that give pairs alike [S23 §3.1].
    fragment_cap : float
        A fragment gives at most this many times its fair share of the pairs.
    degree_max : int
        Highest degree of the plate model.
    cross_validation_gain : float
        A degree is raised only when the cross-validated residual falls below this share of the former.
    """

    m_reg: int = 4
    region_cap: float = 3.0
    stages: tuple[Stage, ...] = ((12, 50), (24, 80), (40, 120))
    n_confirm_measurements: int = 100
    n_confirm_stars: int = 150
    k_height: float = 0.1
    angle_arcmin: float = 30.0
    match_px: float = 10.0
    match_share: float = 0.012
    v_min_ident: float | None = None
    min_share: float = 0.3
    frame_triangles: int = 4000
    skew_max: float = 0.03
    tile_step: float = 0.6
    tile_radius: float = 0.6
    corner_radius: float = 0.5
    outward_fields: float = 5.0
    outward_max_deg: float = 10.0
    false_probability_max: float = 1e-9
    min_pairs: int = 5
    k_rej: float = 3.0
    star_group_fwhm: float = 2.0
    measurement_group_fwhm: float = 1.5
    group_magnitudes: float = 1.5
    floor_px: float = 0.03
    fragments: int = 4
    fragment_cap: float = 1.5
    degree_max: int = 3
    cross_validation_gain: float = 0.97

    @classmethod
    def paper(cls) -> IdentificationSettings:
        """The values of [S23 app. A]; where the paper gives none, ours."""
        return cls(
            region_cap=1.0,
            stages=((50, 100),),
            n_confirm_measurements=100,
            n_confirm_stars=200,
            angle_arcmin=60.0,
            match_px=10.0,
            match_share=1.0,
            v_min_ident=0.7,
            frame_triangles=19600,
            corner_radius=0.6,
        )

    @classmethod
    def profile(cls, name: str) -> IdentificationSettings:
        """Give a profile by its name.

        Parameters
        ----------
        name : str
            "measured" (the defaults) or "paper".

        Raises
        ------
        BadSettings
            There is no such profile.
        """
        if name == "measured":
            return cls()
        if name == "paper":
            return cls.paper()
        raise BadSettings(
            f"there is no identification profile {name!r}", advice="choose one of: measured, paper"
        )


@dataclass(frozen=True, slots=True)
class PreliminarySettings:
    """Parameters of preliminary identification; the defaults are those of [S23 app. A].

    `PreliminarySettings.measured()` is the profile that the series uses; docs/how-to/series.md says what it
    gains.

    Attributes
    ----------
    r_rej_px : float
        Radius of a strobe (R_rej).
    n_min_ack : float
        Least share of the strobes that must hold a measurement (N_min_ack).
    m_reg, n_mea_reg : int
        The frame is cut in m_reg × m_reg regions, the n_mea_reg brightest of each are selected.
    tries : int
        Selected measurements of the first list that are tried; needing one more is failure.
    first_wins : bool
        The first hypothesis with enough acknowledgements is taken or refused. Else the most acknowledged
        goes first, and a refused one makes room for the next.
    overlap_only : bool
        Only strobes that fall in the other frame count, so that large shifts can be found.
    chance_most : float
        The strobe is made so narrow that chance fills at most this share of the strobes; 1: not at all.
    confirm_factor : int
        A strobe may be filled by the confirm_factor · n_mea_reg brightest of each region; 0: by any. The
        paper names no such set here; 2 is its k_blob, confirming over proposing set (docs/how-to/series.md).
    use_flags : bool
        Leave out measurements with NO_PEAK, TRAIL and BLEED where enough others are there.
    narrowing : bool
        Pair again with narrower strobes; the shift is then a weighted mean with outliers cut, over mutual
        nearest pairs of all bright measurements, instead of the plain mean of (3, 4).
    still_share : float
        Least share for a shift of less than a pixel, which hot pixels show as well.
    false_probability_max : float
        A shift whose odds of being chance exceed this is refused.
    """

    r_rej_px: float = 20.0
    n_min_ack: float = 0.7
    m_reg: int = 4
    n_mea_reg: int = 3
    tries: int = 3
    first_wins: bool = True
    overlap_only: bool = False
    chance_most: float = 1.0
    confirm_factor: int = 2
    use_flags: bool = False
    narrowing: bool = False
    still_share: float = 0.7
    false_probability_max: float = 1e-9

    @classmethod
    def measured(cls) -> PreliminarySettings:
        """The profile of the series: narrowing strobes, odds instead of a high share, any overlap."""
        return cls(
            n_min_ack=0.2,
            tries=48,
            first_wins=False,
            overlap_only=True,
            chance_most=0.15,
            use_flags=True,
            narrowing=True,
        )
