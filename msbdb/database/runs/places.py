"""What a run found at a place: the building, or the reason for none, and what each detector decided."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
from sqlalchemy import Engine

from msbdb.database.runs.reading import read_rasters, read_run, read_survey, read_tables
from msbdb.errors import InputError
from msbdb.kept import PER_METRE, Rasters, lattice_of
from msbdb.params import DETECTORS
from msbdb.tables import (
    BUILDING,
    CANDIDATE_REGION,
    FLAT_REGION,
    REASONS,
    REJECTION,
    REJECTION_COUNT,
    SPECTRAL_CLASS,
    Reason,
    Run,
    Survey,
)

if TYPE_CHECKING:
    import pandas as pd

READ = (BUILDING, FLAT_REGION, CANDIDATE_REGION, REJECTION, REJECTION_COUNT, SPECTRAL_CLASS)
"""The tables that an answer needs."""

STRUCTURE = {0: "neither roof nor vegetation", 1: "roof", 2: "vegetation"}
"""What the classes by structure mean."""

LARGER = 2.0
"""The area of a dropped region is at most so many times that of the cells there: its points are not in all cells."""

FAR = 1.5
"""Distance to the middle of a dropped region, in roots of its area, up to which a place may lie in it."""


@dataclass(frozen=True, slots=True)
class DetectorAnswer:
    """What one detector decided about a place.

    Parameters
    ----------
    method : str
        The detector.
    supports : bool or None
        Whether it takes the place for a building; None where the run did not keep that.
    region_id : int or None
        Its region there, of the table ``flat_region`` or ``candidate_region``.
    stage, reason : str
        By which stage it dropped the place, and why; empty where it dropped nothing there.
    area_m2 : float or None
        Area of the dropped region, where the ledger has a row for it.
    rejection_at : tuple of float or None
        Easting and northing of that row, metres.
    """

    method: str
    supports: bool | None
    region_id: int | None = None
    stage: str = ""
    reason: str = ""
    area_m2: float | None = None
    rejection_at: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class Place:
    """What a run found at a place.

    Parameters
    ----------
    survey : str
        Its name.
    easting, northing : float
        The place in the CRS of the database, metres.
    reason : Reason or None
        The decisive reason; None where an older msbdb kept none and no building is there.
    building : dict or None
        Columns of the table ``building``.
    height_m : float or None
        Height of the surface above ground, metres; None without data.
    ground_m : float or None
        Height of the ground in the vertical reference of the source, metres; None where the run did not keep it.
    structure : str
        Land cover by structure: roof, vegetation or neither.
    colour : str
        Land cover by colour: number and label of its class; empty without one.
    detectors : tuple of DetectorAnswer
        Of each detector that was run.
    """

    survey: str
    easting: float
    northing: float
    reason: Reason | None
    building: dict[str, Any] | None
    height_m: float | None
    ground_m: float | None
    structure: str
    colour: str
    detectors: tuple[DetectorAnswer, ...]

    @property
    def sentences(self) -> list[str]:
        """The answer in plain sentences."""
        return [self._decision(), *self._surface(), *(_said(one) for one in self.detectors)]

    def _decision(self) -> str:
        """Say whether there is a building, and why not."""
        if self.building is not None:
            b = self.building
            odds = "" if b["probability"] is None else f", probability {b['probability']:.2f}"
            size = f"{b['area_m2']:.0f} m2, up to {b['h_max']:.1f} m high, storeys: {b['storeys']}"
            rest = "" if self.reason in (None, Reason.BUILDING) else f" This cell is at its edge: {self._why()}."
            return f"Building {b['building_id']} stands here ({b['state']}{odds}; {size}).{rest}"
        if self.reason is None:
            return "No building stands here. This run was made by an older msbdb and kept no reasons; build it again."
        return f"No building stands here: {self._why()}.{self._votes()}"

    def _votes(self) -> str:
        """Say how many detectors take a raised place for a building."""
        known = [one.supports for one in self.detectors if one.supports is not None]
        if not known or self.reason in (Reason.NO_DATA, Reason.LOW):
            return ""
        return f" Of {len(known)} detectors {sum(known) or 'none'} would take it for a building."

    def _why(self) -> str:
        return "" if self.reason is None else REASONS[self.reason]

    def _surface(self) -> Iterator[str]:
        """Say what is known of the surface."""
        if self.height_m is None:
            return
        ground = "" if self.ground_m is None else f", and the ground is at {self.ground_m:.2f} m"
        yield f"The surface is {self.height_m:.2f} m above ground{ground}."
        colour = f"; by colour {self.colour}" if self.colour else ""
        yield f"Land cover by structure: {self.structure}{colour}."


def _said(answer: DetectorAnswer) -> str:
    """Say what a detector decided."""
    if answer.supports:
        region = "" if answer.region_id is None else f" (region {answer.region_id})"
        return f"{answer.method}: a building{region}."
    if answer.reason:
        where = ", without a row in the ledger"
        if answer.area_m2 is not None and answer.rejection_at is not None:
            east, north = answer.rejection_at
            where = f", a region of {answer.area_m2:.0f} m2 around {east:.1f}, {north:.1f}"
        return f"{answer.method}: dropped by the stage '{answer.stage}': {answer.reason}{where}."
    unknown = "not kept by this run" if answer.supports is None else "no region"
    return f"{answer.method}: {unknown}."


def explain_places(engine: Engine, places: Sequence[tuple[float, float]], survey: str | None = None) -> list[Place]:
    """Return what a run found at places, each in the CRS of the database.

    Parameters
    ----------
    engine : Engine
        From ``open_database``.
    places : sequence of (float, float)
        Easting and northing, metres.
    survey : str, optional
        Its name; not needed where the database holds only one.

    Raises
    ------
    InputError
        When there is no such survey, no name was given and there are several, or a place is outside of its extent.
    """
    record = read_survey(engine, survey)
    outside = [place for place in places if not _within(record, place)]
    if outside:
        (east, north), (west, south, right, top) = outside[0], record.bounds
        msg = (
            f"The place {east:.1f}, {north:.1f} is outside of the survey '{record.name}', which covers eastings "
            f"{west:.1f} to {right:.1f} and northings {south:.1f} to {top:.1f}. Give easting and northing in this "
            "order, and the CRS of the place where it is another one than the database's."
        )
        raise InputError(msg)
    run = read_run(engine, record.name)
    frames, rasters = read_tables(engine, READ, record.name), read_rasters(engine, record.name)
    known = _Known(record, run, frames, rasters)
    return [known.at(east, north) for east, north in places]


def _within(survey: Survey, place: tuple[float, float]) -> bool:
    """Whether a place lies in the extent of a survey; a NaN does not."""
    west, south, east, north = survey.bounds
    return west <= place[0] < east and south < place[1] <= north


class _Known:
    """A run in memory, to be asked about places."""

    def __init__(self, survey: Survey, run: Run, frames: "dict[str, pd.DataFrame]", rasters: Rasters) -> None:
        self.survey, self.run, self.frames, self.rasters = survey, run, frames, rasters
        self.spec = lattice_of(survey)

    def at(self, easting: float, northing: float) -> Place:
        """Return what is known of a place."""
        row, col = (int(number[0]) for number in self.spec.rowcol(np.array([easting]), np.array([northing])))
        cell, rasters = (row, col), self.rasters
        reason = None if rasters.reason is None else Reason(int(rasters.reason[cell]))
        valid = bool(rasters.valid[cell])
        building = self._building(shapely.Point(easting, northing), is_building=reason == Reason.BUILDING)
        return Place(
            survey=self.survey.name,
            easting=easting,
            northing=northing,
            reason=Reason.BUILDING if reason is None and building is not None else reason,
            building=building,
            height_m=float(rasters.heights_cm[cell]) / PER_METRE if valid else None,
            ground_m=None if rasters.terrain_cm is None else float(rasters.terrain_cm[cell]) / PER_METRE,
            structure=STRUCTURE[int(rasters.structure[cell])],
            colour=self._colour(cell),
            detectors=tuple(self._asked(method, cell) for method in DETECTORS if method in self.run.methods),
        )

    def _building(self, point: shapely.Point, *, is_building: bool) -> dict[str, Any] | None:
        """Return the building whose outline holds a point, or, where its cell is building, the nearest one."""
        buildings = self.frames["building"]
        if not len(buildings):
            return None
        distance = shapely.distance(buildings.geometry.to_numpy(), point)
        nearest = int(np.argmin(distance))
        if distance[nearest] > 0 and not is_building:
            return None
        import pandas as pd

        found = buildings.iloc[nearest].drop("geometry").to_dict()
        return {str(name): None if pd.isna(value) else value for name, value in found.items()}

    def _colour(self, cell: tuple[int, int]) -> str:
        """Return number and label of the class by colour of a cell; empty without one."""
        if self.rasters.spectral is None or not self.rasters.spectral[cell]:
            return ""
        number, classes = int(self.rasters.spectral[cell]), self.frames["spectral_class"]
        return f"class {number}, {classes.loc[classes['speindex'] == number, 'label'].iloc[0]}"

    def _asked(self, method: str, cell: tuple[int, int]) -> DetectorAnswer:
        """Return what a detector decided about a cell."""
        rasters = self.rasters
        label = int(rasters.regions[method][cell]) if method in rasters.regions else 0
        supports: bool | None = label > 0 if method in rasters.regions else None
        if rasters.support is not None:
            supports = bool(int(rasters.support[cell]) >> DETECTORS.index(method) & 1)
        if label:
            return DetectorAnswer(method, supports, region_id=self._region(method, label))
        dropped = self._dropped(method, cell)
        if supports or dropped is None:
            return DetectorAnswer(method, supports)
        stage, reason, area_m2, place = dropped
        return DetectorAnswer(method, supports, None, stage, reason, area_m2, place)

    def _region(self, method: str, label: int) -> int:
        """Return the id of a region by its label: labels are in the order of the ids."""
        if method == "flatregions":
            return int(np.sort(self.frames["flat_region"]["region_id"].to_numpy())[label - 1])
        found = self.frames["candidate_region"]
        return int(np.sort(found.loc[found["method"] == method, "candidate_id"].to_numpy())[label - 1])

    def _dropped(
        self, method: str, cell: tuple[int, int]
    ) -> tuple[str, str, float | None, tuple[float, float] | None] | None:
        """Return stage and reason by which a detector dropped a cell, and area and place of the row in the ledger."""
        answers = self.rasters.answers.get(method)
        if answers is None or not answers[cell]:
            return None
        number, counts = int(answers[cell]), self.frames["rejection_count"]
        kind = counts[(counts["method"] == method) & (counts["number"] == number)].iloc[0]
        rows = self.frames["rejection"]
        same = (rows["method"] == method) & (rows["stage"] == kind["stage"]) & (rows["reason"] == kind["reason"])
        own = rows[same]
        # Loaded here, as compiled code takes time to load.
        from msbdb.labels import label_zones

        labels, _ = label_zones(answers == number)
        piece_m2 = np.count_nonzero(labels == labels[cell]) * self.spec.cell_area_m2
        # Regions that touch are one piece, so that the piece is at least about as large as the region.
        own = own[own["area_m2"] <= LARGER * piece_m2]
        east, north = (float(one[0]) for one in self.spec.xy(np.array([cell[0]]), np.array([cell[1]])))
        distance = np.hypot(own["xcen"] - east, own["ycen"] - north) / np.sqrt(own["area_m2"])
        if not len(own) or distance.min() > FAR:
            return str(kind["stage"]), str(kind["reason"]), None, None
        row = own.iloc[int(distance.to_numpy().argmin())]
        place = float(row["xcen"]), float(row["ycen"])
        return str(kind["stage"]), str(kind["reason"]), float(row["area_m2"]), place
