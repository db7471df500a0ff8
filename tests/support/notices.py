"""The notices of one call, for tests in which every warning would otherwise be an error."""

import warnings
from collections.abc import Callable
from typing import ParamSpec, TypeVar

from msbdb.errors import MsbdbWarning

P = ParamSpec("P")
R = TypeVar("R")


def with_notices(function: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> tuple[R, list[str]]:
    """Return the result of a call, and the notices that it gave; other warnings stay errors."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", MsbdbWarning)
        result = function(*args, **kwargs)
    return result, [str(warning.message) for warning in caught]
