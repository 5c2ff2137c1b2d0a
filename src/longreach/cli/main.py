"""The command `longreach`: one verb a file; what a verb needs is imported when it runs, so that --help stays quick."""

import functools
import sys
import traceback
from collections.abc import Callable, Sequence
from typing import Any

import typer

from longreach.cli import connect, estimate, evaluate, info, plan, ros, run, serve, view, warmup
from longreach.cli import map as map_verb
from longreach.errors import LongreachError

app = typer.Typer(
    name="longreach",
    help="Keep a mobile manipulator's hand where you think it is, over long trajectories.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
_options = {"verbose": False}


def _print_version(wanted: bool) -> bool:
    if wanted:
        from longreach import __version__

        typer.echo(f"longreach {__version__}")
        raise typer.Exit
    return wanted


@app.callback()
def _read_options(
    verbose: bool = typer.Option(False, "--verbose", help="Show the traceback of an error."),
    version: bool = typer.Option(
        False, "--version", is_eager=True, callback=_print_version, help="Print the version and end."
    ),
) -> None:
    _options["verbose"] = verbose


def _fail(error: BaseException, sentence: str, code: int) -> typer.Exit:
    if _options["verbose"]:
        traceback.print_exception(error)
    print(f"longreach: {sentence}", file=sys.stderr)
    return typer.Exit(code)


def _answers_in_a_sentence(verb: Callable[..., None]) -> Callable[..., None]:
    """Turn what a user can mend into one sentence and exit code 2, an interrupt into 130."""

    @functools.wraps(verb)
    def command(*args: Any, **kwargs: Any) -> None:
        try:
            verb(*args, **kwargs)
        except LongreachError as error:
            raise _fail(error, str(error), 2) from error
        except OSError as error:
            reason = error.strerror or str(error)
            raise _fail(error, f"{error.filename}: {reason}." if error.filename else f"{reason}.", 2) from error
        except KeyboardInterrupt as error:
            raise _fail(error, "interrupted; nothing half-written is left behind.", 130) from error

    return command


for _module in (info, estimate, map_verb, evaluate, plan, run, serve, connect, view, warmup):
    app.command(name=_module.__name__.rpartition(".")[2])(_answers_in_a_sentence(_module.command))
for _node in ros.app.registered_commands:
    if _node.callback is not None:
        _node.callback = _answers_in_a_sentence(_node.callback)
app.add_typer(ros.app, name="ros")


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line; --verbose may stand anywhere."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    first = [a for a in given if a == "--verbose"][:1]
    app(first + [a for a in given if a != "--verbose"], prog_name="longreach")
