"""The forest of parts (V33), and the buildings that are its roots."""

from collections.abc import Iterator

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from sqlalchemy import Connection, Table, select

from msbdb.database.integrity.finding import Finding, by_id
from msbdb.database.sqltables import SQL

BUILDING = SQL["building"]
PART = SQL["part"]

CHECK = "forest"
BATCH = 10_000
"""Rows that are read at once."""


def check_forest(connection: Connection) -> Iterator[Finding]:
    """Yield parts that break V33.

    A father exists, of the same run and tree, on the coarser scale that SUPSCALE says, and is larger; a root is its own
    tree's root; and who goes from father to father comes to that root, in no circle.
    """
    parts = _frame(connection, ("part_id", "run_id", "supid", "supscale", "root_id", "scale", "area_px"), PART)
    # Ids that are given twice are told among the values.
    parts = parts.drop_duplicates("part_id", ignore_index=True)
    place = pd.Index(parts["part_id"]).get_indexer(parts["supid"])
    is_child, has_father = (parts["supid"] != 0).to_numpy(), place >= 0
    yield from _told(parts, is_child & ~has_father, "its father {supid} does not exist", "a part of this id")
    father = parts.iloc[np.where(has_father, place, 0)].reset_index(drop=True).add_prefix("father_")
    both = pd.concat([parts, father], axis=1)
    child = is_child & has_father
    for holds, what, expected in (
        (both["run_id"] == both["father_run_id"], "it is of run {run_id}", "its father's run {father_run_id}"),
        (both["root_id"] == both["father_root_id"], "its tree is {root_id}", "its father's {father_root_id}"),
        (both["supscale"] == both["father_scale"], "SUPSCALE is {supscale}", "{father_scale}, its father's scale"),
        (both["scale"] > both["father_scale"], "it is on scale {scale}", "a finer one than {father_scale}"),
        (
            both["area_px"] < both["father_area_px"],
            "it has {area_px} cells",
            "fewer than its father's {father_area_px}",
        ),
    ):
        yield from _told(both, child & ~holds.to_numpy(), what, expected)
    yield from _told(
        parts,
        (~is_child) & (parts["root_id"] != parts["part_id"]).to_numpy(),
        "it has no father, and its tree is {root_id}",
        "a root's tree is its own id {part_id}",
    )
    top, in_circle = _tops(place)
    yield from _told(parts, in_circle, "its fathers run in a circle", "a root at the top")
    root = parts["part_id"].to_numpy()[top]
    lost = is_child & ~in_circle & ~is_child[top] & (root != parts["root_id"].to_numpy())
    yield from _told(parts, lost, "its topmost father is not {root_id}", "the root that it names")


def check_buildings(connection: Connection) -> Iterator[Finding]:
    """Yield roots without a building, buildings without a root, and buildings whose numbers are not their tree's."""
    parts = _frame(connection, ("part_id", "run_id", "supid", "root_id", "scale"), PART)
    buildings = _frame(connection, ("building_id", "run_id", "root_id", "parts", "scales"), BUILDING)
    roots = parts[parts["supid"] == 0]
    for row in roots[~roots["part_id"].isin(buildings["root_id"])].itertuples():
        yield Finding("buildings", "part", by_id("part", "part_id", row.part_id), "no building has this root", "one")
    trees = parts.groupby("root_id").agg(found_parts=("part_id", "size"), found_scales=("scale", "nunique"))
    both = buildings.merge(trees, how="left", left_on="root_id", right_index=True).fillna(0)
    is_root = both["root_id"].isin(roots["part_id"])
    for row in both[~is_root].itertuples():
        key = by_id("building", "building_id", row.building_id)
        yield Finding("buildings", "building", key, f"part {row.root_id} is no root", "the root of a tree")
    for column in ("parts", "scales"):
        wrong = both[is_root & (both[column] != both[f"found_{column}"])]
        for record in wrong.to_dict(orient="records"):
            key = by_id("building", "building_id", record["building_id"])
            expected = f"{int(record[f'found_{column}'])}, as its tree has"
            yield Finding("buildings", "building", key, f"{column} is {record[column]}", expected)


def _frame(connection: Connection, names: tuple[str, ...], table: Table) -> pd.DataFrame:
    """Return columns of whole numbers, in order of the first."""
    columns = [table.columns[name] for name in names]
    result = connection.execute(select(*columns).order_by(columns[0]), execution_options={"yield_per": BATCH})
    # Column by column, as an array of rows takes ten times as long to make.
    batches = [np.array(list(zip(*rows, strict=True)), dtype=np.int64) for rows in result.partitions()]
    held = np.concatenate(batches, axis=1) if batches else np.empty((len(names), 0), dtype=np.int64)
    return pd.DataFrame(dict(zip(names, held, strict=True)))


def _told(parts: pd.DataFrame, wrong: NDArray[np.bool_], what: str, expected: str) -> Iterator[Finding]:
    """Yield a finding a wrong part; the sentences name its columns."""
    for row in parts[wrong].to_dict(orient="records"):
        values = {str(name): value for name, value in row.items()}
        key = by_id("part", "part_id", row["part_id"])
        yield Finding(CHECK, "part", key, what.format_map(values), expected.format_map(values))


def _tops(father: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Return the topmost place above each part, and which parts have none, by doubling the steps.

    ``father`` (N,) holds places of fathers, -1 for none.
    """
    own = np.arange(len(father))
    up = np.where(father < 0, own, father)
    for _ in range(max(1, len(father).bit_length())):
        up = up[up]
    return up, father[up] >= 0
