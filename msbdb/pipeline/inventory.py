"""A database in hand: its tables as frames, for people who work in Python."""

from pathlib import Path
from types import TracebackType
from typing import Self

import geopandas as gpd
import pandas as pd

from msbdb.database import (
    canonical_dump,
    list_runs,
    open_database,
    read_buildings,
    read_classes,
    read_parts,
    read_rejections,
    read_scales,
)


class Inventory:
    """An open database of buildings; close it, or use it in a ``with`` block.

    Each method reads one table of a survey, which need not be named where the database holds only one.

    Parameters
    ----------
    db : str or path
        A SpatiaLite file or a ``postgresql+psycopg://`` URL.
    """

    def __init__(self, db: str | Path) -> None:
        self.engine = open_database(db)

    def __enter__(self) -> Self:
        """Return the inventory itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the database."""
        self.close()

    def close(self) -> None:
        """Close the database."""
        self.engine.dispose()

    def runs(self) -> pd.DataFrame:
        """Return a row a run: survey, method, profile, version, date, CRS, density and cell."""
        return list_runs(self.engine)

    def buildings(self, survey: str | None = None) -> gpd.GeoDataFrame:
        """Return the buildings with their footprints."""
        return read_buildings(self.engine, survey)

    def parts(self, survey: str | None = None) -> gpd.GeoDataFrame:
        """Return the parts of all scales."""
        return read_parts(self.engine, survey)

    def scales(self, survey: str | None = None) -> pd.DataFrame:
        """Return the scales with their thresholds."""
        return read_scales(self.engine, survey)

    def classes(self, survey: str | None = None) -> pd.DataFrame:
        """Return the land-cover classes."""
        return read_classes(self.engine, survey)

    def rejections(self, survey: str | None = None) -> gpd.GeoDataFrame:
        """Return the ledger: every region that a stage dropped, and why."""
        return read_rejections(self.engine, survey)

    def dump(self) -> list[str]:
        """Return the whole content as lines that are equal for equal content."""
        return list(canonical_dump(self.engine))


def open(db: str | Path) -> Inventory:
    """Open a database that is there.

    Raises
    ------
    DatabaseError
        When there is none, or it cannot be read.
    """
    return Inventory(db)
