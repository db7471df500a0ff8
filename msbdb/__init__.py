"""Multi-scale building databases from airborne LiDAR and imagery.

The names below are the public interface. `msbdb.api` also has ``evaluate``, ``export``, ``serve`` and ``view``: here
these names belong to packages. An open database has all of them but ``serve`` as methods. Libraries that take time to
load are imported when used.

Examples
--------
>>> import msbdb
>>> report = msbdb.build("town.laz", db="town.sqlite")  # doctest: +SKIP
>>> with msbdb.open("town.sqlite") as town:  # doctest: +SKIP
...     print(town.buildings().sort_values("h_max").tail())
"""

from msbdb import api, errors
from msbdb.api import (
    BuildReport,
    Inventory,
    advance,
    build,
    changes,
    classes,
    classify,
    evaluate_points,
    import_inventory,
    import_roof_samples,
    info,
    measure,
    open,
    plan,
    qgis,
    queries,
    query,
    read_plan,
    relabel,
    set_state,
    summary,
    tiles,
    update,
    why,
)
from msbdb.errors import MsbdbError
from msbdb.params import Params, profile
from msbdb.version import __version__

__all__ = [
    "BuildReport",
    "Inventory",
    "MsbdbError",
    "Params",
    "__version__",
    "advance",
    "api",
    "build",
    "changes",
    "classes",
    "classify",
    "errors",
    "evaluate_points",
    "import_inventory",
    "import_roof_samples",
    "info",
    "measure",
    "open",
    "plan",
    "profile",
    "qgis",
    "queries",
    "query",
    "read_plan",
    "relabel",
    "set_state",
    "summary",
    "tiles",
    "update",
    "why",
]


def __dir__() -> list[str]:
    """Return the public names for completion, and none of the modules that happen to be loaded."""
    return sorted(__all__)
