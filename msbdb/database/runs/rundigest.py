"""The digest of a run's content: a load of the same content is recognised by it, and an edited row detected."""

import hashlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from msbdb.database.schema.canonical import plain, to_json
from msbdb.tables import Run, Survey


@dataclass(frozen=True, slots=True, eq=False)
class RunContent:
    """The content of a run as plain columns, which are read faster than frames.

    Parameters
    ----------
    survey : Survey
        The survey with its sources.
    run : Run
        Parameters, counts, timings and notices.
    columns : mapping of str to mapping of str to (N,) ndarray
        The columns of each of ``tables.TABLES`` by their names: int64, float64 with NaN for null, or objects for texts
        and geometries. Rows are in the table's order, polygons are multipolygons.
    rasters : mapping of str to (H, W) ndarray
        Heights, classes and labels of the regions, by the names of their rows.
    """

    survey: Survey
    run: Run
    columns: Mapping[str, Mapping[str, NDArray[Any]]]
    rasters: Mapping[str, NDArray[Any]]

    def digest(self) -> str:
        """Return the SHA-256 of the content except its timings."""
        digest = hashlib.sha256()
        run = asdict(self.run)
        del run["timings"]
        digest.update(to_json([survey_row(self.survey), source_rows(self.survey), run]).encode())
        for table, columns in self.columns.items():
            for name, values in columns.items():
                digest.update(f"\0{table}.{name}\0".encode())
                digest.update(_column_bytes(name, values))
        for name, raster in sorted(self.rasters.items()):
            cells = portable(raster)
            digest.update(f"\0{name}\0{cells.dtype.str}\0{cells.shape}\0".encode())
            digest.update(cells.ravel().data)
        return digest.hexdigest()


def survey_row(survey: Survey) -> dict[str, Any]:
    """Return the survey's columns except its key."""
    row = asdict(survey)
    del row["sources"]
    row["west"], row["south"], row["east"], row["north"] = row.pop("bounds")
    return {name: plain(value) for name, value in row.items()}


def source_rows(survey: Survey) -> list[dict[str, Any]]:
    """Return the sources in canonical order."""
    rows = [plain(asdict(source)) for source in survey.sources]
    return sorted(rows, key=lambda row: (row["role"], row["name"], row["sha256"]))


def portable(values: NDArray[Any]) -> NDArray[Any]:
    """Return an array in C order and little-endian."""
    return np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<"))


def _column_bytes(name: str, values: NDArray[Any]) -> bytes:
    """Return a column's content as bytes; equal columns give equal bytes."""
    if name == "geometry":
        # A point needs no normalisation.
        shapes = shapely.normalize(values) if shapely.get_dimensions(values).any() else values
        return b"".join(shapely.to_wkb(shapes, byte_order=1))
    if values.dtype.kind in "if":
        return portable(values).tobytes()
    words = values.tolist()
    # Each different text is encoded once.
    written = {word: to_json(word) for word in set(words)}
    return f"[{', '.join(written[word] for word in words)}]".encode()
