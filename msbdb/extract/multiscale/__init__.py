"""Multi-scale extraction of building parts (Vu, Yamazaki and Matsuoka 2009): one module a step."""

from msbdb.extract.multiscale.forest import Forest
from msbdb.extract.multiscale.run import extract_parts

__all__ = ["Forest", "extract_parts"]
