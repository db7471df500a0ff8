"""Parameters of the footprints of parts and flat regions together."""

from dataclasses import dataclass

from msbdb.params.declare import param


@dataclass(frozen=True, slots=True)
class FuseParams:
    """What decides of a piece that only one of the two systems found."""

    edge_m: float = param(
        0.5,
        unit="m",
        low=0.0,
        high=20.0,
        source="ours: narrower costs a true roof on Delft 2, wider the light wells of Delft 1",
        doc="Disputed strips up to twice as wide are edges, on which the parts' word stands; at least a cell.",
    )
    smooth_m: float = param(
        0.06,
        unit="m",
        low=0.001,
        high=5.0,
        source="ours: a scanner's range noise and a half; 0.05 to 0.08 m do alike, 0.04 m costs a true roof on Delft 2",
        doc="Median roughness up to which a piece is a roof by itself; grows with cells above 1 m.",
    )
    roof_share: float = param(
        0.55,
        unit="1",
        low=0.0,
        high=1.0,
        source="ours: a little more than the even odds of the cover; 0.55 to 0.6 do alike",
        doc="Mean probability of roof from which a piece is one by its echoes and texture.",
    )
    seen_share: float = param(
        2 / 3,
        unit="1",
        low=0.0,
        high=1.0,
        source="ours: most of the roof; below it the flat regions see too little for their silence to tell anything",
        doc="Share of a building that flat regions must cover so that a piece they leave out is in doubt.",
    )
