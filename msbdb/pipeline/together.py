"""Footprints of parts and flat regions together in a build: each cell's evidence, and the buildings' labels."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msbdb.extract.multiscale.forest import Forest
from msbdb.grid import Grid
from msbdb.inventory.fuse import RoofEvidence, fuse_footprints
from msbdb.labels import reorder
from msbdb.params import Params
from msbdb.pipeline.flat import Flat
from msbdb.surface import Structure

MOST_MM = np.iinfo(np.uint16).max
PARTS_OF_ONE = np.iinfo(np.uint8).max


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


@dataclass(frozen=True, slots=True, eq=False)
class Together:
    """The fused footprints of a build, and what is needed to fuse them anew.

    Parameters
    ----------
    labels : (H, W) ndarray of int32
        0 for none, otherwise row number + 1 in the buildings in order of their ids. A building may have no cell left.
    evidence : Evidence
        On the same lattice.
    """

    labels: NDArray[np.int32]
    evidence: Evidence

    def state(self) -> dict[str, NDArray[np.generic]]:
        """Return the rasters to keep."""
        return {
            "together": self.labels,
            "roughness_mm": self.evidence.roughness_mm,
            "roof_probability": self.evidence.roof_probability,
        }


def keep_evidence(structure: Structure) -> Evidence:
    """Round the evidence to what the database keeps, so that a build and what is done anew from it are the same."""
    millimetres = np.clip(np.rint(structure.roughness_m * np.float32(1000)), 0, MOST_MM)
    share = np.rint(structure.roof_probability * np.float32(PARTS_OF_ONE))
    return Evidence(millimetres.astype(np.uint16), share.astype(np.uint8))


def fuse(forest: Forest, flat: Flat, evidence: Evidence | None, heights: Grid, params: Params) -> Together | None:
    """Fuse the footprints of a build; None where it has no evidence.

    Parameters
    ----------
    forest : Forest
        The parts; empty where none were sought.
    flat : Flat
        The flat regions.
    evidence : Evidence, optional
        Of a build by both extractors.
    heights : Grid
        Heights above ground, metres.
    params : Params
        Section ``fuse``, and what `msbdb.inventory.fuse.fuse_footprints` reads beside it.
    """
    if evidence is None:
        return None
    plain = RoofEvidence(
        heights,
        evidence.roughness_mm.astype(np.float32) / np.float32(1000),
        evidence.roof_probability.astype(np.float32) / np.float32(PARTS_OF_ONE),
    )
    labels = fuse_footprints(forest.root_labels, flat.firm_labels, plain, params)
    parts = forest.parts
    roots = np.flatnonzero((parts["supid"] == 0).to_numpy())
    roots = roots[np.argsort(parts["part_id"].to_numpy()[roots])]
    return Together(reorder(labels, roots, len(parts)), evidence)
