"""Layers and changes as files for other programs."""

from msbdb.export.formats import FORMATS, export

__all__ = ["FORMATS", "export"]
