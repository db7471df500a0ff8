"""The books of the multi-scale extraction: lost regions as rows of clusters, until they get their ids."""

from msbdb.extract.books import Books
from msbdb.extract.multiscale.clusters import Clusters, Step


class Ledger(Books):
    """Counts by stage, checked to balance, and the clusters that were lost; ``level`` is -1 where no scale applies."""

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
        if lost:
            self.write(stage, step.dropped)
        entered, kept = int(before.alive.sum()), int(step.clusters.alive.sum())
        self.count(stage, entered, kept, len(step.dropped), pieces=step.pieces, written=lost)
        return step.clusters
