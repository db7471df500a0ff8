"""Layers of vector files: plain columns with geometries, written whole or not at all.

GDAL writes them through pyogrio, which takes arrays. So nothing here needs pandas, which takes longer to load than an
export of a town takes to write.
"""

import os
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import shapely
from numpy.typing import NDArray

from msbdb.errors import CRSError, FileError
from msbdb.io.files import existing_files

if TYPE_CHECKING:
    import geopandas as gpd
    from pyproj import CRS

ROOM_BYTES = 2**16
"""More than the drivers keep in their buffers until they close a file."""


ROWS_AT_A_TIME = 20_000
"""Rows that are written at once, where a format takes more later."""

APPENDED = frozenset({"GPKG"})
"""OGR's names of the formats to whose layers rows are appended as quickly as they are written."""

DEFERRED = ("geopandas", "pandas", "pyproj")
"""Libraries that writing arrays does not need; loading them takes as long as all the rest of an export."""


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """The rows of a layer.

    Parameters
    ----------
    columns : mapping of str to (N,) ndarray
        By name: numbers, where NaN is null; objects, which are texts or None; or a masked array, null where masked.
    geometry : (N,) ndarray of object
        Geometries of one type; of what is only written also their WKB, bytes.
    crs : str
        Their CRS as GDAL takes it, from `crs_text`; a layer without one cannot be written.
    kind : str
        The type of the geometries in GDAL's words.
    """

    columns: Mapping[str, NDArray[Any]]
    geometry: NDArray[np.object_]
    crs: str
    kind: str = "MultiPolygon"

    @classmethod
    def of(cls, frame: "gpd.GeoDataFrame") -> Self:
        """Return the rows of a frame; its nullable columns become masked arrays, texts become objects."""
        columns = {str(name): _column(frame[name]) for name in frame.columns if name != frame.geometry.name}
        return cls(columns, frame.geometry.to_numpy(), "" if frame.crs is None else crs_text(frame.crs))

    def frame(self) -> "gpd.GeoDataFrame":
        """Return the rows as a frame; masked whole numbers become ``Int64``."""
        import geopandas as gpd
        import pandas as pd

        columns = {
            name: pd.array(values.tolist(), dtype="Int64") if isinstance(values, np.ma.MaskedArray) else values
            for name, values in self.columns.items()
        }
        return gpd.GeoDataFrame(columns, geometry=self.geometry, crs=self.crs)

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.geometry)

    def pieces(self, size: int) -> Iterator[Self]:
        """Yield the rows, so many at a time; a layer without rows is a piece, too."""
        for first in range(0, max(len(self), 1), size):
            some = slice(first, first + size)
            columns = {name: values[some] for name, values in self.columns.items()}
            yield replace(self, columns=columns, geometry=self.geometry[some])


def _column(values: Any) -> NDArray[Any]:  # noqa: ANN401  (a series of pandas, which is not loaded here)
    """Return a column of a frame as an array."""
    kind = getattr(values.dtype, "numpy_dtype", values.dtype)  # of the nullable numbers
    if isinstance(values.dtype, np.dtype):
        return np.asarray(values)
    null = values.isna().to_numpy()
    if isinstance(kind, np.dtype):
        numbers: NDArray[Any] = np.ma.MaskedArray(values.to_numpy(dtype=kind, na_value=kind.type(0)), mask=null)
        return numbers
    words = np.array(values, dtype=object)
    words[null] = None
    return words


def crs_text(crs: "CRS") -> str:
    """Return a CRS as GDAL takes it: by its EPSG code, or as WKT."""
    code = crs.to_epsg()
    return f"EPSG:{code}" if code else crs.to_wkt("WKT1_GDAL")


def texts(values: NDArray[Any]) -> NDArray[np.object_]:
    """Return numbers as texts, None for null: as browsers read ids above 2^53 without rounding.

    Examples
    --------
    >>> texts(np.array([5, 2**59 - 1]))
    array(['5', '576460752303423487'], dtype=object)
    """
    found = np.empty(len(values), dtype=object)
    found[:] = [None if value is None else str(value) for value in values.tolist()]
    return found


def write_layers(
    path: Path,
    layers: Mapping[str, Layer],
    driver: str,
    finish: Callable[[Path], None] | None = None,
    prepared: Callable[[Layer], Layer] | None = None,
    /,
    *,
    encoding: str | None = None,
    **options: str,
) -> None:
    """Write layers into a new vector file, which replaces an old one.

    Parameters
    ----------
    path : Path
        The file; its folder must exist.
    layers : mapping of str to Layer
        By name; each with a CRS. Several only where the format holds several.
    driver : str
        OGR's name of the format, such as GPKG.
    finish : callable, optional
        Completes the written file, before it takes its place.
    prepared : callable, optional
        Makes of rows what is written. It is called for each piece of a layer.
    encoding : str, optional
        Of texts, for drivers with a choice.
    **options
        Dataset and layer creation options of the driver.

    Raises
    ------
    CRSError
        When a layer has no CRS.
    FileError
        When the file cannot be written; what was there before is still there.

    Notes
    -----
    The layers are written into a temporary folder beside the file, and moved when complete: a reader sees the old file
    or the new one. A Shapefile consists of several files, which are moved one by one, the .shp last. A crash between
    the moves can leave a mixture of old and new files.

    GeoPackages are written `ROWS_AT_A_TIME`, so that only these rows are in memory once more as GDAL takes them.

    GDAL reports no error when the disk is full as it closes a file, and the last few kB are lost. So some free space is
    required after it.
    """
    for name, layer in layers.items():
        if not layer.crs:
            msg = f"Layer {name} has no CRS; set it before writing {path}."
            raise CRSError(msg)
    pyogrio = _pyogrio()
    refusals = (pyogrio.errors.DataSourceError, pyogrio.errors.DataLayerError, OSError)
    try:
        with tempfile.TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent) as folder:
            written = Path(folder, path.name)
            with _unsynchronised(pyogrio):
                for name, layer in _pieces(layers, driver, prepared):
                    columns = layer.columns.values()
                    pyogrio.raw.write(
                        written,
                        _encoded(layer.geometry),
                        [np.asarray(values) for values in columns],
                        list(layer.columns),
                        [values.mask if isinstance(values, np.ma.MaskedArray) else None for values in columns],
                        layer=name,
                        driver=driver,
                        geometry_type=layer.kind,
                        crs=layer.crs,
                        encoding=encoding,
                        append=written.exists(),
                        **options,
                    )
            if finish is not None:
                finish(written)
            _require_room(Path(folder))
            _replace(written, path)
    except refusals as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        msg = f"{path} cannot be written: {reason}. Check the folder, its permissions and the space on the disk."
        raise FileError(msg) from error


def _encoded(geometry: NDArray[np.object_]) -> NDArray[np.object_]:
    """Return geometries as WKB."""
    if len(geometry) and isinstance(geometry[0], bytes):
        return geometry
    return np.asarray(shapely.to_wkb(geometry), dtype=np.object_)


def _pieces(
    layers: Mapping[str, Layer], driver: str, prepared: Callable[[Layer], Layer] | None
) -> Iterator[tuple[str, Layer]]:
    """Yield what is written at once, with the name of its layer."""
    for name, layer in layers.items():
        for piece in layer.pieces(ROWS_AT_A_TIME) if driver in APPENDED else (layer,):
            yield name, piece if prepared is None else prepared(piece)


class _Deferred(ModuleType):
    """Stands for a library that is imported once it is used; its version is known before."""

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401  (any attribute of the library)
        """Return an attribute of the library itself."""
        if name == "__version__":
            return version(self.__name__)
        if sys.modules.get(self.__name__) is self:
            del sys.modules[self.__name__]
        return getattr(import_module(self.__name__), name)


def _pyogrio() -> Any:  # noqa: ANN401  (a library without types)
    """Import pyogrio without the libraries that it only looks for when it is imported.

    Its functions on frames import them themselves, as do all others afterwards.
    """
    if "pyogrio" not in sys.modules:
        deferred = {name: _Deferred(name) for name in DEFERRED if name not in sys.modules}
        sys.modules.update(deferred)
        try:
            import_module("pyogrio")
        finally:
            for name, stand_in in deferred.items():
                if sys.modules.get(name) is stand_in:
                    del sys.modules[name]
    return import_module("pyogrio")


@contextmanager
def _unsynchronised(pyogrio: Any) -> Iterator[None]:  # noqa: ANN401  (a library without types)
    """Let SQLite's formats leave the waiting for the disk to `_replace`, in place of a wait for each layer."""
    option = "OGR_SQLITE_SYNCHRONOUS"
    before = pyogrio.get_gdal_config_option(option)
    pyogrio.set_gdal_config_options({option: "OFF"})
    try:
        yield
    finally:
        pyogrio.set_gdal_config_options({option: before})


def _require_room(folder: Path) -> None:
    """Raise the system's error when the disk is full, so that what was written just now may be cut off."""
    probe = folder / "room"
    with probe.open("wb") as file:
        file.write(bytes(ROOM_BYTES))
        file.flush()
        os.fsync(file.fileno())
    probe.unlink()


def _replace(written: Path, path: Path) -> None:
    """Move the written file and its sidecars over the old ones, and remove the old ones that have no successor."""
    new = sorted(written.parent.iterdir(), key=lambda file: file == written)
    for file in new:
        with file.open("rb") as handle:
            os.fsync(handle.fileno())
    for stale in existing_files(path):
        if stale != path and not written.with_name(stale.name).exists():
            stale.unlink()
    for file in new:
        file.replace(path.with_name(file.name))
