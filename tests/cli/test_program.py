"""Help, version, and misuse: what a user reads before anything works."""

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

Program = Callable[..., subprocess.CompletedProcess[str]]
VERBS = ("simulate", "train", "val", "export", "fit-hmm", "bundle", "run", "detect", "evaluate", "report", "demo")


def test_help_names_every_verb(program: Program) -> None:
    result = program("--help")
    assert result.returncode == 0
    assert all(verb in result.stdout for verb in VERBS)


@pytest.mark.parametrize("verb", [(verb,) for verb in VERBS if verb != "simulate"] + [("simulate", "drives")])
def test_help_of_a_verb_shows_an_example(program: Program, verb: tuple[str, ...]) -> None:
    result = program(*verb, "--help")
    assert result.returncode == 0
    assert f"autolights {' '.join(verb)}" in result.stdout
    assert "Example" in result.stdout


def test_version(program: Program) -> None:
    result = program("--version")
    assert (result.returncode, result.stdout.split()[0]) == (0, "autolights")


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        pytest.param(["fly"], "No such command", id="unknown-verb"),
        pytest.param(["train", "train/nothing"], "shipped: ", id="unknown-config-lists-the-shipped"),
        pytest.param(["train", "train/demo", "epoch=3"], "did you mean 'epochs'?", id="typo-in-override"),
        pytest.param(["train", "train/demo", "data=nowhere"], "nowhere", id="missing-data"),
        pytest.param(["run", "nowhere", "nowhere"], "nowhere", id="missing-bundle"),
        pytest.param(["evaluate", "nowhere"], "nowhere", id="missing-run"),
        pytest.param(["fit-hmm", "x.json", "--prior", "none"], "uniform or empirical", id="unknown-prior"),
        pytest.param(["simulate", "images", "sim/images_demo", "train_images=-1"], "train_images", id="bad-value"),
    ],
)
def test_misuse_ends_with_a_clear_error(program: Program, tmp_path: Path, arguments: list[str], text: str) -> None:
    out = [] if arguments == ["fly"] else ["--out", str(tmp_path / "out")]
    result = program(*arguments, *out)
    assert result.returncode in (1, 2)
    assert text in result.stderr
    assert "Traceback" not in result.stderr
    assert not list(tmp_path.iterdir())


def test_an_existing_output_is_kept(program: Program, tmp_path: Path) -> None:
    out = tmp_path / "hmm.json"
    out.write_text("precious")
    result = program("fit-hmm", tmp_path / "confusion.json", "--out", out)
    assert result.returncode == 2
    assert "--force" in result.stderr
    assert out.read_text() == "precious"
