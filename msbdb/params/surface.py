"""Parameters of the surfaces: DSM, DTM and nDSM."""

from dataclasses import dataclass

from msbdb.params.declare import param


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
