"""The program ``msbdb``: its commands; libraries that take time to import are loaded by the commands that need them."""

import click

from msbdb.cli.build import build, classify
from msbdb.cli.command import INTERRUPTED
from msbdb.cli.db import db, doctor
from msbdb.cli.export import export, qgis, serve
from msbdb.cli.inventory import changes, import_, measure, state, update
from msbdb.cli.outputs import classes, evaluate, info, query, view, why
from msbdb.cli.params import params, plan
from msbdb.cli.tiles import tiles
from msbdb.threads import end_now, own_process
from msbdb.version import __version__


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__, prog_name="msbdb")
def cli() -> None:
    """Multi-scale building databases from airborne LiDAR and imagery.

    Start with 'msbdb build --points FILE.laz --db town.sqlite', then 'msbdb info town.sqlite'.
    """


for _command in (
    build,
    plan,
    tiles,
    info,
    query,
    why,
    classes,
    view,
    serve,
    export,
    qgis,
    evaluate,
    classify,
    measure,
    update,
    changes,
    import_,
    state,
    db,
    params,
    doctor,
):
    cli.add_command(_command)


def main() -> None:
    """Run the program."""
    own_process()
    try:
        cli(prog_name="msbdb")
    except SystemExit as ended:
        if ended.code == INTERRUPTED:
            end_now(INTERRUPTED)
        raise


if __name__ == "__main__":
    main()
