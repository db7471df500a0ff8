"""Parameters of the ground filters."""

from dataclasses import dataclass

from msbdb.params.declare import param


@dataclass(frozen=True, slots=True)
class GroundParams:
    """Telling ground from off-ground."""

    ground_filter: str = param(
        "auto",
        unit="-",
        choices=("auto", "class2", "progressive", "wavelet", "quadratic", "adaptive"),
        source="V16",
        doc="'auto' trusts class 2 where it is given, and filters by the default otherwise.",
    )
    ground_cell_m: float = param(
        1.0,
        unit="m",
        low=0.25,
        high=20.0,
        source="ours: fine enough for courtyards, coarse enough to see past crowns",
        doc="Cell on which ground is told; the lattice's own where that is coarser.",
    )
    window_m: float = param(
        80.0,
        unit="m",
        low=5.0,
        high=500.0,
        source="ours: half the width of the widest hall that is still a building",
        doc="Half-width of the largest window of the progressive filter.",
    )
    window_growth: float = param(
        1.4,
        unit="1",
        low=1.05,
        high=4.0,
        source="ours: finer steps change nothing on the tiles at hand",
        doc="Factor from one window to the next.",
    )
    slope: float = param(
        0.15,
        unit="m/m",
        low=0.0,
        high=2.0,
        source="Pingel et al. 2013: 0.15, the default of the SMRF filter",
        doc="Steepest terrain that the progressive filter keeps between two windows.",
    )
    height_m: float = param(
        0.3,
        unit="m",
        low=0.05,
        high=5.0,
        source="ours: Zhang et al. 2003 give 0.3 for their initial threshold",
        doc="Height threshold of the first window, and the part that all windows share.",
    )
    steep_slope: float = param(
        1.0,
        unit="m/m",
        low=0.0,
        high=5.0,
        source="ours: banks of earthworks are no steeper; on towns laid over hills of 50 % 0.5 loses much",
        doc="Steepest terrain that the progressive filter looks for, where it finds no edges.",
    )
    hill_m2: float = param(
        100.0,
        unit="m2",
        low=0.0,
        high=1e6,
        source="ours: what is smaller than a house is judged as one",
        doc="Smallest region without edges that the progressive filter takes for a hill.",
    )
    trend_m: float = param(
        8.0,
        unit="m",
        low=1.0,
        high=200.0,
        source="ours: on towns laid over hills of 40 %, 6 to 10 m keep the ground and 12 m lose it",
        doc="Sigma of the trend of hilly terrain that is taken off before the progressive filter runs again.",
    )
    edge_step_m: float = param(
        0.9,
        unit="m",
        low=0.05,
        high=10.0,
        source="ours: banks of 1 in 1.5 step less, sheds more; on the tiles at hand 0.4 to 1.2 differ little",
        doc="Step to the ground beside it that makes a 1 m cell of a boundary an edge; larger cells need more.",
    )
    edge_share: float = param(
        0.5,
        unit="1",
        low=0.0,
        high=1.0,
        source="ours: 0.3 takes mounds for roofs, 0.7 loses roofs built into slopes",
        doc="Share of a region's boundary that must be edge for it to stand off the ground.",
    )
    low_outlier_m: float = param(
        1.0,
        unit="m",
        low=0.1,
        high=50.0,
        source="ours: below any step of real terrain at the cell's size",
        doc="A lowest point this far below the median of its 5 x 5 cells is raised to that floor.",
    )
    wavelet_cluster_m: float = param(
        0.5,
        unit="m",
        low=0.0,
        high=10.0,
        source="ours: garden walls and kerbs; on the tiles at hand 0.3 to 0.5 give the same ground",
        doc="Wavelet filter: nearer centres of the two clusters of a resolution are one cluster.",
    )
    adaptive_default_m: float = param(
        0.0,
        unit="m",
        low=0.0,
        high=50.0,
        source="S4 names a default window and no value; ours: cars, hedges and stems fit into it",
        doc="Adaptive filter: half-width of the default window; 0 takes three cells of low points.",
    )
    adaptive_fall_m: float = param(
        1.5,
        unit="m",
        low=0.1,
        high=20.0,
        source="ours: quays and garden walls are lower, single storeys higher; 1 m loses canal banks",
        doc="Adaptive filter: least height of a feature at its edges.",
    )
    adaptive_slope: float = param(
        0.5,
        unit="m/m",
        low=0.0,
        high=5.0,
        source="ours: towns on slopes of 35 % keep their streets; where the slope is less, less is taken",
        doc="Adaptive filter: steepest terrain from one side of a feature to the other.",
    )
    adaptive_iterations: int = param(
        6,
        unit="-",
        low=1,
        high=50,
        source="S4 iterates without a number; ours: real tiles settle after 3 to 5",
        doc="Adaptive filter: most iterations; it ends earlier when less than a thousandth of the low points sink.",
    )
    quadratic_window_m: float = param(
        60.0,
        unit="m",
        low=2.0,
        high=1000.0,
        source="C13 gives none; ours: holds ground beside most blocks; in an old town 40 and 100 m err more",
        doc="Quadratic filter: width w of a window, rounded to whole steps.",
    )
    quadratic_step_m: float = param(
        20.0,
        unit="m",
        low=1.0,
        high=500.0,
        source="C13 gives none; ours: each point lies in nine windows; 10 m gains little and takes four times as long",
        doc="Quadratic filter: sliding step ss.",
    )
    quadratic_area_m2: float = param(
        10.0,
        unit="m2",
        low=0.0,
        high=1000.0,
        source="C13 gives none; ours: the paper's own for buildings, 10 m2; 2 to 50 differ little",
        doc="Quadratic filter: T_a.",
    )
    quadratic_link: float = param(
        2.0,
        unit="1",
        low=1.0,
        high=10.0,
        source="C2 gives none; ours: joins a surface of scattered points, and no wall to the ground beside it",
        doc="Quadratic filter: T_c in point spacings.",
    )
    quadratic_growth: int = param(
        3,
        unit="-",
        low=0,
        high=50,
        source="C13 leaves windows of too few low points open; ours: up to three times the width",
        doc="Quadratic filter: steps by which a window may grow to all sides.",
    )
    quadratic_passes: int = param(
        2,
        unit="-",
        low=1,
        high=20,
        source="C13: 1; ours: 15 % of an old town.s roof points stay where the median is a roof, then 6 %",
        doc="Quadratic filter: times that the windows slide over all; again on the ground heights of the time before.",
    )
    quadratic_again_m: float = param(
        1.5,
        unit="m",
        low=0.0,
        high=50.0,
        source="ours: above what the fit misses by on quays and banks, below a storey",
        doc="Quadratic filter: least height by which ground heights sink after the first time.",
    )
