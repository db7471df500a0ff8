"""Parameters of the extractor of the slides on adaptive filtering."""

from dataclasses import dataclass

from msbdb.params.declare import param

CALIBRATED = "ours: calibrated together, on four surveys and thinned copies"


@dataclass(frozen=True, slots=True)
class AdaptiveParams:
    """Buildings from off-ground points by clustering; lengths follow the spacing unless a least one is larger."""

    ndvi_bounds: tuple[float, ...] = param(
        (0.0, 0.2),
        unit="1",
        low=-1.0,
        high=1.0,
        source="ours: as for the classes; S6 gives none, and warns of one that is not appropriate",
        doc="Lowest and highest threshold of NDVI; Otsu's method finds the value between them.",
    )
    ndvi_smooth: float = param(
        0.7,
        unit="1",
        low=0.0,
        high=1.0,
        source="ours: a planted roof is level, a crown is not; as for the cover",
        doc="Green points whose surroundings are level to this degree stay.",
    )
    surface_factor: float = param(
        1.75,
        unit="spacings",
        low=1.0,
        high=20.0,
        source="ours: ten points, enough for a plane and its residuals",
        doc="Radius within which the surface about a point is a plane.",
    )
    surface_least_m: float = param(
        1.25,
        unit="m",
        low=0.0,
        high=20.0,
        source="ours: smaller than the narrowest roof plane",
        doc="The same, at least.",
    )
    level_m: float = param(
        0.1,
        unit="m",
        low=0.005,
        high=5.0,
        source=CALIBRATED + "; 0.1 and 0.15 m tried",
        doc="Residual of the plane that tells nothing: at half of it a surface is level, at twice it is not.",
    )
    around_factor: float = param(
        2.5, unit="spacings", low=1.0, high=50.0, source="ours: enough echoes for a share", doc="Radius of the shares."
    )
    around_least_m: float = param(
        2.5,
        unit="m",
        low=0.0,
        high=50.0,
        source="ours: wider tells crowns a little better and rounds corners",
        doc="The same, at least.",
    )
    split_weight: float = param(
        7.5,
        unit="1",
        low=0.0,
        high=100.0,
        source=CALIBRATED,
        doc="Log-odds that a share of echoes of split pulses takes from a roof.",
    )
    level_weight: float = param(
        4.0, unit="1", low=0.0, high=100.0, source=CALIBRATED, doc="Log-odds that a level surface gives to a roof."
    )
    bias: float = param(2.0, unit="1", low=-50.0, high=50.0, source=CALIBRATED, doc="Log-odds without any evidence.")
    blind_level_weight: float = param(
        9.4, unit="1", low=0.0, high=100.0, source=CALIBRATED, doc="The same, where the source knows no echoes."
    )
    blind_bias: float = param(
        -3.0, unit="1", low=-50.0, high=50.0, source=CALIBRATED, doc="The same, where the source knows no echoes."
    )
    least_odds: float = param(
        0.75,
        unit="1",
        low=-50.0,
        high=50.0,
        source=CALIBRATED,
        doc="Points of smaller log-odds are vegetation; a large negative value keeps all.",
    )
    steps: int = param(
        2,
        unit="count",
        low=1,
        high=20,
        source="ours: S6 clusters and tightens step by step, without numbers; 2 and 4 give the same regions",
        doc="Steps of the clustering; distance and thresholds go evenly from the first to the last.",
    )
    link_factors: tuple[float, ...] = param(
        (3.0, 2.5),
        unit="spacings",
        low=1.0,
        high=50.0,
        source="ours: random points of a surface hang together from 1.2 spacings on",
        doc="Distance in space at which the tree of clusters is cut, in the first and the last step.",
    )
    link_least_m: float = param(
        0.5, unit="m", low=0.0, high=20.0, source="ours: roofs lose points to skylights and wet tiles", doc="Least cut."
    )
    points: tuple[float, ...] = param(
        (3.0, 6.0), unit="count", low=1.0, high=1e6, source="ours: fewer make no surface", doc="Least number of points."
    )
    area_m2: tuple[float, ...] = param(
        (4.0, 8.0), unit="m2", low=0.0, high=1e6, source="ours: the finest scale", doc="Least area."
    )
    height_m: tuple[float, ...] = param(
        (2.0, 2.3),
        unit="m",
        low=0.0,
        high=100.0,
        source="ours: from the mask to the eaves of a garage; cars, hedges and walls are lower",
        doc="Least height above ground of the upper tenth.",
    )
    width_m: tuple[float, ...] = param(
        (0.0, 1.5),
        unit="m",
        low=0.0,
        high=100.0,
        source="ours: wires, fences and garden walls are narrower than a shed",
        doc="Least width across, of a rectangle that spreads as its points do.",
    )
    level_shares: tuple[float, ...] = param(
        (0.0, 0.15),
        unit="1",
        low=0.0,
        high=1.0,
        source=CALIBRATED,
        doc="Least mean degree to which its points are level.",
    )
    level_per_split: tuple[float, ...] = param(
        (0.5, 1.5),
        unit="1",
        low=0.0,
        high=100.0,
        source="ours: roofs with split echoes have plane surfaces, crowns have not",
        doc="Least ratio of the mean degree to which its points are level to the share of split echoes.",
    )
    regain_factor: float = param(
        2.0,
        unit="spacings",
        low=0.0,
        high=20.0,
        source="ours: eaves split pulses as crowns do (S8)",
        doc="Off-ground points this near to a region, in plan, become its points.",
    )
    regain_step_m: float = param(
        1.0, unit="m", low=0.0, high=20.0, source="ours: less than a storey's parapet", doc="Largest step to them."
    )
