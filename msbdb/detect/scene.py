"""The values between the steps: the scene that every detector takes, and the regions that it returns."""

from dataclasses import dataclass, field, replace

import geopandas as gpd
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from msbdb.errors import InputError
from msbdb.grid import Bands, Grid
from msbdb.kept import PER_METRE
from msbdb.labels import Labels
from msbdb.ledger import Answers
from msbdb.params import Params
from msbdb.parts.forest import Forest
from msbdb.points.cloud import PointCloud
from msbdb.spectral.coverclasses import Cover
from msbdb.surface import Surface
from msbdb.surface.gridding import count_first
from msbdb.surface.structure import Structure
from msbdb.tables import Survey

MOST_MM = np.iinfo(np.uint16).max
CERTAIN = np.iinfo(np.uint8).max


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """Each cell's own evidence of roof, in the whole numbers that the database keeps.

    Parameters
    ----------
    roughness_mm : (H, W) ndarray of uint16
        Residual of the best plane in the small window, millimetres; more than 65.535 m counts as that.
    roof_probability : (H, W) ndarray of uint8
        Of roof against vegetation, before any smoothing; 255 is certain.
    """

    roughness_mm: NDArray[np.uint16]
    roof_probability: NDArray[np.uint8]

    @classmethod
    def of(cls, structure: Structure) -> "Evidence":
        """Round the evidence to what the database keeps, so that a build and a re-labelling give the same."""
        millimetres = np.clip(np.rint(structure.roughness_m * np.float32(1000)), 0, MOST_MM)
        share = np.rint(structure.roof_probability * np.float32(CERTAIN))
        return cls(millimetres.astype(np.uint16), share.astype(np.uint8))


@dataclass(frozen=True, slots=True, eq=False)
class Elevations:
    """The terrain beneath each cell and the echoes in it, in the whole numbers that the database keeps.

    Parameters
    ----------
    terrain_cm : (H, W) ndarray of int32, optional
        Level of the terrain in the vertical reference of the source, centimetres. None where it is not known: the
        source has heights above ground, or an older msbdb did not keep it.
    echoes : (H, W) ndarray of uint16, optional
        First echoes in the cell; of a raster 1 where it has a value. None where an older msbdb did not keep them.
    of_points : bool
        Whether the source has points.
    """

    terrain_cm: NDArray[np.int32] | None = None
    echoes: NDArray[np.uint16] | None = None
    of_points: bool = False

    @classmethod
    def of(cls, surface: Surface, cloud: PointCloud | None) -> "Elevations":
        """Take the terrain of a surface, and count the first echoes of its cells."""
        terrain_cm = np.rint(np.asarray(surface.dtm.values, dtype=np.float64) * PER_METRE).astype(np.int32)
        spec, observed = surface.dtm.spec, surface.samples.observed
        echoes = observed.astype(np.uint16) if cloud is None else count_first(cloud, spec)
        return cls(terrain_cm if surface.terrain_known else None, echoes, cloud is not None)


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """One survey, prepared for the detectors: all on one lattice.

    Parameters
    ----------
    survey : Survey
        The record of the survey; its name is part of all ids.
    heights : Grid
        Heights above ground, metres.
    cover : Cover
        Land cover by structure, colours and the operator's labels.
    evidence : Evidence, optional
        Each cell's own evidence of roof; None where a run of an older msbdb kept none.
    elevations : Elevations
        The terrain above sea and the echoes of each cell, where they are known.
    parcels : (H, W) ndarray of int32, optional
        The parcel of each cell, by which touching houses are divided: 0 for none. None where the user gave no parcels.
    surface : Surface, optional
        DSM, DTM and nDSM; None where a scene is read back from the database.
    cloud : PointCloud, optional
        The points; None for a raster source.
    bands : Bands, optional
        Colours of the orthophoto or the points.
    above : (N,) ndarray of float64, optional
        Heights of the points above ground, metres, where the plan asked for them or the ground filter gives them.
    noise_m : (H, W) ndarray of float32, optional
        What noise adds to heights (`msbdb.surface.noise`), metres; None where nothing, or where nobody knows.
    recorded : (H, W) ndarray of float32, optional
        How far later echoes were recorded (`msbdb.surface.cover.recorded_echoes`); None where they were everywhere.
    intensity : (H, W) ndarray of uint8, optional
        That of the first echoes in steps of its logarithm (`msbdb.spectral.colours.kept_intensity`); None where the
        points have none.
    """

    survey: Survey
    heights: Grid
    cover: Cover
    evidence: Evidence | None
    elevations: Elevations = field(default_factory=Elevations)
    parcels: Labels | None = None
    surface: Surface | None = None
    cloud: PointCloud | None = None
    bands: Bands | None = None
    above: NDArray[np.float64] | None = None
    noise_m: NDArray[np.float32] | None = None
    recorded: NDArray[np.float32] | None = None
    intensity: NDArray[np.uint8] | None = None

    def require_surface(self) -> Surface:
        """Return the surface.

        Raises
        ------
        InputError
            When the scene was read back from a database, which keeps no surface.
        """
        if self.surface is None:
            msg = (
                f"The survey '{self.survey.name}' was read from a database, which keeps no surface. "
                "Detect buildings from its source files."
            )
            raise InputError(msg)
        return self.surface

    def require_cloud(self) -> PointCloud:
        """Return the points.

        Raises
        ------
        InputError
            When the scene has none.
        """
        if self.cloud is None:
            msg = f"The survey '{self.survey.name}' has no points; give its LAS or LAZ files."
            raise InputError(msg)
        return self.cloud

    def crowns(self, params: Params) -> NDArray[np.bool_] | None:
        """Return the crowns over roofs by colour and roughness, where the structure decides and there is evidence."""
        if self.evidence is None or self.cover.colours_decide:
            return None
        return self.cover.crowns(self.evidence.roughness_mm / np.float32(1000), params.cover.leaf_m)

    def with_points_aside(self) -> "Scene":
        """Return the scene with points that files hold, where memory is bounded (`msbdb.points.aside.set_aside`)."""
        return self if self.cloud is None else replace(self, cloud=self.cloud.aside())

    def without_sources(self) -> "Scene":
        """Return the scene without surface, points and bands, which no step after the detectors needs."""
        return replace(self, surface=None, cloud=None, bands=None, above=None, noise_m=None, recorded=None)


@dataclass(frozen=True, slots=True, eq=False)
class Regions:
    """What one detector found in a scene.

    Parameters
    ----------
    method : str
        Name of the detector.
    labels : (H, W) ndarray of int32
        0 for none, otherwise row number + 1 in ``table``.
    table : GeoDataFrame
        ``tables.FLAT_REGION``, ``tables.CANDIDATE_REGION`` or, of the multi-scale detector, the roots of
        ``tables.PART``; in order of the ids, except for the roots.
    ledger : DataFrame
        ``tables.REJECTION`` without geometry: a row for each region that a stage dropped. Regions smaller than
        ``fuse.piece_m2`` are only counted later, and have the id 0.
    counts : dict
        By stage: regions ``in`` (with the ``pieces`` that the stage cut itself, less those it joined), ``kept`` and
        ``dropped``.
    of_points : (N,) ndarray of int32, optional
        Labels of the points, of a detector that takes the points themselves.
    forest : Forest, optional
        The tree of parts over the scales, of the multi-scale detector.
    answers : (H, W) ndarray of uint8, optional
        Which stage dropped a cell, and why (`msbdb.ledger.Ledger.marked`); None where that is not known.
    counted : DataFrame, optional
        ``tables.REJECTION_COUNT`` of regions read back from a database, in which small dropped regions have no row.
    """

    method: str
    labels: NDArray[np.int32]
    table: gpd.GeoDataFrame | pd.DataFrame
    ledger: pd.DataFrame
    counts: dict[str, dict[str, int]]
    of_points: NDArray[np.int32] | None = None
    forest: Forest | None = None
    answers: Answers | None = None
    counted: pd.DataFrame | None = None
