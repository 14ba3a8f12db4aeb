"""`autolights simulate`: data with known truth."""

from pathlib import Path
from typing import Annotated

import typer

from autolights.cli.options import Force, Out, Overrides

app = typer.Typer(help="Simulate data with known truth.", no_args_is_help=True, rich_markup_mode=None)


@app.command("images")
def images(
    config: Annotated[str, typer.Argument(help="YAML file or shipped name.")] = "sim/images_demo",
    overrides: Overrides = None,
    out: Out = Path("runs/images"),
    force: Force = False,
) -> None:
    """Simulate training and validation images with labels, as a YOLO-format folder.

    \b
    Example: autolights simulate images sim/images_demo train_images=100 --out runs/images
    """
    from autolights.core import load_config
    from autolights.sim import ImagesConfig, simulate_images

    simulate_images(load_config(config, ImagesConfig, overrides or ()), out, force=force)
    typer.echo(out)


@app.command("drives")
def drives(
    config: Annotated[str, typer.Argument(help="YAML file or shipped name.")] = "sim/drives_demo",
    overrides: Overrides = None,
    out: Out = Path("runs/drives"),
    force: Force = False,
) -> None:
    """Simulate drives with two cameras: frames, poses, calibration, an imperfect map, and the truth.

    \b
    Example: autolights simulate drives sim/drives_demo seed=7 --out runs/drives
    """
    from autolights.core import load_config
    from autolights.sim import DrivesConfig, simulate_drives

    simulate_drives(load_config(config, DrivesConfig, overrides or ()), out, force=force)
    typer.echo(out)
