"""What a database holds: as plain values, as a map, and as files for other programs."""

from pathlib import Path
from typing import Any


def info(db: str | Path) -> dict[str, Any]:
    """Return what a database holds: a record a run, with its survey, counts and notices."""
    from msbdb.run.outputs import info_of

    return info_of(db)


def view(db: str | Path, out: Path, *, survey: str | None = None, of: str = "buildings") -> None:
    """Draw a map on a hillshade, as PNG.

    Parameters
    ----------
    db : str or path
        The database.
    out : path
        The picture.
    survey : str, optional
        Not needed where the database holds one.
    of : {'buildings', 'flatregions', 'area3d', 'adaptive'}
        Footprints and parts by scale and height, flat regions by their zone, or candidate regions by their height.
    """
    from msbdb.run.outputs import draw

    draw(db, Path(out), survey=survey, of=of)


def export(db: str | Path, out: Path, *, survey: str | None = None, overwrite: bool = False) -> None:
    """Write parts and footprints of a survey to a GeoPackage, Shapefile or GeoJSON, by the file's ending."""
    from msbdb.run.outputs import write_layers

    write_layers(db, Path(out), survey=survey, overwrite=overwrite)
