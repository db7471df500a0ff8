"""Flat regions by differential morphological and attribute profiles (Mongus et al. 2013, section 3)."""

from msbdb.extract.flatregions.initialise import initialise
from msbdb.extract.flatregions.run import FlatRegions, extract_flat_regions

__all__ = ["FlatRegions", "extract_flat_regions", "initialise"]
