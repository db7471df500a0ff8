"""Pieces are joined as by looking at all of them again after each join."""

import numpy as np

from msbdb.fuse.houses.joining import DIFFER, MOMENTS, PAIRS, Joining
from msbdb.fuse.houses.roofpieces import RoofPieces, Touches
from msbdb.params import TouchingParams

SIDE = 9
"""Pieces along each side of a square of pieces, each beside its eight neighbours."""


class Rescanning(Joining):
    """Looks at all nodes again after each join."""

    pairs = 0

    def _two_on_one(self):
        """Return the first pair of all that a third node encloses."""
        for one, beside in enumerate(self.beside):
            for other in sorted(node for node in beside if node > one):
                outline = self.around[one] + self.around[other] - 2 * beside[other][PAIRS]
                for third in sorted(beside.keys() & self.beside[other].keys()):
                    shared = beside[third][PAIRS] + self.beside[other][third][PAIRS]
                    owners = {self.owners[node] for node in (one, other, third)} - {0}
                    if shared >= self.params.enclosed_share * outline and len(owners) <= 1:
                        self.pairs += 1
                        return one, other
        return None


def pieces(random):
    """Draw pieces of a square of roofs, most of them with steps between, and where they touch."""
    count = SIDE * SIDE
    place = np.arange(count).reshape(SIDE, SIDE)
    sides = (place[:, :-1], place[:, 1:]), (place[:-1], place[1:]), (place[:-1, :-1], place[1:, 1:])
    one, other = (np.concatenate([side[end].ravel() for side in sides]) for end in range(2))
    counts = np.zeros((len(one), 14))
    counts[:, PAIRS] = random.integers(1, 60, len(one))
    counts[:, PAIRS + 1 : DIFFER] = counts[:, [PAIRS]] * (random.random((len(one), DIFFER - 1)) < 0.8)
    counts[:, DIFFER] = counts[:, PAIRS] * random.uniform(0, 4, len(one))
    cells = random.integers(20, 900, count).astype(np.float64)
    middle = random.uniform(0, 500, (count, 2))
    spread = cells[:, None] * (middle**2 + cells[:, None] / 12)
    moments = np.column_stack([cells[:, None] * middle, spread, cells * middle[:, 0] * middle[:, 1]])
    counts[:, MOMENTS:] = moments[one] / cells[one, None] * counts[:, [PAIRS]]
    heights = random.uniform(3, 30, count)
    rims, none = random.integers(0, 20, count).astype(np.float64), np.zeros((count, 3))
    owners = random.integers(0, 3, count) * random.integers(0, 2)
    labels = (place + 1).astype(np.int32)
    found = RoofPieces(labels, cells, cells * heights, heights, moments, owners, rims, none)
    return found, Touches(one, other, counts)


def test_the_pieces_beside_a_join_are_enough_to_look_at():
    """The same pieces go into the same others, and the same borders are left; some pairs are joined on a third."""
    pairs = 0
    for seed in range(30):
        given = pieces(np.random.default_rng(seed))
        quick, slow = (kind(*given, TouchingParams(enclosed_share=0.4), 0.5) for kind in (Joining, Rescanning))
        np.testing.assert_array_equal(quick.run(), slow.run())
        assert quick.borders() == slow.borders()
        pairs += slow.pairs
    assert pairs > 20
