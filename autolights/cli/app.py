"""The program: its verbs in the order of the work, and how errors end it."""

import errno
import signal
import sys
from collections.abc import Callable
from typing import Annotated, NoReturn

import typer

import autolights
from autolights.cli import delivery, info, proof, runtime, simulation, training
from autolights.core.errors import AutolightsError

_HELP = """
Traffic lights done right: train a detector, export it, run it with cameras, poses and an HD map, and prove it.

The way through, each step a verb:

\b
  simulate images   training images with labels          simulate drives   two-camera drives with truth
  train             images → checkpoint                  val               checkpoint → AP, confusion matrix
  info              size, cost, licence of a network     export            checkpoint → ONNX, checked
  fit-hmm           confusion matrix → hmm.json          bundle            ONNX + HMMs → one verified folder
  run               bundle + drive → estimates.jsonl     detect            bundle + images or video → boxes
  evaluate          estimates + truth → tables           report            everything → one HTML page
  tune              bundle → its fastest way here          map-audit         runs → what is wrong in the map
  demo              all of it, in order

Results go to stdout (--json for machines), progress and messages to stderr.
Exit code 0: done; 1: failed; 2: misused.
"""

_TRAINING_STACK = ("albumentations", "faster_coco_eval", "matplotlib", "onnx", "tensorboard", "torch", "torchvision")

app = typer.Typer(
    name="autolights",
    help=_HELP,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"autolights {autolights.__version__}")
        raise typer.Exit


@app.callback()
def _program(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and stop.")
    ] = False,
) -> None:
    """Traffic lights done right."""


app.add_typer(simulation.app, name="simulate")
_VERBS: dict[str, Callable[..., None]] = {
    "train": training.train,
    "val": training.val,
    "info": info.info,
    "export": delivery.export,
    "fit-hmm": delivery.fit_hmm,
    "bundle": delivery.bundle,
    "run": runtime.run,
    "detect": runtime.detect,
    "tune": runtime.tune,
    "map-audit": proof.map_audit,
    "evaluate": proof.evaluate,
    "report": proof.report,
    "demo": proof.demo,
}
for _verb, _function in _VERBS.items():
    app.command(_verb)(_function)


def main() -> None:
    """Run the program; expected errors end it with one line on stderr and their exit code."""
    signal.signal(signal.SIGTERM, _stop)
    try:
        app()
    except AutolightsError as error:
        _fail(str(error), error.exit_code)
    except ModuleNotFoundError as error:
        if error.name not in _TRAINING_STACK:
            raise
        _fail(f"this verb needs the package '{error.name}'; install it with: pip install 'autolights[train]'", 2)
    except OSError as error:
        # A disk that fills while text is written tells the reason, but not the file.
        if error.filename is None and error.errno != errno.ENOSPC:
            raise
        _fail(": ".join(str(part) for part in (error.filename, error.strerror) if part), 1)


def _fail(text: str, exit_code: int) -> NoReturn:
    print(f"error: {text}", file=sys.stderr)
    sys.exit(exit_code)


def _stop(signal_number: int, _frame: object) -> NoReturn:
    """End as an exception does, so that nothing half-written is left behind."""
    sys.exit(128 + signal_number)
