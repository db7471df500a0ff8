"""How the project compiles its kernels."""

from collections.abc import Callable
from typing import ParamSpec, TypeVar, cast

import numba

P = ParamSpec("P")
R = TypeVar("R")


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function for arrays: cached on disk, without the interpreter's lock.

    Neither threads nor relaxed floating-point rules are used, so that the same input gives the same output on
    every machine.
    """
    return cast("Callable[P, R]", numba.njit(function, cache=True, nogil=True))
