"""Building regions straight from the points by multi-scale 3-D area morphology (Cao & Wu)."""

from msbdb.extract.area3d.run import extract_area3d

__all__ = ["extract_area3d"]
