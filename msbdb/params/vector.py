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
