"""Surveys of random towns and parts of them: the inventory has the ground that the latest survey of each place has."""

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from skimage.morphology import isotropic_opening
from support.faultfiles import write_raster
from support.notices import with_notices
from support.towns import BOUNDS, RANDOM_TOWN, ROW, UTM, random_houses, town_heights

from msbdb import api
from msbdb.database import check_database, open_database, read_history
from msbdb.outline.polygons import rasterise

SLIVER_CELLS = 2.5
"""Radius of a disc: thinner differences are those of outlines at a border."""

CHANGE_M2 = 30.0

PART = st.sampled_from([(0.0, 200.0), (0.0, 70.0), (0.0, 102.0), (64.0, 200.0), (91.0, 200.0)])
"""West and east of a survey, metres from the corner."""


@pytest.mark.long
@settings(max_examples=6, deadline=None)
@given(RANDOM_TOWN, st.lists(st.tuples(RANDOM_TOWN, PART), min_size=1, max_size=3))
def test_the_inventory_has_the_ground_of_the_latest_survey(first: list, later: list) -> None:
    """No house is lost, none stays that is gone, none covers another one's ground, and the database is sound."""
    with tempfile.TemporaryDirectory() as words:
        folder = Path(words)
        db = folder / "town.sqlite"
        true = np.asarray(town_heights([*ROW, *random_houses(first)]).values) > 0
        for n, (sides, (west, east)) in enumerate([(first, BOUNDS[::2]), *later]):
            heights = town_heights([*ROW, *random_houses(sides)], bounds=(west, BOUNDS[1], east, BOUNDS[3]))
            values = np.asarray(heights.values)
            file = write_raster(folder / f"{n}.tif", values, heights.spec, crs=UTM)
            with_notices(lambda file=file, n=n: api.update(ndsm=file, db=db, survey=f"s{n}", date=f"20{10 + n}-01-01"))
            start = round(2 * west)
            true[:, start : start + values.shape[1]] = values > 0
            engine = open_database(db)
            versions, findings = read_history(engine), check_database(engine)
            engine.dispose()
            current = versions[versions["valid_to"].isna()].geometry
            spec = town_heights([], bounds=BOUNDS).spec
            difference = (rasterise(list(current), spec) > 0) ^ true
            assert findings == []
            assert isotropic_opening(difference, SLIVER_CELLS).sum() * spec.cell_area_m2 < CHANGE_M2
