"""An open database: one object with the tables of its surveys, its queries, maps and files."""

from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from msbdb.api.outputs import evaluate, export, view

if TYPE_CHECKING:
    import geopandas as gpd
    import pandas as pd

    from msbdb.evaluate import Evaluation


class Inventory:
    """An open database of buildings; close it, or use it in a ``with`` block.

    Each method reads one table of a survey, which need not be named where the database holds only one.

    Parameters
    ----------
    db : str or path
        A SpatiaLite file or a ``postgresql+psycopg://`` URL.
    """

    def __init__(self, db: str | Path) -> None:
        from msbdb import database

        self.db = db
        self.engine = database.open_database(db)
        self._read = database

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

    def runs(self) -> "pd.DataFrame":
        """Return a row a run: survey, method, profile, version, date, CRS, density and cell."""
        return self._read.list_runs(self.engine)

    def buildings(self, survey: str | None = None) -> "gpd.GeoDataFrame":
        """Return the buildings with their footprints."""
        return self._read.read_buildings(self.engine, survey)

    def parts(self, survey: str | None = None) -> "gpd.GeoDataFrame":
        """Return the parts of all scales."""
        return self._read.read_parts(self.engine, survey)

    def flat_regions(self, survey: str | None = None) -> "gpd.GeoDataFrame":
        """Return the flat regions."""
        return self._read.read_flat_regions(self.engine, survey)

    def candidates(self, survey: str | None = None, method: str | None = None) -> "gpd.GeoDataFrame":
        """Return the candidate regions of the detectors on points, or of one of them: area3d or adaptive."""
        return self._read.read_candidates(self.engine, survey, method)

    def scales(self, survey: str | None = None) -> "pd.DataFrame":
        """Return the scales with their thresholds."""
        return self._read.read_scales(self.engine, survey)

    def classes(self, survey: str | None = None) -> "pd.DataFrame":
        """Return the land-cover classes."""
        return self._read.read_classes(self.engine, survey)

    def rejections(self, survey: str | None = None) -> "gpd.GeoDataFrame":
        """Return the ledger: every region as large as a building that a stage dropped, and the reason."""
        return self._read.read_rejections(self.engine, survey)

    def rejection_counts(self, survey: str | None = None) -> "pd.DataFrame":
        """Return the ledger in numbers: how many regions a detector dropped, by stage and reason, small ones too."""
        return self._read.read_rejection_counts(self.engine, survey)

    def view(
        self,
        out: str | Path,
        survey: str | None = None,
        **options: Any,  # noqa: ANN401  (those of msbdb.api.view)
    ) -> None:
        """Write a page in 3-D (.html) or a map; the options are those of `msbdb.api.view`."""
        view(self.db, Path(out), survey=survey, **options)

    def export(
        self,
        out: str | Path,
        survey: str | None = None,
        **options: Any,  # noqa: ANN401  (those of msbdb.api.export)
    ) -> dict[str, int]:
        """Write layers to a file, in the format of its ending; the options are those of `msbdb.api.export`."""
        return export(self.db, out, survey=survey, **options)

    def evaluate(
        self,
        reference: str | Path,
        survey: str | None = None,
        **options: Any,  # noqa: ANN401  (those of msbdb.api.evaluate)
    ) -> "Evaluation":
        """Compare the footprints with a reference; the options are those of ``msbdb evaluate``.

        ``layer``, ``aoi``, ``crs``, ``height``, ``overlap``, ``cell_m`` and ``of``; see `msbdb.api.evaluate`.
        """
        return evaluate(self.db, Path(reference), survey=survey, **options)

    def query(self, name: str, parameters: Mapping[str, object] | None = None) -> "pd.DataFrame":
        """Run an example query; see `msbdb.api.query`."""
        return self._read.run_example(self.engine, name, **(parameters or {}))

    def dump(self, *, provenance: bool = False) -> list[str]:
        """Return the content as lines that are equal for equal content; see `msbdb.database.canonical_dump`."""
        return list(self._read.canonical_dump(self.engine, provenance=provenance))


def open(db: str | Path) -> Inventory:
    """Open a database that exists.

    Raises
    ------
    DatabaseError
        When it does not exist, or cannot be read.
    """
    return Inventory(db)
