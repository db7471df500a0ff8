"""Every parameter of msbdb, declared once: the command line, the docs and the run table derive from here.

A stage has one frozen dataclass. Each field carries its unit, bounds, meaning and provenance: the paper's
requirement number where a paper gives the value, or ``ours`` with the reason. A profile is a set of other values.
"""

import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, Field, asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from msbdb.errors import FileError, ParameterError


def param(
    default: Any,  # noqa: ANN401  (a parameter may be of any plain type)
    *,
    unit: str,
    doc: str,
    source: str,
    low: float | None = None,
    high: float | None = None,
    choices: tuple[str, ...] | None = None,
) -> Any:  # noqa: ANN401
    """Declare a parameter: its default, unit, bounds or choices, meaning and where the value comes from."""
    metadata = {"unit": unit, "doc": doc, "source": source, "low": low, "high": high, "choices": choices}
    return field(default=default, metadata=metadata)


@dataclass(frozen=True, slots=True)
class SurfaceParams:
    """From points to DSM, DTM and nDSM."""

    cell_m: float = param(
        0.0,
        unit="m",
        low=0.0,
        high=50.0,
        source="V14: mean point spacing, 1/sqrt(density)",
        doc="Cell size; 0 takes the mean spacing of the first echoes, snapped to a ladder of round values.",
    )
    max_gap_m: float = param(
        1.0,
        unit="m",
        low=0.0,
        high=1000.0,
        source="ours: water and canals stay open, however far a crown leans over them",
        doc="Empty cells this near to a measured one, or within two cells, take its value; farther ones stay invalid.",
    )
    mask_m: float = param(
        2.0,
        unit="m",
        low=0.1,
        high=20.0,
        source="V17",
        doc="Cells of the nDSM below this height are no part of any building.",
    )
    slicing: str = param(
        "storey",
        unit="-",
        choices=("storey", "step"),
        source="V18, V19",
        doc="Slice the heights by storeys, or by a metric step.",
    )
    storey_m: float = param(
        3.0,
        unit="m",
        low=1.5,
        high=10.0,
        source="V18: 2 to 3 m",
        doc="Height of a storey.",
    )
    step_m: float = param(
        1.0,
        unit="m",
        low=0.05,
        high=50.0,
        source="ours: V19 gives no step",
        doc="Height of a slice when slicing is 'step'.",
    )


@dataclass(frozen=True, slots=True)
class GroundParams:
    """Telling ground from off-ground."""

    ground_filter: str = param(
        "auto",
        unit="-",
        choices=("auto", "class2", "progressive", "wavelet"),
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


@dataclass(frozen=True, slots=True)
class CoverParams:
    """Telling roofs from vegetation by texture and echoes; all calibrated together on the tiles at hand."""

    window_m: float = param(
        1.5,
        unit="m",
        low=0.5,
        high=20.0,
        source="ours: smaller than the narrowest roof plane",
        doc="Small window of the texture.",
    )
    wide_window_m: float = param(
        2.5, unit="m", low=0.5, high=20.0, source="ours: enough echoes for a share", doc="Wide window of the texture."
    )
    split_weight: float = param(
        8.0,
        unit="1",
        low=0.0,
        high=100.0,
        source="ours: calibrated together, on four surveys and thinned copies",
        doc="Log-odds a share of split first echoes, small window.",
    )
    split_wide_weight: float = param(
        3.5,
        unit="1",
        low=0.0,
        high=100.0,
        source="ours: calibrated together, on four surveys and thinned copies",
        doc="Log-odds a share of split first echoes, wide window.",
    )
    solid_weight: float = param(
        2.0,
        unit="1",
        low=0.0,
        high=100.0,
        source="ours: calibrated together, on four surveys and thinned copies",
        doc="Log-odds a share of last echoes that stop near the surface.",
    )
    echo_rough_weight: float = param(
        0.15,
        unit="1",
        low=0.0,
        high=100.0,
        source="ours: calibrated together, on four surveys and thinned copies",
        doc="Log-odds a factor e of roughness, beside the echoes.",
    )
    echo_bias: float = param(
        -1.2,
        unit="1",
        low=-50.0,
        high=50.0,
        source="ours: calibrated together, on four surveys and thinned copies",
        doc="Log-odds without any evidence.",
    )
    rough_weight: float = param(
        1.5,
        unit="1",
        low=0.0,
        high=100.0,
        source="ours: calibrated together, on four surveys and thinned copies",
        doc="Log-odds a factor e of roughness, without echoes.",
    )
    rough_m: float = param(
        0.25,
        unit="m",
        low=0.01,
        high=10.0,
        source="ours: calibrated together, on four surveys and thinned copies",
        doc="Roughness in the small window that tells nothing.",
    )
    rough_wide_m: float = param(
        0.35,
        unit="m",
        low=0.01,
        high=10.0,
        source="ours: calibrated together, on four surveys and thinned copies",
        doc="Roughness in the wide window that tells nothing.",
    )
    smooth_floor_m: float = param(
        0.02,
        unit="m",
        low=0.001,
        high=1.0,
        source="ours: the range noise of a scanner",
        doc="Least roughness that is told.",
    )
    smooth_m: float = param(
        2.0,
        unit="m",
        low=0.0,
        high=20.0,
        source="ours: calibrated together, on four surveys and thinned copies",
        doc="Sigma of the smoothing of the odds.",
    )
    neck_m: float = param(
        1.2, unit="m", low=0.0, high=20.0, source="ours: hedges and walls are thinner", doc="Thinner roofs are cut."
    )
    blind_neck_m: float = param(
        2.0,
        unit="m",
        low=0.0,
        high=20.0,
        source="ours: roughness alone mistakes more crowns",
        doc="The same, without echoes.",
    )
    hole_m2: float = param(
        20.0,
        unit="m2",
        low=0.0,
        high=1e4,
        source="ours: the finest scale",
        doc="Smaller holes of a roof, above the mask, are filled.",
    )
    min_roof_m2: float = param(
        10.0, unit="m2", low=0.0, high=1e4, source="ours: the finest scale", doc="Smaller regions are no roof."
    )
    smooth_m_limit: float = param(
        0.12,
        unit="m",
        low=0.01,
        high=5.0,
        source="ours: three times a scanner's range noise",
        doc="Cells below it are smooth.",
    )
    min_smooth_share: float = param(
        0.3,
        unit="1",
        low=0.0,
        high=1.0,
        source="ours: calibrated together, on four surveys and thinned copies",
        doc="Least smooth share of a roof, without echoes.",
    )
    smooth_per_split: float = param(
        3.0,
        unit="1",
        low=0.0,
        high=100.0,
        source="ours: calibrated together, on four surveys and thinned copies",
        doc="Smooth share that a roof needs a share of split echoes.",
    )
    free_split_share: float = param(
        0.05,
        unit="1",
        low=0.0,
        high=1.0,
        source="ours: what edges and chimneys split",
        doc="Split share that needs no smooth cells.",
    )
    green_share: float = param(
        0.6,
        unit="1",
        low=0.0,
        high=1.0,
        source="ours: crowns of Nîmes that stop every pulse are 90 % green, its roofs at most 20 %",
        doc="Regions with this share of vegetation's colour are vegetation unless they are smooth.",
    )
    green_smooth_share: float = param(
        0.7,
        unit="1",
        low=0.0,
        high=1.0,
        source="ours: crowns reach 60 % of smooth cells, flat and pitched roofs have 70 to 90 %",
        doc="Share of smooth cells from which a green region is a green roof.",
    )
    grow_m: float = param(
        1.0,
        unit="m",
        low=0.0,
        high=20.0,
        source="ours: calibrated together, on four surveys and thinned copies",
        doc="Width of the edge that is given back to roofs.",
    )
    grow_step_m: float = param(
        1.0,
        unit="m",
        low=0.0,
        high=20.0,
        source="ours: calibrated together, on four surveys and thinned copies",
        doc="Largest step in height to a cell that is given back.",
    )


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


@dataclass(frozen=True, slots=True)
class SpectralParams:
    """Classes of land cover, and what they remove."""

    classes: int = param(15, unit="count", low=2, high=250, source="V35", doc="K of k-means.")
    seed: int = param(0, unit="-", low=0, high=2**31 - 1, source="ours: the paper states none", doc="Seed of k-means.")
    sample: int = param(
        100_000,
        unit="count",
        low=100,
        high=10_000_000,
        source="ours: centres from a sample are as good and cost a fixed time",
        doc="Cells on which k-means is fitted.",
    )
    filter_share: float = param(
        0.8,
        unit="1",
        low=0.0,
        high=1.0,
        source="V34: 'a bit smaller than the smallest building'",
        doc="Area of the bands' open-close filter as a share of the finest scale.",
    )
    tail_percent: float = param(
        2.0,
        unit="%",
        low=0.0,
        high=40.0,
        source="ours: V21, the paper states no normalisation; a glint must not squeeze all other values together",
        doc="Percentile of each band that becomes 0; that of 100 less it becomes 1.",
    )
    vegetation_index: str = param(
        "auto",
        unit="-",
        choices=("auto", "ndvi", "pseudo-ndvi", "green-red"),
        source="V20, V36; ours: on real surveys green-red tells crowns from roofs far better than pulse intensity",
        doc="Evidence of leaves; 'auto' takes NDVI where near infrared exists, else green-red, else pseudo-NDVI.",
    )
    ndvi_bounds: tuple[float, ...] = param(
        (0.0, 0.2),
        unit="1",
        low=-1.0,
        high=1.0,
        source="ours: roofs lie below the first in every orthophoto seen, lit crowns above the second",
        doc="Lowest and highest threshold of NDVI; Otsu's method finds the value between them.",
    )
    green_red_bounds: tuple[float, ...] = param(
        (0.0, 0.1),
        unit="1",
        low=-1.0,
        high=1.0,
        source="ours: as for NDVI, wide enough for the colour balance of different cameras",
        doc="Lowest and highest threshold of (green - red) / (green + red).",
    )
    pseudo_ndvi_bounds: tuple[float, ...] = param(
        (0.0, 0.4),
        unit="1",
        low=-1.0,
        high=1.0,
        source="ours: the index of the scaled bands spreads about twice as wide as NDVI",
        doc="Lowest and highest threshold of the index of intensity and red, both scaled to 0 to 1.",
    )
    smooth_m: float = param(
        0.05,
        unit="m",
        low=0.0,
        high=10.0,
        source="ours: plain roofs show 0.003 to 0.05 m on real surveys, hedges and crowns 0.06 to 3 m",
        doc="A green class smoother than this is a planted roof, not a crown.",
    )
    rough_m: float = param(
        0.5,
        unit="m",
        low=0.0,
        high=100.0,
        source="ours: the roughest roof classes seen show 0.4 to 0.46 m, at cells of 0.5 and 1 m",
        doc="Roughness of a sure crown: at it the index may lie farthest below its threshold.",
    )
    leafless_share: float = param(
        0.5,
        unit="1",
        low=0.0,
        high=2.0,
        source="ours: crowns that are bare or in shadow lie a little below the threshold on real surveys",
        doc="From smooth_m to rough_m, the index a crown needs falls by this share of the width of its bounds.",
    )
    clutter_m: float = param(
        1.0,
        unit="m",
        low=0.0,
        high=100.0,
        source="ours: twice the roughest roof class seen",
        doc="A class rougher than this that is not green enough for a crown is neither: masts, cranes, fences.",
    )
    shadow_brightness: float = param(
        0.15,
        unit="1",
        low=0.0,
        high=1.0,
        source="ours: V36 leaves it to the operator; smooth dark classes are roofs in shadow or dark roofs (V43)",
        doc="A class darker than this is shadow, unless it is known to be smoother than rough_m.",
    )
    water_ndvi: float = param(
        -0.3,
        unit="1",
        low=-1.0,
        high=1.0,
        source="ours: roofs lie above, open water below",
        doc="A smooth class whose NDVI is below this is water; needs a near-infrared band.",
    )
    decides: str = param(
        "structure",
        unit="-",
        choices=("structure", "spectral"),
        source="ours: echoes and texture tell crowns better",
        doc="What tells roofs from vegetation where there is imagery: structure, or colours alone (V36 to V41).",
    )
    min_building_share: float = param(
        0.3,
        unit="1",
        low=0.0,
        high=1.0,
        source="ours: V41 removes at no pixel at all, which is lax (V43)",
        doc="A part with a smaller share of building classes is removed.",
    )
    split_share: float = param(
        0.0,
        unit="1",
        low=0.0,
        high=0.5,
        source="V44: 0.4, as the vu2009 profile; ours: 15 classes of fewer materials differ by noise, and cut roofs",
        doc="A part is split when its second class reaches this share; 0 never splits.",
    )


@dataclass(frozen=True, slots=True)
class FlatRegionParams:
    """Flat regions by differential morphological and attribute profiles."""

    on: str = param(
        "ndsm",
        unit="-",
        choices=("ndsm", "surface"),
        source="M27: the paper itself recommends a ground filter against plateaus",
        doc="Seek flat regions on heights above ground, or on the raw surface as the paper does.",
    )
    s_max_m: float = param(
        1.5,
        unit="m",
        low=0.0,
        high=50.0,
        source="M11 gives 3.0; ours: that takes narrow roofs and corners with it, 1 to 2 m do as well against crowns",
        doc="S_I: largest window of the profile that finds outliers.",
    )
    valley_factor: float = param(
        0.0,
        unit="cells",
        low=0.0,
        high=100.0,
        source="M10 gives 2; ours: where one or two pulses hit a cell, valleys are what tells a crown from a roof",
        doc="A valley this many times R_g deep is an outlier; 0 keeps valleys.",
    )
    peak_factor: float = param(
        2.0,
        unit="cells",
        low=0.0,
        high=100.0,
        source="M10 gives 4 to spare roofs, with windows twice as wide; ours: crowns lose their tips",
        doc="The same for peaks; 0 keeps peaks.",
    )
    gradients: str = param(
        "initial",
        unit="-",
        choices=("initial", "denoised"),
        source="ours: what denoising smooths over is what tells crowns; M13 takes the denoised surface",
        doc="The surface of which the gradients are summed.",
    )
    gradient_window_m: float = param(
        0.9,
        unit="m",
        low=0.0,
        high=20.0,
        source="ours: M13 states none; as wide at any cell, so that gradients compare; 1.2 m loses roofs",
        doc="Window of the gradients, at least 3 cells.",
    )
    gradient_cap_m: float = param(
        1.5,
        unit="m",
        low=0.0,
        high=1000.0,
        source="ours: half a storey; without a cap the foot of a tower makes its podium rough",
        doc="A gradient counts as no more than this; 0 sets no cap, which the raw surface needs.",
    )
    lambda_min_m2: float = param(
        20.0, unit="m2", low=0.0, high=1e6, source="M23: 30, 20, 20", doc="λ_min: sum of gradients of the first zone."
    )
    lambda_max_m2: float = param(
        40_000.0, unit="m2", low=0.0, high=1e9, source="M23: 40000", doc="λ_max: sum of gradients of the last zone."
    )
    lambda_step_m2: float = param(
        20.0,
        unit="m2",
        low=0.0,
        high=1e6,
        source="M23 gives 250, 500, 300, against plateaus; ours: heights above ground have none, and small roofs gain",
        doc="λ_Δ: width of a zone.",
    )
    ratio: float = param(
        2.0,
        unit="1/m",
        low=0.0,
        high=100.0,
        source="M17, M23 give 1.5; ours: with capped gradients 1.9 to 2.2 do best",
        doc="R: a flat region has at least R times its zone's upper λ of area.",
    )
    largest_m2: float = param(
        50_000.0,
        unit="m2",
        low=0.0,
        high=1e9,
        source="ours: λ_max alone takes all the ground of a tile of a few hectares for one building",
        doc="Larger flat regions are terrain; 0 sets no limit.",
    )
    opening_m: float = param(
        1.5,
        unit="m",
        low=0.0,
        high=50.0,
        source="M19 gives 3; ours: that cuts roofs of 3 m and all that trees indent",
        doc="Window of the opening and closing of flat regions.",
    )
    max_compactness: float = param(
        30.0,
        unit="1",
        low=1.0,
        high=1e6,
        source="M20, M23 give 9, 11, 10.5; ours: connected blocks of an old town reach 18, and 30 is 93 to 1",
        doc="ψ: regions of this P²/(4πA) or more are too long and thin.",
    )
    grow_m: float = param(
        0.9,
        unit="m",
        low=0.0,
        high=20.0,
        source="ours: lowest points lie beside or below a roof in the cells of its edge",
        doc="Width of the edge that is given back to regions on heights above ground.",
    )
    grow_step_m: float = param(
        1.0,
        unit="m",
        low=0.0,
        high=20.0,
        source="ours: as for the cover; 0.3 to 2 m differ little",
        doc="Largest step in height to a cell that is given back.",
    )


@dataclass(frozen=True, slots=True)
class VectorParams:
    """From raster parts to polygons."""

    simplify_px: float = param(
        1.0,
        unit="cells",
        low=0.0,
        high=100.0,
        source="ours: V47 gives no tolerance",
        doc="Tolerance of the outlines' simplification, in cells; shared edges stay shared.",
    )


@dataclass(frozen=True, slots=True)
class Params:
    """All parameters of a build, a section a stage."""

    surface: SurfaceParams = field(default_factory=SurfaceParams)
    ground: GroundParams = field(default_factory=GroundParams)
    cover: CoverParams = field(default_factory=CoverParams)
    scale: ScaleParams = field(default_factory=ScaleParams)
    granulometry: GranulometryParams = field(default_factory=GranulometryParams)
    spectral: SpectralParams = field(default_factory=SpectralParams)
    flatregions: FlatRegionParams = field(default_factory=FlatRegionParams)
    vector: VectorParams = field(default_factory=VectorParams)


MONGUS: dict[str, Any] = {
    "on": "surface",
    "s_max_m": 3.0,
    "valley_factor": 2.0,
    "peak_factor": 4.0,
    "gradients": "denoised",
    "gradient_window_m": 0.0,
    "gradient_cap_m": 0.0,
    "lambda_min_m2": 30.0,
    "lambda_max_m2": 40_000.0,
    "lambda_step_m2": 250.0,
    "ratio": 1.5,
    "largest_m2": 0.0,
    "opening_m": 3.0,
    "max_compactness": 9.0,
    "grow_m": 0.0,
}
"""Mongus et al. 2013 as written, with Table 1's values of the data set DS1 (M23).

λ_max is made for square kilometres: where all the ground of a tile sums up to less, it is one flat region.
"""


PROFILES: dict[str, dict[str, dict[str, Any]]] = {
    "default": {},
    "vu2009": {
        "surface": {"cell_m": 1.0},
        "ground": {"ground_filter": "wavelet"},
        "scale": {
            "scales_m2": (50.0, 100.0, 200.0, 500.0, 1000.0),
            "keep_courtyards": False,
            "merge_slivers": False,
            "fake_father_coverage": 0.0,
        },
        "spectral": {"decides": "spectral", "split_share": 0.4},
    },
    "mongus2013": {"flatregions": MONGUS},
    "mongus2013-ds2": {
        "flatregions": {**MONGUS, "lambda_min_m2": 20.0, "lambda_step_m2": 500.0, "max_compactness": 11.0}
    },
    "mongus2013-ds3": {
        "flatregions": {**MONGUS, "lambda_min_m2": 20.0, "lambda_step_m2": 300.0, "max_compactness": 10.5}
    },
}
"""What each profile sets otherwise than the defaults."""


def sections(params: Params) -> Iterator[tuple[str, Any]]:
    """Yield each section's name and its dataclass."""
    for section in fields(params):
        yield section.name, getattr(params, section.name)


def as_dict(params: Params) -> dict[str, dict[str, Any]]:
    """Return all values as nested plain dictionaries, for TOML, JSON and the run table."""
    return asdict(params)


def with_values(params: Params, values: Mapping[str, Mapping[str, Any]]) -> Params:
    """Return the parameters with some values replaced, checked against their declarations.

    Raises
    ------
    ParameterError
        For an unknown section or name, a wrong type, or a value out of bounds.
    """
    known = dict(sections(params))
    changed = {}
    for section, pairs in values.items():
        if section not in known or not isinstance(pairs, Mapping):
            msg = f"There is no parameter section '{section}'; the sections are {', '.join(known)}."
            raise ParameterError(msg)
        declared = {f.name: f for f in fields(known[section])}
        for name in pairs:
            if name not in declared:
                msg = f"There is no parameter '{section}.{name}'; this section has {', '.join(declared)}."
                raise ParameterError(msg)
        checked = {name: _checked(section, declared[name], value) for name, value in pairs.items()}
        changed[section] = replace(known[section], **checked)
    return replace(params, **changed)


def profile(name: str = "default") -> Params:
    """Return the parameters of a named profile."""
    if name not in PROFILES:
        msg = f"There is no profile '{name}'; the profiles are {', '.join(PROFILES)}."
        raise ParameterError(msg)
    return with_values(Params(), PROFILES[name])


def read_params(path: Path, base: Params) -> Params:
    """Read a TOML file with a table a section over the base values.

    Raises
    ------
    FileError
        When the file cannot be read.
    ParameterError
        When it is no TOML, or sets what is not declared.
    """
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        msg = f"The parameter file {path} cannot be read: {error.strerror}."
        raise FileError(msg) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        msg = f"The parameter file {path} is no valid TOML: {error}."
        raise ParameterError(msg) from error
    return with_values(base, values)


def declared() -> Iterator[tuple[str, Field[Any], Any]]:
    """Yield section, field and default of every parameter, in order of the stages."""
    for section, values in sections(Params()):
        for item in fields(values):
            yield section, item, item.default if item.default is not MISSING else getattr(values, item.name)


def _checked(section: str, item: Field[Any], value: Any) -> Any:  # noqa: ANN401
    """Return the value in its declared type, or refuse it."""
    name = f"{section}.{item.name}"
    meta = item.metadata
    converted = _converted(name, type(item.default), value)
    if meta["choices"] and converted not in meta["choices"]:
        msg = f"{name} must be one of {', '.join(meta['choices'])}; got {value!r}."
        raise ParameterError(msg)
    numbers = converted if isinstance(converted, tuple) else (converted,)
    for number in numbers:
        too_low = meta["low"] is not None and not number >= meta["low"]
        too_high = meta["high"] is not None and not number <= meta["high"]
        if too_low or too_high:
            msg = f"{name} must lie between {meta['low']} and {meta['high']} {meta['unit']}; got {value!r}."
            raise ParameterError(msg)
    return converted


def _converted(name: str, kind: type, value: Any) -> Any:  # noqa: ANN401
    """Convert a plain TOML or JSON value to the type of the default."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if kind is float and is_number:
        return float(value)
    if kind is tuple and isinstance(value, list | tuple):
        return tuple(_converted(name, float, item) for item in value)
    if kind is int and is_number and value == int(value):
        return int(value)
    if kind in (bool, str) and isinstance(value, kind):
        return value
    msg = f"{name} must be of type {kind.__name__}; got {value!r}."
    raise ParameterError(msg)
