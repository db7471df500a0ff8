"""What disturbed runs left, as a table."""

from collections import Counter
from collections.abc import Callable

from disturbance.runs import Outcome

COLUMNS = ("runs", "came through", "absent", "old", "between", "new", "wrong")


def table(outcomes: list[Outcome], name: str, of: Callable[[Outcome], str]) -> list[str]:
    """Return a table of what was left, a line for each group of runs."""
    groups: dict[str, Counter[str]] = {}
    for outcome in outcomes:
        found = groups.setdefault(of(outcome), Counter())
        found.update(["runs", outcome.left])
        found["came through"] += outcome.ended == "done"
        found["wrong"] += bool(outcome.problem)
    groups["all"] = sum(groups.values(), Counter())
    lines = [f"| {name} | {' | '.join(COLUMNS)} |", "|---|" + "---:|" * len(COLUMNS)]
    return lines + [f"| {key} | {' | '.join(str(n[column]) for column in COLUMNS)} |" for key, n in groups.items()]
