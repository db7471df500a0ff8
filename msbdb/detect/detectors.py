"""The detectors: the list of them, and the multi-scale one, whose work is the tree of parts."""

from collections.abc import Callable

import numpy as np

from msbdb.detect.adaptive.bathurst import detect_adaptive
from msbdb.detect.area3d.caowu import detect_area3d
from msbdb.detect.flatregions.mongus2013 import detect_flat_regions
from msbdb.detect.scene import Regions, Scene
from msbdb.params import Params
from msbdb.parts.tree import extract_parts


def detect_multiscale(scene: Scene, params: Params) -> Regions:
    """Detect buildings by structure and colours, and grow the tree of their parts: the detector ``multiscale``.

    Parameters
    ----------
    scene : Scene
        Heights above ground and land cover count; a scene that was read from a database has them as well.
    params : Params
        Sections ``surface``, ``scale``, ``granulometry`` and ``spectral``.

    Returns
    -------
    Regions
        The table has the roots among ``tables.PART``, without outlines; ``forest`` has all parts.
    """
    forest = extract_parts(
        scene.heights,
        scene.cover.classes,
        survey=scene.survey.name,
        params=params,
        colours=scene.cover.colours,
        crowns=scene.crowns(params),
    )
    is_root = (forest.parts["supid"] == 0).to_numpy()
    number = np.zeros(is_root.size + 1, dtype=np.int32)
    number[1:][is_root] = np.arange(1, np.count_nonzero(is_root) + 1)
    roots = forest.parts[is_root].reset_index(drop=True)
    return Regions("multiscale", number[forest.root_labels], roots, forest.rejections, forest.counts, forest=forest)


DETECTORS: dict[str, Callable[[Scene, Params], Regions]] = {
    "adaptive": detect_adaptive,
    "area3d": detect_area3d,
    "flatregions": detect_flat_regions,
    "multiscale": detect_multiscale,
}
"""From a scene and parameters to regions: each by its name on the command line and in the database, in that order."""
