"""Runs the command, and reports what goes wrong."""

import io
import sys
import traceback
from collections.abc import Iterable, Sequence
from typing import NoReturn

from cyclopts import CycloptsError
from rich.text import Text

from .._interrupts import repeated_interrupts, reported_interrupts
from .._setup import setup
from ..config import ConfigError, printable
from ..console import Console
from ._app import INTERRUPTED, SUCCESS, USER_ERROR, app

_NO_MEMORY = (
    "ran out of memory; expected enough for all images, maps and rays; lower scene.camera.resolution, "
    "shadow_map.resolution or reference.supersampling"
)


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Runs the command with `arguments`, by default the process's own, and exits.

    The exit code is 0 on success and 130 after an interrupt. It is 2 after a mistake in the user's input, which is
    reported in one message on stderr. Any other error is a bug, and keeps its traceback.
    """
    # Without JAX, which `_jax.start_jax` loads.
    setup(programs=False, progress=False)
    errors = Console(stderr=True)
    for stream in (sys.stdout, sys.stderr):
        # The stream's encoding may lack characters of names.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        with reported_interrupts(), repeated_interrupts():
            app(
                sys.argv[1:] if arguments is None else list(arguments),
                exit_on_error=False,
                print_error=False,
                error_console=errors,
            )
    except CycloptsError as error:
        _print_error(errors, [f"{_sentence(error)}; see diffshadow --help"])
        sys.exit(USER_ERROR)
    except KeyboardInterrupt:
        _print_error(errors, ["interrupted"])
        sys.exit(INTERRUPTED)
    except (ValueError, OSError) as error:
        if not _is_mistake(error):
            raise
        _print_error(errors, map(str, error.mistakes) if isinstance(error, ConfigError) else [str(error)])
        sys.exit(USER_ERROR)
    except (MemoryError, RuntimeError) as error:
        # XLA raises a `RuntimeError` whose text alone names the cause.
        if not isinstance(error, MemoryError) and "RESOURCE_EXHAUSTED" not in str(error):
            raise
        _print_error(errors, [_NO_MEMORY])
        sys.exit(USER_ERROR)
    sys.exit(SUCCESS)


def _is_mistake(error: ValueError | OSError) -> bool:
    """Whether `error` comes from a mistake in the user's input, and not from a bug in this program.

    This package raises `ValueError` only for mistakes in the user's input. A `ValueError` raised inside a library is a
    bug.
    """
    if isinstance(error, ConfigError | OSError):
        return True
    frames = [frame for frame, _ in traceback.walk_tb(error.__traceback__)]
    module = str(frames[-1].f_globals.get("__name__", ""))
    return module.partition(".")[0] == __name__.partition(".")[0]


def _sentence(error: CycloptsError) -> str:
    text = " ".join(str(error).split())
    return text if text.endswith("...") else text.removesuffix(".")


def _print_error(console: Console, messages: Iterable[str]) -> None:
    """Prints an error, with one line per message."""
    # Without wrapping, so that editors and grep find FILE:LINE in one piece.
    lines = "\n".join(map(printable, messages))
    console.print(Text.assemble(("error: ", "bold red"), lines), soft_wrap=True)
