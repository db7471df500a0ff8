"""The CRS policy: from what a file states and what the user states to one metric CRS.

Coordinates leave this room in a projected CRS in metres. A CRS in feet is scaled exactly to its metric twin: EPSG's CRS
of the same datum, method and projection parameters. Without a twin it is reprojected to its UTM zone. So is a CRS whose
metres are none on the ground, as that of web maps. Heights in feet are scaled. A geographic CRS is refused, because
reprojecting is the user's decision.
"""

import copy
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS, Proj, Transformer
from pyproj.aoi import AreaOfInterest
from pyproj.database import query_utm_crs_info
from pyproj.enums import TransformDirection
from pyproj.exceptions import CRSError as ProjError

from msbdb.errors import CRSError, give_notice
from msbdb.grid import Bounds

Z_UNITS = {"m": 1.0, "ft": 0.3048, "us-ft": 1200 / 3937}
"""Metres in a unit of height; ft is the international foot, us-ft the US survey foot."""

PARAMETER_TOLERANCE = 1e-6
"""Largest misfit, in metres or degrees, at which two projection parameters still count as the same."""

MOST_STRETCH = 0.01
"""Ours: lengths on the map may differ by 1 % from those on the ground. CRSs for surveys stay below 0.3 %, equal-area
ones of a continent below 1 %; Pseudo-Mercator has 41 % at 45°."""

CORNERS = 21
"""Points on each side of a rectangle that is reprojected: its sides become curves."""

AREA_MARGIN_DEG = 1.0
"""How far beyond a CRS's area of use data may lie without a notice."""


@dataclass(frozen=True, slots=True)
class Fallback:
    """A CRS for files that state none, such as that of the database; others keep their own."""

    crs: CRS
    whose: str


CrsLike = CRS | str | int | Fallback


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """How a file's coordinates become metric ones.

    Parameters
    ----------
    crs : CRS
        The metric, projected, two-dimensional CRS of the result.
    vertical_crs : CRS, optional
        The heights' CRS in metres, where the file names one.
    source : CRS
        The file's own horizontal CRS.
    xy_factor, z_factor : float
        Metres in a unit of the file.
    transformer : Transformer, optional
        From ``source`` to ``crs``, where scaling is not enough.
    notices : tuple of str
        What was converted or assumed, without the file's name.
    """

    crs: CRS
    vertical_crs: CRS | None
    source: CRS
    xy_factor: float
    z_factor: float
    transformer: Transformer | None
    notices: tuple[str, ...]

    def to_metres(
        self, x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return easting, northing and height in metres; x, y and z are float64 in the file's units."""
        if self.transformer is not None:
            x, y = self.transformer.transform(x, y)
        elif self.xy_factor != 1.0:
            x, y = x * self.xy_factor, y * self.xy_factor
        return x, y, z if self.z_factor == 1.0 else z * self.z_factor

    def box_in_metres(self, box: Bounds) -> Bounds:
        """Return west, south, east and north of a rectangle in the file's units; infinite where it leaves the CRS."""
        return self._box(box, self.xy_factor, TransformDirection.FORWARD)

    def box_in_units(self, box: Bounds) -> Bounds:
        """Return those of a metric rectangle in the file's units."""
        return self._box(box, 1 / self.xy_factor, TransformDirection.INVERSE)

    def _box(self, box: Bounds, factor: float, direction: TransformDirection) -> Bounds:
        """Return the rectangle around another one."""
        if self.transformer is not None and np.isfinite(box).all():
            box = self.transformer.transform_bounds(*box, densify_pts=CORNERS, direction=direction)
        west, south, east, north = (value * factor for value in box)
        return west, south, east, north


def parse_crs(value: CrsLike) -> CRS:
    """Return the CRS of an EPSG number, a name, a WKT text or a CRS object.

    Raises
    ------
    CRSError
        If the value is not understood.
    """
    try:
        return canonical(CRS.from_user_input(value.crs if isinstance(value, Fallback) else value))
    except ProjError as error:
        msg = f"The CRS {value!r} is not known; give an EPSG code such as 2154 or EPSG:2154, or a WKT text."
        raise CRSError(msg) from error


def split_crs(crs: CRS) -> tuple[CRS, CRS | None]:
    """Return the horizontal and the vertical part of a CRS, without any attached datum shift."""
    if crs.is_bound and crs.source_crs is not None:
        return split_crs(crs.source_crs)
    if crs.is_compound:
        horizontal, *rest = crs.sub_crs_list
        return split_crs(horizontal)[0], rest[0] if rest else None
    return (crs.to_2d() if len(crs.axis_info) == 3 else crs), None


@lru_cache(maxsize=256)
def canonical(crs: CRS) -> CRS:
    """Return EPSG's own form of a CRS where it has one, so that equal CRSs compare as equal; else the CRS itself.

    A projected CRS of unknown datum that is named 'EPSG:n', and whose projection is that of EPSG:n, is EPSG:n.
    """
    if crs.is_compound:
        return crs
    crs = split_crs(crs)[0]
    code = crs.to_epsg()
    if code is not None:
        return CRS.from_epsg(code)
    named = re.fullmatch(r"EPSG:(\d+)", crs.name.strip(), flags=re.IGNORECASE)
    if named and has_unknown_datum(crs):
        try:
            candidate = CRS.from_epsg(int(named[1]))
        except ProjError:
            return crs
        return candidate if same_projection(crs, candidate) else crs
    return crs


def has_unknown_datum(crs: CRS) -> bool:
    """Whether the CRS has no known datum."""
    datum = crs.geodetic_crs.datum if crs.geodetic_crs else None
    return datum is None or datum.name.lower().startswith(("unknown", "unnamed", "not specified", "not_specified"))


def same_projection(one: CRS, other: CRS) -> bool:
    """Whether two projected CRSs have the same method, parameters and units, whatever their datum and names."""
    first, second = one.coordinate_operation, other.coordinate_operation
    if first is None or second is None or first.method_name != second.method_name:
        return False
    ours, theirs = ({p.name: float(p.value) * p.unit_conversion_factor for p in op.params} for op in (first, second))
    units = [[axis.unit_conversion_factor for axis in crs.axis_info[:2]] for crs in (one, other)]
    return (
        ours.keys() == theirs.keys()
        and all(abs(ours[name] - theirs[name]) <= PARAMETER_TOLERANCE for name in ours)
        and units[0] == units[1]
    )


def same_crs(one: CRS, other: CRS) -> bool:
    """Whether two horizontal CRSs are the same; one of unknown datum is the same as any of its projection."""
    if one == other or one.equals(other, ignore_axis_order=True):
        return True
    return (has_unknown_datum(one) or has_unknown_datum(other)) and same_projection(one, other)


def name_of(crs: CRS) -> str:
    """Return a CRS's name and EPSG code, for messages."""
    code = crs.to_epsg()
    return f"'{crs.name}'" + (f" (EPSG:{code})" if code else "")


def settle(found: CRS | None, stated: CrsLike | None, where: str) -> CRS:
    """Return the CRS of a file from what the file says and what the user states.

    Parameters
    ----------
    found : CRS, optional
        The file's own.
    stated : CRS, str, int or Fallback, optional
        The user's, for files that have none; a `Fallback` gives a notice where it is used.
    where : str
        The file's name, for messages.

    Raises
    ------
    CRSError
        If neither states one, or the two differ.
    """
    usable = found is not None and not split_crs(found)[0].is_engineering
    own = canonical(found) if found is not None and usable else None
    if stated is None:
        if own is None:
            said = f" (its header has only '{found.name}')" if found is not None else ""
            msg = f"{where} states no CRS{said}. State it with --crs, for instance --crs EPSG:2154."
            raise CRSError(msg)
        return own
    wanted = parse_crs(stated)
    if own is None and isinstance(stated, Fallback):
        msg = f"{where} states no CRS; that of {stated.whose} is used, {name_of(wanted)}. State another with --crs."
        give_notice(msg)
    if own is None:
        return wanted
    if isinstance(stated, Fallback):
        return own
    (mine, my_heights), (yours, your_heights) = split_crs(own), split_crs(wanted)
    heights_differ = my_heights is not None and your_heights is not None and my_heights != your_heights
    if heights_differ or not same_crs(canonical(mine), canonical(yours)):
        msg = (
            f"{where} has the CRS {name_of(own)}, but {name_of(wanted)} was stated. "
            "Leave --crs out to trust the file, or correct the file's header."
        )
        raise CRSError(msg)
    says_more = has_unknown_datum(mine) or (my_heights is None and your_heights is not None)
    return wanted if says_more else own


def reference(
    crs: CRS,
    *,
    bounds: Bounds,
    where: str,
    z_unit: str = "auto",
    z_hint: str | None = None,
    what: str = "points",
    target: CRS | None = None,
    resampled: bool = False,
) -> Reference:
    """Return how coordinates in a settled CRS become metric ones (see the module's head for the rules).

    Parameters
    ----------
    crs : CRS
        The settled CRS; may be compound.
    bounds : tuple of float
        West, south, east and north in the file's units, from which a UTM zone is found.
    where, what : str
        The file's name and what it holds, for messages.
    z_unit : {'auto', 'm', 'ft', 'us-ft'}
        Unit of the heights. 'auto' takes the vertical CRS's, else ``z_hint``, else that of a CRS in feet, else metres.
    z_hint : {'m', 'ft', 'us-ft'}, optional
        Unit that the file states apart from its CRS.
    target : CRS, optional
        A metric CRS for coordinates that must be reprojected, such as the database's; by default their UTM zone.
    resampled : bool
        The data will be brought onto the lattice of others, so that no length is measured in their own CRS.

    Raises
    ------
    CRSError
        If the CRS is geographic, not projected at all, or in a unit for which there is no rule.
    """
    horizontal, vertical = split_crs(crs)
    horizontal = canonical(horizontal)
    if horizontal.is_geographic:
        msg = (
            f"The {what} of {where} are in degrees, {name_of(horizontal)}. Reproject them first, for instance to "
            f"{name_of(utm_zone(horizontal, bounds))}, with 'pdal translate' and filters.reprojection, or gdalwarp."
        )
        raise CRSError(msg)
    if not horizontal.is_projected:
        msg = f"The {what} of {where} have the CRS {name_of(horizontal)}, which is not projected. Reproject them first."
        raise CRSError(msg)
    factor = float(horizontal.axis_info[0].unit_conversion_factor)
    notices: list[str] = []
    z_factor = _height_factor(vertical, factor, z_unit, z_hint, notices)
    metric, transformer = _metric_crs(horizontal, bounds, target, notices, resampled=resampled)
    return Reference(
        crs=metric,
        vertical_crs=None if vertical is None else metric_vertical(vertical),
        source=horizontal,
        xy_factor=factor if transformer is None else 1.0,
        z_factor=z_factor,
        transformer=transformer,
        notices=tuple(notices),
    )


def _metric_crs(
    crs: CRS, bounds: Bounds, target: CRS | None, notices: list[str], *, resampled: bool
) -> tuple[CRS, Transformer | None]:
    """Return the metric CRS for a projected one, and the transformer where scaling is not enough."""
    axis, place = crs.axis_info[0], next(_centres(crs, bounds), None)
    # Where the data lie beyond the area of use, the CRS is rather wrong than unfit.
    measured = not resampled and misplaced(crs, bounds) is None
    off = stretch(crs, *place) if measured and place is not None else 0.0
    if off > MOST_STRETCH:
        why = f"in which lengths are {100 * off:.0f} % off here"
    elif axis.unit_conversion_factor == 1.0:
        return crs, None
    else:
        twin = metric_twin(crs)
        if twin is not None:
            notices.append(f"coordinates in {axis.unit_name}, {name_of(crs)}, were scaled to metres, {name_of(twin)}.")
            return twin, None
        why = f"in {axis.unit_name}, for which EPSG has no metric CRS of the same projection"
    fits = target is not None and place is not None and stretch(target, *place) <= MOST_STRETCH
    metric = target if fits and target is not None else utm_zone(crs, bounds)
    notices.append(f"coordinates of {name_of(crs)}, {why}, were reprojected to {name_of(metric)}.")
    return metric, Transformer.from_crs(crs, metric, always_xy=True)


def stretch(crs: CRS, longitude: float, latitude: float) -> float:
    """Return by how much lengths on a map differ from those on the ground at a place, as a share: the largest one.

    0 where the projection is not defined.

    Examples
    --------
    Pseudo-Mercator and Lambert-93 in the south of France:

    >>> [round(stretch(CRS.from_epsg(code), 4.0, 45.0), 3) for code in (3857, 2154)]
    [0.414, 0.001]
    """
    try:
        factors = Proj(crs).get_factors(longitude, latitude, errcheck=True)
    except ProjError:
        return 0.0
    scales = np.array([factors.meridional_scale, factors.parallel_scale])
    return float(np.abs(scales - 1).max()) if np.isfinite(scales).all() else 0.0


def _height_factor(
    vertical: CRS | None, xy_factor: float, z_unit: str, z_hint: str | None, notices: list[str]
) -> float:
    """Return the metres in a unit of height."""
    named = None if vertical is None else float(vertical.axis_info[0].unit_conversion_factor)
    if z_unit != "auto":
        if z_unit not in Z_UNITS:
            msg = f"The unit of height must be auto, {', '.join(Z_UNITS)}; got {z_unit!r}."
            raise CRSError(msg)
        if named is not None and not math.isclose(named, Z_UNITS[z_unit], rel_tol=1e-9):
            notices.append(
                f"heights were read in {z_unit} as stated, against the vertical CRS '{vertical and vertical.name}'."
            )
        factor, why = Z_UNITS[z_unit], "as stated"
    elif named is not None:
        factor, why = named, "the unit of the vertical CRS"
    elif z_hint is not None:
        factor, why = Z_UNITS[z_hint], "the vertical unit that the header states"
    elif 0.3 < xy_factor < 0.31:
        factor, why = xy_factor, "assumed to be in the horizontal foot; state another unit with --z-unit"
    else:
        factor, why = 1.0, "assumed"
    if factor != 1.0:
        notices.append(f"heights were multiplied by {factor:.10g} to metres ({why}).")
    return factor


@lru_cache(maxsize=256)
def metric_twin(crs: CRS) -> CRS | None:
    """Return EPSG's CRS in metres with the same datum, method and projection parameters, or None.

    The parameters are compared as PROJ's identification does, exactly or rounded to 0.1 mm or 1 mm: false origins
    of CRSs in feet are often the metric ones, rounded.
    """
    for digits in (None, 4, 3):
        for authority in _in_metres(crs, digits).list_authority(auth_name="EPSG", min_confidence=70):
            candidate = CRS.from_epsg(int(authority.code))
            if all(axis.unit_conversion_factor == 1.0 for axis in candidate.axis_info[:2]):
                return candidate
    return None


def _in_metres(crs: CRS, digits: int | None) -> CRS:
    """Return the CRS with its axes and lengths in metres, the lengths rounded, and without its identity."""
    form: dict[str, Any] = copy.deepcopy(crs.to_json_dict())
    for axis in form["coordinate_system"]["axis"]:
        axis["unit"] = "metre"
    for parameter in form["conversion"]["parameters"]:
        unit = parameter.get("unit")
        if isinstance(unit, dict) and unit["type"] == "LinearUnit":
            length = parameter["value"] * unit["conversion_factor"]
            parameter["value"] = length if digits is None else round(length, digits)
            parameter["unit"] = "metre"
    for key in ("id", "ids", "scope", "area", "bbox", "usages", "remarks"):
        form.pop(key, None)
    form["conversion"].pop("id", None)
    form["name"] = form["conversion"]["name"] = "unknown"
    return CRS.from_json_dict(form)


def metric_vertical(crs: CRS) -> CRS:
    """Return a vertical CRS in metres: itself, EPSG's twin of it, or the same with another unit."""
    if crs.axis_info[0].unit_conversion_factor == 1.0:
        return crs
    form: dict[str, Any] = copy.deepcopy(crs.to_json_dict())
    form["coordinate_system"]["axis"][0]["unit"] = "metre"
    form.pop("id", None)
    form["name"] = re.sub(r"\s*\((US )?(survey )?(ftUS|ft|foot|feet)\)", "", form["name"])
    metric = CRS.from_json_dict(form)
    code = metric.to_epsg()
    return metric if code is None else CRS.from_epsg(code)


def utm_zone(crs: CRS, bounds: Bounds) -> CRS:
    """Return the UTM zone of the bounds' centre, on the CRS's datum where EPSG has it, else on WGS 84.

    Raises
    ------
    CRSError
        If the centre does not lie on the earth's surface between 80° south and 84° north.
    """
    for longitude, latitude in _centres(crs, bounds):
        if not (abs(longitude) <= 180 and -80 <= latitude <= 84):
            continue
        area = AreaOfInterest(longitude, latitude, longitude, latitude)
        datum = crs.geodetic_crs.name if crs.geodetic_crs else "WGS 84"
        for name in (datum, "WGS 84"):
            zones = query_utm_crs_info(datum_name=name.replace(" ", ""), area_of_interest=area, contains=True)
            if zones:
                return CRS.from_epsg(min(int(zone.code) for zone in zones))
    msg = f"No UTM zone fits the bounds {bounds} in the CRS {name_of(crs)}. Check the CRS and the coordinates."
    raise CRSError(msg)


def _centres(crs: CRS, bounds: Bounds) -> Iterator[tuple[float, float]]:
    """Yield longitude and latitude of the bounds' centre, of the axes swapped, and of the CRS's area of use."""
    west, south, east, north = bounds
    x, y = (west + east) / 2, (south + north) / 2
    if math.isfinite(x) and math.isfinite(y):
        if crs.is_geographic:
            yield x, y
            yield y, x
        elif crs.geodetic_crs is not None:
            yield Transformer.from_crs(crs, crs.geodetic_crs, always_xy=True).transform(x, y)
    area = crs.area_of_use
    if area is not None:
        yield (area.west + area.east) / 2, (area.south + area.north) / 2


def misplaced(crs: CRS, bounds: Bounds) -> str | None:
    """Return a notice if bounds in the CRS's unit lie where it is not meant to be used, which hints at a wrong CRS."""
    area = crs.area_of_use
    if area is None or crs.geodetic_crs is None:
        return None
    x, y = (bounds[0] + bounds[2]) / 2, (bounds[1] + bounds[3]) / 2
    longitude, latitude = Transformer.from_crs(crs, crs.geodetic_crs, always_xy=True).transform(x, y)
    # From 180° west to 180° east is all around, not nothing.
    wide = (area.east - area.west) % 360 or 360
    across = (longitude - area.west + AREA_MARGIN_DEG) % 360 <= wide + 2 * AREA_MARGIN_DEG
    if (area.south - AREA_MARGIN_DEG <= latitude <= area.north + AREA_MARGIN_DEG) and across:
        return None
    return f"the data lie outside of the area of use of {name_of(crs)}, {area.name}; check the CRS."
