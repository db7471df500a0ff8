"""Parameters of the detectors that search the data themselves: flat regions, 3-D area morphology, adaptive filter."""

from dataclasses import dataclass

from msbdb.params.declare import param, require_rising

CALIBRATED = "calibrated together, on four surveys and thinned copies"

# A table, in which a parameter takes a line or two: the formatter would give every argument a line of its own.
# fmt: off


@dataclass(frozen=True, slots=True)
class FlatRegionParams:
    """Flat regions by differential morphological and attribute profiles."""

    on: str = param("ndsm", "-",
        "Search flat regions on heights above ground, or on the raw surface as the paper does.",
        paper="M27: the paper itself recommends a ground filter against plateaus", choices=("ndsm", "surface"))
    gaps: str = param("near", "-",
        "Empty cells to interpolate from lowest points: those within surface.max_gap_m, or all.", paper="M8: all",
        ours="over water the surface would slope from quay to quay and be flat", choices=("near", "all"))
    s_max_m: float = param(1.5, "m", "S_I: largest window of the profile that finds outliers, at least 3 cells.",
        paper="M11 gives 3.0",
        ours="that removes narrow roofs and corners too; against crowns 1 to 2 m do as well", low=0, high=50)
    valley_factor: float = param(0.0, "cells", "A valley this many times R_g deep is an outlier; 0 keeps valleys.",
        paper="M10 gives 2", ours="with one or two pulses a cell, valleys distinguish a crown from a roof",
        low=0, high=100)
    peak_factor: float = param(2.0, "cells", "The same for peaks; 0 keeps peaks.",
        paper="M10 gives 4 to spare roofs, with windows twice as wide", ours="crowns lose their tips", low=0, high=100)
    gradients: str = param("initial", "-", "The surface whose gradients are summed.",
        ours="denoising removes the roughness that marks crowns; M13 takes the denoised surface",
        choices=("initial", "denoised"))
    gradient_window_m: float = param(0.9, "m", "Window of the gradients, at least 3 cells.",
        ours="M13 states none; the same width at any cell, so that gradients compare; 1.2 m loses roofs",
        low=0, high=20)
    gradient_cap_m: float = param(1.5, "m",
        "A larger gradient counts as this; 0 sets no cap, which the raw surface needs.",
        ours="half a storey; without a cap the foot of a tower makes its podium rough", low=0, high=1000)
    lambda_min_m2: float = param(20.0, "m2", "λ_min: sum of gradients of the first zone.", paper="M23: 30, 20, 20",
        low=0, high=1e6)
    lambda_max_m2: float = param(40_000.0, "m2", "λ_max: sum of gradients of the last zone.", paper="M23: 40000",
        low=0, high=1e9)
    lambda_step_m2: float = param(20.0, "m2", "λ_Δ: width of a zone.",
        paper="M23 gives 250, 500, 300, against plateaus", ours="heights above ground have none, and small roofs gain",
        low=0, high=1e6)
    lambda_unit: str = param("m2", "-",
        "Unit in which the three λ count gradients: their sum times the cell's area, or over cells.",
        paper="M14 states none", ours="A13: Table 1 gives λ_min as an area of 30 or 20 m2", choices=("m2", "px"))
    ratio: float = param(1.75, "1/m",
        "R: a flat region has at least R times its zone's upper λ of area; less in cells above 0.35 m.",
        paper="M17, M23 give 1.5", ours="1.5 takes more crowns, 2 loses large roofs with holes", low=0, high=100)
    blind_ratio: float = param(2.0, "1/m", "The same, as far as single echoes are not trusted.",
        paper="M17, M23 give 1.5",
        ours="roughness alone mistakes more crowns", low=0, high=100)
    largest_m2: float = param(500_000.0, "m2", "Larger flat regions are terrain; 0 sets no limit.",
        ours="the largest halls cover 40 ha; λ_max alone takes the ground of a tile for one building", low=0, high=1e9)
    leaf_probability: float = param(0.2, "1",
        "Cells are leaves where the probability of roof around them is less, and leaf_rough_m exceeded; 0 is off.",
        ours="three quarters of the false cells have less than 0.5, a tenth of the true ones; above 0.2 few echoes "
        "lose roofs", low=0, high=1)
    leaf_rough_m: float = param(0.4, "m", "What is smoother is glass or planting, and no leaves.",
        ours="0.15 loses planted roofs; 0.3 and 0.5 m differ little", low=0, high=1)
    leaf_sigma_m: float = param(1.0, "m",
        "Sigma of the means of probability and of roughness around a cell, at least 0.7 cells.",
        ours="0.75 to 3 m differ little", low=0, high=20)
    opening_m: float = param(1.5, "m", "Window of the opening and closing of flat regions.", paper="M19 gives 3",
        ours="that cuts roofs of 3 m and all that trees indent", low=0, high=50)
    compactness: str = param("inverse", "-", "Ψ: P²/(4πA), or 4πA/P² as printed.", paper="M20: 4πA/P²",
        ours="A9: that is 1 at most, so that Ψ < ψ = 9 rejects nothing", choices=("inverse", "literal"))
    max_compactness: float = param(100.0, "1", "ψ: regions of this Ψ or more are too long and thin.",
        paper="M20, M23 give 9, 11, 10.5",
        ours="connected blocks of old towns reach 55; 100 is a rectangle of 312 to 1", low=1, high=1e6)
    compact_m2: float = param(10_000.0, "m2", "Of a larger region Ψ counts per so much area; 0 counts it as a whole.",
        ours="Ψ of blocks that touch grows with their number; so a hectare and more needs a mean width of 5.6 m",
        low=0, high=1e9)
    grow_m: float = param(0.9, "m", "Width of the edge that is given back to regions on heights above ground.",
        ours="in the cells of a roof's edge the lowest points lie beside or below the roof", low=0, high=20)
    grow_step_m: float = param(1.0, "m", "Largest step in height to a cell that is given back.",
        ours="as for the cover; 0.3 to 2 m differ little", low=0, high=20)


@dataclass(frozen=True, slots=True)
class Area3dParams:
    """Building regions among the points by 3-D area morphology."""

    heights_m: tuple[float, ...] = param((), "m",
        "Height scales h_j; empty finds them in the histogram of the heights.",
        paper="C14: prior knowledge of the scene, if known", low=0, high=1000)
    most_heights: int = param(4, "count", "Most height scales; 1 is the single-scale mode (SS).", paper="C14",
        low=1, high=50)
    mask_first: bool = param(True, "-", "Take the mask's height as the first scale, before the histogram's.",
        ours="the histogram's first minimum lies at 2.1 to 5.4 m on the test tiles, above annexes")
    histogram_tail_percent: float = param(0.1, "%",
        "Share of the points that the histogram omits at either end; 0 takes all, as the paper does.",
        ours="one crane or bird must not make all bins coarse", low=0, high=20)
    link_spacings: float = param(2.0, "spacings",
        "T_c: points nearer than this many mean point spacings are connected.",
        ours="C2 gives no T_c; 1.75 cuts roofs apart, 2.5 joins crowns to roofs", low=1, high=20)
    smallest_m2: float = param(10.0, "m2", "T_a: area of the smallest building.", paper="C14, A17", low=0.01, high=1e6)
    areas_m2: tuple[float, ...] = param((), "m2",
        "T_a of each area scale, each fed by the one below; empty takes smallest_m2 alone.", paper="C7; C14 uses one",
        low=0.01, high=1e6)
    neighbours: int = param(16, "count", "K: points whose change of curvature is taken together.",
        ours="C16 gives no K; 12 takes crowns for roofs, 32 loses narrow roofs", low=4, high=200)
    max_curvature: float = param(0.06, "1", "T_coc: points with a larger change of curvature belong to crowns.",
        ours="C16 gives no threshold; 0.05 to 0.08 differ little", low=0, high=1)
    thin_m: float = param(0.5, "m", "The change of curvature uses one point per cube of this size; 0 uses all points.",
        ours="the 16 nearest of 20 points/m2 lie within one leaf's reach, where crowns are smooth; 4 points/m2",
        low=0, high=10)
    max_echo_share: float = param(0.5, "1",
        "Points whose K neighbours have a larger share of pulses with several echoes belong to crowns.",
        ours="0.1 to 0.25 on roofs, 0.6 to 0.95 in crowns; 1 ignores echoes, as the paper does", low=0, high=1)
    max_crown: float = param(0.0032, "1",
        "Regions of a larger product of mean curvature and share of several echoes are crowns.",
        ours="small smooth patches of crowns pass T_coc; grows with spacing/thin_m; 1 omits the test, as the paper",
        low=0, high=1)
    max_crown_curvature: float = param(0.02, "1",
        "Regions of a larger mean change of curvature, times the distrust in single echoes, are crowns.",
        ours="without echoes the distrust is 1; 1 omits the test", low=0, high=1)
    max_ndvi: float = param(0.3, "1", "Regions of a larger mean NDVI are crowns, where the points have NDVI.",
        ours="above the classes' bounds of NDVI; not measured, no test tile has it; 1 omits the test", low=-1, high=1)
    grow_m: float = param(0.6, "m",
        "Points this near to a region in plan return to it: edges, chimneys and walls are no planes.",
        ours="beyond, fewer than half of the points are roofs, at any density; 0 gives nothing back", low=0, high=20)
    grow_spacings: float = param(1.0, "spacings", "The same, at least.",
        ours="the points' spacing limits how near a region comes to a roof's edge", low=0, high=20)
    grow_step_m: float = param(1.0, "m",
        "Points higher than this above the region beside them return within half the distance, none of twice it.",
        ours="as for the flat regions; crowns rise higher over a roof; 0.5 to 2 m differ little", low=0, high=100)
    wall_factor: float = param(2.0, "1",
        "Only echoes lower by more than that step return within so many times the distance.",
        ours="below eaves, pulses of one echo hit walls and lower roofs; 1 treats them as others", low=1, high=20)
    foot_m: float = param(1.0, "m",
        "Points below the mask, but above this, return to a region over them: feet of its walls.",
        ours="surveys differ in how far down they count walls; 0.3 costs one tile of four 1.3 points", low=0, high=1000)
    sector_spacings: float = param(4.0, "spacings", "R: radius of the eight sectors around a point.",
        ours="C8 gives no R; at 3, one inner point in five has an empty sector by chance, at 4 one in seventy",
        low=0.5, high=50)
    gap_spacings: float = param(4.0, "spacings", "E_s: a sector whose nearest point is farther makes an edge point.",
        ours="C9 gives no E_s; as R", low=0.5, high=50)
    line_most: int = param(12, "count", "n_b: most edge points of a line.", ours="C11 gives no n_b", low=3, high=200)
    line_least: int = param(5, "count", "n_s: fewest edge points of a line.",
        ours="C11 gives no n_s; a line often fits 4 of them by chance", low=3, high=200)
    line_error_spacings: float = param(0.35, "spacings", "σ_l: largest error of a line, root mean square.",
        ours="C11 gives no σ_l; edge points lie within about half a spacing of the wall", low=0, high=10)
    rectangularity_1: float = param(0.75, "1", "T_rect of rule 1: least rectangularity.", paper="C18", low=0, high=2)
    rectangularity_2: float = param(0.10, "1", "T_rect of rule 2: least rectangularity.", paper="C18 gives 0.40",
        ours="wings and rows of houses around courts are one region, and fill 0.15 of it", low=0, high=2)
    compactness: float = param(0.9, "1", "T_comp of both rules: least points an edge point.", paper="C18 gives 3",
        ours="that rejects houses below 100 m2; the smallest, of 10 m2, reach 1", low=0, high=1000)
    compactness_density: float = param(3.0, "1/m2",
        "Compactness is converted to this density of points; 0 leaves it as counted.",
        paper="C17, C20: between the paper's two densities, 2.2 and 4.2", low=0, high=1000)
    linearity: float = param(0.3, "1", "T_line of rule 2: least linearity.", paper="C18 gives 0.45",
        ours="small and sparsely scanned houses reach 0.35", low=0, high=1)
    perpendicular_deg: float = param(10.0, "deg", "Main directions this near to a right angle are perpendicular.",
        ours="C18 gives no tolerance", low=0, high=45)


@dataclass(frozen=True, slots=True)
class AdaptiveParams:
    """Buildings from points above ground by clustering; lengths follow the spacing, but for a least length.

    Where a parameter has two values, the clustering goes evenly from the first to the second.
    """

    ndvi_bounds: tuple[float, ...] = param((0.0, 0.2), "1",
        "Lowest and highest threshold of NDVI; Otsu's method finds the value between them.",
        ours="as for the classes; S6 gives none, and warns of an unsuitable one", low=-1, high=1)
    ndvi_smooth: float = param(0.7, "1", "Green points whose surroundings are level to this degree stay.",
        ours="a planted roof is level, a crown is not; as for the cover", low=0, high=1)
    surface_factor: float = param(1.75, "spacings", "Radius within which the surface around a point is a plane.",
        ours="ten points, enough for a plane and its residuals", low=1, high=20)
    surface_least_m: float = param(0.8, "m", "The same, at least.",
        ours="in sample: most points of a roof lie as far from ridge and eaves; with 1.25 m roofs pass for crowns",
        low=0, high=20)
    level_m: float = param(0.082, "m",
        "Residual between level and not within a radius of 1 m: at half of it a surface is level, at twice it is not.",
        ours="in sample: 0.06 m separates roofs from crowns better, but not where echoes lie 20 cm beside their places",
        low=0.005, high=5)
    around_factor: float = param(2.5, "spacings", "Radius of the shares.", ours="enough echoes for a share",
        low=1, high=50)
    around_least_m: float = param(2.5, "m", "The same, at least.",
        ours="wider detects crowns a little better and rounds corners", low=0, high=50)
    split_weight: float = param(7.5, "1", "Log-odds that a share of echoes of split pulses takes from a roof.",
        ours=CALIBRATED, low=0, high=100)
    leaf_level: float = param(0.25, "1", "Mean level share up to which split echoes count in full, as of leaves.",
        ours="three quarters of the points of crowns lie below on three tiles", low=0, high=1)
    glass_level: float = param(0.75, "1", "Mean level share from which split echoes do not count: glass or nets.",
        ours="roofs of glass reach it; above leaf_level", low=0.01, high=1)
    level_weight: float = param(4.0, "1", "Log-odds that a level surface gives to a roof.", ours=CALIBRATED,
        low=0, high=100)
    bias: float = param(2.0, "1", "Log-odds without any evidence.", ours=CALIBRATED, low=-50, high=50)
    blind_level_weight: float = param(9.4, "1", "level_weight, as far as single echoes are not trusted.",
        ours=CALIBRATED,
        low=0, high=100)
    blind_bias: float = param(-2.5, "1", "bias, as far as single echoes are not trusted.",
        ours="in sample: roofs begin at a mean degree of 0.35; 0.25 takes more crowns", low=-50, high=50)
    least_odds: float = param(0.75, "1", "Points of smaller log-odds are vegetation; a large negative value keeps all.",
        ours=CALIBRATED, low=-50, high=50)
    steps: int = param(2, "count",
        "Steps of the clustering; distance and thresholds go evenly from the first to the last.",
        ours="S6 clusters and tightens step by step, without numbers; 2 and 4 give the same regions", low=1, high=20)
    link_factors: tuple[float, ...] = param((3.0, 2.5), "spacings",
        "Distance in space at which the tree of clusters is cut, in the first and the last step.",
        ours="random points of a surface are connected from 1.2 spacings on", low=1, high=50)
    link_least_m: float = param(0.5, "m", "The same, at least.", ours="roofs lose points to skylights and wet tiles",
        low=0, high=20)
    points: tuple[float, ...] = param((3.0, 6.0), "count", "Least number of points.", ours="fewer make no surface",
        low=1, high=1e6)
    area_m2: tuple[float, ...] = param((4.0, 8.0), "m2", "Least area.",
        ours="below the finest scale, as outlines grow afterwards", low=0, high=1e6)
    height_m: tuple[float, ...] = param((2.0, 2.3), "m", "Least height above ground of the upper tenth.",
        ours="from the mask to the eaves of a garage; cars, hedges and walls are lower", low=0, high=100)
    width_m: tuple[float, ...] = param((0.0, 1.5), "m",
        "Least width across, of a rectangle whose spread is that of the points.",
        ours="wires, fences and garden walls are narrower than a shed", low=0, high=100)
    level_shares: tuple[float, ...] = param((0.0, 0.15), "1", "Least mean degree to which its points are level.",
        ours=CALIBRATED, low=0, high=1)
    level_per_split: tuple[float, ...] = param((0.5, 1.5), "1",
        "Least ratio of the mean degree to which its points are level to the share of split echoes.",
        ours="roofs with split echoes have plane surfaces, crowns have not", low=0, high=100)
    regain_factor: float = param(2.0, "spacings",
        "Points above ground this near to a region, in plan, become its points.",
        ours="eaves split pulses as crowns do (S8)", low=0, high=20)
    regain_step_m: float = param(1.0, "m", "Largest step to them.", ours="less than a storey's parapet", low=0, high=20)

    def __post_init__(self) -> None:
        """Refuse limits in the wrong order."""
        require_rising("adaptive", self, "leaf_level", "glass_level")
