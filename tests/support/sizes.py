"""How much of a campaign belongs to the default size of the tests: cases of a long list, random examples."""

from collections.abc import Iterable
from typing import Any

import pytest
from hypothesis import settings


def sample(cases: Iterable[Any], every: int) -> list[Any]:
    """Return cases for ``parametrize``: the first and each so-many-th later one as they are, the others marked long."""
    return [case if number % every == 0 else _long(case) for number, case in enumerate(cases)]


def examples(most: int) -> settings:
    """Return settings for so many random examples in the long size, and for a quarter of them by default.

    It is in proportion to the profile, which ``conftest.py`` chooses before any test module is read.
    """
    return settings(max_examples=most * settings().max_examples // 100, deadline=None)


def _long(case: Any) -> Any:
    values = case if isinstance(case, tuple) else (case,)
    return pytest.param(*values, marks=pytest.mark.long)
