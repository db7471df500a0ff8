"""The list of detectors; a fifth one is one module and one line here."""

from collections.abc import Callable
from dataclasses import dataclass

from msbdb.detect.adaptive.bathurst import detect_adaptive
from msbdb.detect.area3d.caowu import detect_area3d
from msbdb.detect.flatregions.mongus2013 import detect_flat_regions
from msbdb.detect.multiscale.vu2009 import detect_multiscale
from msbdb.detect.scene import Regions, Scene
from msbdb.params import Params


@dataclass(frozen=True, slots=True)
class Detector:
    """A way to detect buildings, independent of the others.

    Parameters
    ----------
    name : str
        Its name on the command line and in the database.
    detect : callable
        From a scene and parameters to regions.
    takes_points : bool
        Whether it needs the points; the others take rasters.
    """

    name: str
    detect: Callable[[Scene, Params], Regions]
    takes_points: bool = False


DETECTORS = {
    detector.name: detector
    for detector in (
        Detector("adaptive", detect_adaptive, takes_points=True),
        Detector("area3d", detect_area3d, takes_points=True),
        Detector("flatregions", detect_flat_regions),
        Detector("multiscale", detect_multiscale),
    )
}
"""By name, in alphabetical order."""
