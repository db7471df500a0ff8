"""Parameters of the outlines."""

from dataclasses import dataclass

from msbdb.params.declare import param


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
    outline: str = param(
        "alpha",
        unit="-",
        choices=("alpha", "hull"),
        source="S7, S1: alpha shape and Douglas-Peucker",
        doc="Outline of regions of points: alpha shape or concave hull.",
    )
    alpha_factor: float = param(
        2.0,
        unit="spacings",
        low=0.5,
        high=1000.0,
        source="ours: S7 gives none; 1.5 leaves holes in thinned roofs, 3 fills corners and gaps between houses",
        doc="1/alpha: triangles of a smaller circumradius belong to a region.",
    )
    alpha_least_m: float = param(
        0.5,
        unit="m",
        low=0.0,
        high=100.0,
        source="ours: skylights and wet tiles leave larger gaps than the spacing of dense surveys",
        doc="The same, at least.",
    )
    outline_simplify: float = param(
        0.5,
        unit="spacings",
        low=0.0,
        high=100.0,
        source="ours: S7 gives no tolerance",
        doc="Tolerance of Douglas-Peucker for outlines of points.",
    )
    outline_grow: float = param(
        0.6,
        unit="spacings",
        low=0.0,
        high=10.0,
        source="ours: the last points of a roof lie inside of its edge; 0.5 to 0.75 do best on true points of roofs",
        doc="By how much alpha shapes and hulls grow.",
    )
    residual_m2: float = param(
        4.0,
        unit="m2",
        low=0.0,
        high=1e6,
        source="S7 removes small residuals by adjustable parameters, without values",
        doc="Smaller pieces and holes of an outline of points are left out.",
    )
