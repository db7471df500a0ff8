"""GeoParquet: one layer with its CRS, and the bounds of each row in a column of their own."""

from collections.abc import Mapping
from pathlib import Path

from msbdb.export.content import Content
from msbdb.io.files import write_atomic


def write_parquet(content: Content, path: Path, options: Mapping[str, str]) -> None:  # noqa: ARG001  (it has none)
    """Write the first layer as GeoParquet 1.1: geometries as WKB, the column ``bbox`` named as their covering.

    Readers skip groups of rows by their bounds, so a window of a large file is read quickly. The CRS is in the file as
    PROJJSON. Ids are texts.
    """
    import geopandas as gpd

    name = next(iter(content.layers))
    frame: gpd.GeoDataFrame = content.textual(name).frame()
    with write_atomic(path) as temporary:
        frame.to_parquet(
            temporary, index=False, geometry_encoding="WKB", schema_version="1.1.0", write_covering_bbox=True
        )
