"""Area morphology: openings, closings, the scale-space that they build, flat zones and granulometry."""

from msbdb.morphology.area import area_closing, area_open_close, area_opening
from msbdb.morphology.granulometry import find_scales, opening_areas
from msbdb.morphology.scalespace import ScaleSpace, build_scale_space
from msbdb.morphology.zones import label_zones

__all__ = [
    "ScaleSpace",
    "area_closing",
    "area_open_close",
    "area_opening",
    "build_scale_space",
    "find_scales",
    "label_zones",
    "opening_areas",
]
