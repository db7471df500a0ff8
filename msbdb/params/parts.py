"""Parameters from parts to inventory: scale-space, granulometry, fusion, outlines, change, and evaluation."""

import math
from dataclasses import dataclass, fields, replace

from msbdb.params.declare import checked_value, param

RASTERS = "fitted to 2741 objects of six places, in cells of 0.5 to 2 m"

# A table, in which a parameter takes a line or two: the formatter would give every argument a line of its own.
# fmt: off


@dataclass(frozen=True, slots=True)
class ScaleParams:
    """The area open-close scale-space and the tree of parts."""

    scales_m2: tuple[float, ...] = param((10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0, 5000.0), "m2",
        "Area thresholds s of the scale-space, ascending; empty finds them by granulometry (V8).",
        paper="V53: 50, 100, 200, 500, 1000", ours="10 and 20 for denser surveys, 2000 and 5000 for halls",
        low=0, high=1e7)
    connectivity: int = param(8, "-", "Neighbourhood of openings, closings and flat zones alike: 4 or 8.",
        ours="V10 states none; 8 keeps islands independent (V12)", low=4, high=8)
    duplicate_share: float = param(0.85, "1",
        "A finer cluster of at least this share of its coarser one's area is its duplicate.", paper="V28: 0.9 or 0.85",
        low=0.5, high=1)
    keep_courtyards: bool = param(True, "-",
        "Cut every cluster of every scale to the cells that are above ground on the finest scale.",
        ours="closing at coarse scales covers courtyards that the finest scale shows as ground")
    merge_slivers: bool = param(True, "-",
        "On every scale, merge zones below its s with the neighbour of the nearest value; no part is smaller.",
        paper="V7: objects of at least s",
        ours="an opening leaves the narrow zones between ground and roof; the way of merging")
    fake_father_ratio: float = param(0.4, "1", "A father whose StdDis over sqrt(area/pi) exceeds this is fake.",
        ours="V46 gives no threshold; by A7: a row of 3 to 5 squares gives 0.44 to 0.59, a disc 0.24", low=0, high=10)
    fake_father_m: float = param(0.0, "m",
        "Absolute StdDis above which a father is fake; 0 turns the absolute test off.", ours="V46 gives no threshold",
        low=0, high=1e5)
    fake_father_min_children: int = param(3, "count", "Fathers with fewer children are never fake.",
        paper="V46: more than two children", low=1, high=1000)
    fake_father_coverage: float = param(0.5, "1",
        "A father is not fake where its children cover a smaller share of its area.",
        ours="StdDis alone would destroy a large roof with small parts far apart on it (A7)", low=0, high=1)


@dataclass(frozen=True, slots=True)
class GranulometryParams:
    """Finding the scales in the image itself, when none are given (V8)."""

    smallest_m2: float = param(20.0, "m2", "Smaller sizes are trees and noise, and give no scale.",
        ours="a garage; only the fixed default scales begin lower, at 10 m2", low=0.01, high=1e6)
    largest_m2: float = param(10_000.0, "m2", "Larger sizes give no scale.",
        ours="larger than most halls; beyond are blocks joined by trees", low=0.02, high=1e7)
    most: int = param(6, "count",
        "Largest number of scales: the finest, the coarsest and the highest peaks of the spectrum between.",
        ours="one more than the paper's five (V53)", low=2, high=50)
    extreme_share: float = param(0.05, "1",
        "Share of the built cells of sizes below the finest scale, and of sizes above the coarsest.",
        ours="the paper takes the smallest and the biggest building, which one stray cell could set", low=0, high=0.49)
    peak_share: float = param(0.02, "1",
        "Share of the built cells that a bin of the smoothed spectrum must hold to be a peak.",
        ours="lower peaks are single buildings", low=0, high=1)


@dataclass(frozen=True, slots=True)
class FuseParams:
    """The decision of all detectors on which cells are building."""

    votes: bool = param(True, "-", "Let three or more detectors decide by votes which cells are building.",
        ours="half of three or four are right more often than the best one; otherwise multiscale decides")
    edge_cost: float = param(0.5, "votes", "λ: cost of an edge of a building between cells of equal height.",
        ours="0.25 to 1 differ little; 0 lets each cell decide by itself", low=0, high=100)
    edge_height_m: float = param(1.0, "m", "τ: step of height over which the cost of an edge falls by a factor e.",
        ours="a third of a storey; 0.5 m differs little", low=0.01, high=100)
    piece_m2: float = param(10.0, "m2",
        "Least area of a building: smaller holes are filled, pieces dropped, and dropped regions only counted.",
        ours="the finest scale", low=0, high=1e4)
    smooth_m: float = param(0.06, "m", "Roughness up to which a cell is smooth; grows with cells above 1 m.",
        ours="1.5 times a scanner's range noise; 0.05 to 0.08 m do alike", low=0.001, high=5)
    flush_m: float = param(0.3, "m", "Neighbouring cells are flush, of one roof, up to this step of height.",
        ours="less than a parapet or an eave over a lower roof; 0.2 and 0.5 m do alike", low=0, high=10)
    flush_share: float = param(0.2, "1",
        "A smooth region belongs to a building if this share of its edge is flush with it.",
        ours="less than one side of a square; 0.1 does alike, 0.3 loses blocks of glass", low=0, high=1)
    support_even: float = param(0.51, "1", "s₀: mean share that the detectors cover of 50 m² of even odds.",
        ours="fitted to 2405 objects of seven places; 0.49 to 0.53 with any of them left out", low=0, high=1)
    support_slope: float = param(9.6, "1", "k: log-odds of a building by its mean share beyond s₀.",
        ours="fitted to 2405 objects of seven places; 9.0 to 10.3 with any of them left out", low=0, high=1000)
    area_slope: float = param(0.74, "1", "a: log-odds of a building by a factor e of its area beyond 50 m².",
        ours="fitted to 2405 objects of seven places; 0.48 to 1.05 with any of them left out", low=0, high=100)
    area_power: float = param(0.0, "1", "q: the area counts as the mean share to this power.",
        ours="0: of points the area counts in full, as it was fitted", low=0, high=10)
    raster_even: float = param(0.66, "1", "s₀ of rasters of heights in cells of 0.5 m.",
        ours=RASTERS + "; 0.53 to 0.71 with any of them left out", low=0, high=1)
    raster_slope: float = param(6.3, "1", "k of rasters of heights.",
        ours=RASTERS + "; 5.9 to 8.1 with any of them left out", low=0, high=1000)
    raster_area_slope: float = param(2.4, "1", "a of rasters of heights.",
        ours=RASTERS + "; 2.0 to 3.0 with any of them left out", low=0, high=100)
    raster_area_power: float = param(2.0, "1", "q of rasters of heights.",
        ours="stands of trees are large, too, but few detectors take them; 0 and 1 decide fewer objects",
        low=0, high=10)
    raster_cell: float = param(0.16, "1", "s₀ rises so much each time that the cells of a raster are twice as wide.",
        ours=RASTERS + "; 0.13 to 0.19 with any of them left out", low=0, high=1)
    sure: float = param(0.95, "1", "p₁: probability from which a building is confirmed; up to 1 - p₁ it is refuted.",
        ours="98 of 100 confirmed objects are true, and 98 of 100 refuted ones false, on places left out of the fit",
        low=0.5, high=1)

    def of_rasters(self, cell_m: float) -> "FuseParams":
        """Return the values for a source without points, in cells of this side, metres."""
        return replace(
            self,
            support_even=self.raster_even + self.raster_cell * math.log2(cell_m / 0.5),
            support_slope=self.raster_slope,
            area_slope=self.raster_area_slope,
            area_power=self.raster_area_power,
        )


@dataclass(frozen=True, slots=True)
class HeightParams:
    """Ground, eaves, ridge and storeys of buildings; no paper gives them."""

    wall_m: float = param(1.0, "m", "A step between neighbouring cells larger than those beside it by this is a wall.",
        ours="dormers and parapets step less, storeys more", low=0.1, high=20)
    wall_slope: float = param(2.0, "m/m", "A step above wall_m that is steeper than this is a wall in any case.",
        ours="roofs of 63 degrees rise as much", low=0, high=10)
    roof_m2: float = param(50.0, "m2", "A roof of this area has weight in the heights of its building.",
        ours="a small house; lift houses are smaller", low=0, high=1e4)
    roof_share: float = param(0.1, "1", "So has a smaller one of this share of its building, from least_roof_m2 on.",
        ours="an annex or a tower is more, a dormer less", low=0, high=1)
    least_roof_m2: float = param(10.0, "m2", "Least area of a roof of weight, unless all are smaller.",
        ours="the finest scale; chimneys and crowns over roofs are smaller", low=0, high=1e4)
    eaves_share: float = param(0.2, "1", "Share of a roof's rim that lies below its eaves.",
        ours="verges and gables take up to two thirds of a rim, one low side of a shed roof a fifth or more",
        low=0, high=1)
    ridge_share: float = param(0.98, "1", "Share of a roof that lies below its ridge.",
        ours="chimneys and antennas take a hundredth of a roof", low=0.5, high=1)
    ring_m: float = param(2.0, "m", "Width of the ring around a building; two cells at least.",
        ours="a pavement or a narrow garden, before the next building or terrace", low=0.1, high=50)
    far_ring_m: float = param(10.0, "m", "Ground as far as this counts where the ring shows too little.",
        ours="a street's width", low=0.1, high=200)
    bare_m: float = param(0.3, "m", "Ground is seen where the surface is this near to the terrain.",
        ours="kerbs and grass are lower, cars and hedges higher", low=0.01, high=5)
    ground_cells: int = param(8, "cells", "Fewer cells of seen ground are too little.",
        ours="the corners of a house", low=1, high=1000)
    ground_tail: float = param(0.05, "1", "Share of the ground below its lowest and above its highest level.",
        ours="steps, light wells and flower beds", low=0, high=0.49)
    low_storey_m: float = param(2.5, "m", "Lowest plausible storey, floor to floor.",
        ours="2.2 to 2.4 m of room and a floor", low=1.5, high=10)
    tall_storey_m: float = param(4.0, "m", "Tallest plausible storey, floor to floor.",
        ours="old town houses and offices; halls have no storeys", low=1.5, high=20)
    roof_build_m: float = param(1.0, "m", "Plinth, roof structure and parapet within the height of the eaves, at most.",
        ours="half a metre below the first floor, and as much above the last", low=0, high=5)


@dataclass(frozen=True, slots=True)
class TouchingParams:
    """The division of touching houses; no paper gives a value."""

    divide: bool = param(True, "-", "Divide touching houses where their roofs show a reason.",
        ours="a row of houses is several buildings; parcels that are given divide in any case")
    step_m: float = param(1.0, "m", "Jump of height from which on a cell shows a step.",
        ours="above what tiles, gutters and sparse points make; 0.7 to 1.6 do alike", low=0.1, high=50)
    valley_m: float = param(0.3, "m", "Depth below both roofs from which on a cell shows a valley.",
        ours="a slope of 12 degrees on both sides", low=0.05, high=50)
    wall_m: float = param(0.25, "m", "Height above both roofs from which on a cell shows a wall.",
        ours="lower ones are ridge tiles and noise", low=0.05, high=50)
    core_m: float = param(1.3, "m", "Gaps in a line of evidence of up to twice this width are closed.",
        ours="less than half of the narrowest house", low=0.1, high=20)
    share: float = param(0.7, "1", "Share of a border that must have evidence.",
        ours="nearly the whole; chimneys and dormers interrupt it", low=0.05, high=1)
    level_m: float = param(1.5, "m", "Difference of the mean heights of two houses with a step between them.",
        ours="half a storey; the teeth of a saw-tooth roof have none", low=0, high=50)
    rise_m: float = param(0.3, "m", "Height by which both roofs rise above the upper end of the valley between them.",
        ours="wings that meet at a ridge do not", low=0, high=50)
    turn_deg: float = param(20.0, "deg", "Angle by which the directions of two houses differ, up to right angles.",
        ours="walls of one house are at right angles within a few degrees; 45 divides at no bend", low=1, high=45)
    contrast: float = param(0.25, "1",
        "Mean difference of ln intensity on both sides of a line across the ridge of a row that divides houses.",
        ours="28 %, above the noise of pulses; owners renew their roofs one by one", low=0.01, high=20)
    round_share: float = param(0.92, "1",
        "An island that has this share in common with an ellipse is one round structure, which no evidence divides.",
        ours="as a regular hexagon; a rectangle has 0.83, an octagon 0.96; 1.1 divides all", low=0.5, high=1.1)
    enclosed_share: float = param(0.75, "1",
        "A piece with this share of its outline beside one other stands on it or in it, and is no house of its own.",
        ours="stairs, towers and tiers; a house in a row has half at most", low=0.1, high=1.1)
    single_m2: float = param(300.0, "m2", "Islands up to this area are one house, unless their pieces are alike.",
        ours="a large single house with its garage; 0 divides all", low=0, high=1e5)
    alike_share: float = param(0.6, "1", "Least area of the smallest of alike pieces, of that of the largest.",
        ours="semi-detached houses are mirrored; a garage has half of its house at most", low=0, high=1)
    house_m2: float = param(30.0, "m2", "Smaller pieces are no house.", ours="the smallest houses of old towns",
        low=0, high=1e5)
    width_m: float = param(3.0, "m", "Narrower pieces are no house.", ours="the narrowest houses of old towns",
        low=0, high=100)
    parcel_m2: float = param(10.0, "m2", "Smaller pieces of a parcel are slivers.", ours="as fuse.piece_m2: a shed",
        low=0, high=1e5)
    parcel_width_m: float = param(2.0, "m", "Narrower pieces of a parcel are slivers.",
        ours="parcels lie up to a metre beside the walls", low=0, high=100)


@dataclass(frozen=True, slots=True)
class VectorParams:
    """From raster parts to polygons."""

    walls: str = param("fitted", "-",
        "Outlines of buildings and parts: fitted to straight walls, or traced along the cells and simplified.",
        ours="buildings have straight walls; where they do not, the fit keeps the traced arc",
        choices=("fitted", "traced"))
    court_m2: float = param(10.0, "m2", "Smaller holes of outlines are closed, and smaller loose pieces dropped.",
        ours="as fuse.piece_m2: smaller courts are light wells, which echoes do not separate from dark roofs",
        low=0, high=1e4)
    simplify_px: float = param(1.0, "cells",
        "Tolerance of the outlines' simplification, in cells; shared edges stay shared.", ours="V47 gives no tolerance",
        low=0, high=100)
    outline: str = param("alpha", "-",
        "Outline of regions of points: alpha shape or concave hull.",
        paper="S7, S1: alpha shape and Douglas-Peucker", choices=("alpha", "hull"))
    alpha_factor: float = param(2.0, "spacings", "1/alpha: triangles of a smaller circumradius belong to a region.",
        ours="S7 gives none; 1.5 leaves holes in thinned roofs, 3 fills corners and gaps between houses",
        low=0.5, high=1000)
    alpha_least_m: float = param(0.5, "m", "The same, at least.",
        ours="skylights and wet tiles leave larger gaps than the spacing of dense surveys", low=0, high=100)
    outline_simplify: float = param(0.5, "spacings", "Tolerance of Douglas-Peucker for outlines of points.",
        ours="S7 gives no tolerance", low=0, high=100)
    outline_grow: float = param(0.6, "spacings", "Distance by which alpha shapes and hulls grow.",
        ours="the last points of a roof lie inside of its edge; 0.5 to 0.75 do best on true points of roofs",
        low=0, high=10)
    residual_m2: float = param(4.0, "m2", "Smaller pieces and holes of an outline of points are removed.",
        paper="S7 removes small residuals by adjustable parameters, without values", low=0, high=1e6)


@dataclass(frozen=True, slots=True)
class ChangeParams:
    """What counts as change between two surveys; no paper gives a value."""

    thickness_m: float = param(1.0, "m",
        "Differences of two footprints count where a disc of this radius fits into them.",
        ours="outlines of two surveys of one roof differ by less than a metre to each side", low=0, high=20)
    least_m2: float = param(25.0, "m2", "Smaller differences of a footprint, or of its heights, are no change.",
        ours="half of the smallest change that must be found", low=0, high=1e6)
    rise_m: float = param(1.5, "m",
        "Change of the height above ground that makes a cell built, gone, raised or lowered.",
        ours="half a storey, far above the noise of two surveys", low=0.1, high=50)
    gone_share: float = param(0.7, "1", "A building is demolished when its heights are gone from this share of it.",
        ours="the rest is rubble, or a wall", low=0.1, high=1)
    surveyed_share: float = param(0.5, "1", "A building with a smaller share in the surveyed area is not surveyed.",
        ours="most of a building suffices to judge it", low=0, high=1)
    link_share: float = param(0.3, "1", "Two footprints are of one building when they share this much of the smaller.",
        ours="slivers between neighbours of a row are less", low=0, high=1)
    offset_pairs: int = param(5, "count", "Fewer pairs of equal buildings give no offset between surveys.",
        ours="a median of fewer is uncertain", low=1, high=10_000)


@dataclass(frozen=True, slots=True)
class EvaluateParams:
    """What counts as agreement with a reference; no section of a build."""

    cell_m: float = param(0.5, "m", "Cell of the grid on which areas are compared.",
        ours="fine against a wall's accuracy, and the grid of the published comparisons", low=0.01, high=100)
    overlap: float = param(0.5, "1", "An object is found when the other side covers this share of its area.",
        ours="V55 names no criterion; half is customary", low=0.01, high=1)
    large_m2: float = param(50.0, "m2", "Objects of at least this area are also scored apart.", paper="X1",
        low=0, high=1e6)
    step_m: float = param(0.5, "m", "Largest distance between two samples on an outline.", ours="as the cell",
        low=0.01, high=100)
    cap_m: float = param(3.0, "m",
        "Samples farther than this from the other outline are counted, but do not enter its RMS.",
        ours="as the ISPRS benchmark on urban object detection", low=0, high=1e3)
    max_gap_m: float = param(1.0, "m",
        "For objects, a cell without first echo takes the class of the nearest cell with one, this near.",
        ours="the spacing of a sparse survey; areas are compared only in cells with a first echo", low=0, high=100)
    min_object_m2: float = param(2.0, "m2", "Smaller components of reference points count by area, but are no objects.",
        ours="less is noise of the classification", low=0, high=1e6)

    def __post_init__(self) -> None:
        """Refuse values out of bounds."""
        for item in fields(self):
            checked_value("evaluate", item, getattr(self, item.name))
