"""What all commands have in common: shared options, examples in the help, logging, notices, and how errors end.

An option that several commands have is spelled and explained in one place.
"""

import datetime
import logging
import os
import re
import traceback
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar

import click
from click.shell_completion import CompletionItem

from msbdb.cli.output import QUIET
from msbdb.cli.progress import keep, reporting
from msbdb.errors import FileError, MsbdbError

F = TypeVar("F", bound=Callable[..., Any])


class InputFile(click.Path):
    """A file that exists; a URL or a folder is refused with the next step."""

    def convert(
        self, value: str | os.PathLike[str], param: click.Parameter | None, ctx: click.Context | None
    ) -> str | bytes | os.PathLike[str]:
        """Return the path."""
        from msbdb.io.files import require_input

        if str(value).startswith("--"):
            self.fail(f"a file is expected; got the option {value}.", param, ctx)
        try:
            require_input(value)
        except FileError as error:
            self.fail(str(error), param, ctx)
        return super().convert(value, param, ctx)


class PointFiles(InputFile):
    """A point file that exists or is remote, or a folder, a pattern or an index that stands for several."""

    def convert(
        self, value: str | os.PathLike[str], param: click.Parameter | None, ctx: click.Context | None
    ) -> str | bytes | os.PathLike[str]:
        """Return the path."""
        from msbdb.io.files import url_of
        from msbdb.io.pointfiles import is_many

        return Path(value) if is_many(value) or url_of(value) is not None else super().convert(value, param, ctx)


INPUT_FILE = InputFile(exists=True, path_type=Path)
POINT_FILES = PointFiles(exists=True, path_type=Path)


class DatabaseName(click.types.StringParamType):
    """The path of a SpatiaLite file, which shells complete, or a URL."""

    def shell_complete(
        self,
        ctx: click.Context,  # noqa: ARG002  (click's)
        param: click.Parameter,  # noqa: ARG002  (click's)
        incomplete: str,
    ) -> list[CompletionItem]:
        """Let the shell complete the names of files."""
        return [CompletionItem(incomplete, type="file")]


DATABASE = DatabaseName()

OUTPUT_FILE = click.Path(path_type=Path)
"""A file to write; what it may be is checked where it is written, for users of Python too."""

INTERRUPTED = 130
"""Exit code after Ctrl-C, as shells count it: 128 + SIGINT."""


def iso_date(text: str) -> str:
    """Return a day, month or year by ISO 8601, as it is: 2021-05-31, 2021-05 or 2021."""
    if re.fullmatch(r"\d{4}(-\d{2}(-\d{2})?)?", text):
        try:
            datetime.date.fromisoformat(text + "0000-01-01"[len(text) :])
        except ValueError:
            pass
        else:
            return text
    msg = f"{text!r} is no date; write it as 2021-05-31, 2021-05 or 2021."
    raise click.BadParameter(msg)


def crs_name(text: str) -> str:
    """Return the name of a CRS; a bare number is an EPSG code.

    Examples
    --------
    >>> crs_name("2154"), crs_name("EPSG:28992")
    ('EPSG:2154', 'EPSG:28992')
    """
    return f"EPSG:{text}" if text.isdecimal() else text


def place(text: str) -> tuple[float, float]:
    """Return the two coordinates of a place written X,Y.

    Examples
    --------
    >>> place("85210.5, 446512")
    (85210.5, 446512.0)
    """
    try:
        x, y = (float(word) for word in text.split(","))
    except ValueError:
        msg = f"{text!r} is no place like 85210.5,446512."
        raise click.BadParameter(msg) from None
    return x, y


def scales_m2(text: str) -> tuple[float, ...]:
    """Return area thresholds, square metres, in rising order; none for 'auto' (V8).

    Examples
    --------
    >>> scales_m2("200,50"), scales_m2("auto")
    ((50.0, 200.0), ())
    """
    if text.strip() == "auto":
        return ()
    try:
        return tuple(sorted({float(item) for item in text.split(",")}))
    except ValueError:
        msg = f"{text!r} is neither 'auto' nor a list of areas in m2 like 50,200,1000."
        raise click.BadParameter(msg) from None


def detectors(text: str) -> tuple[str, ...]:
    """Return the names of detectors in a list like multiscale,flatregions.

    Examples
    --------
    >>> detectors("multiscale, flatregions")
    ('multiscale', 'flatregions')
    """
    return tuple(name.strip() for name in text.split(",") if name.strip())


def declared_range(section: type, name: str) -> click.FloatRange:
    """Return the type of an option that sets a parameter: a number within the parameter's bounds."""
    bounds = next(item.metadata for item in fields(section) if item.name == name)
    return click.FloatRange(bounds["low"], bounds["high"])


def assignment(text: str) -> tuple[str, str]:
    """Return name and column of an assignment written NAME=COLUMN.

    Examples
    --------
    >>> assignment("height=HGT")
    ('height', 'HGT')
    """
    name, _, column = text.partition("=")
    if not name.strip() or not column.strip():
        msg = f"{text!r} is no assignment like height=HGT."
        raise click.BadParameter(msg)
    return name.strip(), column.strip()


def parameter(text: str) -> tuple[str, str]:
    """Return name and value of a parameter of a query, written NAME=VALUE.

    Examples
    --------
    >>> parameter("survey=spring")
    ('survey', 'spring')
    """
    name, sign, value = text.partition("=")
    if not name.strip() or not sign:
        msg = f"{text!r} is no parameter like survey=spring; 'msbdb query --list' shows them."
        raise click.BadParameter(msg)
    return name.strip(), value.strip()


def class_label(text: str) -> tuple[int, str]:
    """Return an operator's label of a class, written NUMBER=LABEL (V36)."""
    from msbdb.landcover import LABELS

    number, _, label = text.partition("=")
    if not number.isdecimal() or label not in LABELS:
        msg = f"{text!r} is no assignment like 3=vegetation; the labels are {', '.join(LABELS)}."
        raise click.BadParameter(msg)
    return int(number), label


def setting(text: str) -> tuple[str, str, object]:
    """Return section, name and value of a parameter written SECTION.NAME=VALUE, the value as in TOML.

    Quotes around words may be left out. Whether the parameter exists is checked where it is set.

    Examples
    --------
    >>> setting("surface.cell_m=0.5"), setting("surface.slicing=step")
    (('surface', 'cell_m', 0.5), ('surface', 'slicing', 'step'))
    """
    import tomllib

    key, _, value = text.partition("=")
    section, _, name = key.strip().partition(".")
    if not name or not value:
        msg = f"{text!r} is no setting like surface.cell_m=0.5; 'msbdb params' lists them all."
        raise click.BadParameter(msg)
    try:
        return section, name, tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        return section, name, value.strip()


SHARED: dict[str, Callable[[F], F]] = {
    "db": click.argument("db", type=DATABASE, metavar="DB"),
    "overwrite": click.option("--overwrite", is_flag=True, help="Replace files that exist."),
    "survey": click.option("--survey", metavar="NAME", help="The survey to use, where the database holds several."),
    "json": click.option("as_json", "--json", is_flag=True, help="Print the result as JSON on the standard output."),
    "verbose": click.option(
        "-v", "--verbose", count=True, help="Print more: -v the steps and decisions, -vv all details."
    ),
    "quiet": click.option("-q", "--quiet", is_flag=True, help="Print only what was asked for, and errors."),
    "log-file": click.option(
        "--log-file",
        type=OUTPUT_FILE,
        metavar="FILE",
        help="Add all steps, notices and errors with times to this file.",
    ),
    "debug": click.option("--debug", is_flag=True, help="Show the traceback of an error."),
}
"""Every option that more than one command takes, by name."""


def shared(*names: str) -> Callable[[F], F]:
    """Decorate a command function with shared options, in the order in which the help lists them."""

    def decorate(function: F) -> F:
        for name in reversed(names):
            function = SHARED[name](function)
        return function

    return decorate


class Command(click.Command):
    """A command with examples, which turns every failure into one clear line and an exit code.

    Parameters
    ----------
    examples : tuple of str
        Complete command lines; they end the help and are part of the docs.
    instead : bool
        Options may take the place of the arguments: where an option comes first, there are no arguments.
    """

    def __init__(
        self,
        *args: Any,  # noqa: ANN401  (click's)
        examples: tuple[str, ...] = (),
        instead: bool = False,
        **kwargs: Any,  # noqa: ANN401  (click's)
    ) -> None:
        super().__init__(*args, **kwargs)
        self.examples, self.instead = examples, instead

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Let an option that may be repeated take several values after one flag, as shells expand them.

        A command with arguments has them first for that, so that no value is taken for one.
        """
        arguments = sum(isinstance(param, click.Argument) for param in self.params)
        if self.instead and args and args[0].startswith("-"):
            arguments = 0
        if not any(word.startswith("-") for word in args[:arguments]):
            repeatable = {opt for param in self.params if _repeats(param) for opt in param.opts}
            args = args[:arguments] + spread(args[arguments:], repeatable)
        return super().parse_args(ctx, args)

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Close the help with the examples."""
        super().format_epilog(ctx, formatter)
        if self.examples:
            with formatter.section("Examples"):
                for example in self.examples:
                    formatter.write(f"{'':>{formatter.current_indent}}{example}\n")

    def invoke(self, ctx: click.Context) -> Any:  # noqa: ANN401  (click's)
        """Run the command; report a failure in one line, with the traceback only under ``--debug``."""
        debug = bool(ctx.params.pop("debug", False))
        verbose, log = ctx.params.pop("verbose", 0), ctx.params.pop("log_file", None)
        ctx.meta[QUIET] = bool(ctx.params.pop("quiet", False))
        if ctx.meta[QUIET] and verbose:
            msg = "--quiet and --verbose are opposites; give one of them."
            raise click.UsageError(msg)
        with reporting(verbose, ctx, log):
            failure: Exception
            try:
                return super().invoke(ctx)
            except click.ClickException as error:
                keep(ctx, logging.ERROR, error.format_message())
                raise
            except (click.exceptions.Exit, click.Abort, BrokenPipeError):
                raise
            except MsbdbError as error:
                failure, message = error, str(error)
            except KeyboardInterrupt:
                keep(ctx, logging.ERROR, "Interrupted.")
                click.echo("\nInterrupted. A database keeps its last complete build; run the command again.", err=True)
                raise click.exceptions.Exit(INTERRUPTED) from None
            except MemoryError as error:
                failure = error
                message = "The memory is not enough for this input. Cut it into smaller tiles, or choose larger cells."
            except OSError as error:
                failure = error
                message = f"{error.strerror or error}{f': {error.filename}' if error.filename else ''}."
            except Exception as error:  # the last resort: a bug must not end in a page of traceback
                failure = error
                message = (
                    f"This is a bug in msbdb, not in your data: {type(error).__name__}: {error}. "
                    "Run again with --debug to see the traceback, and report it with the command."
                )
            if debug:
                click.echo("".join(traceback.format_exception(failure)), err=True)
            keep(ctx, logging.ERROR, message, failure)
            raise click.ClickException(message)


def command(name: str, *, examples: tuple[str, ...], instead: bool = False) -> Callable[[Callable[..., Any]], Command]:
    """Declare a command of this name; ``-v``, ``--quiet``, ``--log-file`` and ``--debug`` are added to its options."""

    def decorate(function: Callable[..., Any]) -> Command:
        made = click.command(name, cls=Command, examples=examples, instead=instead)(function)
        return shared("debug", "log-file", "quiet", "verbose")(
            made
        )  # a command takes more options at its end, the last one first

    return decorate


def spread(args: list[str], repeatable: set[str]) -> list[str]:
    """Repeat a flag before each of the values that follow it.

    Examples
    --------
    >>> spread(["--points", "a.laz", "b.laz", "--db", "x"], {"--points"})
    ['--points', 'a.laz', '--points', 'b.laz', '--db', 'x']
    """
    result: list[str] = []
    flag = ""
    for position, arg in enumerate(args):
        if arg.startswith("-"):
            flag = arg if arg in repeatable else ""
        elif flag and args[position - 1] != flag:
            result.append(flag)
        result.append(arg)
    return result


def _repeats(param: click.Parameter) -> bool:
    """Whether a parameter is an option that may be given more than once."""
    return isinstance(param, click.Option) and param.multiple
