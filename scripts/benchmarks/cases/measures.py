"""What a build of a case is worth: each detector and their fusion, on the ground of its own and on others."""

import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import laspy
import numpy as np
from numpy.typing import NDArray
from simulated.files import write_image

from cases.copies import with_class_alone
from cases.labelled import Objects, Reference
from cases.othergrounds import OTHER_GROUNDS
from cases.rasters import as_rasters
from msbdb.detect.scene import Scene
from msbdb.grid import GridSpec
from msbdb.params import DETECTORS, Params, profile, with_values
from msbdb.parts.forest import Forest
from msbdb.points.cloud import GROUND_CLASS, UNCLASSIFIED_CLASS
from msbdb.run.compose import Regions, detect, fuse_and_decompose
from msbdb.run.inputs import Inputs
from msbdb.run.preparation.drafts import read_cloud
from msbdb.run.preparation.pointfacts import sparse_with_facts
from msbdb.run.preparation.prepare import Label, prepare
from msbdb.run.reports import Notices, Stages, collect_notices

GIVEN = "class 2"
"""The ground of the given classes."""

OWN = "walls"
"""The ground of the default values."""

Value = float | str | Objects | None


@dataclass(frozen=True)
class Case:
    """Points to build from, and what is building there."""

    name: str
    crs: str
    clouds: list[laspy.LasData]
    reference: Reference
    known: dict[str, Value]
    """What its row says beforehand."""
    raster_m: float = 0.0
    """Cells of the rasters that are made of the points, metres; 0 builds from the points."""
    gaps: bool = False
    """Whether cells of the rasters without an echo have no value."""
    ortho: tuple[Path, ...] = ()
    """Orthophotos beside the points or the rasters."""
    picture: tuple[NDArray[np.floating], GridSpec] | None = None
    """A picture in place of orthophotos: red, green and blue, (3, H, W) from 0 to 255, and its lattice."""


def measure(case: Case, grounds: tuple[str, ...]) -> dict[str, Value]:
    """Build a case on each ground, and compare what is found.

    Returns
    -------
    dict
        Density; quality by area, per cent, of each detector and of the buildings on the ground of the default values,
        and of the buildings on each other ground; objects found and true; seconds.
    """
    begun = time.perf_counter()
    row: dict[str, Value] = {"case": case.name, **case.known}
    for ground in grounds:
        scene, regions, forest = build(case, ground)
        spec, built = scene.heights.spec, forest.root_labels > 0
        quality = case.reference.quality(built, spec)
        if ground == OWN:
            row |= {"density": scene.survey.density}
            row |= {name: case.reference.quality(found.labels > 0, spec) for name, found in regions.items()}
            row |= {"buildings": quality, "found": case.reference.found_objects(built, spec)}
            row |= {"true": case.reference.true_objects(built, spec)}
        else:
            row[ground] = quality
    return {**row, "seconds": time.perf_counter() - begun}


def build(case: Case, ground: str) -> tuple[Scene, dict[str, Regions], Forest]:
    """Build a case by the default values on a ground, without any other class than that of the ground."""
    scene, regions, params = detected(case, ground)
    with collect_notices(Notices()):
        return scene, regions, fuse_and_decompose(scene, regions, params, Stages(None)).forest


def on_ground(clouds: Sequence[laspy.LasData], ground: str) -> tuple[list[laspy.LasData], str]:
    """Return copies with no other class than that of a given ground or of another method's, and the filter to use."""
    copies = [with_class_alone(cloud, GROUND_CLASS if ground == GIVEN else None) for cloud in clouds]
    if ground in OTHER_GROUNDS:
        for cloud, mask in zip(copies, OTHER_GROUNDS[ground](copies), strict=True):
            cloud.classification = np.where(mask, GROUND_CLASS, UNCLASSIFIED_CLASS).astype(np.uint8)
    return copies, "class2" if ground == GIVEN or ground in OTHER_GROUNDS else ground


def detected(
    case: Case, ground: str, values: Mapping[str, Any] = MappingProxyType({})
) -> tuple[Scene, dict[str, Regions], Params]:
    """Run the detectors on a case by the default values, or by some others, and return the values for the later steps.

    The ground is that of a filter of ours, of the given classes, or of another method, whose points count as class 2.
    """
    clouds, own = on_ground(case.clouds, ground)
    params = with_values(with_values(profile(), values), {"ground": {"ground_filter": own}})
    with tempfile.TemporaryDirectory() as name, collect_notices(Notices()):
        folder = Path(name)
        files = tuple(folder / f"{number}.las" for number in range(len(clouds)))
        for file, cloud in zip(files, case.clouds if case.raster_m else clouds, strict=True):
            cloud.write(file)
        inputs = Inputs(points=files, crs=case.crs)
        if case.raster_m:
            inputs = as_rasters(files, case.crs, case.raster_m, folder, gaps=case.gaps)
        ortho = case.ortho
        if case.picture is not None:
            ortho = (write_image(folder / "ortho.tif", *case.picture, ("red", "green", "blue")),)
        inputs = replace(inputs, ortho=ortho, ortho_crs=case.crs if ortho else None)
        stages = Stages(None)
        points = sparse_with_facts(read_cloud(inputs, None), params)
        scene, params, _ = prepare(inputs, points, params, stages, Label(case.name))
        return scene, detect(scene, DETECTORS, params, stages), params
