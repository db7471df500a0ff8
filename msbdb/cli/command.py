"""What all commands have in common: examples in the help, logging, notices, and how errors end."""

import logging
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import click

from msbdb.cli.options import shared
from msbdb.cli.output import stderr_console
from msbdb.errors import MsbdbError, MsbdbWarning

logger = logging.getLogger(__name__)

INTERRUPTED = 130
"""Exit code after Ctrl-C, as shells count it: 128 + SIGINT."""


class Command(click.Command):
    """A command with examples, which turns every failure into one clear line and an exit code.

    Parameters
    ----------
    examples : tuple of str
        Complete command lines; they end the help and are part of the docs.
    """

    def __init__(self, *args: Any, examples: tuple[str, ...] = (), **kwargs: Any) -> None:  # noqa: ANN401
        super().__init__(*args, **kwargs)
        self.examples = examples

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Let an option that may be repeated take several values after one flag, as shells expand them."""
        if not any(isinstance(param, click.Argument) for param in self.params):
            args = spread(args, {opt for param in self.params if _repeats(param) for opt in param.opts})
        return super().parse_args(ctx, args)

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Close the help with the examples."""
        super().format_epilog(ctx, formatter)
        if self.examples:
            with formatter.section("Examples"):
                for example in self.examples:
                    formatter.write(f"{'':>{formatter.current_indent}}{example}\n")

    def invoke(self, ctx: click.Context) -> Any:  # noqa: ANN401
        """Run the command; report a failure in one line, with the traceback only under ``--debug``."""
        debug = bool(ctx.params.pop("debug", False))
        with _reporting(ctx.params.pop("verbose", 0), ctx):
            failure: Exception
            try:
                return super().invoke(ctx)
            except (click.ClickException, click.exceptions.Exit, click.Abort, BrokenPipeError):
                raise
            except MsbdbError as error:
                failure, message = error, str(error)
            except KeyboardInterrupt:
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
            raise click.ClickException(message)


def command(name: str, *, examples: tuple[str, ...]) -> Callable[[Callable[..., Any]], Command]:
    """Declare a command of this name; ``-v`` and ``--debug`` are added to its own options."""

    def decorate(function: Callable[..., Any]) -> Command:
        made = click.command(name, cls=Command, examples=examples)(function)
        return shared("debug", "verbose")(made)  # a command takes more options at its end, the last one first

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


@contextmanager
def _reporting(verbose: int, ctx: click.Context) -> Iterator[None]:
    """Send log records and notices to the standard error while a command runs."""
    handler = _ConsoleHandler()
    package = logging.getLogger("msbdb")
    level = package.level
    package.addHandler(handler)
    package.setLevel([logging.WARNING, logging.INFO, logging.DEBUG][min(verbose, 2)])
    shown: set[str] = ctx.ensure_object(set)

    def show(message: Warning | str, category: type[Warning], *_: object, **__: object) -> None:
        if issubclass(category, MsbdbWarning):
            notice(str(message), shown)
        else:
            logger.info("%s: %s", category.__name__, message)

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("always", MsbdbWarning)
            warnings.showwarning = show
            yield
    finally:
        package.removeHandler(handler)
        package.setLevel(level)


class _ConsoleHandler(logging.Handler):
    """Writes log records above the progress bars, a line each."""

    def emit(self, record: logging.LogRecord) -> None:
        """Write one record."""
        line = f"{record.levelname.lower()}: {self.format(record)}"
        stderr_console().print(line, markup=False, highlight=False, soft_wrap=True, style="dim")


def notice(message: str, shown: set[str]) -> None:
    """Show the user a notice, once."""
    if message not in shown:
        shown.add(message)
        stderr_console().print(f"Notice: {message}", markup=False, highlight=False, soft_wrap=True)
