"""Buildings from off-ground points by NDVI and stepwise clustering (slides on adaptive filtering, Bathurst)."""

from msbdb.extract.adaptive.run import extract_adaptive

__all__ = ["extract_adaptive"]
