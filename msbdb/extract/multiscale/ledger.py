"""The books of an extraction: what each stage took in, kept and dropped, so that nothing vanishes silently."""

import pandas as pd

from msbdb.errors import TableError
from msbdb.extract.multiscale.clusters import Clusters, Step


class Ledger:
    """Counts by stage, checked to balance, and the regions that were lost."""

    def __init__(self) -> None:
        """Open empty books."""
        self.counts: dict[str, dict[str, int]] = {}
        self._lost: list[pd.DataFrame] = []

    def book(self, stage: str, before: Clusters, step: Step, *, lost: bool = True) -> Clusters:
        """Book a stage and return the clusters that it leaves.

        Parameters
        ----------
        stage : str
            Name of the stage.
        before : Clusters
            What went in.
        step : Step
            What the stage left.
        lost : bool
            Whether the dropped regions are lost and go to the ledger. Duplicates are only counted, as the coarser
            cluster stands for them.
        """
        self.count(stage, int(before.alive.sum()), int(step.clusters.alive.sum()), len(step.dropped), step.pieces)
        if lost:
            self.write(stage, step.dropped)
        return step.clusters

    def count(self, stage: str, entered: int, kept: int, dropped: int, pieces: int = 0) -> None:
        """Note the numbers of a stage, which cut so many pieces itself.

        Raises
        ------
        TableError
            When in = kept + dropped does not hold.
        """
        if entered + pieces != kept + dropped:
            msg = (
                f"The stage '{stage}' does not balance: {entered} regions in and {pieces} pieces cut, "
                f"but {kept} kept and {dropped} dropped. This is a fault of msbdb; please report it."
            )
            raise TableError(msg)
        self.counts[stage] = {"in": entered + pieces, "pieces": pieces, "kept": kept, "dropped": dropped}

    def write(self, stage: str, regions: pd.DataFrame) -> None:
        """Write lost regions, as rows of clusters with a ``reason``; ``level`` is -1 where no scale applies."""
        if len(regions):
            self._lost.append(regions.assign(stage=stage))

    def lost(self, empty: pd.DataFrame) -> pd.DataFrame:
        """Return all lost regions with stage and reason; the empty table gives the columns when there are none."""
        return pd.concat(self._lost or [empty.iloc[:0].assign(reason="", stage="")], ignore_index=True)
