"""Parameters of what is prepared from the data: surface, ground, cover by structure, and classes by colour."""

from dataclasses import dataclass

from msbdb.params.declare import param, require_rising

CALIBRATED = "calibrated together, on four surveys and thinned copies"

# A table, in which a parameter takes a line or two: the formatter would give every argument a line of its own.
# fmt: off


@dataclass(frozen=True, slots=True)
class SurfaceParams:
    """From points to DSM, DTM and nDSM."""

    most_density: float = param(30.0, "1/m2",
        "Where there are more first echoes a square metre, a share of the points is taken, by lot; 0 takes all.",
        ours="copies of three places with 54 to 69 points/m2 lose up to 8 points of quality without it; 25 does alike",
        low=0, high=1e4)
    cell_m: float = param(0.0, "m", "Cell size; 0 takes the mean spacing of the first echoes, by cell_rule.",
        paper="V14: mean point spacing, 1/sqrt(density)", low=0, high=50)
    cell_rule: str = param("spacing", "-",
        "With cell_m 0: 1/sqrt(density) on a ladder of round values, or 1/density in whole cm as printed.",
        paper="V14, M7", ours="A10: 1/density is no length; it leaves 13 empty cells a point",
        choices=("spacing", "literal"))
    max_gap_m: float = param(1.0, "m",
        "Empty cells this near to a measured cell, or within two cells, take its value; others stay invalid.",
        ours="water and canals stay open, however far a crown leans over them", low=0, high=1000)
    below_top_m: float = param(1.5, "m",
        "A cell whose nearest echo lies so far below a roof's edge takes the height of the roof; 0 is off.",
        ours="walls, and ground beside their foot; half a storey: 0.5 to 2.5 m differ by 0.3 points of quality at most",
        low=0, high=100)
    mask_m: float = param(2.0, "m", "Cells of the nDSM below this height belong to no building.", paper="V17",
        low=0.1, high=20)
    slicing: str = param("storey", "-", "Slice the heights by storeys, or by a metric step.", paper="V18, V19",
        choices=("storey", "step"))
    storey_m: float = param(3.0, "m", "Height of a storey.", paper="V18: 2 to 3 m", low=1.5, high=10)
    storeys_from: str = param("p90", "-",
        "H of a part: storeys of the 90th percentile of its heights, or of its flat zone as written.",
        paper="V30: the flat zone", ours="an opening lowers the zone of a podium under a tower",
        choices=("p90", "zone"))
    step_m: float = param(1.0, "m", "Height of a slice where slicing is 'step'.", ours="V19 gives no step",
        low=0.05, high=50)
    level_m: float = param(0.5, "m",
        "Up to this step, neighbouring cells of one level are not cut by a slice; 0 slices each cell by itself.",
        ours="V18 gives no rounding; ten times a scanner's noise, less than a step between two roofs", low=0, high=10)
    level_slope: float = param(0.1, "m/m", "A level may span several slices where it rises by no more than this.",
        ours="flat roofs, and the slope of the ground under a level hall; pitched roofs rise by 0.3 and more",
        low=0, high=1)


@dataclass(frozen=True, slots=True)
class GroundParams:
    """Separation of ground from objects above it."""

    ground_filter: str = param("auto", "-",
        "'auto' uses class 2 where the points have it, and the filter by walls elsewhere.", paper="V16",
        choices=("auto", "class2", "walls", "progressive", "wavelet", "quadratic", "adaptive"))
    ground_cell_m: float = param(1.0, "m", "Cell of the ground filter; half of the lattice's where that is larger.",
        ours="fine enough for courtyards, coarse enough to see past crowns", low=0.25, high=20)
    clutter_m: float = param(2.0, "m", "Filter by walls: half-width of the square that removes crowns, cars and masts.",
        ours="narrower than a shed with its eaves; 3 and 4 m lose sheds, 2 m keeps them", low=0.5, high=20)
    block_m: float = param(20.0, "m", "Filter by walls: side of a block whose lowest cell carries the trend.",
        ours="most blocks of this size see a street, a yard or a court; 15 m differs little", low=2, high=200)
    low_share: float = param(0.3, "1", "Filter by walls: share of the blocks' lowest cells that lie below the trend.",
        ours="up to two thirds of the blocks may be covered; 0.15 to 0.7 differ little", low=0.01, high=0.99)
    wall_low_m: float = param(0.8, "m", "Filter by walls: a smaller step between cells of 1 m is no wall.",
        ours="banks and rocks step less; 0.5 m takes wooded knolls for buildings", low=0, high=10)
    wall_high_m: float = param(1.6, "m", "Filter by walls: a larger step is surely a wall.",
        ours="twice the smaller one; sheds step more", low=0.1, high=20)
    terrace_cost: float = param(0.43, "1", "Filter by walls: cost of a wall within ground, per smooth edge of a roof.",
        ours="3 to 7: walls bound a building for 70 % of its edge; 0.38 loses a roof in a slope, 0.7 terraces",
        low=0, high=10)
    podium_share: float = param(0.9, "1", "Filter by walls: a region that falls by walls for this share is a building.",
        ours="nearly all around; a way up, or the tile's border, is enough for terrain", low=0.5, high=1)
    hollow_share: float = param(0.25, "1",
        "Filter by walls: area of hollows, per area of what stands above the trend, up to which they are pits.",
        ours="an excavation of 20 m beside two rows of houses; 0 is off", low=0, high=1)
    even_step_m: float = param(0.3, "m", "Filter by walls: what rises by more from cell to cell of 1 m is no way.",
        ours="the steepest streets; 0.2 to 0.4 m give the same", low=0.01, high=2)
    reached_share: float = param(0.75, "1",
        "Filter by walls: share of a region to which ways must lead for all of it to be terrain.",
        ours="terraces 0.8 to 1, roofs that touch a slope up to 0.65; above 1 the ways alone are terrain",
        low=0.1, high=1.1)
    window_m: float = param(80.0, "m", "Progressive filter, also inside `walls`: largest half-width of a window.",
        ours="half the width of the widest hall that is still a building", low=5, high=500)
    window_growth: float = param(1.4, "1", "Progressive filter: factor from one window to the next.",
        ours="finer steps change nothing on the test tiles", low=1.05, high=4)
    slope: float = param(0.15, "m/m", "Progressive filter: steepest terrain that is kept between two windows.",
        paper="Pingel et al. 2013: 0.15, the default of the SMRF filter", low=0, high=2)
    height_m: float = param(0.3, "m",
        "Progressive filter: height threshold of the first window, which is part of the threshold of each window.",
        ours="Zhang et al. 2003 give 0.3 for their initial threshold", low=0.05, high=5)
    steep_slope: float = param(1.0, "m/m",
        "Progressive filter: steepest terrain that is searched for where there are no edges.",
        ours="banks of earthworks are no steeper; 0.5 loses much of towns on hills of 50 %", low=0, high=5)
    hill_m2: float = param(100.0, "m2",
        "Smallest region without edges that is taken for a hill. Walls: largest piece of few echoes that is a shed.",
        ours="a smaller region is judged as a house", low=0, high=1e6)
    trend_m: float = param(8.0, "m",
        "Progressive filter: sigma of the trend of hilly terrain, which is subtracted before a second pass.",
        ours="in towns on hills of 40 %, 6 to 10 m keep the ground and 12 m lose it", low=1, high=200)
    edge_step_m: float = param(0.9, "m",
        "Step to the ground beside it that makes a 1 m cell of a boundary an edge; larger cells need more.",
        ours="banks of 1 in 1.5 step less, sheds more; 0.4 to 1.2 differ little on the test tiles", low=0.05, high=10)
    edge_share: float = param(0.5, "1", "Share of a region's boundary that must be edge for a region above ground.",
        ours="0.3 takes mounds for roofs, 0.7 loses roofs built into slopes", low=0, high=1)
    low_outlier_m: float = param(1.0, "m",
        "A cell of a hollow of up to 10 m² this far below the median of its 5 x 5 cells is raised to that limit.",
        ours="more than any step of real terrain at the cell's size", low=0.1, high=50)
    wavelet_cluster_m: float = param(0.5, "m",
        "Wavelet filter: the two clusters of a resolution are one if their centres are nearer.",
        ours="garden walls and kerbs; 0.3 to 0.5 give the same ground on the test tiles", low=0, high=10)
    adaptive_default_m: float = param(0.0, "m",
        "Adaptive filter: half-width of the default window; 0 takes three cells of low points.",
        paper="S4 names a default window and no value", ours="cars, hedges and stems fit into it", low=0, high=50)
    adaptive_fall_m: float = param(1.5, "m", "Adaptive filter: least height of a feature at its edges.",
        ours="quays and garden walls are lower, single storeys higher; 1 m loses canal banks", low=0.1, high=20)
    adaptive_slope: float = param(0.5, "m/m",
        "Adaptive filter: steepest terrain from one side of a feature to the other.",
        ours="towns on slopes of 35 % keep their streets; where the slope is less, less is taken", low=0, high=5)
    adaptive_iterations: int = param(6, "-",
        "Adaptive filter: most iterations; it stops when less than a thousandth of the low points sink.",
        paper="S4 iterates without a number", ours="real tiles need 3 to 5", low=1, high=50)
    quadratic_window_m: float = param(60.0, "m", "Quadratic filter: width w of a window, rounded to whole steps.",
        paper="C13 gives none", ours="holds ground beside most blocks; in an old town 40 and 100 m have larger errors",
        low=2, high=1000)
    quadratic_step_m: float = param(20.0, "m", "Quadratic filter: sliding step ss.", paper="C13 gives none",
        ours="each point lies in nine windows; 10 m gains little and takes four times as long", low=1, high=500)
    quadratic_area_m2: float = param(10.0, "m2", "Quadratic filter: T_a.", paper="C13 gives none",
        ours="the paper's own for buildings, 10 m2; 2 to 50 differ little", low=0, high=1000)
    quadratic_link: float = param(2.0, "1", "Quadratic filter: T_c in point spacings.", paper="C2 gives none",
        ours="joins a surface of scattered points, and no wall to the ground beside it", low=1, high=10)
    quadratic_growth: int = param(3, "-", "Quadratic filter: steps by which a window may grow to all sides.",
        paper="C13 leaves windows of too few low points open", ours="up to three times the width", low=0, high=50)
    quadratic_passes: int = param(2, "-",
        "Quadratic filter: passes of the windows over all points; each uses the ground heights of the one before.",
        paper="C13: 1",
        ours="after one, 15 % of an old town's roof points stay where the median is a roof; after two, 6 %",
        low=1, high=20)
    quadratic_again_m: float = param(1.5, "m",
        "Quadratic filter: least height by which ground heights sink after the first pass.",
        ours="more than the fit's error on quays and banks, less than a storey", low=0, high=50)

    def __post_init__(self) -> None:
        """Refuse limits in the wrong order."""
        require_rising("ground", self, "wall_low_m", "wall_high_m")


@dataclass(frozen=True, slots=True)
class CoverParams:
    """Separation of roofs from vegetation by texture and echoes; all calibrated together on the test tiles."""

    window_m: float = param(1.5, "m", "Small window of the texture.", ours="smaller than the narrowest roof plane",
        low=0.5, high=20)
    wide_window_m: float = param(2.5, "m", "Wide window of the texture.", ours="enough echoes for a share",
        low=0.5, high=20)
    split_weight: float = param(8.0, "1", "Log-odds per share of split first echoes, small window.", ours=CALIBRATED,
        low=0, high=100)
    split_wide_weight: float = param(3.5, "1", "Log-odds per share of split first echoes, wide window.",
        ours=CALIBRATED, low=0, high=100)
    solid_weight: float = param(2.0, "1", "Log-odds per share of last echoes near the surface.", ours=CALIBRATED,
        low=0, high=100)
    glass_m: float = param(0.05, "m", "Wide-window roughness up to which split echoes are of glass, not of leaves.",
        ours="planes of glass or nets split echoes and stay planes; the range noise of a scanner", low=0.001, high=5)
    leaf_m: float = param(0.15, "m", "Wide-window roughness from which split echoes count in full.",
        ours="three times glass_m; from 0.1 to 0.2 m little changes", low=0.002, high=10)
    echo_rough_weight: float = param(0.15, "1", "Log-odds per factor e of roughness, with echoes.", ours=CALIBRATED,
        low=0, high=100)
    echo_bias: float = param(-1.2, "1", "Log-odds without any evidence.", ours=CALIBRATED, low=-50, high=50)
    rough_weight: float = param(1.5, "1",
        "Log-odds per factor e of roughness, as far as single echoes are not trusted.", ours=CALIBRATED,
        low=0, high=100)
    rough_m: float = param(0.25, "m",
        "Roughness in the small window that supports neither roof nor crown; grows with cells above 0.6 m.",
        ours=CALIBRATED, low=0.01, high=10)
    rough_wide_m: float = param(0.35, "m",
        "Roughness in the wide window that supports neither roof nor crown; grows with cells above 0.6 m.",
        ours=CALIBRATED, low=0.01, high=10)
    smooth_floor_m: float = param(0.02, "m", "Least roughness; smaller values count as this.",
        ours="the range noise of a scanner", low=0.001, high=1)
    smooth_m: float = param(2.0, "m", "Sigma of the smoothing of the odds.", ours=CALIBRATED, low=0, high=20)
    neck_m: float = param(1.2, "m", "Thinner necks of roofs are cut.", ours="hedges and walls are thinner",
        low=0, high=20)
    blind_neck_m: float = param(2.0, "m", "The same, as far as single echoes are not trusted.",
        ours="roughness alone mistakes more crowns",
        low=0, high=20)
    hole_m2: float = param(20.0, "m2", "Smaller holes of a roof, above the mask, are filled.",
        ours="twice the finest scale", low=0, high=1e4)
    min_roof_m2: float = param(10.0, "m2", "Smaller regions are no roof.", ours="the finest scale", low=0, high=1e4)
    smooth_m_limit: float = param(0.12, "m", "Cells of less roughness are smooth; grows with large cells.",
        ours="three times a scanner's range noise", low=0.01, high=5)
    min_smooth_share: float = param(0.5, "1", "Least smooth share of a roof, as far as single echoes are not trusted.",
        ours="most of a roof is smooth; with 0.6 blocks at 1 point/m2 are lost", low=0, high=1)
    smooth_per_split: float = param(3.0, "1", "Smooth share that a roof needs per share of split echoes.",
        ours=CALIBRATED, low=0, high=100)
    free_split_share: float = param(0.05, "1", "Share of split echoes that needs no smooth cells.",
        ours="edges and chimneys split as many", low=0, high=1)
    green_share: float = param(0.6, "1",
        "Regions with this share of vegetation's colour are vegetation unless they are smooth.",
        ours="crowns of Nîmes that stop every pulse are 90 % green, its roofs at most 20 %", low=0, high=1)
    green_smooth_share: float = param(0.7, "1", "Share of smooth cells from which a green region is a green roof.",
        ours="crowns reach 60 % of smooth cells, flat and pitched roofs have 70 to 90 %", low=0, high=1)
    grow_m: float = param(1.0, "m", "Width of the edge that is given back to roofs.", ours=CALIBRATED, low=0, high=20)
    grow_step_m: float = param(1.0, "m", "Largest step in height to a cell that is given back.", ours=CALIBRATED,
        low=0, high=20)

    def __post_init__(self) -> None:
        """Refuse limits in the wrong order."""
        require_rising("cover", self, "glass_m", "leaf_m")


@dataclass(frozen=True, slots=True)
class SpectralParams:
    """Classes of land cover by colour, and what they remove."""

    classes: int = param(15, "count", "K of k-means.", paper="V35", low=2, high=250)
    seed: int = param(0, "-", "Seed of k-means.", ours="the paper states none", low=0, high=2**31 - 1)
    sample: int = param(100_000, "count", "Cells on which k-means is fitted.",
        ours="centres from a sample are as good and cost a fixed time", low=100, high=10_000_000)
    filter_share: float = param(0.8, "1", "Area of the bands' open-close filter as a share of the finest scale.",
        paper="V34: 'a bit smaller than the smallest building'", low=0, high=1)
    tail_percent: float = param(2.0, "%", "This percentile of each band becomes 0, and that of 100 less it becomes 1.",
        ours="V21, the paper states no normalisation; one bright reflection must not decide the scaling",
        low=0, high=40)
    vegetation_index: str = param("auto", "-",
        "Evidence of leaves; 'auto' takes NDVI where near infrared exists, else green-red, else pseudo-NDVI.",
        paper="V20, V36", ours="on real surveys green-red separates crowns from roofs far better than pulse intensity",
        choices=("auto", "ndvi", "pseudo-ndvi", "green-red"))
    ndvi_bounds: tuple[float, ...] = param((0.0, 0.2), "1",
        "Lowest and highest threshold of NDVI; Otsu's method finds the value between them.",
        ours="in every orthophoto seen, roofs lie below the first and lit crowns above the second", low=-1, high=1)
    green_red_bounds: tuple[float, ...] = param((0.0, 0.1), "1",
        "Lowest and highest threshold of (green - red) / (green + red).",
        ours="as for NDVI, wide enough for the colour balance of different cameras", low=-1, high=1)
    pseudo_ndvi_bounds: tuple[float, ...] = param((0.0, 0.4), "1",
        "Lowest and highest threshold of the index of intensity and red, both scaled to 0 to 1.",
        ours="the index of the scaled bands spreads about twice as wide as NDVI", low=-1, high=1)
    smooth_m: float = param(0.05, "m", "A green class of less roughness is a planted roof, not a crown.",
        ours="plain roofs show 0.003 to 0.05 m on real surveys, hedges and crowns 0.06 to 3 m", low=0, high=10)
    roof_share: float = param(0.5, "1", "A class is no vegetation where a larger share of it is roofs by structure.",
        ours="of pictures in which roofs and crowns share colours, most such classes are roofs", low=0, high=1)
    green_roof_share: float = param(0.75, "1", "The same for a class whose index exceeds the bounds of the threshold.",
        ours="between dense rows of trees of Woodford, 0.64, and green roofs apart from crowns, 0.85", low=0, high=1)
    rough_m: float = param(0.5, "m",
        "Roughness of a certain crown, where the index may lie farthest below its threshold.",
        ours="the roughest roof classes seen show 0.4 to 0.46 m, at cells of 0.5 and 1 m", low=0, high=100)
    leafless_share: float = param(0.5, "1",
        "From smooth_m to rough_m, the index a crown needs falls by this share of the width of its bounds.",
        ours="crowns that are bare or in shadow lie a little below the threshold on real surveys", low=0, high=2)
    clutter_m: float = param(1.0, "m",
        "A class of more roughness, not green enough for a crown, is neither roof nor crown: masts, cranes, fences.",
        ours="twice the roughest roof class seen", low=0, high=100)
    shadow_brightness: float = param(0.15, "1",
        "A darker class is shadow, unless its roughness is known to be below rough_m.",
        ours="V36 leaves it to the operator; smooth dark classes are roofs in shadow or dark roofs (V43)",
        low=0, high=1)
    water_ndvi: float = param(-0.3, "1",
        "A smooth class whose NDVI is below this is water; needs a near-infrared band.",
        ours="roofs lie above, open water below", low=-1, high=1)
    decides: str = param("structure", "-",
        "What separates roofs from vegetation where there is imagery: structure, or colours alone (V36 to V41).",
        ours="echoes and texture detect crowns better", choices=("structure", "spectral"))
    min_building_share: float = param(0.3, "1", "A part with a smaller share of building classes is removed.",
        ours="V41 removes a part only if it has no such pixel, which is lax (V43)", low=0, high=1)
    split_share: float = param(0.0, "1", "A part is split when its second class reaches this share; 0 never splits.",
        paper="V44: 0.4, as the vu2009 profile", ours="15 classes of fewer materials differ by noise, and cut roofs",
        low=0, high=0.5)
