"""A run as the database keeps it: one typed value of records, tables and rasters.

From it the classes can be labelled again without the source data, and a map can be drawn.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from msbdb.errors import TableError
from msbdb.params import POINT_DETECTORS
from msbdb.surveyplan import Plan
from msbdb.tables import Run, Survey

if TYPE_CHECKING:
    import pandas as pd

    from msbdb.grid import Grid, GridSpec

PER_METRE = 100
"""Heights above ground are whole centimetres, finer than any scanner, so that they are kept without loss."""

ROWS_AT_A_TIME = 256
"""Rows of a raster that are worked out in 64 bits at a time: all at once would take twice the memory of the result."""

REGION_NAMES = {"flatregions": "flat", "area3d": "area3d", "adaptive": "adaptive"}
"""Names of the detectors' label rasters in the database."""

ANSWER_NAMES = {method: f"{name}_answer" for method, name in REGION_NAMES.items()}
"""Names of the rasters of the detectors' answers in the database."""

REQUIRED_RASTERS = ("ndsm_cm", "structure", "valid")
"""Names of the rasters that every run has."""


Packed = Mapping[str, tuple[NDArray[np.generic], dict[str, Any]]]
"""Rasters by their names in the database, with their compressed rows."""


@dataclass(frozen=True, slots=True, eq=False)
class Rasters:
    """The rasters of a run, all of one shape (H, W).

    Parameters
    ----------
    heights_cm : (H, W) ndarray of int32, centimetres
        Heights above ground.
    valid : (H, W) ndarray of bool
        Where the heights are known.
    structure : (H, W) ndarray of uint8
        Class by structure: 0 none, 1 building, 2 vegetation.
    spectral : (H, W) ndarray of uint8, optional
        Class by colour; None without imagery.
    regions : mapping of str to (H, W) ndarray of int32
        Labels of the regions of the detectors that were run, except ``multiscale``: 0 for none, otherwise row number
        + 1 in order of the ids.
    roughness_mm : (H, W) ndarray of uint16, optional
        Residual of the best plane in the small window, millimetres.
    roof_probability : (H, W) ndarray of uint8, optional
        Probability of roof against vegetation; 255 is certain.
    terrain_cm : (H, W) ndarray of int32, optional
        Level of the terrain in the vertical reference of the source, centimetres.
    echoes : (H, W) ndarray of uint16, optional
        First echoes in the cell; of a raster 1 where it has a value.
    reason : (H, W) ndarray of uint8, optional
        Why a cell is a building or not: `msbdb.tables.Reason`. None where a run of an older msbdb kept none.
    support : (H, W) ndarray of uint8, optional
        Which detectors take a cell for building: bit n is that of ``params.DETECTORS[n]``. None as for ``reason``.
    answers : mapping of str to (H, W) ndarray of uint8
        By detector: the ``number`` in ``tables.REJECTION_COUNT`` of the stage and reason by which it dropped the cell;
        0 where it dropped nothing.
    parcels : (H, W) ndarray of int32, optional
        The parcel of each cell, 0 for none; None where the user gave no parcels.
    intensity : (H, W) ndarray of uint8, optional
        That of the first echoes in steps of its logarithm, 0 where unknown; None where the points have none.
    """

    heights_cm: NDArray[np.int32]
    valid: NDArray[np.bool_]
    structure: NDArray[np.uint8]
    spectral: NDArray[np.uint8] | None = None
    regions: Mapping[str, NDArray[np.int32]] = field(default_factory=dict)
    roughness_mm: NDArray[np.uint16] | None = None
    roof_probability: NDArray[np.uint8] | None = None
    terrain_cm: NDArray[np.int32] | None = None
    echoes: NDArray[np.uint16] | None = None
    reason: NDArray[np.uint8] | None = None
    support: NDArray[np.uint8] | None = None
    answers: Mapping[str, NDArray[np.uint8]] = field(default_factory=dict)
    parcels: NDArray[np.int32] | None = None
    intensity: NDArray[np.uint8] | None = None

    def by_name(self) -> dict[str, NDArray[np.generic]]:
        """Return the rasters by the names of their rows in the database, those that are None left out."""
        named: dict[str, NDArray[np.generic] | None] = {
            "ndsm_cm": self.heights_cm,
            "valid": self.valid.astype(np.uint8),
            "structure": self.structure,
            "spectral": self.spectral,
            "roughness_mm": self.roughness_mm,
            "roof_probability": self.roof_probability,
            "terrain_cm": self.terrain_cm,
            "echoes": self.echoes,
            "reason": self.reason,
            "support": self.support,
            "parcels": self.parcels,
            "intensity": self.intensity,
            **{REGION_NAMES[method]: labels for method, labels in self.regions.items()},
            **{ANSWER_NAMES[method]: cells for method, cells in self.answers.items()},
        }
        return {name: values for name, values in named.items() if values is not None}

    @classmethod
    def from_names(cls, rows: Mapping[str, NDArray[np.generic]]) -> Self:
        """Return the rasters from the rows of the database, the inverse of ``by_name``.

        Raises
        ------
        TableError
            When a raster that every run has is missing.
        """
        missing = [name for name in REQUIRED_RASTERS if name not in rows]
        if missing:
            there = ", ".join(sorted(rows)) or "none"
            msg = (
                f"A run needs the rasters {', '.join(REQUIRED_RASTERS)}; got {there}. "
                "Check the database with 'msbdb db check', and build the survey again."
            )
            raise TableError(msg)
        return cls(
            heights_cm=rows["ndsm_cm"].astype(np.int32),
            valid=rows["valid"].astype(np.bool_),
            structure=rows["structure"].astype(np.uint8),
            spectral=rows["spectral"].astype(np.uint8) if "spectral" in rows else None,
            regions={method: rows[name].astype(np.int32) for method, name in REGION_NAMES.items() if name in rows},
            roughness_mm=rows["roughness_mm"].astype(np.uint16) if "roughness_mm" in rows else None,
            roof_probability=rows["roof_probability"].astype(np.uint8) if "roof_probability" in rows else None,
            terrain_cm=rows["terrain_cm"].astype(np.int32) if "terrain_cm" in rows else None,
            echoes=rows["echoes"].astype(np.uint16) if "echoes" in rows else None,
            reason=rows["reason"].astype(np.uint8) if "reason" in rows else None,
            support=rows["support"].astype(np.uint8) if "support" in rows else None,
            answers={method: rows[name].astype(np.uint8) for method, name in ANSWER_NAMES.items() if name in rows},
            parcels=rows["parcels"].astype(np.int32) if "parcels" in rows else None,
            intensity=rows["intensity"].astype(np.uint8) if "intensity" in rows else None,
        )

    @classmethod
    def of_heights(cls, heights: "Grid", structure: NDArray[np.uint8]) -> Self:
        """Return the rasters of a scene in which nothing was detected yet."""
        metres = np.asarray(heights.values, dtype=np.float64)
        return cls(np.round(metres * PER_METRE).astype(np.int32), heights.valid, structure)


def lattice_of(survey: Survey) -> "GridSpec":
    """Return the lattice on which a survey's rasters lie."""
    # A run is read without PROJ; only its place on the ground needs it.
    from affine import Affine
    from pyproj import CRS

    from msbdb.grid import GridSpec

    west, south, east, north = survey.bounds
    shape = round((north - south) / survey.cell_m), round((east - west) / survey.cell_m)
    transform = Affine(survey.cell_m, 0.0, west, 0.0, -survey.cell_m, north)
    return GridSpec(shape, transform, CRS.from_wkt(survey.crs_wkt))


def heights_of(survey: Survey, rasters: Rasters) -> "Grid":
    """Return the heights above ground of a run, metres, equal to those of its build to the bit."""
    from msbdb.grid import Grid

    return Grid(in_metres(rasters.heights_cm), rasters.valid, lattice_of(survey))


def in_metres(cells: NDArray[np.int32], above: NDArray[np.float32] | None = None) -> NDArray[np.float32]:
    """Return centimetres as metres, and what lies above added, worked out in 64 bits, a few rows at a time."""
    metres = np.empty(cells.shape, dtype=np.float32)
    for top in range(0, len(cells), ROWS_AT_A_TIME):
        rows = slice(top, top + ROWS_AT_A_TIME)
        metres[rows] = cells[rows] / PER_METRE if above is None else above[rows] + cells[rows] / PER_METRE
    return metres


@dataclass(frozen=True, slots=True, eq=False)
class KeptRun:
    """All that one build writes into the database, in one transaction.

    Parameters
    ----------
    survey : Survey
        Where and when the data were taken, and from which files.
    run : Run
        Detectors, parameters, counts, timings and notices.
    frames : dict of str to DataFrame
        One frame for each of ``tables.TABLES`` by name, or for those that were read; GeoDataFrames where the table has
        a geometry.
    rasters : Rasters
        Heights, classes and labels of the regions.
    plan : Plan, optional
        The plan by which it was built; None where an older msbdb kept none.
    packed : mapping of str to (ndarray, dict)
        Rasters by their names that were compressed beside other work, with their rows (`msbdb.database.pack_rasters`).
        All others are compressed when they are written.
    """

    survey: Survey
    run: Run
    frames: "dict[str, pd.DataFrame]"
    rasters: Rasters
    plan: Plan | None = None
    packed: Packed = field(default_factory=dict)

    @property
    def heights(self) -> "Grid":
        """The heights above ground, metres."""
        return heights_of(self.survey, self.rasters)

    @property
    def candidate_counts(self) -> dict[str, int]:
        """The number of candidate regions of each detector on points that was run."""
        found = self.frames["candidate_region"]["method"]
        return {name: int((found == name).sum()) for name in POINT_DETECTORS if name in self.run.methods}
