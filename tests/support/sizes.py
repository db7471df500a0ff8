"""How much of a campaign belongs to each size of the tests: cases of a long list, random examples."""

from collections.abc import Iterable
from typing import Any

import pytest
from hypothesis import settings


def sample(cases: Iterable[Any], every: int, every_long: int = 1) -> list[Any]:
    """Return cases for ``parametrize``, each for one size of the tests.

    Case 0 and each later one whose number ``every`` divides have no mark. Of the others those whose number
    ``every_long`` divides are marked long, the rest campaign.
    """
    marks = (pytest.mark.long, pytest.mark.campaign)
    return [
        case if number % every == 0 else _marked(case, marks[number % every_long > 0])
        for number, case in enumerate(cases)
    ]


def examples(most: int) -> settings:
    """Return settings for so many random examples in the long size, and for fewer in the others.

    It is in proportion to the profile, which ``conftest.py`` chooses before any test module is read.
    """
    return settings(max_examples=most * settings().max_examples // 100, deadline=None)


def _marked(case: Any, mark: pytest.MarkDecorator) -> Any:
    values = case if isinstance(case, tuple) else (case,)
    return pytest.param(*values, marks=mark)
