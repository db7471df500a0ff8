"""From bands to a class map with its tables (V34 to V36): filter, cluster, label automatically."""

from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from msbdb.bands import Bands
from msbdb.errors import GridMismatchError
from msbdb.grid import Grid
from msbdb.labels import sizes
from msbdb.landcover import ClassMap
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

    Returns
    -------
    Classified
        Empty when no cell qualifies.

    Raises
    ------
    GridMismatchError
        When the lattices differ.
    """
    _require_lattice(bands, ndsm, roughness)
    filtered = filter_to_classify(bands, ndsm, params)
    spectral = params.spectral
    sample = draw_sample(filtered, bands, ndsm.values, roughness, count=spectral.sample, seed=spectral.seed)
    model = fit_model(sample, spectral) if len(sample) else None
    labels = dict(enumerate(model.suggested, start=1)) if model else {}
    index = predict(filtered, model.centres) if model else np.zeros(ndsm.spec.shape, dtype=np.uint8)
    cells = sizes(index, len(labels))
    tables = class_tables(model, cells)
    return Classified(ClassMap(index, labels, ndsm.spec), *tables, model)


def class_tables(model: ClassModel | None, cells: NDArray[np.integer]) -> tuple[pd.DataFrame, pd.DataFrame]:
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
            "label": list(model.suggested),
            "labelled_by": "automatic",
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
