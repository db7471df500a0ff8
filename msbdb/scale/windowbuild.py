"""The steps of a build in one window of a survey, in two halves: up to the parts, and what the database keeps of them.

After the first half it is known which cells are buildings, and so whether the window holds its islands of roofs whole.
The outlines of a window that is too narrow are never made.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msbdb.detect.scene import Regions, Scene
from msbdb.fuse.touching import Division
from msbdb.grid import Bounds, Grid
from msbdb.params import Params
from msbdb.parts.forest import Forest
from msbdb.points.cloud import PointCloud
from msbdb.run.compose import Job, counts_of, decompose, detect, divide_houses, fuse
from msbdb.run.describe import Description, describe, describe_choices
from msbdb.run.prepare import Window, note_missing_sources, prepare, read_cloud
from msbdb.run.reports import Stages
from msbdb.surveyplan import Plan
from msbdb.tables import Counts


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """What the steps found in a window of a survey.

    Parameters
    ----------
    scene : Scene
        Without its sources.
    description : Description
        Tables, rasters and counts.
    counts : Counts
        What the run keeps of them.
    points : int
        Points in the own ground of the window; of rasters, cells with a value.
    reach : tuple of float or None
        West, south, east and north of these points, or of all of these cells, metres; None without any.
    """

    scene: Scene
    description: Description
    counts: Counts
    points: int
    reach: Bounds | None


@dataclass(frozen=True, slots=True, eq=False)
class Decomposed:
    """A window of a survey whose cells are decided and divided into parts, but not described.

    Parameters
    ----------
    scene : Scene
        Without its sources.
    params : Params
        With the values of the plan.
    regions : mapping of str to Regions
        Of each detector that was run.
    built : (H, W) ndarray of bool or None
        The cells that the detectors take together; None where they do not decide together.
    division : Division or None
        The houses in these cells.
    forest : Forest
        The tree of parts.
    choices : dict
        What the run decided itself, as `msbdb.run.describe.describe_choices` returns it.
    points, reach : int, tuple of float or None
        As `Found` has them.
    """

    scene: Scene
    params: Params
    regions: Mapping[str, Regions]
    built: NDArray[np.bool_] | None
    division: Division | None
    forest: Forest
    choices: dict[str, object]
    points: int
    reach: Bounds | None

    @property
    def roofs(self) -> NDArray[np.bool_]:
        """The (H, W) cells of buildings: those to which the raster of reasons will give *building*."""
        roofs: NDArray[np.bool_] = self.forest.root_labels > 0
        return roofs

    def described(self, job: Job, stages: Stages) -> Found:
        """Return what the database keeps of the window: outlines, heights, evidence and rasters."""
        with stages.stage("outlines"):
            made = describe(
                self.scene, self.regions, self.forest, self.params, built=self.built, division=self.division
            )
        return Found(self.scene, made, counts_of(self.scene, made, job, self.choices), self.points, self.reach)


def decompose_window(job: Job, plan: Plan, window: Window, stages: Stages) -> Decomposed:
    """Take a window of a survey through all steps from reading to the tree of parts, one detector at a time.

    Parameters
    ----------
    job : Job
        What to do.
    plan : Plan
        The plan of the survey.
    window : Window
        The part that is built; the classes count the cells of its own ground alone.
    stages : Stages
        For timings and progress.

    Raises
    ------
    NodataError
        When the window has no points or heights.
    MsbdbError
        When the files cannot be used.
    """
    with stages.stage("read"):
        cloud = read_cloud(job.inputs, stages.progress, plan.points, window.area)
    scene, params, _ = prepare(job.inputs, cloud, job.params, stages, job.label, plan=plan, window=window)
    points, reach = _cells_in(scene.heights, window.own) if cloud is None else _held_by(cloud, window.own)
    del cloud
    scene = scene.with_points_aside()
    note_missing_sources(scene)
    choices = describe_choices(scene, params)
    regions = detect(scene, job.methods, params, stages, frugal=True)
    scene = scene.without_sources()
    built = fuse(scene, regions, params, stages)
    division = divide_houses(scene, built, params, stages)
    with stages.stage("parts"):
        forest = decompose(scene, regions, built, division, params)
    return Decomposed(scene, params, regions, built, division, forest, choices, points, reach)


def _held_by(cloud: PointCloud, own: Bounds) -> tuple[int, Bounds | None]:
    """Return how many points lie in bounds, and how far they reach; those on the west or south edge count."""
    west, south, east, north = own
    held = (cloud.x >= west) & (cloud.x < east) & (cloud.y >= south) & (cloud.y < north)
    if not held.any():
        return 0, None
    # Without copies of the coordinates, which would be the highest peak of all.
    (west, east), (south, north) = (
        (float(each.min(where=held, initial=np.inf)), float(each.max(where=held, initial=-np.inf)))
        for each in (cloud.x, cloud.y)
    )
    return int(np.count_nonzero(held)), (west, south, east, north)


def _cells_in(heights: Grid, own: Bounds) -> tuple[int, Bounds | None]:
    """Return how many cells with a value have their centre in bounds, and how far all cells there reach."""
    rows, cols = heights.spec.within(own)
    if rows.start == rows.stop:
        return 0, None
    return int(np.count_nonzero(heights.valid[rows, cols])), heights.spec.crop(rows, cols).bounds
