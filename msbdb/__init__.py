"""Multi-scale building databases from airborne LiDAR and imagery.

The names below are all there is to the public interface. They are loaded when they are first used, so that
``import msbdb`` costs nothing.

Examples
--------
>>> import msbdb
>>> report = msbdb.build(["town.laz"], db="town.sqlite")  # doctest: +SKIP
>>> with msbdb.open("town.sqlite") as town:  # doctest: +SKIP
...     print(town.buildings().sort_values("h_max").tail())
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from msbdb.errors import MsbdbError
from msbdb.version import __version__

if TYPE_CHECKING:
    from msbdb.api.build import BuildReport, build
    from msbdb.api.changes import changes
    from msbdb.api.classify import classify
    from msbdb.api.inventory import Inventory, open
    from msbdb.api.reports import info, relabel
    from msbdb.api.update import update
    from msbdb.params import Params, profile

_HOMES = {
    "BuildReport": "msbdb.pipeline",
    "Inventory": "msbdb.pipeline",
    "Params": "msbdb.params",
    "build": "msbdb.pipeline",
    "changes": "msbdb.pipeline",
    "classify": "msbdb.pipeline",
    "info": "msbdb.pipeline",
    "open": "msbdb.pipeline",
    "profile": "msbdb.params",
    "relabel": "msbdb.pipeline",
    "update": "msbdb.pipeline",
}

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
    "relabel",
    "update",
]


def __getattr__(name: str) -> Any:  # noqa: ANN401  (whatever the name stands for)
    """Load a public name from its home on first use."""
    if name not in _HOMES:
        msg = f"module 'msbdb' has no attribute '{name}'"
        raise AttributeError(msg)
    return getattr(import_module(_HOMES[name]), name)
