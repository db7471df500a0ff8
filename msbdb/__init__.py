"""Multi-scale building databases from airborne LiDAR and imagery.

The names below are the public interface. Libraries that take time to load are imported when they are used.

Examples
--------
>>> import msbdb
>>> report = msbdb.build(["town.laz"], db="town.sqlite")  # doctest: +SKIP
>>> with msbdb.open("town.sqlite") as town:  # doctest: +SKIP
...     print(town.buildings().sort_values("h_max").tail())
"""

from msbdb.api import BuildReport, Inventory, build, changes, classify, info, open, queries, query, relabel, update, why
from msbdb.errors import MsbdbError
from msbdb.params import Params, profile
from msbdb.version import __version__

__all__ = [
    "BuildReport",
    "Inventory",
    "MsbdbError",
    "Params",
    "__version__",
    "build",
    "changes",
    "classify",
    "info",
    "open",
    "profile",
    "queries",
    "query",
    "relabel",
    "update",
    "why",
]
