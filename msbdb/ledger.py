"""The ledger of a detector: how many regions each stage takes, keeps and drops, the dropped ones, and their cells."""

from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from msbdb.errors import TableError
from msbdb.tables import REJECTION_COUNT

Answers = NDArray[np.uint8]
"""(H, W) what a detector decided for each cell: 0 nothing, else the number of the stage and reason of its ledger."""

KIND = ["stage", "reason"]


class Ledger:
    """Counts by stage, checked to balance, and the dropped regions, a row each.

    Parameters
    ----------
    method : str
        Name of the detector.
    least_m2 : float
        Smaller regions get no row in a database, so that they need no id: theirs is 0.

    Attributes
    ----------
    counts : dict
        By stage: regions ``in`` (with the ``pieces`` that the stage cut itself, less those it joined), ``kept`` and
        ``dropped``.
    """

    def __init__(self, method: str, least_m2: float = 0.0) -> None:
        self.method, self.least_m2 = method, least_m2
        self.counts: dict[str, dict[str, int]] = {}
        self._lost: list[pd.DataFrame] = []
        self._rows: dict[str, int] = {}
        self._marks: list[tuple[tuple[str, str], NDArray[np.int64]]] = []

    def write(self, stage: str, regions: pd.DataFrame) -> int:
        """Write lost regions, rows with a ``reason``, under the stage that dropped them; return how many."""
        if len(regions):
            self._lost.append(regions.assign(method=self.method, stage=stage))
        self._rows[stage] = self._rows.get(stage, 0) + len(regions)
        return len(regions)

    def mark(
        self, stage: str, reasons: NDArray[np.object_], labels: NDArray[np.integer], cells: NDArray[np.integer]
    ) -> None:
        """Mark the cells of dropped regions; what a later stage marks replaces what was marked before.

        Parameters
        ----------
        stage : str
            The stage that dropped them.
        reasons : (M,) ndarray of str
            Why, a reason a region.
        labels : (K,) ndarray of int
            Which region each cell or point belongs to, 1 to M.
        cells : (K,) ndarray of int
            The flat index of its cell, in row order. Of two reasons in a cell the later in the alphabet stays, so that
            the order of points has no effect.
        """
        codes, words = pd.factorize(reasons, sort=True)
        for code, word in enumerate(words):
            chosen = cells[(codes == code)[labels - 1]]
            # Points share cells; a cell is marked once.
            self._marks.append(((stage, str(word)), pd.unique(chosen).astype(np.int64)))

    def count(
        self, stage: str, entered: int, kept: int, dropped: int, *, pieces: int = 0, written: bool = True
    ) -> None:
        """Add the numbers of a stage, after all of its rejected regions are written.

        Parameters
        ----------
        stage : str
            Its name; a stage that is run on several scales is counted several times.
        entered, kept, dropped : int
            Numbers of regions.
        pieces : int
            How many regions more the stage made by cutting; negative where it joined regions.
        written : bool
            Whether the dropped regions have rows. Duplicates have none, as another region covers them.

        Raises
        ------
        TableError
            When in = kept + dropped does not hold, or the stage has not a row for each region that it dropped.
        """
        if entered + pieces != kept + dropped:
            msg = (
                f"The stage '{stage}' does not balance: {entered} regions in and {pieces} pieces cut, "
                f"but {kept} kept and {dropped} dropped. This is a fault of msbdb; please report it."
            )
            raise TableError(msg)
        sums = self.counts.setdefault(stage, dict.fromkeys(("in", "pieces", "kept", "dropped"), 0))
        for name, value in (("in", entered + pieces), ("pieces", pieces), ("kept", kept), ("dropped", dropped)):
            sums[name] += value
        rows = self._rows.get(stage, 0)
        if rows != (sums["dropped"] if written else 0):
            msg = (
                f"The stage '{stage}' dropped {sums['dropped']} regions, but wrote {rows} rows into the ledger. "
                "This is a fault of msbdb; please report it."
            )
            raise TableError(msg)

    def lost(self, empty: pd.DataFrame) -> pd.DataFrame:
        """Return all lost regions in the order of writing; without any, an empty table with the same columns."""
        return pd.concat(self._lost or [empty.iloc[:0].assign(reason="", method="", stage="")], ignore_index=True)

    def marked(self) -> "Marks":
        """Return the marked cells, numbered by their stages and reasons in alphabetical order, as `sum_up` does."""
        written = {kind for frame in self._lost for kind in _kinds_of(frame)}
        number = {kind: place for place, kind in enumerate(sorted(written), start=1)}
        cells = [cells for _, cells in self._marks]
        numbers = [np.full(cells.size, number[kind], dtype=np.uint8) for kind, cells in self._marks]
        none = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.uint8)
        return Marks(np.concatenate([none[0], *cells]), np.concatenate([none[1], *numbers]))


class Marks(NamedTuple):
    """Cells that a detector dropped: flat indices, and the numbers of stage and reason; later ones replace earlier."""

    cells: NDArray[np.int64]
    numbers: NDArray[np.uint8]

    def on(self, shape: tuple[int, int]) -> Answers:
        """Return the numbers on a lattice of this shape, 0 elsewhere."""
        answers = np.zeros(shape, dtype=np.uint8)
        answers.ravel()[self.cells] = self.numbers
        return answers


def _kinds_of(frame: pd.DataFrame) -> list[tuple[str, str]]:
    """Return the different pairs of stage and reason of a frame."""
    return [(str(stage), str(reason)) for stage, reason in frame[KIND].drop_duplicates().to_numpy()]


def sum_up(rows: pd.DataFrame, counted: pd.DataFrame, least_m2: float) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Divide the ledger of a detector: rows for what could have been a building, numbers for all.

    Parameters
    ----------
    rows : DataFrame
        ``tables.REJECTION`` of one detector, a row for each dropped region that is not yet counted only.
    counted : DataFrame
        ``tables.REJECTION_COUNT``; the regions in ``small`` are those that have no row any more. Empty for a new run.
    least_m2 : float
        Least area of a building; smaller regions are only counted.

    Returns
    -------
    rows : DataFrame
        Those of at least this area.
    counts : DataFrame
        ``tables.REJECTION_COUNT``, in order of stage and reason, numbered from 1.

    Examples
    --------
    >>> from msbdb.tables import REJECTION
    >>> dropped = REJECTION.empty()
    >>> dropped.loc[0] = [1, "area3d", "rules", "rough", 1, 40.0, 0.0, 0.0]
    >>> dropped.loc[1] = [2, "area3d", "rules", "rough", 1, 4.0, 0.0, 0.0]
    >>> kept, counts = sum_up(REJECTION.typed(dropped), REJECTION_COUNT.empty(), 10.0)
    >>> len(kept), counts[["regions", "area_m2", "small", "small_m2"]].to_numpy().tolist()
    (1, [[2.0, 44.0, 1.0, 4.0]])
    """
    large = (rows["area_m2"] >= least_m2).to_numpy()
    one = pd.DataFrame(rows)[["method", *KIND]].assign(
        regions=1,
        large_m2=np.where(large, rows["area_m2"], 0.0),
        small=np.where(large, 0, 1),
        small_m2=np.where(large, 0.0, rows["area_m2"]),
    )
    # The regions with a row are counted by their rows.
    old = counted[["method", *KIND, "small", "small_m2"]].assign(regions=counted["small"], large_m2=0.0)
    both = pd.concat([frame for frame in (one, old) if len(frame)] or [one])
    # Sorted by area, as sums of floating-point numbers depend on their order.
    both = both.iloc[np.lexsort((both["small_m2"], both["large_m2"]))]
    sums = ["regions", "large_m2", "small", "small_m2"]
    found = both.groupby(["method", *KIND], as_index=False)[sums].sum()
    found = found.assign(area_m2=found["large_m2"] + found["small_m2"], number=np.arange(1, len(found) + 1))
    return rows[large].reset_index(drop=True), REJECTION_COUNT.typed(found)
