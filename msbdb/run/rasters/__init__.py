"""Surveys from rasters of heights: the surface of a part, and the blocks that a plan looks at."""
