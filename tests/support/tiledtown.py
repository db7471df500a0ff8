"""A small town that four tiles cut: a block of houses over their corner, and workers that fail in ways of their own."""

import os
import signal
from dataclasses import replace
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np
import rasterio
from affine import Affine
from rasterio.windows import Window
from simulated.files import write_heights, write_image, write_points
from simulated.scenes import DATUM_M, Block, Scene, Tree, World, scan

from msbdb.database import TileStatus
from msbdb.grid import Grid, GridSpec
from msbdb.params import Params, with_values
from msbdb.run.preparation.drafts import build_surface
from msbdb.scale.tilework import TileTask, work

TILE_M = 60.0

KILLED = "MSBDB_TEST_KILLED"
"""Names the file that remembers that a worker was killed."""


def town(without: str = "") -> Scene:
    """Return a town of 120 by 120 m with a courtyard over the corner of the tiles, and houses and trees around it.

    The house ``without`` is pulled down.
    """
    blocks = (
        Block("ring", 44, 44, 34, 34, DATUM_M + 12.5, 1, hole=(54, 54, 14, 14)),
        Block("hall", 52, 95, 20, 14, DATUM_M + 9.5, 2, material="gravel"),
        Block("west", 15, 20, 14, 12, DATUM_M + 6.5, 3),
        Block("south", 90, 12, 12, 14, DATUM_M + 6.5, 4, ridge_m=2.5),
        Block("east", 95, 85, 13, 10, DATUM_M + 7.5, 5, turn_deg=20.0),
    )
    trees = tuple(Tree(8.0 + 10 * n, 36.0, 3.5, 9.0 + n % 3, 2.5) for n in range(11))
    blocks = tuple(block for block in blocks if block.name != without)
    return scan(World("town", (120, 120), blocks, trees, origin=(389_040.0, 5_821_020.0)), density=1.0)


def write_town(folder: Path, without: str = "") -> list[Path]:
    """Write the town as two files, a western and an eastern one."""
    folder.mkdir(exist_ok=True)
    points = town(without).points
    west = points.x < 389_090.0
    return [write_points(folder / f"{name}.laz", points.take(own)) for name, own in (("w", west), ("e", ~west))]


def write_rasters(folder: Path, *, cell_m: float = 1.0, ground_m: float = 2.0, without: str = "") -> dict[str, Path]:
    """Write DSM, DTM and an orthophoto of the town, and return them by role.

    Their cells lie beside the absolute lattice, by half a cell northwards. The DSM has a void without a tag, the DTM
    other cells, and none with a value under the hall.
    """
    folder.mkdir(exist_ok=True)
    scene = town(without)
    surface = build_surface(scene.points, with_values(Params(), {"surface": {"cell_m": cell_m}}))
    transform = Affine.translation(0.3 * cell_m, 0.5 * cell_m) @ surface.dsm.spec.transform
    dsm = Grid(surface.dsm.values, surface.dsm.valid, replace(surface.dsm.spec, transform=transform))
    west, south, east, north = dsm.spec.bounds
    shape = round((north - south) / ground_m) + 6, round((east - west) / ground_m) + 6
    spec = GridSpec(shape, Affine(ground_m, 0, west - 5, 0, -ground_m, north + 7), dsm.spec.crs)
    ground = np.fromfunction(lambda row, col: DATUM_M + np.sin(row / 9) / 4 + col / 200, shape).astype(np.float32)
    left, bottom = scene.world.origin
    dtm = Grid(ground, ~spec.holding((left + 55, bottom + 98, left + 69, bottom + 106)), spec)
    found = {name: write_heights(folder / f"{name}.tif", grid) for name, grid in (("dsm", dsm), ("dtm", dtm))}
    with rasterio.open(found["dsm"], "r+") as image:
        cells = image.read(1)
        cells[:7, -20:] = -3.4e38
        image.write(cells, 1)
    fine = GridSpec((700, 720), Affine(0.2, 0, west - 3, 0, -0.2, north + 6), dsm.spec.crs)
    found["ortho"] = write_image(folder / "ortho.tif", scene.ortho(fine), fine, ("red", "green", "blue", "nir"))
    return found


def write_vrt(path: Path, folder: Path) -> Path:
    """Write a raster as four pieces and a virtual raster over them, as gdalbuildvrt makes it; return this."""
    folder.mkdir()
    sources = []
    with rasterio.open(path) as image:
        crs, transform, height, width = image.crs.to_wkt(), image.transform, image.height, image.width
        for row, rows in ((0, height // 2), (height // 2, height - height // 2)):
            for column, columns in ((0, width // 3), (width // 3, width - width // 3)):
                own, name = Window(column, row, columns, rows), f"{row}-{column}.tif"
                at = transform @ Affine.translation(column, row)
                profile = image.profile | {"width": columns, "height": rows, "transform": at}
                with rasterio.open(folder / name, "w", **profile) as piece:
                    piece.write(image.read(window=own))
                sources.append(
                    f'<ComplexSource><SourceFilename relativeToVRT="1">{name}</SourceFilename>'
                    "<SourceBand>1</SourceBand>"
                    f'<SrcRect xOff="0" yOff="0" xSize="{columns}" ySize="{rows}"/>'
                    f'<DstRect xOff="{column}" yOff="{row}" xSize="{columns}" ySize="{rows}"/>'
                    "<NODATA>-9999</NODATA></ComplexSource>"
                )
    place = ", ".join(repr(value) for value in transform.to_gdal())
    found = folder / f"{path.stem}.vrt"
    found.write_text(
        f'<VRTDataset rasterXSize="{width}" rasterYSize="{height}"><SRS>{escape(crs)}</SRS>'
        f'<GeoTransform>{place}</GeoTransform><VRTRasterBand dataType="Float32" band="1">'
        f"<NoDataValue>-9999</NoDataValue>{''.join(sources)}</VRTRasterBand></VRTDataset>",
        encoding="utf-8",
    )
    return found


def work_once_killed(task: TileTask) -> TileStatus:
    """Build a tile; the first process that begins one is killed on the way, as by a machine without memory."""
    marker = Path(os.environ[KILLED])
    if not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return work(task)


def end_at_third(task: TileTask) -> TileStatus:
    """Build two tiles, and kill the whole process at the third, as a power cut does."""
    marker = Path(os.environ[KILLED])
    done = int(marker.read_text()) if marker.exists() else 0
    if done == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    marker.write_text(str(done + 1))
    return work(task)
