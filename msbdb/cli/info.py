"""``msbdb info``: what a database holds."""

from msbdb.cli.command import command
from msbdb.cli.options import shared
from msbdb.cli.output import emit, emit_json


@command("info", examples=("msbdb info town.sqlite", "msbdb info postgresql://me@localhost/town --json"))
@shared("db", "json")
def info(*, db: str, as_json: bool) -> None:
    """Tell what a database holds.

    Its surveys with their sources, its runs with their counts, and the version of its schema. With --json also what
    each run decided itself: the ground filter, the scales, the scaling of the bands and the centres of the classes.
    """
    from msbdb import pipeline

    result = pipeline.info(db)
    if as_json:
        emit_json(result)
    else:
        for run in result.get("runs", []):
            run["ground_filter"] = run.pop("chosen").get("ground_filter")
        emit(result)
