"""The update of the inventory by a survey: compared with the buildings before, and written as versions."""

import logging
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray

from msbdb.change.comparison import Comparison, compare, measure, measure_roofs
from msbdb.change.seams import Surveyed
from msbdb.database import (
    PATIENCE_S,
    Advance,
    Engine,
    OutdatedError,
    Seams,
    Standing,
    first_day,
    open_database,
    read_buildings,
    read_parts,
    read_plan,
    read_run,
    read_standing,
    read_survey,
    survey_key,
    write_advance,
)
from msbdb.errors import DatabaseError, InputError, give_notice
from msbdb.identity import to_json
from msbdb.io.vector import read_polygons
from msbdb.params import DETECTORS, Params, as_dict, choose_detectors, with_values
from msbdb.params import profile as named_profile
from msbdb.run.inputs import Inputs, Paths
from msbdb.run.inventory.borders import combined, make_seams, near_pieces, pieces_of
from msbdb.run.inventory.ground import StoredGround
from msbdb.run.preparation.prepare import Label
from msbdb.run.reports import AdvanceReport, Notices, collect_notices
from msbdb.surveyplan import Plan
from msbdb.tables import EXTRACTOR_SHARES, HEIGHTS, Survey
from msbdb.version import __version__

logger = logging.getLogger(__name__)

ATTEMPTS = 5
"""Attempts to compute an update, when others change the same place of the inventory at the same time."""

MEASURED_FIRST = "its heights are known for the first time"

SEAM_M = 3.0
"""Pieces of a building that a border cuts lie this near: a few cells."""

SAME_M2 = 1e-3
"""Outlines that differ by less in area are one outline, moved by the offset of the survey."""

FROM_SURVEY = ("state", "parts", *EXTRACTOR_SHARES.values(), "probability")

CELL_HEIGHTS = ("h_max", "h_mean", "h_p50", "h_p90")


def is_built(
    points: Paths,
    *,
    db: str | Path,
    survey: str,
    date: str,
    ortho: Paths = (),
    params: Params | None = None,
    profile: str = "default",
    extract: str | Sequence[str] = DETECTORS,
    denoising_figure: Path | None = None,
    plan: Plan | None = None,
    **given: Any,  # noqa: ANN401  (the other inputs of build)
) -> bool:
    """Return whether a survey was built from the same files, with the same values, by the same msbdb.

    The parameters are those of `msbdb.api.build`; where a plan is given, the survey must be built by it.
    """
    with collect_notices(Notices()):
        inputs = Inputs.of(points, ortho, **given)
        methods = choose_detectors(extract)
    inputs.require_files()
    try:
        engine = open_database(db)
    except DatabaseError:
        return False
    try:
        record, run, own = read_survey(engine, survey), read_run(engine, survey), read_plan(engine, survey)
    except InputError:
        return False
    finally:
        engine.dispose()
    wanted = to_json([as_dict(params or named_profile(profile)), profile, __version__, list(methods), date])
    found = to_json([run.parameters, run.profile, run.version, list(run.methods), record.date])
    stated = run.counts.stated == inputs.stated()
    stated = stated and plan in (None, own)
    return denoising_figure is None and stated and wanted == found and set(record.sources) == set(inputs.sources())


def advance_inventory(db: str | Path, survey: str, *, aoi: Path | None) -> AdvanceReport:
    """Update the inventory by a survey that is built already; see `msbdb.api.advance`."""
    engine = open_database(db, timeout_s=PATIENCE_S, keep_open=True)
    try:
        record = read_survey(engine, survey)
        require_date(survey, record.date)
        area = _area(record, aoi)
        for _ in range(ATTEMPTS):
            notices = Notices()
            try:
                with collect_notices(notices):
                    report = _advance(engine, record, area)
                return replace(report, notices=(*notices.kept, *notices.passing))
            except OutdatedError:
                logger.info("The inventory changed where survey %s lies; comparing again", survey)
    finally:
        engine.dispose()
    msg = (
        f"Others keep changing the inventory at the place of the survey '{survey}'. "
        "Wait until they have finished, and try again."
    )
    raise DatabaseError(msg)


def require_date(survey: str, date: str) -> None:
    """Refuse a survey without a date, or with one in the future."""
    Label(survey, date)
    if not date:
        msg = (
            f"The survey '{survey}' has no date, so its place in the inventory's history is unknown. "
            "Build it again with --date, for instance --date 2021-05-31."
        )
        raise InputError(msg)


def _area(record: Survey, aoi: Path | None) -> shapely.MultiPolygon:
    """Return where a survey lies, cut by the area of interest."""
    shape = shapely.box(*record.bounds)
    if aoi is not None:
        wanted = read_polygons(aoi, to=record.crs_wkt).union_all()
        shape = shapely.intersection(shape, wanted)
    parts = [part for part in shapely.get_parts(shape) if part.geom_type == "Polygon" and not part.is_empty]
    if not parts:
        msg = f"The area of interest does not overlap the survey '{record.name}'. Check both, and the CRS of the area."
        raise InputError(msg)
    whole: shapely.MultiPolygon = shapely.normalize(shapely.multipolygons(parts))
    return whole


def _advance(engine: Engine, record: Survey, area: shapely.MultiPolygon) -> AdvanceReport:
    """Compare and write once."""
    date = first_day(record.date)
    standing = read_standing(engine, record.name, date, record.bounds, area)
    if standing.applied is not None:
        own = standing.offsets[standing.offsets["survey_id"] == survey_key(record.name)]
        offset = {str(name): value for name, value in own.drop(columns="survey_id").iloc[0].items()}
        return _report(record, date, "unchanged", standing.applied, offset, is_compared=len(standing.before) > 0)
    before, ground = standing.before, StoredGround(engine, record)
    after = read_buildings(engine, record.name)
    is_whole = area.equals(shapely.box(*record.bounds))
    found = compare(
        before, after, survey=ground, earlier=_earlier(engine, standing), area=None if is_whole else area,
        params=_params(engine, record.name).change,
    )  # fmt: skip
    found, states = _states(found, before, after, ground)
    states = _with_roofs(states, found, engine, record, ground)
    states = _with_parts(states, found, engine, record.name)
    states = _with_unseen(states, found, before, record)
    made = Advance(
        survey=record.name, survey_id=survey_key(record.name), date=date, area=area, digest=standing.digest,
        basis=standing.basis, before=before, born=standing.born, offset=asdict(found.offset), changes=found.changes,
        states=states,
    )  # fmt: skip
    made = replace(made, seams=_seams(engine, standing, made, record))
    status = write_advance(engine, made)
    return _report(record, date, status, made.counts, made.offset, is_compared=len(before) > 0)


def _seams(engine: Engine, standing: Standing, made: Advance, record: Survey) -> Seams:
    """Return the buildings that the border to surveys beside this one cuts, made whole."""
    pieces, loose = pieces_of(standing, made)
    near = near_pieces(pieces, loose, SEAM_M)
    pieces, loose = pieces[near].reset_index(drop=True), loose[near]
    surveys = {}
    for name in sorted(set(pieces["survey"])):
        other = record if name == record.name else read_survey(engine, name)
        surveys[survey_key(name)] = Surveyed(shapely.box(*other.bounds), StoredGround(engine, other), other.density)
    params = _params(engine, record.name)
    return make_seams(pieces, loose, surveys, standing, params=params.change, touching=params.touching)


def _params(engine: Engine, survey: str) -> Params:
    """Return what counts as change, and what divides touching houses, as the survey's run has it."""
    values: Any = read_run(engine, survey).parameters
    return with_values(Params(), {name: values.get(name, {}) for name in ("change", "touching")})


def _earlier(engine: Engine, standing: Standing) -> list[StoredGround]:
    """Return the ground of the earlier surveys of the place, the latest first, each brought to the inventory's place.

    A survey that was applied before lies to the inventory as its stored offset says.
    """
    offsets = standing.offsets.set_index("survey_id")
    grounds = []
    for event in standing.events.itertuples(index=False):
        dx, dy, dz = (float(offsets.loc[event.survey_id, name]) for name in ("dx_m", "dy_m", "dz_m"))
        grounds.append(StoredGround(engine, read_survey(engine, event.name), (dx, dy, dz)))
    return grounds


def _states(
    found: Comparison, before: gpd.GeoDataFrame, after: gpd.GeoDataFrame, ground: StoredGround
) -> tuple[Comparison, gpd.GeoDataFrame]:
    """Return the values of the new versions: those of the survey's own buildings, or measured in their outlines.

    A building of an imported inventory, which no survey has measured, gets a version with its own outline and the
    heights found there, also where it is unchanged.
    """
    found = _with_first_measures(found, before, ground)
    versions = found.versions
    rows = versions["after"].to_numpy()
    known = pd.DataFrame(after.drop(columns="geometry")).astype(object)
    values = known.reindex(rows).set_axis(versions.index)
    states = gpd.GeoDataFrame(
        values[["building_id", *FROM_SURVEY, *HEIGHTS, *CELL_HEIGHTS, "area_m2", "volume_m3"]].assign(
            before=versions["before"]
        ),
        geometry=versions.geometry,
        crs=after.crs,
    )
    states["state"] = states["state"].fillna("unsure")
    made = np.flatnonzero(~versions["adopted"].to_numpy())
    shapes = versions.geometry.to_numpy()[made]
    for some, heights, _ in ground.beneath(shapes):
        for one in some:
            for name, value in measure(shapes[one], heights).items():
                states.loc[states.index[made[one]], name] = value
    # A building has the area of its cells, and its fitted outline a little more or less. Who keeps one keeps the other.
    changes = found.changes
    kept = changes[(changes["kind"] == "modified") & ~changes["outline"] & (changes["darea_m2"].abs() < SAME_M2)]
    states.loc[states.index[kept["version"]], "area_m2"] = before["area_m2"].iloc[kept["before"]].to_numpy()
    return found, states


def _with_first_measures(found: Comparison, before: gpd.GeoDataFrame, ground: StoredGround) -> Comparison:
    """Add a version to each unchanged building whose heights were unknown so far and are known now."""
    changes = found.changes.copy()
    unknown = np.flatnonzero(before["h_p90"].isna())
    wanted = (changes["kind"] == "unchanged") & (changes["before"] >= 0) & (changes["version"] < 0)
    wanted &= changes["before"].isin(unknown)
    shapes = before.geometry.to_numpy()[changes.loc[wanted, "before"]]
    measured = sorted(
        one for some, heights, _ in ground.beneath(shapes) for one in some if measure(shapes[one], heights)
    )
    more: list[dict[str, Any]] = []
    for row in changes.index[wanted][measured]:
        at = int(changes.loc[row, "before"])
        changes.loc[row, "version"] = len(found.versions) + len(more)
        changes.loc[row, "note"] = "; ".join(word for word in (changes.loc[row, "note"], MEASURED_FIRST) if word)
        shape = before.geometry.iloc[at]
        more.append({"before": at, "after": int(changes.loc[row, "after"]), "adopted": False, "geometry": shape})
    if not more:
        return found
    added = gpd.GeoDataFrame(more, geometry="geometry", crs=found.versions.crs)
    versions = gpd.GeoDataFrame(pd.concat([found.versions, added], ignore_index=True), crs=found.versions.crs)
    types = {"before": "int64", "after": "int64", "adopted": "bool"}
    return replace(found, changes=changes, versions=versions.astype(types))


def _with_roofs(
    states: gpd.GeoDataFrame, found: Comparison, engine: Engine, record: Survey, ground: StoredGround
) -> gpd.GeoDataFrame:
    """Give versions with an outline that is not the survey's own the ground, eaves, ridge and storeys inside it."""
    rows = np.flatnonzero(~found.versions["adopted"].to_numpy())
    if not len(rows):
        return states
    values: Any = read_run(engine, record.name).parameters
    params = with_values(Params(), {name: values.get(name, {}) for name in ("heights", "surface")})
    shapes = states.geometry.to_numpy()[rows]
    for some, heights, elevations in ground.beneath(shapes, params.heights.far_ring_m):
        for one in some:
            for name, value in measure_roofs(shapes[one], heights, elevations, params).items():
                states.loc[states.index[rows[one]], name] = value
    return states


def _with_parts(states: gpd.GeoDataFrame, found: Comparison, engine: Engine, survey: str) -> gpd.GeoDataFrame:
    """Give versions with an outline that is not the survey's own the number of the parts inside it."""
    rows = np.flatnonzero(~found.versions["adopted"].to_numpy())
    if not len(rows):
        return states
    parts = read_parts(engine, survey)
    inner: NDArray[np.object_] = np.asarray(shapely.points(parts["xin"].to_numpy(), parts["yin"].to_numpy()))
    tree = shapely.STRtree(inner)
    for row in rows.tolist():
        inside = parts.iloc[tree.query(states.geometry.iloc[row], predicate="contains")]
        if len(inside):
            states.loc[states.index[row], "parts"] = len(inside)
    return states


def _with_unseen(
    states: gpd.GeoDataFrame, found: Comparison, before: gpd.GeoDataFrame, record: Survey
) -> gpd.GeoDataFrame:
    """Give versions that reach beyond the survey the measures of both sides: beyond it those of the version before."""
    box = shapely.box(*record.bounds)
    names = {*FROM_SURVEY, *HEIGHTS, *CELL_HEIGHTS, "area_m2", "volume_m3"} - {"parts"}
    for row in np.flatnonzero(~found.versions["adopted"].to_numpy()).tolist():
        at, shape = int(found.versions["before"].iloc[row]), states.geometry.iloc[row]
        inside, beyond = shapely.intersection(shape, box), shapely.difference(shape, box)
        if at < 0 or beyond.area < max(record.cell_m**2, SAME_M2) or pd.isna(before["h_p90"].iloc[at]):
            continue
        kept = before.iloc[[at]]
        share = beyond.area / kept.geometry.iloc[0].area
        kept = kept.assign(area_m2=kept["area_m2"] * share, volume_m3=kept["volume_m3"] * share, geometry=[beyond])
        pieces = [kept]
        if inside.area > 0 and pd.notna(states["h_p90"].iloc[row]):
            pieces.append(states.iloc[[row]].assign(area_m2=inside.area, geometry=[inside]))
        both = pd.DataFrame(pd.concat([pd.DataFrame(piece).astype(object) for piece in pieces], ignore_index=True))
        for name, value in combined(both, shape).items():
            if name in names or (name == "parts" and len(pieces) == 1):
                states.loc[states.index[row], name] = value
    return states


def _report(
    record: Survey, date: str, status: str, counts: dict[str, int], offset: dict[str, Any], *, is_compared: bool
) -> AdvanceReport:
    """Sum up an update, without its notices."""
    # Without a spread nothing was measured.
    if is_compared and pd.isna(offset["spread_m"]) and set(counts) - {"new", "versions"}:
        pairs = int(offset["pairs"])
        msg = (
            f"Too few buildings are alike in the survey and the inventory ({pairs}). The offset between them is not "
            "measured, and taken as 0."
        )
        give_notice(msg)
    plain = {name: None if pd.isna(value) else float(value) for name, value in offset.items()}
    plain["pairs"] = int(offset["pairs"])
    return AdvanceReport(record.name, date, status, dict(counts), plain, ())
