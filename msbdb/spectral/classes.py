"""From bands to a class map with its tables (V34 to V36): filter, cluster, label."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from msbdb.bands import Bands
from msbdb.errors import GridMismatchError, InputError
from msbdb.grid import Grid
from msbdb.labels import sizes
from msbdb.landcover import LABELS, ClassMap
from msbdb.params import Params
from msbdb.spectral.kmeans import draw_sample, predict
from msbdb.spectral.model import ClassModel, filter_to_classify, fit_model
from msbdb.tables import SPECTRAL_CLASS, SPECTRAL_CLASS_BAND, validate


class Classified(NamedTuple):
    """The classes by colour: their map, their tables, and the fitted model, None where no cell qualified.

    ``table`` is ``tables.SPECTRAL_CLASS``, ``band_table`` is ``tables.SPECTRAL_CLASS_BAND``.
    """

    classes: ClassMap
    table: pd.DataFrame
    band_table: pd.DataFrame
    model: ClassModel | None


def classify(
    bands: Bands,
    ndsm: Grid,
    roughness: NDArray[np.floating] | None,
    params: Params,
    operator_labels: Mapping[int, str] | None = None,
) -> Classified:
    """Classify the cells of at least one storey by their bands (V34 to V36).

    Parameters
    ----------
    bands : Bands
        Any number of bands; invalid cells stay unclassified.
    ndsm : Grid
        Height above ground, metres, on the bands' lattice. Cells below the mask stay unclassified (V35, V17).
    roughness : (H, W) ndarray of float, metres, optional
        Local roughness of the surface, as `msbdb.surface.texture.roughness` gives it. Labels are surer with it.
    params : Params
        Sections ``spectral``, ``surface`` (the mask) and ``scale`` (connectivity, and the scales, at least one).
    operator_labels : mapping of int to str, optional
        Information class of some classes; overrules the suggestion.

    Returns
    -------
    Classified
        Empty when no cell qualifies.

    Raises
    ------
    GridMismatchError
        When the lattices differ.
    InputError
        For labels or classes that do not exist.
    """
    _require_lattice(bands, ndsm, roughness)
    filtered = filter_to_classify(bands, ndsm, params)
    spectral = params.spectral
    sample = draw_sample(filtered, bands, ndsm.values, roughness, count=spectral.sample, seed=spectral.seed)
    model = fit_model(sample, spectral) if len(sample) else None
    labels = merged_labels(model, operator_labels)
    index = predict(filtered, model.centres) if model else np.zeros(ndsm.spec.shape, dtype=np.uint8)
    cells = sizes(index, len(labels))
    tables = class_tables(model, labels, set(operator_labels or ()), cells)
    return Classified(ClassMap(index, labels, ndsm.spec), *tables, model)


def merged_labels(model: ClassModel | None, operator_labels: Mapping[int, str] | None) -> dict[int, str]:
    """Return the label of every class: the operator's where one was given, else the suggestion (V36).

    Raises
    ------
    InputError
        For a class or a label that does not exist.
    """
    labels = dict(enumerate(model.suggested, start=1)) if model else {}
    for number, label in (operator_labels or {}).items():
        if number not in labels or label not in LABELS:
            msg = (
                f"The label '{label}' was given to class {number}; there are the classes 1 to {len(labels)} "
                f"and the labels {', '.join(LABELS)}."
            )
            raise InputError(msg)
        labels[number] = label
    return labels


def class_tables(
    model: ClassModel | None, labels: Mapping[int, str], by_operator: set[int], cells: NDArray[np.integer]
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Describe the classes: `tables.SPECTRAL_CLASS` and `tables.SPECTRAL_CLASS_BAND`.

    ``cells`` counts the cells of each class in the whole map; the means are those of the sample, which is all cells
    unless there are more than it may hold.
    """
    if model is None:
        return SPECTRAL_CLASS.empty(), SPECTRAL_CLASS_BAND.empty()
    numbers = np.arange(1, len(model.centres) + 1, dtype=np.int64)
    classes = pd.DataFrame(
        {
            "speindex": numbers,
            "label": [labels[int(k)] for k in numbers],
            "labelled_by": ["operator" if int(k) in by_operator else "automatic" for k in numbers],
            "source": "spectral",
            "cells": cells.astype(np.int64),
            "share": cells / max(int(cells.sum()), 1),
            "ndvi": model.facts.index,
            "brightness": model.facts.brightness,
            "roughness_m": model.facts.roughness,
            "height_m": model.facts.height,
        }
    )
    names = model.centres.scaling.names
    means = pd.DataFrame(
        {
            "speindex": np.repeat(numbers, len(names)),
            "band": list(names) * len(numbers),
            "mean": model.band_means.ravel(),
        }
    )
    validate(classes, SPECTRAL_CLASS)
    validate(means, SPECTRAL_CLASS_BAND)
    return classes, means


def _require_lattice(bands: Bands, ndsm: Grid, roughness: NDArray[np.floating] | None) -> None:
    """Refuse inputs on different lattices."""
    if not bands.spec.same_lattice(ndsm.spec):
        msg = f"The bands lie on {bands.spec}, the nDSM on {ndsm.spec}; resample the bands onto the nDSM's lattice."
        raise GridMismatchError(msg)
    if roughness is not None and roughness.shape != ndsm.spec.shape:
        msg = f"The roughness has the shape {roughness.shape}, the nDSM {ndsm.spec.shape}; they must agree."
        raise GridMismatchError(msg)
