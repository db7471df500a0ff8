"""Layers of the inventory and of surveys as files for other programs."""

from msbdb.export.content import WHATS, Content
from msbdb.export.formats import FORMATS, Format, check_options, choose_layers, export, find_format

__all__ = ["FORMATS", "WHATS", "Content", "Format", "check_options", "choose_layers", "export", "find_format"]
