"""Parts and buildings for other programs: one module a format."""

from msbdb.export.formats import FORMATS, export

__all__ = ["FORMATS", "export"]
