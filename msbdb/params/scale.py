"""Parameters of the scale-space, the tree of parts, and of finding the scales."""

from dataclasses import dataclass

from msbdb.params.declare import param


@dataclass(frozen=True, slots=True)
class ScaleParams:
    """The area open-close scale-space and the tree of parts."""

    scales_m2: tuple[float, ...] = param(
        (10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0, 5000.0),
        unit="m2",
        low=0.0,
        high=1e7,
        source="V53: 50, 100, 200, 500, 1000; ours: 10 and 20 for denser surveys, 2000 and 5000 for halls",
        doc="Area thresholds s of the scale-space, ascending; empty finds them by granulometry (V8).",
    )
    connectivity: int = param(
        8,
        unit="-",
        low=4,
        high=8,
        source="ours: V10 states none; 8 keeps islands independent (V12)",
        doc="Neighbourhood of openings, closings and flat zones alike: 4 or 8.",
    )
    duplicate_share: float = param(
        0.85,
        unit="1",
        low=0.5,
        high=1.0,
        source="V28: 0.9 or 0.85",
        doc="A finer cluster of at least this share of its coarser one's area is its duplicate.",
    )
    keep_courtyards: bool = param(
        True,
        unit="-",
        source="ours: closing at coarse scales covers courtyards that the finest scale shows as ground",
        doc="Cut every cluster of every scale to the cells that are above ground on the finest scale.",
    )
    merge_slivers: bool = param(
        True,
        unit="-",
        source="ours: an opening leaves the narrow zones between ground and roof; V7 wants objects of at least s",
        doc="Give flat zones smaller than the finest scale to their larger neighbours before clusters are formed.",
    )
    fake_father_ratio: float = param(
        0.4,
        unit="1",
        low=0.0,
        high=10.0,
        source="ours: V46 gives no threshold; by A7: a row of 3 to 5 squares gives 0.44 to 0.59, a disc 0.24",
        doc="A father whose StdDis over sqrt(area/pi) exceeds this is fake.",
    )
    fake_father_m: float = param(
        0.0,
        unit="m",
        low=0.0,
        high=1e5,
        source="ours: V46 gives no threshold",
        doc="Absolute StdDis above which a father is fake; 0 turns the absolute test off.",
    )
    fake_father_min_children: int = param(
        3,
        unit="count",
        low=1,
        high=1000,
        source="V46: more than two children",
        doc="Fathers with fewer children are never fake.",
    )
    fake_father_coverage: float = param(
        0.5,
        unit="1",
        low=0.0,
        high=1.0,
        source="ours: StdDis alone would destroy a large roof with small parts far apart on it (A7)",
        doc="A father of whose area the children cover a smaller share is not fake.",
    )


@dataclass(frozen=True, slots=True)
class GranulometryParams:
    """Finding the scales in the image itself, when none are given (V8)."""

    smallest_m2: float = param(
        20.0,
        unit="m2",
        low=0.01,
        high=1e6,
        source="ours: the finest of the default scales",
        doc="Sizes below this are trees and noise, and give no scale.",
    )
    largest_m2: float = param(
        10_000.0,
        unit="m2",
        low=0.02,
        high=1e7,
        source="ours: larger than most halls; what is larger are blocks joined by trees",
        doc="Sizes above this give no scale.",
    )
    most: int = param(
        6,
        unit="count",
        low=2,
        high=50,
        source="ours: as many as the default scales",
        doc="Largest number of scales: the finest, the coarsest and the highest peaks of the spectrum between.",
    )
    extreme_share: float = param(
        0.05,
        unit="1",
        low=0.0,
        high=0.49,
        source="ours: the paper takes the smallest and the biggest building, which one stray cell could set",
        doc="Share of the built cells of sizes below the finest scale, and of sizes above the coarsest.",
    )
    peak_share: float = param(
        0.02,
        unit="1",
        low=0.0,
        high=1.0,
        source="ours: lower peaks are single buildings",
        doc="Share of the built cells that a bin of the smoothed spectrum must hold to be a peak.",
    )
