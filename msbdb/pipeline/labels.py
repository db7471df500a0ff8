"""Operators' labels of classes, which survive that their survey is built again (V36)."""

from collections.abc import Hashable
from typing import Any

import numpy as np
import pandas as pd

from msbdb.pipeline.cover import Cover

MEASURED = ("cells", "ndvi", "brightness", "roughness_m")
"""Figures by which a class is known as the same one."""

LOST = (
    "The operator's label '{label}' of class {number} was not kept, as the class is another one now. "
    "See 'msbdb classes', and label it again."
)


def keep_labels(cover: Cover, labelled: pd.DataFrame, lost: list[str]) -> Cover:
    """Give classes the labels that an operator gave them before, where they are the same classes.

    Parameters
    ----------
    cover : Cover
        Classes as they were found now.
    labelled : DataFrame
        The survey's classes with an operator's label so far (`msbdb.database.read_labelled_classes`).
    lost : list of str
        Takes a sentence for each label that cannot be kept.
    """
    now = {int(row["speindex"]): row for row in cover.table.to_dict(orient="records")}
    kept: dict[int, str] = {}
    for old in labelled.to_dict(orient="records"):
        number, label = int(old["speindex"]), str(old["label"])
        if number in now and _is_same(old, now[number]):
            kept[number] = label
        else:
            lost.append(LOST.format(label=label, number=number))
    return cover.relabelled(kept) if kept else cover


def _is_same(old: dict[Hashable, Any], new: dict[Hashable, Any]) -> bool:
    """Tell whether two classes of one number have the same content."""
    one, two = (np.array([row[name] for name in MEASURED], dtype=np.float64) for row in (old, new))
    return bool(old["source"] == new["source"] and np.allclose(one, two, rtol=1e-6, atol=1e-9, equal_nan=True))
