"""The kinds of cases: the places as they are, and copies of another density, with noise, other echoes, over hills or under trees."""

import itertools
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import laspy
import numpy as np
from pyproj import CRS
from simulated.hills import RELIEFS, Relief, lifted, relief_of
from simulated.scrub import PLANTS, overgrown
from simulated.trees import crowns_of, planted

from cases.copies import (
    copied,
    first_only,
    mirrored,
    of_two_sensors,
    of_two_strips,
    on_lines,
    pulses,
    razed,
    seen_from_aside,
    shaken,
    taken,
    thickened,
    thinned,
    thinned_east_of,
    with_echoes_apart,
    with_echoes_on_walls,
    with_fewer_later,
    with_outliers,
)
from cases.labelled import NAMED, PLACES, Place, cell_for, first_density, reference_of
from cases.measures import Case
from msbdb.grid import lattice
from msbdb.ground.choice import terrain
from msbdb.io.las import read_points
from msbdb.params import GroundParams

DENSITIES = (8.0, 4.0, 2.0, 1.0, 0.5, 0.3)
"""First echoes a square metre of the thinned copies."""

FEW = (1.0, 0.5, 0.3)
"""First echoes a square metre of the thinned copies that have no others."""

LATER, APART_M = (0.5, 0.3, 0.1), 5.0
"""Shares of the pulses that keep later echoes, and the least distance of the echoes of a pulse, metres."""

WEAK, WEAK_APART_M, WEAK_M2 = (0.5, 0.1), 2.5, (2.0, 1.0)
"""Shares and distance as those above, and first echoes a square metre, of thinned copies by weaker sensors."""

RASTERS = (0.5, 1.0, 2.0)
"""Cells of the rasters, metres."""

LINES = (3.0, 5.0, 8.0)
"""Distance of scan lines, in the spacings of the points along them."""

UNEVEN = (3.0, 5.0, 8.0)
"""How many times denser the western half of an uneven copy is."""

NOISE = {
    "height": partial(shaken, height_m=0.1),
    "plan": partial(shaken, plan_m=0.2),
    "strips": partial(of_two_strips, aside_m=0.3, up_m=0.1),
    "outliers": partial(with_outliers, share=0.005, low_m=10, high_m=50),
}
"""The kinds of noisy copies: standard deviations in metres, a shift of half of the pulses, and a share of outliers."""

WALLS = (0.1, 0.3)
"""Echoes a square metre of wall, per first echo a square metre of ground, in copies by oblique sensors."""

ASIDE, AZIMUTH_DEG = (0.36, 0.7), 70.0
"""Tangents of the angles of view of single strips, of 20 and 35 degrees, and where their sensor flies."""

THINNED = ("delft_1", "delft_2", "montpellier", "beziers_right", "amsterdam", "sevilla_plaza", "champs")

DENSE, DENSE_M2 = ("delft_2", "montpellier", "champs"), 66.0
"""The places of which there are dense copies, and about how many first echoes a square metre these have."""

LIFTED = ("delft_2", "montpellier", "amsterdam", "sevilla_plaza", "beziers_right")

PLANTED = ("delft_1", "delft_2", "montpellier", "beziers_left", "beziers_right", "amsterdam")
"""The places with classes of ground and of roofs, beside which trees are planted."""

LARGER = "amsterdam"
"""The place whose blocks go on over mirrored edges."""

CROWNS, A_HECTARE = ("montpellier", "champs"), 100.0
"""The places whose crowns are planted elsewhere, and how many of them a hectare."""

VILLAGES, LEFT, MANY = ("delft_1", "amsterdam", "sevilla_plaza"), 0.15, 250.0
"""The places of which this share of the roofs stays as villages, and the most trees a hectare there."""

OVERGROWN = ("delft_1", "delft_2", "montpellier", "beziers_left", "beziers_right", "amsterdam", "guldheden_east")
"""The places with class 2 on whose ground low plants grow."""

WOODED_M2 = (1.0, 0.5)
"""First echoes a square metre of the thinned copies of wooded hills."""

WINDOW_M = 300.0
"""Of a larger place only so much of the south-western corner is laid over hills."""

KNOLLS = "guldheden_east"
"""The place whose terrain is used as wooded knolls."""


def as_they_are(data: Path, names: set[str]) -> Iterator[Case]:
    """Yield the places."""
    for place in PLACES:
        if place.name in names:
            clouds = place.read(data)
            reference = reference_of(place, clouds, data, cell_for(first_density(clouds)))
            yield Case(place.name, place.crs, clouds, reference, {"pdal": place.pdal, "whitebox": place.whitebox})


def with_fewer_pulses(data: Path, names: set[str], densities: tuple[float, ...] = DENSITIES) -> Iterator[Case]:
    """Yield thinned copies of places; the reference is made of all points."""
    for name in THINNED:
        if name not in names:
            continue
        place = NAMED[name]
        clouds = place.read(data)
        density = first_density(clouds)
        for target in densities:
            if target < density:
                copies = [thinned(cloud, target / density) for cloud in clouds]
                reference = reference_of(place, clouds, data, cell_for(target))
                yield Case(f"{name}, {target:g}", place.crs, copies, reference, {})


def with_more_points(data: Path, names: set[str]) -> Iterator[Case]:
    """Yield copies of places as dense as the densest surveys."""
    for case in as_they_are(data, names & set(DENSE)):
        density = first_density(case.clouds)
        copies = [thickened(cloud, DENSE_M2, density) for cloud in case.clouds]
        yield Case(f"{case.name}, {DENSE_M2:g}", case.crs, copies, case.reference, {})


def with_scan_lines(data: Path, names: set[str]) -> Iterator[Case]:
    """Yield copies of places in which points are far denser along scan lines than across."""
    for case in as_they_are(data, names & set(THINNED)):
        spacing_m = first_density(case.clouds) ** -0.5
        for ratio in LINES:
            copies = [on_lines(cloud, ratio, spacing_m) for cloud in case.clouds]
            yield Case(f"{case.name}, {ratio:g}", case.crs, copies, case.reference, {})


def with_sparse_halves(data: Path, names: set[str]) -> Iterator[Case]:
    """Yield copies of places that are sparser in the east; the line halves the roofs of the reference."""
    for case in as_they_are(data, names & set(THINNED)):
        x_m = _middle(case)
        for times in UNEVEN:
            copies = [thinned_east_of(cloud, x_m, 1 / times) for cloud in case.clouds]
            yield Case(f"{case.name}, {times:g}", case.crs, copies, case.reference, {})


def with_noise(data: Path, names: set[str]) -> Iterator[Case]:
    """Yield copies of places as worse sensors would record them; the reference is that of the echoes as they are."""
    for case in as_they_are(data, names & set(THINNED)):
        for kind, noisy in NOISE.items():
            copies = [noisy(cloud) for cloud in case.clouds]
            yield Case(f"{case.name}, {kind}", case.crs, copies, case.reference, {})


def by_oblique_sensors(data: Path, names: set[str]) -> Iterator[Case]:
    """Yield copies of places with echoes on walls; the reference is that of the other echoes."""
    for case in as_they_are(data, names & set(THINNED)):
        density = first_density(case.clouds)
        for share in WALLS:
            copies = [with_echoes_on_walls(cloud, share, density) for cloud in case.clouds]
            yield Case(f"{case.name}, {share:g}", case.crs, copies, case.reference, {})


def by_single_strips(data: Path, names: set[str]) -> Iterator[Case]:
    """Yield copies of places without what buildings hide from a strip that looks aside; the reference is of what is left."""
    for case in as_they_are(data, names & set(THINNED)):
        for slope in ASIDE:
            copies = [seen_from_aside(cloud, slope, AZIMUTH_DEG) for cloud in case.clouds]
            reference = reference_of(NAMED[case.name], copies, data, case.reference.spec.cell_m)
            degrees = np.degrees(np.arctan(slope))
            yield Case(f"{case.name}, {degrees:.0f} degrees", case.crs, copies, reference, {})


def with_first_echoes(data: Path, names: set[str]) -> Iterator[Case]:
    """Yield copies of places as a sensor of one echo records them, each place once."""
    for case in as_they_are(data, {name for name in names if not name.endswith("cadastre")}):
        yield Case(case.name, case.crs, [first_only(cloud) for cloud in case.clouds], case.reference, {})


def with_few_later_echoes(data: Path, names: set[str]) -> Iterator[Case]:
    """Yield copies of places as a weaker sensor records them, and as one that separates only echoes far apart."""
    for case in as_they_are(data, {name for name in names if not name.endswith("cadastre")}):
        yield from _by_weaker_sensors(case, LATER, APART_M)


def with_few_pulses_and_later_echoes(data: Path, names: set[str]) -> Iterator[Case]:
    """Yield thinned copies of places as weaker sensors record them."""
    for case in with_fewer_pulses(data, names, WEAK_M2):
        yield from _by_weaker_sensors(case, WEAK, WEAK_APART_M)


def _by_weaker_sensors(case: Case, shares: tuple[float, ...], apart_m: float) -> Iterator[Case]:
    """Yield copies of a case with shares of the later echoes, and with echoes so far apart where pulses are known."""
    for share in shares:
        copies = [with_fewer_later(cloud, share) for cloud in case.clouds]
        yield Case(f"{case.name}, {share:g}", case.crs, copies, case.reference, {})
    if all(len(np.unique(pulses(cloud))) < len(cloud.points) for cloud in case.clouds):
        copies = [with_echoes_apart(cloud, apart_m) for cloud in case.clouds]
        yield Case(f"{case.name}, {apart_m:g} m apart", case.crs, copies, case.reference, {})


def with_two_sensors(data: Path, names: set[str]) -> Iterator[Case]:
    """Yield copies of places of which a weaker sensor recorded the west; the line halves the roofs of the reference."""
    for case in as_they_are(data, {name for name in names if not name.endswith("cadastre")}):
        x_m = _middle(case)
        weaker = {"first": first_only, "0.1": partial(with_fewer_later, share=0.1)}
        for kind, recorded in weaker.items():
            copies = [of_two_sensors(cloud, recorded(cloud), x_m) for cloud in case.clouds]
            yield Case(f"{case.name}, {kind}", case.crs, copies, case.reference, {})


def _middle(case: Case) -> float:
    """Return the easting that halves the roofs of the reference."""
    spec, roofs = case.reference.spec, case.reference.built & case.reference.scored
    return float(spec.xy(0, np.median(np.nonzero(roofs)[1]))[0])


def with_few_first_echoes(data: Path, names: set[str]) -> Iterator[Case]:
    """Yield thinned copies of places as a sensor of one echo records them."""
    for case in with_fewer_pulses(data, names, FEW):
        yield Case(case.name, case.crs, [first_only(cloud) for cloud in case.clouds], case.reference, {})


def on_rasters(data: Path, names: set[str]) -> Iterator[Case]:
    """Yield places as rasters of heights: a surface of the highest first echoes, and a terrain through class 2."""
    for case in as_they_are(data, names & set(THINNED)):
        for cell_m in RASTERS:
            reference = reference_of(NAMED[case.name], case.clouds, data, max(case.reference.spec.cell_m, cell_m))
            yield Case(f"{case.name}, {cell_m:g} m", case.crs, case.clouds, reference, {}, raster_m=cell_m)


def on_rasters_with_gaps(data: Path, names: set[str]) -> Iterator[Case]:
    """Yield places as rasters of heights in which cells without an echo have no value."""
    for case in on_rasters(data, names):
        yield replace(case, gaps=True)


def over_hills(data: Path, names: set[str]) -> Iterator[Case]:
    """Yield towns that are laid over other relief."""
    hills = reliefs(data)
    for name in LIFTED:
        if name in names:
            place = NAMED[name]
            clouds = [south_west(cloud, WINDOW_M) for cloud in place.read(data)]
            reference = reference_of(place, clouds, data, cell_for(first_density(clouds)))
            for kind, relief in hills.items():
                laid = [laid_over(cloud, relief) for cloud in clouds]
                yield Case(f"{name}, {kind}", place.crs, laid, reference, {})


def under_trees(data: Path, names: set[str]) -> Iterator[Case]:
    """Yield towns with trees of other places beside and over their houses, with all echoes and with first ones only."""
    for case in as_they_are(data, names & set(PLANTED)):
        density = first_density(case.clouds)
        for donor in CROWNS:
            if donor == case.name:
                continue
            clouds = _with_trees(case.clouds, density, donor, A_HECTARE, data)
            reference = reference_of(NAMED[case.name], clouds, data, case.reference.spec.cell_m)
            yield Case(f"{case.name}, {donor}", case.crs, clouds, reference, {})
            firsts = [first_only(cloud) for cloud in clouds]
            yield Case(f"{case.name}, {donor}, first", case.crs, firsts, reference, {})


def villages(data: Path, names: set[str]) -> Iterator[Case]:
    """Yield towns of which few houses are left, under many trees: with all echoes, with few later ones, and with few pulses."""
    for case in as_they_are(data, names & set(VILLAGES)):
        density = first_density(case.clouds)
        few = [razed(cloud, LEFT) for cloud in case.clouds]
        for donor, per_hectare in itertools.product(CROWNS, (A_HECTARE, MANY)):
            clouds = _with_trees(few, density, donor, per_hectare, data)
            weaker = {
                "": (density, copied),
                ", a tenth": (density, partial(with_fewer_later, share=0.1)),
                ", 2": (2.0, partial(thinned, share=2 / density)),
                ", 1": (1.0, partial(thinned, share=1 / density)),
            }
            for kind, (target, recorded) in weaker.items():
                reference = reference_of(NAMED[case.name], clouds, data, cell_for(target))
                copies = [recorded(cloud) for cloud in clouds]
                yield Case(f"{case.name}, {donor}, {per_hectare:g}{kind}", case.crs, copies, reference, {})


def with_low_plants(data: Path, names: set[str]) -> Iterator[Case]:
    """Yield towns with scrub, hedges and crops on their bare ground; the reference is that of the echoes as they are."""
    for case in as_they_are(data, names & set(OVERGROWN)):
        for kind in PLANTS:
            copies = [overgrown(cloud, kind) for cloud in case.clouds]
            yield Case(f"{case.name}, {kind}", case.crs, copies, case.reference, {})


def over_wooded_hills(data: Path, names: set[str]) -> Iterator[Case]:
    """Yield villages under many trees that are laid over relief: with all echoes, first ones alone, and few pulses."""
    hills = reliefs(data)
    for name in (each for each in VILLAGES if each in names):
        place = NAMED[name]
        few = [razed(south_west(cloud, WINDOW_M), LEFT) for cloud in place.read(data)]
        density = first_density(few)
        fewer = {f", {target:g}": (target, partial(thinned, share=target / density)) for target in WOODED_M2}
        recorded = {"": (density, copied), ", first": (density, first_only)} | fewer
        for donor in CROWNS:
            clouds = _with_trees(few, density, donor, MANY, data)
            for (hill, relief), (kind, (target, record)) in itertools.product(hills.items(), recorded.items()):
                reference = reference_of(place, clouds, data, cell_for(target))
                copies = [record(laid_over(cloud, relief)) for cloud in clouds]
                yield Case(f"{name}, {donor}, {hill}{kind}", place.crs, copies, reference, {})


def _with_trees(
    clouds: list[laspy.LasData], density: float, donor: str, per_hectare: float, data: Path
) -> list[laspy.LasData]:
    """Return copies with trees of another place, of as many first echoes a square metre as there are."""
    [trees] = NAMED[donor].read(data)
    crowns = crowns_of(trees, min(1.0, density / first_density([trees])))
    return [planted(cloud, crowns, per_hectare) for cloud in clouds]


def mirrored_town(data: Path, names: set[str]) -> Iterator[Case]:
    """Yield a dense town at four and nine times its area: what touches goes on over the mirrored edges."""
    for case in as_they_are(data, names & {LARGER}):
        for times in (2, 3):
            clouds = [mirrored(cloud, times) for cloud in case.clouds]
            reference = reference_of(NAMED[LARGER], clouds, data, case.reference.spec.cell_m)
            yield Case(f"{case.name}, {times}² times", case.crs, clouds, reference, {})


def reliefs(data: Path) -> dict[str, Relief]:
    """Return the reliefs that towns are laid over."""
    return {name: relief for name, relief in RELIEFS.items() if name != "waves"} | {"knolls": knolls(data)}


def knolls(data: Path) -> Relief:
    """Return the relief of the knolls, by their class 2."""
    place: Place = NAMED[KNOLLS]
    points = read_points([data / file for file in place.files], crs=CRS.from_user_input(place.crs))
    spec = lattice(points.bounds, 1.0, points.crs)
    return relief_of(terrain(points, spec, GroundParams(ground_filter="class2"))[0])


def south_west(cloud: laspy.LasData, side_m: float) -> laspy.LasData:
    """Return the points of a square at the south-western corner."""
    x, y = np.asarray(cloud.x), np.asarray(cloud.y)
    return taken(cloud, (x < x.min() + side_m) & (y < y.min() + side_m))


def laid_over(cloud: laspy.LasData, relief: Relief) -> laspy.LasData:
    """Return a copy whose points are lifted onto a relief."""
    copy = copied(cloud)
    x, y, z = (np.asarray(cloud[axis], dtype=np.float64) for axis in "xyz")
    copy.z = lifted(x, y, z, np.asarray(cloud.classification), relief)
    return copy
