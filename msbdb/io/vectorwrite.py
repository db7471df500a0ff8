"""Writing of vector layers, all or nothing."""

import os
import tempfile
from pathlib import Path

import geopandas as gpd
import pyogrio
from pyogrio.errors import DataLayerError, DataSourceError, FeatureError, FieldError, GeometryError

from msbdb.errors import CRSError, FileError

SIDECARS = (".shp", ".shx", ".dbf", ".prj", ".cpg", ".qix", ".sbn", ".sbx", ".shp.xml")
"""The files of a Shapefile, some of them left there by other programs."""

ROOM_BYTES = 2**16
"""More than the drivers keep in their buffers until they close a file."""

_REFUSALS = (DataLayerError, DataSourceError, FeatureError, FieldError, GeometryError, OSError)


def write_layers(path: Path, layers: dict[str, gpd.GeoDataFrame], driver: str, **options: object) -> None:
    """Write layers into a new vector file, which takes the place of an old one.

    Parameters
    ----------
    path : Path
        The file; its folder must exist.
    layers : dict of str to GeoDataFrame
        By name; each with a CRS. Several only where the format holds several.
    driver : str
        OGR's name of the format, such as GPKG.
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
    The layers are written into a temporary folder beside the file and moved over when complete, so that a reader
    sees the old file or the new one. A Shapefile consists of several files, which are moved one by one, the .shp
    last; a crash between the moves is the one way to a mixture.

    GDAL says nothing when the disk is full as it closes a file, and the last few kB are lost. So a little room must
    be left after it.
    """
    for name, frame in layers.items():
        if frame.crs is None:
            msg = f"Layer {name} has no CRS; set it before writing {path}."
            raise CRSError(msg)
    try:
        with tempfile.TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent) as folder:
            written = Path(folder, path.name)
            for name, frame in layers.items():
                pyogrio.write_dataframe(
                    frame, written, layer=name, driver=driver, append=written.exists(), promote_to_multi=None, **options
                )
            _require_room(Path(folder))
            _replace(written, path)
    except _REFUSALS as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        msg = f"{path} cannot be written: {reason}. Check the folder, its permissions and the space on the disk."
        raise FileError(msg) from error


def existing_files(path: Path) -> list[Path]:
    """Return the files that writing to the path would replace, the sidecars of a Shapefile included."""
    candidates = [path]
    if path.suffix.lower() == ".shp":
        candidates += [path.with_suffix(suffix) for suffix in SIDECARS if suffix != path.suffix]
    return [candidate for candidate in candidates if candidate.exists()]


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
