"""Morphology of images: area filters, the scale-space, the component tree, profiles and gradients.

The same area filters on the points themselves are in `msbdb.points.pointarea`.
"""

from msbdb.morphology.area import area_closing, area_open_close, area_opening
from msbdb.morphology.attributeprofiles import AttributeProfile, build_profile, zone_thresholds
from msbdb.morphology.componenttree import ComponentTree, areas, build_tree, is_increasing, sums
from msbdb.morphology.levelzones import label_level_zones
from msbdb.morphology.scalespace import ScaleSpace, build_scale_space, find_scales, opening_areas
from msbdb.morphology.smallzones import merge_small_zones
from msbdb.morphology.windows import (
    Theta,
    external_gradient,
    internal_gradient,
    second_order_gradient,
    window_profile,
)

__all__ = [
    "AttributeProfile",
    "ComponentTree",
    "ScaleSpace",
    "Theta",
    "area_closing",
    "area_open_close",
    "area_opening",
    "areas",
    "build_profile",
    "build_scale_space",
    "build_tree",
    "external_gradient",
    "find_scales",
    "internal_gradient",
    "is_increasing",
    "label_level_zones",
    "merge_small_zones",
    "opening_areas",
    "second_order_gradient",
    "sums",
    "window_profile",
    "zone_thresholds",
]
