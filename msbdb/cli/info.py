"""``msbdb info``: what a database holds."""

from msbdb.cli.command import command
from msbdb.cli.options import shared
from msbdb.cli.output import emit, emit_json


@command("info", examples=("msbdb info town.sqlite", "msbdb info postgresql://me@localhost/town --json"))
@shared("db", "json")
def info(*, db: str, as_json: bool) -> None:
    """Tell what a database holds.

    Its surveys with their sources, its runs with their counts, and the version of its schema.
    """
    from msbdb import pipeline

    result = pipeline.info(db)
    if as_json:
        emit_json(result)
    else:
        emit(result)
