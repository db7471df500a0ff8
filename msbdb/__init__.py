"""Multi-scale building databases from airborne LiDAR and imagery."""

from msbdb.version import __version__

__all__ = ["__version__"]
