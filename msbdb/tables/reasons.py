"""Why a place is a building or not: the values of a run's raster ``reason``."""

from enum import IntEnum


class Reason(IntEnum):
    """The decisive reason of a cell; ``REASONS`` has its meaning."""

    NO_DATA = 0
    BUILDING = 1
    LOW = 2
    SMALL = 3
    VEGETATION_BY_STRUCTURE = 4
    VEGETATION_BY_COLOUR = 5
    OTHER_CLASS = 6
    UNSUPPORTED = 7
    HARDLY_SUPPORTED = 8
    OUTVOTED = 9
    SMALL_PART = 10
    UNLIKE_PART = 11
    GAP = 12
    NO_PARTS = 13


REASONS = {
    Reason.NO_DATA: "no height is known, because no echo is near",
    Reason.BUILDING: "a building",
    Reason.LOW: "lower than the least height of a building",
    Reason.SMALL: "the object is smaller than the least area of a building",
    Reason.VEGETATION_BY_STRUCTURE: "vegetation by the echoes and the texture of the surface",
    Reason.VEGETATION_BY_COLOUR: "vegetation by colour",
    Reason.OTHER_CLASS: "the class of land cover is labelled as no building",
    Reason.UNSUPPORTED: "no detector takes it for a building",
    Reason.HARDLY_SUPPORTED: "fewer than half of the detectors take it for a building",
    Reason.OUTVOTED: "enough detectors take it for a building, but it is rough, small, or beyond a building's edge",
    Reason.SMALL_PART: "a part of a building smaller than the finest scale",
    Reason.UNLIKE_PART: "a part with too few cells of building classes",
    Reason.GAP: "a gap between the parts of a larger region",
    Reason.NO_PARTS: "the multi-scale detector, which makes the buildings, was not run",
}
"""What each reason means."""
