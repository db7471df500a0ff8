"""Parameters of the comparison of a survey with the inventory."""

from dataclasses import dataclass

from msbdb.params.declare import param


@dataclass(frozen=True, slots=True)
class ChangeParams:
    """What counts as change between two surveys; no paper gives a value."""

    thickness_m: float = param(
        1.0,
        unit="m",
        low=0.0,
        high=20.0,
        source="ours: outlines of two surveys of one roof differ by less than a metre to each side",
        doc="Differences of two footprints count where a disc of this radius fits into them.",
    )
    least_m2: float = param(
        25.0,
        unit="m2",
        low=0.0,
        high=1e6,
        source="ours: half of the smallest change that must be found",
        doc="Smaller differences of a footprint, or of its heights, are no change.",
    )
    rise_m: float = param(
        1.5,
        unit="m",
        low=0.1,
        high=50.0,
        source="ours: half a storey, far above the noise of two surveys",
        doc="Change of the height above ground that makes a cell built, gone, raised or lowered.",
    )
    gone_share: float = param(
        0.7,
        unit="1",
        low=0.1,
        high=1.0,
        source="ours: what is left is rubble, or a wall",
        doc="A building is demolished when its heights are gone from this share of it.",
    )
    surveyed_share: float = param(
        0.5,
        unit="1",
        low=0.0,
        high=1.0,
        source="ours: most of a building tells of it",
        doc="A building of which less lies in the surveyed area is not surveyed.",
    )
    link_share: float = param(
        0.3,
        unit="1",
        low=0.0,
        high=1.0,
        source="ours: slivers between neighbours of a row are less",
        doc="Two footprints are of one building when they share this much of the smaller.",
    )
    offset_pairs: int = param(
        5,
        unit="count",
        low=1,
        high=10_000,
        source="ours: a median of fewer says little",
        doc="Fewer pairs of like buildings tell no offset between surveys.",
    )
