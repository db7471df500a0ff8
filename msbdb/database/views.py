"""The views: one text for both dialects, in ``schema/views``."""

from dataclasses import dataclass

from msbdb.database.sqlfiles import read_sql

# Sums of links are subqueries of a row, not joined tables of all rows: a view is asked for a window or a survey, and
# neither dialect takes such a question into a grouped join.


@dataclass(frozen=True, slots=True)
class View:
    """A view: its key and geometry are those of a base table; one without geometry has neither base nor key.

    ``key`` is both the view's and the base table's key column, by which the base table's spatial index serves the view.
    A ``complete`` view has one row for every row of its base table, and so its extent.
    """

    name: str
    key: str = ""
    base: str = ""
    complete: bool = False

    @property
    def doc(self) -> str:
        """What it shows, from the file's comment."""
        return read_sql("views", self.name).title

    @property
    def sql(self) -> str:
        """Its query."""
        return read_sql("views", self.name).sql


VIEWS = (
    View("footprint", key="part_id", base="part"),
    View("part_tree", key="part_id", base="part", complete=True),
    View("building_summary", key="building_id", base="building", complete=True),
    View("part_evidence", key="part_id", base="part", complete=True),
    View("unexplained_flat_region", key="region_id", base="flat_region"),
    View("candidate_evidence", key="candidate_id", base="candidate_region", complete=True),
    View("unexplained_candidate", key="candidate_id", base="candidate_region"),
    View("building_evidence", key="building_id", base="building", complete=True),
    View("footprint_current", key="version_id", base="building_version"),
    View("building_history", key="version_id", base="building_version", complete=True),
)
"""The views with a geometry, which are layers of GIS clients."""

TABLE_VIEWS = (View("roof_material_by_class"),)
"""The views without one."""


def footprint_at_query() -> str:
    """Return the query of the function ``footprint_at`` with the day as ``:date``, for dialects without functions."""
    _, body, _ = read_sql("functions", "footprint_at").sql.split("$$")
    return body.strip().replace("to_char(day, 'YYYY-MM-DD')", ":date")
