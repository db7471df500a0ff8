"""The parameters of an evaluation, declared as those of a build are."""

from dataclasses import dataclass, fields

from msbdb.errors import ParameterError
from msbdb.params import param


@dataclass(frozen=True, slots=True)
class EvaluateParams:
    """What counts as agreement."""

    cell_m: float = param(
        0.5,
        unit="m",
        low=0.01,
        high=100.0,
        source="ours: fine against a wall's accuracy, and the grid of the published comparisons",
        doc="Cell of the grid on which areas are compared.",
    )
    overlap: float = param(
        0.5,
        unit="1",
        low=0.01,
        high=1.0,
        source="ours: V55 names no criterion; half is customary",
        doc="Share of an object's area that the other side must cover for it to count as found.",
    )
    large_m2: float = param(
        50.0,
        unit="m2",
        low=0.0,
        high=1e6,
        source="X1",
        doc="Objects of at least this area are also scored apart.",
    )
    step_m: float = param(
        0.5,
        unit="m",
        low=0.01,
        high=100.0,
        source="ours: as the cell",
        doc="Largest distance between two samples on an outline.",
    )
    cap_m: float = param(
        3.0,
        unit="m",
        low=0.0,
        high=1e3,
        source="ours: as the ISPRS benchmark on urban object detection",
        doc="Samples farther than this from the other outline are left out of its RMS, and counted.",
    )
    max_gap_m: float = param(
        1.0,
        unit="m",
        low=0.0,
        high=100.0,
        source="ours: the spacing of a sparse survey",
        doc="For the objects, cells without a first echo take the class of the nearest cell with one within this "
        "distance; areas are compared only in cells that hold one.",
    )
    min_object_m2: float = param(
        2.0,
        unit="m2",
        low=0.0,
        high=1e6,
        source="ours: less is noise of the classification",
        doc="Smaller components of reference points count by area, but are no objects.",
    )

    def __post_init__(self) -> None:
        """Refuse values out of bounds."""
        for item in fields(self):
            low, high = item.metadata["low"], item.metadata["high"]
            if not low <= getattr(self, item.name) <= high:
                msg = (
                    f"evaluate.{item.name} must lie between {low} and {high} {item.metadata['unit']}; "
                    f"got {getattr(self, item.name)!r}."
                )
                raise ParameterError(msg)
