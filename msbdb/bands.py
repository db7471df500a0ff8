"""Image bands on a lattice: what the rasters' reader gives and the spectral stage takes."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msbdb.errors import GridMismatchError, InputError
from msbdb.grid import GridSpec


@dataclass(frozen=True, slots=True, eq=False)
class Bands:
    """Band values and their shared validity on a lattice (V13: any number of bands); the arrays are read-only.

    Parameters
    ----------
    values : (B, H, W) ndarray of float32
        Finite everywhere, in the source's units (digital numbers); zero where not valid.
    names : tuple of str
        One unique name a band; ``red``, ``green``, ``blue``, ``nir`` and ``intensity`` have a meaning.
    valid : (H, W) ndarray of bool
        Where every band was observed.
    spec : GridSpec
        The lattice.
    """

    values: NDArray[np.float32]
    names: tuple[str, ...]
    valid: NDArray[np.bool_]
    spec: GridSpec

    def __post_init__(self) -> None:
        """Check shapes, dtypes and names, and freeze the arrays."""
        expected = (len(self.names), *self.spec.shape)
        if self.values.shape != expected or self.valid.shape != self.spec.shape:
            msg = (
                f"Values {self.values.shape} and validity {self.valid.shape} must fit the bands and lattice {expected}."
            )
            raise GridMismatchError(msg)
        if self.values.dtype != np.float32 or self.valid.dtype != np.bool_:
            msg = f"Values must be float32 and validity bool; got {self.values.dtype} and {self.valid.dtype}."
            raise InputError(msg)
        if not self.names or len(set(self.names)) != len(self.names):
            msg = f"Every band needs a name of its own; got {self.names}."
            raise InputError(msg)
        self.values.flags.writeable = False
        self.valid.flags.writeable = False

    def band(self, name: str) -> NDArray[np.float32] | None:
        """Return the (H, W) values of the named band, or None if there is no such band."""
        return self.values[self.names.index(name)] if name in self.names else None
