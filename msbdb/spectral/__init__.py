"""From image bands to a class map: gridding, filtering, k-means and its information classes."""

from msbdb.spectral.classes import classify
from msbdb.spectral.colours import grid_colours, grid_intensity, spectral_bands, stack

__all__ = ["classify", "grid_colours", "grid_intensity", "spectral_bands", "stack"]
