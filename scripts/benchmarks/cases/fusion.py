"""What the fusion takes of a case, so that variants of it can be judged without the detectors."""

import pickle
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cases.labelled import Reference
from cases.measures import Case, detected
from msbdb.detect.scene import Evidence, Regions
from msbdb.fuse.cells import fuse_cells
from msbdb.fuse.probability import mean_support, refused_objects
from msbdb.grid import Grid
from msbdb.labels import Labels, label_zones, sizes
from msbdb.params import FuseParams

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Seen:
    """What the detectors found in a case, and the heights and the roughness beneath."""

    heights: Grid
    evidence: Evidence | None
    covered: Mapping[str, Mask]
    """By detector: the cells that it takes."""
    mask_m: float
    green: Mask
    """Cells of the colour of vegetation."""
    of_points: bool = True
    coloured: bool = False

    def fused(self, params: FuseParams, without: str = "") -> Mask:
        """Return the cells that the detectors decide together, or all but one of them."""
        regions = {
            name: Regions(name, cells.astype(np.int32), None, None, {})
            for name, cells in self.covered.items()
            if name != without
        }
        return fuse_cells(
            self.heights,
            regions,
            params,
            mask_m=self.mask_m,
            of_points=self.of_points,
            coloured=self.coloured,
            evidence=self.evidence,
            green=self.green,
        )


@dataclass(frozen=True)
class Islands:
    """The islands of fused cells that are scored, and the refused objects that are.

    Parameters
    ----------
    kept : (N,) ndarray of bool
        Whether it is an island of fused cells; the others are refused objects.
    support : (N,) ndarray of float64
        Mean share that the detectors cover.
    true : (N,) ndarray of bool
        Whether the reference covers half of the scored cells.
    area_m2 : (N,) ndarray of float64
        Of all cells.
    """

    kept: Mask
    support: NDArray[np.float64]
    true: Mask
    area_m2: NDArray[np.float64]


def seen(case: Case, ground: str, folder: Path | None) -> Seen:
    """Run the detectors on a case, or read what an earlier run kept in a folder."""
    kept = None if folder is None else folder / f"{case.name}, {ground}.pickle"
    if kept is not None and kept.exists():
        found: Seen = pickle.loads(kept.read_bytes())
        return found
    scene, regions, params = detected(case, ground)
    covered = {name: one.labels > 0 for name, one in regions.items()}
    green, coloured = scene.cover.colours.labelled("vegetation"), scene.cover.spectral is not None
    found = Seen(
        scene.heights, scene.evidence, covered, params.surface.mask_m, green, scene.elevations.of_points, coloured
    )
    if kept is not None:
        kept.parent.mkdir(parents=True, exist_ok=True)
        kept.write_bytes(pickle.dumps(found))
    return found


def islands_of(fused: Mask, found: Seen, reference: Reference, params: FuseParams) -> Islands:
    """Return the islands and the refused objects of which half is scored, with their support and their truth."""
    kept = _judged(*label_zones(fused), True, found, reference)
    refused = refused_objects(found.heights, fused, params, mask_m=found.mask_m)
    both = kept, _judged(*refused, False, found, reference)
    return Islands(*(np.concatenate([getattr(one, each.name) for one in both]) for each in fields(Islands)))


def _judged(labels: Labels, count: int, kept: bool, found: Seen, reference: Reference) -> Islands:
    """Judge labelled objects."""
    spec = found.heights.spec
    cells = sizes(labels, count)
    support = mean_support(labels, count, found.covered.values())
    there = reference.sampled(labels, spec)
    scored, built = sizes(there[reference.scored], count), sizes(there[reference.scored & reference.built], count)
    area_m2 = cells * spec.cell_area_m2
    judged = (2 * scored * reference.spec.cell_area_m2 >= area_m2) & (scored > 0)
    return Islands(np.full(count, kept)[judged], support[judged], (2 * built >= scored)[judged], area_m2[judged])
