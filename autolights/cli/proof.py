"""The verbs that prove: map-audit, evaluate, report, demo."""

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from autolights.cli.options import Force, Json, Out, Overrides, Signals
from autolights.core.errors import UsageError

_Runs = Annotated[list[Path], typer.Argument(exists=True, help="Folders made by `run`; each knows its drive.")]
_Drives = Annotated[
    list[Path] | None,
    typer.Option("--drive", exists=True, help="Drive of the run in the same place, if it has moved; one for each run."),
]


def evaluate(
    runs: _Runs,
    drive: _Drives = None,
    signals: Signals = "signals/autolights_13",
    out: Out = Path("runs/evaluation.json"),
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Score estimates against the truth of their drives: the paper's ablation table and more.

    \b
    Example: autolights evaluate runs/demo/estimates/* --out runs/evaluation.json
    """
    from autolights.core import load_signals
    from autolights.core.atomic import refuse_existing
    from autolights.evaluate import evaluate as score
    from autolights.evaluate import table

    refuse_existing(out, force=force)
    evaluation = score(_pairs(runs, drive), load_signals(signals))
    evaluation.save(out)
    typer.echo(json.dumps(evaluation.to_json()) if as_json else table(evaluation))


def map_audit(
    runs: _Runs,
    drive: _Drives = None,
    signals: Signals = "signals/autolights_13",
    limits: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="A limit, e.g. moved_m=0.8; repeatable.")
    ] = None,
    correct: Annotated[
        list[str] | None,
        typer.Option(help="missing, extra, moved or type: which findings the corrected map takes up; by default all."),
    ] = None,
    corrected: Annotated[
        Path | None,
        typer.Option(help="The corrected map, instead of map.geojson in --out; the map itself needs --force."),
    ] = None,
    out: Out = Path("runs/map_audit"),
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Hold the map of one or several drives against what their runs saw; write a corrected one.

    Lists lights that are missing, extra, moved or of another type, with the images that say so. Writes audit.json,
    audit.html and map.geojson into --out. The runs are of variant full.

    \b
    Example: autolights map-audit runs/demo/estimates/sunny --out runs/map_audit
             autolights map-audit runs/monday runs/tuesday --correct missing --correct moved
    """
    from autolights.core import load_signals
    from autolights.core.config import parse_config
    from autolights.map_audit import KINDS, MapAuditConfig, audit_map, table

    audit = audit_map(
        _pairs(runs, drive),
        load_signals(signals),
        out,
        parse_config({}, MapAuditConfig, limits or (), source="--set"),
        corrected=corrected,
        kinds=correct or KINDS,
        force=force,
    )
    typer.echo(json.dumps(audit.to_json()) if as_json else f"{table(audit)}\n{out}")


def report(
    runs: _Runs,
    train: Annotated[Path, typer.Option(exists=True, help="Folder made by `train`.")],
    val: Annotated[Path, typer.Option(exists=True, help="Folder made by `val`.")],
    bundle: Annotated[Path, typer.Option(exists=True, help="Folder made by `bundle`.")],
    drive: _Drives = None,
    title: Annotated[str, typer.Option(help="Heading of the page.")] = "autolights",
    out: Out = Path("runs/report.html"),
    force: Force = False,
) -> None:
    """Write one HTML page that opens anywhere: tables, curves, matrices, sequences, pictures, a short film.

    \b
    Example: autolights report runs/demo/estimates/* --train runs/demo/train --val runs/demo/val \\
               --bundle runs/demo/bundle --out report.html
    """
    from autolights.core import Bundle
    from autolights.core.atomic import refuse_existing
    from autolights.evaluate import evaluate as score
    from autolights.evaluate import write_report

    refuse_existing(out, force=force)
    loaded = Bundle.load(bundle)
    pairs = _pairs(runs, drive)
    write_report(
        out,
        train_dir=train,
        metrics_path=val / "metrics.json",
        bundle=loaded,
        runs=pairs,
        evaluation=score(pairs, loaded.signals),
        minutes={},
        title=title,
    )
    typer.echo(out)


def demo(
    overrides: Overrides = None,
    config: Annotated[str, typer.Option(help="YAML file or shipped name.")] = "demo/demo",
    out: Out = Path("runs/demo"),
    as_json: Json = False,
) -> None:
    """Run the whole way: simulate, train, validate, export, fit, bundle, run, evaluate, report.

    A stage whose result is there and unchanged is skipped, so an interrupted demo goes on where it stopped.

    \b
    Example: autolights demo --out runs/demo
    """
    from autolights.core import load_config
    from autolights.demo import DemoConfig, run_demo

    summary = run_demo(load_config(config, DemoConfig, overrides or ()), out)
    typer.echo(json.dumps(summary) if as_json else _demo_text(summary, out))


def _demo_text(summary: dict[str, Any], out: Path) -> str:
    rows = ["variant                      FPS   APE (m)  class accuracy (%)"]
    names = {"od": "OD", "od_fusion": "OD + Fusion", "proposed": "OD + Fusion + Tracking"}
    for key, name in names.items():
        row = summary[key]
        ape, accuracy = (
            "–" if row[figure] is None else f"{row[figure]:.{digits}f}"
            for figure, digits in (("ape_m", 2), ("class_accuracy", 1))
        )
        rows.append(f"{name:24}{row['fps']:8.1f}{ape:>10}{accuracy:>20}")
    rows.append(f"{sum(summary['minutes'].values()):.1f} minutes; open {out / 'report.html'}")
    return "\n".join(rows)


def _pairs(runs: list[Path], drives: list[Path] | None) -> list[tuple[Path, Path]]:
    if drives:
        if len(drives) != len(runs):
            raise UsageError(f"--drive must be given once for each run: {len(runs)} runs, {len(drives)} drives")
        return list(zip(runs, drives, strict=True))
    from autolights.data import load_run_info

    return [(run, Path(load_run_info(run)["drive"])) for run in runs]
