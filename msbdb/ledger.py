"""The ledger of a detector: how many regions each stage takes, keeps and drops, and the dropped ones as rows."""

import pandas as pd

from msbdb.errors import TableError


class Ledger:
    """Counts by stage, checked to balance, and the dropped regions, a row each.

    Parameters
    ----------
    method : str
        Name of the detector.

    Attributes
    ----------
    counts : dict
        By stage: regions ``in`` (with the ``pieces`` that the stage cut itself, less those it joined), ``kept`` and
        ``dropped``.
    """

    def __init__(self, method: str) -> None:
        self.method = method
        self.counts: dict[str, dict[str, int]] = {}
        self._lost: list[pd.DataFrame] = []
        self._rows: dict[str, int] = {}

    def write(self, stage: str, regions: pd.DataFrame) -> int:
        """Write lost regions, rows with a ``reason``, under the stage that dropped them; return how many."""
        if len(regions):
            self._lost.append(regions.assign(method=self.method, stage=stage))
        self._rows[stage] = self._rows.get(stage, 0) + len(regions)
        return len(regions)

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
        """Return all lost regions in the order of writing; the empty table gives the columns when there are none."""
        return pd.concat(self._lost or [empty.iloc[:0].assign(reason="", method="", stage="")], ignore_index=True)
