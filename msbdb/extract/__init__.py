"""Extractors: from rasters and points to building parts, flat regions and candidates."""
