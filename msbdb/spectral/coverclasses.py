"""Land cover of a survey: structure, classes of colours, and the operator's labels, in one class map (V34 to V36)."""

from collections.abc import Hashable, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from msbdb.errors import GridMismatchError, InputError, PassingNotice, give_notice
from msbdb.grid import Bands, Grid
from msbdb.labels import sizes, sums
from msbdb.landcover import LABELS, ClassMap, overlay
from msbdb.params import Params
from msbdb.spectral.kmeans import Sample, draw_sample, predict
from msbdb.spectral.model import ClassModel, filter_to_classify, fit_model
from msbdb.surface import Structure, cover_with_colours, drop_green_regions
from msbdb.tables import SPECTRAL_CLASS, SPECTRAL_CLASS_BAND, validate

COLOURS = {"red", "green", "blue", "nir"}
"""Bands that make imagery."""

MEASURED = ("cells", "ndvi", "brightness", "roughness_m")
"""Figures by which a class is known as the same one."""

LOST = (
    "The operator's label '{label}' of class {number} was not kept, as the class is another one now. "
    "See 'msbdb classes', and label it again."
)


class Classified(NamedTuple):
    """The classes by colour: their map, their tables, and the fitted model, None where no cell qualified.

    ``table`` is ``tables.SPECTRAL_CLASS``, ``band_table`` is ``tables.SPECTRAL_CLASS_BAND``.
    """

    classes: ClassMap
    table: pd.DataFrame
    band_table: pd.DataFrame
    model: ClassModel | None


class Fitted(NamedTuple):
    """The model of the classes, None where no cell qualified, and the filtered bands where they are made already."""

    model: ClassModel | None
    filtered: Bands | None = None


def classify(
    bands: Bands,
    ndsm: Grid,
    roughness: NDArray[np.floating] | None,
    params: Params,
    fitted: Fitted | None = None,
    *,
    roof: NDArray[np.bool_] | None = None,
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
    fitted : Fitted, optional
        The model of a larger survey; without it the classes are fitted to these bands.
    roof : (H, W) ndarray of bool, optional
        Cells that the structure takes for roofs. With it, roofs of the colour of crowns are no vegetation.

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
    if fitted is None:
        sample, filtered = sample_to_classify(bands, ndsm, roughness, params, roof)
        model = fit_model(sample, params.spectral) if len(sample) else None
    else:
        model = fitted.model
        filtered = fitted.filtered or filter_to_classify(bands, ndsm, params)
    labels = dict(enumerate(model.suggested, start=1)) if model else {}
    index = predict(filtered, model.centres) if model else np.zeros(ndsm.spec.shape, dtype=np.uint8)
    cells = sizes(index, len(labels))
    tables = class_tables(model, cells)
    return Classified(ClassMap(index, labels, ndsm.spec), *tables, model)


def sample_to_classify(
    bands: Bands,
    ndsm: Grid,
    roughness: NDArray[np.floating] | None,
    params: Params,
    roof: NDArray[np.bool_] | None = None,
) -> tuple[Sample, Bands]:
    """Return the cells to which classes are fitted, and the filtered bands; parameters are those of `classify`."""
    filtered, own = filter_to_classify(bands, ndsm, params), params.spectral
    return draw_sample(filtered, bands, ndsm.values, roughness, roof, count=own.sample, seed=own.seed), filtered


def is_imagery(bands: Bands | None) -> bool:
    """Return whether there are colours; one band of intensity alone separates materials too poorly."""
    return bands is not None and bool(COLOURS & set(bands.names))


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


@dataclass(frozen=True, slots=True, eq=False)
class Cover:
    """The class maps of a build and the tables that describe their classes.

    Parameters
    ----------
    structure : ClassMap
        Roofs and vegetation by texture and echoes.
    spectral : ClassMap, optional
        Classes by colour, with their automatic labels; None without imagery.
    table, bands : DataFrame
        ``tables.SPECTRAL_CLASS`` and ``tables.SPECTRAL_CLASS_BAND``.
    colours_decide : bool
        Colours alone separate roofs from vegetation (V36 to V41 as written), structure only where imagery is missing.
    green_decides : bool
        Spectral vegetation is vegetation even where the structure sees a roof.
    operator : mapping of int to str
        The operator's labels.
    model : ClassModel, optional
        The fit of the classes by colour; None without imagery, and for a kept run, whose record has it.
    """

    structure: ClassMap
    spectral: ClassMap | None
    table: pd.DataFrame
    bands: pd.DataFrame
    colours_decide: bool
    green_decides: bool
    operator: Mapping[int, str]
    model: ClassModel | None = None

    @property
    def classes(self) -> ClassMap:
        """The map that the detectors read."""
        if self.spectral is None or not self.colours_decide:
            return overlay(self.structure, self.spectral, operator=self.operator, green_decides=self.green_decides)
        count = max(self.spectral.labels, default=0)
        beyond = (self.spectral.index == 0) & (self.structure.index > 0)
        index = np.where(beyond, self.structure.index + count, self.spectral.index).astype(np.uint8)
        labels = {**self.spectral.labels, count + 1: "building", count + 2: "vegetation", **self.operator}
        return ClassMap(index, labels, self.spectral.spec)

    @property
    def colours(self) -> ClassMap:
        """The classes by colour alone, with the operator's labels; no cell has a class without imagery."""
        if self.spectral is None:
            return ClassMap(np.zeros(self.structure.spec.shape, dtype=np.uint8), {}, self.structure.spec)
        operator = {number: label for number, label in self.operator.items() if number in self.spectral.labels}
        return replace(self.spectral, labels={**self.spectral.labels, **operator})

    def crowns(self, roughness_m: NDArray[np.floating], limit_m: float) -> NDArray[np.bool_]:
        """Return the cells of vegetation by colour that are rougher than a limit, metres: crowns, not green roofs."""
        found: NDArray[np.bool_] = self.colours.labelled("vegetation") & (roughness_m > limit_m)
        return found

    def with_buildings(self, built: NDArray[np.bool_], heights: Grid, mask_m: float) -> "Cover":
        """Return the cover with other roofs by structure: those that several detectors support together.

        Parameters
        ----------
        built : (H, W) ndarray of bool
            Cells of buildings. All other cells at or above the mask count as vegetation.
        heights : Grid
            Heights above ground, metres.
        mask_m : float
            Height of the mask (V17), metres.
        """
        raised = heights.valid & (np.asarray(heights.values) >= mask_m)
        index = np.where(built, np.uint8(1), np.where(raised, np.uint8(2), np.uint8(0)))
        return replace(self, structure=ClassMap(index, self.structure.labels, self.structure.spec))

    def relabelled(self, labels: Mapping[int, str]) -> "Cover":
        """Return the cover with further labels by the operator.

        Raises
        ------
        InputError
            For a class or a label that does not exist.
        """
        known = self.table["speindex"].tolist()
        for number, label in labels.items():
            if number not in known or label not in LABELS:
                msg = (
                    f"Class {number} cannot be labelled '{label}': there are the classes 1 to {max(known, default=0)} "
                    f"and the labels {', '.join(LABELS)}."
                )
                raise InputError(msg)
        chosen = self.table["speindex"].isin(list(labels))
        table = self.table.assign(
            label=[labels.get(k, old) for k, old in zip(known, self.table["label"], strict=True)],
            labelled_by=np.where(chosen, "operator", self.table["labelled_by"]),
        )
        return replace(self, table=table, operator={**self.operator, **labels})


def classify_cover(
    structure: Structure,
    bands: Bands | None,
    ndsm: Grid,
    params: Params,
    *,
    echoes: bool,
    fitted: Fitted | None = None,
    counted: NDArray[np.bool_] | None = None,
) -> Cover:
    """Classify the colours, if given, and describe all classes in one table; see `classify`.

    Without ``echoes`` the classes of colours help the structure (`msbdb.surface.structure.cover_with_colours`).
    Where ``counted`` is given, (H, W), the table counts these cells alone.
    """
    by_structure, roughness_m = structure.cover, structure.filled_m
    spectral, table, band_table, model = None, SPECTRAL_CLASS.empty(), SPECTRAL_CLASS_BAND.empty(), None
    if bands is not None and is_imagery(bands):
        roof = by_structure.labelled("building")
        spectral, table, band_table, model = classify(bands, ndsm, roughness_m, params, fitted, roof=roof)
        if counted is not None:
            table, _ = class_tables(model, sizes(np.where(counted, spectral.index, 0), len(spectral.labels)))
    colours_decide = spectral is not None and params.spectral.decides == "spectral"
    if spectral is not None:
        odds = None if model is None or echoes else model.roof_odds
        if odds is not None:
            by_structure = cover_with_colours(structure, ndsm, spectral.index, odds, params.cover)
        by_structure = drop_green_regions(by_structure, spectral.labelled("vegetation"), roughness_m, params.cover)
    own = by_structure.index if counted is None else np.where(counted, by_structure.index, np.uint8(0))
    table = pd.concat([table, _structure_rows(own, len(table), ndsm, roughness_m)], ignore_index=True)
    green = bands is not None and "nir" in bands.names and not echoes
    return Cover(by_structure, spectral, table, band_table, colours_decide, green, {}, model)


def _structure_rows(index: NDArray[np.uint8], count: int, ndsm: Grid, roughness_m: NDArray[np.float32]) -> pd.DataFrame:
    """Describe the two structural classes, which follow the spectral ones; one without cells is 0 m high."""
    cells = sizes(index, 2)
    size = np.where(cells > 0, cells, np.nan)
    heights = sums(index, np.asarray(ndsm.values, dtype=np.float64), 2)
    rough = sums(index, roughness_m.astype(np.float64), 2)
    rows = pd.DataFrame(
        {
            "speindex": np.array([count + 1, count + 2], dtype=np.int64),
            "label": ["building", "vegetation"],
            "labelled_by": "automatic",
            "source": "structure",
            "cells": cells,
            "share": cells / max(int(cells.sum()), 1),
            "ndvi": np.nan,
            "brightness": np.nan,
            "roughness_m": rough / size,
            "height_m": heights / np.maximum(cells, 1),
        }
    )
    return rows[SPECTRAL_CLASS.names]


def keep_labels(cover: Cover, labelled: pd.DataFrame) -> Cover:
    """Give classes the labels that an operator gave them before, where they are the same classes.

    Parameters
    ----------
    cover : Cover
        Classes as they were found now.
    labelled : DataFrame
        The survey's classes with an operator's label so far (`msbdb.database.read_labelled_classes`).

    Warns
    -----
    PassingNotice
        For each label that cannot be kept.
    """
    now = {int(row["speindex"]): row for row in cover.table.to_dict(orient="records")}
    kept: dict[int, str] = {}
    for old in labelled.to_dict(orient="records"):
        number, label = int(old["speindex"]), str(old["label"])
        if number in now and _is_same(old, now[number]):
            kept[number] = label
        else:
            give_notice(LOST.format(label=label, number=number), PassingNotice)
    return cover.relabelled(kept) if kept else cover


def _is_same(old: dict[Hashable, Any], new: dict[Hashable, Any]) -> bool:
    """Return whether two classes of one number have the same content."""
    one, two = (np.array([row[name] for name in MEASURED], dtype=np.float64) for row in (old, new))
    return bool(old["source"] == new["source"] and np.allclose(one, two, rtol=1e-6, atol=1e-9, equal_nan=True))
