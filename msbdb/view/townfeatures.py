"""The buildings and blocks of a large town as features of tiles, with what the map of its page needs."""

from collections.abc import Mapping
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from msbdb.io.vector import archive_of

FAR, NEAR = (11, 14), (15, 15)
"""Zooms of the tiles of a large town, from afar and near (ours): the first shows it whole, the last has steps of 15 cm
at the equator. On zoom 14 a pixel is 2 to 5 m, and most parts are smaller; `page.js` has the same border."""

STATES = ("confirmed", "unsure", "refuted")
"""The states of a building in the order of page.js."""


def archives_of(features: gpd.GeoDataFrame, finest: int) -> list[bytes]:
    """Return the tiles of a town as two archives (PMTiles): from afar, and near."""
    return [archive_of(seen_from_afar(features, finest), "town", FAR), archive_of(features, "town", NEAR)]


def town_features(rows: Mapping[str, Any], finest: int, geometry: NDArray[np.object_]) -> gpd.GeoDataFrame:
    """Return buildings and blocks as features, with what `page.js` gives those of a small town.

    Parameters
    ----------
    rows : mapping
        ``buildings``, ``parts`` and ``blocks`` by column, as the page has them: whole numbers, None for null.
    finest : int
        The last scale.
    geometry : (N,) ndarray of MultiPolygon
        Longitudes and latitudes, degrees: those of the buildings, then those of the blocks.

    Returns
    -------
    GeoDataFrame
        One row each, ``n`` its number; -1 for what is not known; heights in metres.
    """
    own, parts, blocks = (pd.DataFrame({key: rows[name][key] for key in keys}) for name, keys in (
        ("buildings", ("first", "after", "height")), ("parts", ("building", "father", "scale", "storeys", "kind")),
        ("blocks", ("part", "low", "high", "height")),
    ))  # fmt: skip
    values, count = rows["buildings"]["values"], len(own)
    roots = parts[parts["father"] == -1].drop_duplicates("building").set_index("building")
    single = pd.DataFrame({
        "row": np.arange(count), "part": -1, "low": 0, "high": np.where(own.index.isin(roots.index), 0, finest),
        "height": own["height"], "storeys": values.get("storeys", [None] * count), "scale": 0,
        "kind": roots["kind"].reindex(own.index, fill_value=0),
    })  # fmt: skip
    each = parts.loc[blocks["part"]].reset_index(drop=True)
    pieces = blocks.assign(row=each["building"], storeys=each["storeys"], scale=each["scale"], kind=each["kind"])
    every = pd.concat([single, pieces], ignore_index=True)
    row = every["row"].to_numpy()
    chance = pd.to_numeric(pd.Series(values.get("probability", [None] * count), dtype="float64")).to_numpy()[row] / 1000
    state = pd.Series(values.get("state", [None] * count)).map({name: n for n, name in enumerate(STATES)})
    height = pd.to_numeric(every["height"]).to_numpy(dtype=np.float64) / 100
    return gpd.GeoDataFrame(
        every.assign(
            n=np.arange(len(every)), first=own["first"].to_numpy()[row], after=own["after"].to_numpy()[row],
            state=state.fillna(-1).astype("int64").to_numpy()[row], height=np.where(np.isnan(height), -1.0, height),
            chance=np.where(np.isnan(chance), -1.0, chance),
            storeys=pd.to_numeric(every["storeys"]).fillna(-1).astype("int64"),
        ), geometry=geometry, crs=4326,
    )  # fmt: skip


def seen_from_afar(features: gpd.GeoDataFrame, finest: int) -> gpd.GeoDataFrame:
    """Return the features of a town for zooms on which its parts cannot be seen: buildings alone, whole on each scale.

    Parameters
    ----------
    features : GeoDataFrame
        Those of `town_features`.
    finest : int
        The last scale.

    Returns
    -------
    GeoDataFrame
        The buildings as they are for scale 0. Those with parts are there a second time, from the scale of their first
        block on, with its number.
    """
    single = features[features["part"] == -1]
    first = features[features["part"] != -1].sort_values(["low", "n"]).drop_duplicates("row").sort_values("row")
    whole = single.set_index("row").loc[first["row"]]
    first = first.assign(high=finest, height=whole["height"].to_numpy(), geometry=whole.geometry.to_numpy())
    return gpd.GeoDataFrame(pd.concat([single, first], ignore_index=True), crs=features.crs)
