"""The `orogen` command: one file per command, loaded when it is called."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from typing import Annotated

from cyclopts import App, CycloptsError, Group, Parameter

from orogen import __version__
from orogen.cli import console
from orogen.errors import OrogenError, SettingsError

FAILED, MISUSED, INTERRUPTED = 1, 2, 130
"""Exit codes beside 0: something could not be done; the command line or a setting is wrong; Ctrl-C."""

COMMON = Group("Common options", sort_key=100)
app = App(
    name="orogen",
    help="Show terrain of any size, exactly and in real time.",
    version=__version__,
    version_flags=["--version"],
    help_format="plaintext",
    group_commands=COMMON,
)
# an interruption is ours to report
app.suppress_keyboard_interrupt = app.meta.suppress_keyboard_interrupt = False

LOOKING = Group("Looking", sort_key=1)
ASKING = Group("Asking the surface", sort_key=2)
DATA = Group("Data", sort_key=3)
MEASURING = Group("Measuring", sort_key=4)

COMMANDS: dict[str, tuple[Group, str, str]] = {
    "view": (LOOKING, "view", "Open a window to move through the terrain."),
    "serve": (LOOKING, "serve", "Show the terrain in a browser."),
    "render": (LOOKING, "render", "Draw a picture."),
    "fly": (LOOKING, "fly", "Draw a video along a flight."),
    "demo": (LOOKING, "demo", "Draw example pictures and a short video from built-in terrain."),
    "height": (ASKING, "query", "Tell the height of the surface at a place."),
    "profile": (ASKING, "query", "Tell the heights along a line."),
    "sight": (ASKING, "query", "Tell whether one place is seen from another."),
    "viewshed": (ASKING, "query", "Write what is seen from a place as a GeoTIFF."),
    "shadow": (ASKING, "query", "Write where the sun shines as a GeoTIFF."),
    "slope": (ASKING, "query", "Write how steep the terrain is as a GeoTIFF."),
    "info": (DATA, "info", "Tell what a raster is, or which GPU is used."),
    "build": (DATA, "build", "Build all levels of a raster, to be opened later without the raster."),
    "export": (DATA, "export", "Write a part as triangles or heights for other programs."),
    "compare": (MEASURING, "compare", "Compare terrain algorithms on the same data and flight, and write a report."),
    "bench": (MEASURING, "bench", "Measure speed, memory and exactness, each against its target."),
}
"""Where a command is listed, its module, and its line there: what `orogen --help` tells without loading commands."""

for _place, (_name, (_group, _module, _help)) in enumerate(COMMANDS.items()):
    # the list is plain; markdown, which joins lines to paragraphs, takes longer to load
    app.command(
        f"orogen.cli.{_module}:{_name}", name=_name, help=_help, group=_group, sort_key=_place, help_format="markdown"
    )
app.command(
    "orogen.cli.cache:app", name="cache", help="Look at the cache of built pyramids, or clear it.", group=DATA,
    sort_key=len(COMMANDS),
)  # fmt: skip
app.register_install_completion_command()


@app.meta.default
def _launch(
    *tokens: Annotated[str, Parameter(show=False, allow_leading_hyphen=True)],
    verbose: Annotated[int, Parameter(name=("--verbose", "-v"), count=True, show_default=False, group=COMMON)] = 0,
    quiet: Annotated[bool, Parameter(name=("--quiet", "-q"), negative="", show_default=False, group=COMMON)] = False,
) -> None:
    """Run a command.

    Parameters
    ----------
    verbose
        Say more on stderr; twice: debugging messages, and the traceback of an error.
    quiet
        Say nothing but errors on stderr, and show no progress.
    """
    console.start(verbose, quiet)
    app(tokens, exit_on_error=False, print_error=False)


def run(arguments: Sequence[str]) -> int:
    """Run a command line; gives the exit code. Errors are one line on stderr."""
    try:
        if named := next((word for word in arguments if word in COMMANDS), None):
            # its own page tells more than its line in the list: all of the function's docstring
            app[named].help = None
        app.meta(arguments, exit_on_error=False, print_error=False, result_action="return_value")
        sys.stdout.flush()
    except CycloptsError as error:
        return _fail(MISUSED, str(error).strip())
    except SettingsError as error:
        return _fail(MISUSED, str(error))
    except OrogenError as error:
        return _fail(FAILED, str(error))
    except KeyboardInterrupt:
        return _fail(INTERRUPTED, "interrupted")
    except BrokenPipeError:
        # whoever read the results has closed the pipe; Python would complain at exit again
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED
    except Exception as error:
        return _fail(FAILED, f"internal error: {type(error).__name__}: {error}; run again with -vv for the traceback")
    return 0


def main() -> None:
    """Run the command line of this process."""
    sys.exit(run(sys.argv[1:]))


def _fail(code: int, message: str) -> int:
    console.error(message)
    return code
