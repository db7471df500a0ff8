"""Parameters of the 3-D area morphology."""

from dataclasses import dataclass

from msbdb.params.declare import param


@dataclass(frozen=True, slots=True)
class Area3dParams:
    """Building regions among the points by 3-D area morphology."""

    heights_m: tuple[float, ...] = param(
        (),
        unit="m",
        low=0.0,
        high=1000.0,
        source="C14: prior knowledge of the scene, where there is any",
        doc="Height scales h_j; none finds them in the histogram of the heights.",
    )
    most_heights: int = param(
        4, unit="count", low=1, high=50, source="C14", doc="Most height scales; 1 is the single-scale mode (SS)."
    )
    mask_first: bool = param(
        True,
        unit="-",
        source="ours: the histogram's first minimum lies at 2.1 to 5.4 m on the tiles at hand, above annexes",
        doc="Take the mask's height as the first scale, before the histogram's.",
    )
    histogram_tail_percent: float = param(
        0.1,
        unit="%",
        low=0.0,
        high=20.0,
        source="ours: one crane or bird must not make all bins coarse",
        doc="Share of the points that the histogram leaves out at either end; 0 takes all, as the paper does.",
    )
    link_spacings: float = param(
        2.0,
        unit="spacings",
        low=1.0,
        high=20.0,
        source="ours: C2 gives no T_c; 1.75 cuts roofs apart, 2.5 joins crowns to roofs",
        doc="T_c: points nearer than this many mean point spacings are connected.",
    )
    smallest_m2: float = param(
        10.0, unit="m2", low=0.01, high=1e6, source="C14, A17", doc="T_a: area of the smallest building."
    )
    neighbours: int = param(
        16,
        unit="count",
        low=4,
        high=200,
        source="ours: C16 gives no K; 12 takes crowns for roofs, 32 loses narrow roofs",
        doc="K: points whose change of curvature is taken together.",
    )
    max_curvature: float = param(
        0.06,
        unit="1",
        low=0.0,
        high=1.0,
        source="ours: C16 gives no threshold; 0.05 to 0.08 differ little",
        doc="T_coc: points with a larger change of curvature belong to crowns.",
    )
    thin_m: float = param(
        0.5,
        unit="m",
        low=0.0,
        high=10.0,
        source="ours: at 20 points/m2 the 16 nearest lie within a leaf's reach, where crowns are smooth; 4 points/m2",
        doc="The change of curvature looks at one point a cube of this size; 0 at all points.",
    )
    max_echo_share: float = param(
        0.5,
        unit="1",
        low=0.0,
        high=1.0,
        source="ours: 0.1 to 0.25 on roofs, 0.6 to 0.95 in crowns; 1 leaves echoes out, as the paper does",
        doc="Points of whose K neighbours a larger share is of pulses with several echoes belong to crowns.",
    )
    max_crown: float = param(
        0.0032,
        unit="1",
        low=0.0,
        high=1.0,
        source="ours: small smooth patches of crowns pass T_coc; 1 leaves the test out, as the paper",
        doc="Crowns are regions whose mean curvature by share of several echoes exceeds it, or it by spacing/thin_m.",
    )
    max_crown_curvature: float = param(
        0.02,
        unit="1",
        low=0.0,
        high=1.0,
        source="ours: where no echoes are known; 1 leaves the test out",
        doc="Regions whose mean change of curvature exceeds this are crowns.",
    )
    max_ndvi: float = param(
        0.3,
        unit="1",
        low=-1.0,
        high=1.0,
        source="ours: above the classes' bounds of NDVI; not measured, no tile at hand has it; 1 leaves it out",
        doc="Regions of a larger mean NDVI are crowns, where the points have NDVI.",
    )
    grow_m: float = param(
        0.6,
        unit="m",
        low=0.0,
        high=20.0,
        source="ours: beyond, fewer than half of the points are roofs, at any density; 0 gives nothing back",
        doc="Points that lie this near to a region in plan return to it: edges, chimneys and walls are no planes.",
    )
    grow_spacings: float = param(
        1.0,
        unit="spacings",
        low=0.0,
        high=20.0,
        source="ours: the edges of regions lie no nearer to those of roofs than the points let them",
        doc="The same, at least.",
    )
    grow_step_m: float = param(
        1.0,
        unit="m",
        low=0.0,
        high=100.0,
        source="ours: as for the flat regions; crowns stand higher over a roof; 0.5 to 2 m differ little",
        doc="Points higher than this above the region beside them return within half the distance, none of twice it.",
    )
    wall_factor: float = param(
        2.0,
        unit="1",
        low=1.0,
        high=20.0,
        source="ours: below eaves, pulses of one echo hit walls and lower roofs; 1 treats them as others",
        doc="Only echoes lower by more than that step return within so many times the distance.",
    )
    foot_m: float = param(
        1.0,
        unit="m",
        low=0.0,
        high=1000.0,
        source="ours: surveys differ in how far down they count walls; 0.3 costs one tile of four 1.3 points",
        doc="Points below the mask, but above this, return to a region that stands over them: feet of its walls.",
    )
    sector_spacings: float = param(
        4.0,
        unit="spacings",
        low=0.5,
        high=50.0,
        source="ours: C8 gives no R; at 3, one inner point in five has an empty sector by chance, at 4 one in seventy",
        doc="R: radius of the eight sectors around a point.",
    )
    gap_spacings: float = param(
        4.0,
        unit="spacings",
        low=0.5,
        high=50.0,
        source="ours: C9 gives no E_s; as R",
        doc="E_s: a sector whose nearest point is farther makes an edge point.",
    )
    line_most: int = param(
        12, unit="count", low=3, high=200, source="ours: C11 gives no n_b", doc="n_b: most edge points of a line."
    )
    line_least: int = param(
        5,
        unit="count",
        low=3,
        high=200,
        source="ours: C11 gives no n_s; through 4 of them a line often fits by chance",
        doc="n_s: fewest edge points of a line.",
    )
    line_error_spacings: float = param(
        0.35,
        unit="spacings",
        low=0.0,
        high=10.0,
        source="ours: C11 gives no σ_l; edge points lie within about half a spacing of the wall",
        doc="σ_l: largest error of a line, root mean square.",
    )
    rectangularity_1: float = param(
        0.75, unit="1", low=0.0, high=2.0, source="C18", doc="T_rect of rule 1: least rectangularity."
    )
    rectangularity_2: float = param(
        0.10,
        unit="1",
        low=0.0,
        high=2.0,
        source="C18 gives 0.40; ours: wings and rows of houses around courts are one region, and fill 0.15 of it",
        doc="T_rect of rule 2: least rectangularity.",
    )
    compactness: float = param(
        0.9,
        unit="1",
        low=0.0,
        high=1000.0,
        source="C18 gives 3; ours: that rejects houses below 100 m2, the smallest of 10 m2 reach 1",
        doc="T_comp of both rules: least points an edge point.",
    )
    compactness_density: float = param(
        3.0,
        unit="1/m2",
        low=0.0,
        high=1000.0,
        source="C17, C20: between the paper's two densities, 2.2 and 4.2",
        doc="Compactness is brought to this density of points; 0 leaves it as counted.",
    )
    linearity: float = param(
        0.3,
        unit="1",
        low=0.0,
        high=1.0,
        source="C18 gives 0.45; ours: small and sparsely scanned houses reach 0.35",
        doc="T_line of rule 2: least linearity.",
    )
    perpendicular_deg: float = param(
        10.0,
        unit="deg",
        low=0.0,
        high=45.0,
        source="ours: C18 gives no tolerance",
        doc="Main directions this near to a right angle are perpendicular.",
    )
