"""Help, version, and misuse: what a user reads before anything works."""

import errno
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from autolights.cli import app as program_module

Program = Callable[..., subprocess.CompletedProcess[str]]
VERBS = (
    *("simulate", "train", "val", "info", "export", "fit-hmm"),
    *("bundle", "run", "detect", "tune", "map-audit", "evaluate", "report", "demo"),
)


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


_SPLIT = ["val", "{here}/train/images/a.jpg", "{here}", "--classes", "a", "--val-fraction", "0.5", "--group-pattern"]


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        pytest.param(["fly"], "No such command", id="unknown-verb"),
        pytest.param(
            [*_SPLIT, "["],
            "no regular expression",
            id="bad-pattern",
        ),
        pytest.param(
            [*_SPLIT, "a"],
            "must have a group",
            id="no-group",
        ),
        pytest.param(["fit-hmm", "{here}"], "is a directory", id="folder-for-a-file"),
        pytest.param(["train", "train/nothing"], "shipped: ", id="unknown-config-lists-the-shipped"),
        pytest.param(["train", "train/demo", "epoch=3"], "did you mean 'epochs'?", id="typo-in-override"),
        pytest.param(["train", "train/demo", "data=nowhere"], "nowhere", id="missing-data"),
        pytest.param(["run", "nowhere", "nowhere"], "nowhere", id="missing-bundle"),
        pytest.param(["evaluate", "nowhere"], "nowhere", id="missing-run"),
        pytest.param(
            ["fit-hmm", "{here}/train/images/a.jpg", "--prior", "none"], "uniform or empirical", id="unknown-prior"
        ),
        pytest.param(["simulate", "images", "sim/images_demo", "train_images=-1"], "train_images", id="bad-value"),
    ],
)
def test_misuse_ends_with_a_clear_error(program: Program, tmp_path: Path, arguments: list[str], text: str) -> None:
    photos = tmp_path / "photos"
    (photos / "train" / "images").mkdir(parents=True)
    (photos / "train" / "images" / "a.jpg").touch()
    out = [] if arguments == ["fly"] else ["--out", str(tmp_path / "out")]
    result = program(*[argument.format(here=photos) for argument in arguments], *out)
    assert result.returncode == 2
    assert text in " ".join(result.stderr.split())
    assert "Traceback" not in result.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["photos"]


def test_an_existing_output_is_kept(program: Program, tmp_path: Path) -> None:
    out = tmp_path / "hmm.json"
    out.write_text("precious")
    result = program("fit-hmm", out, "--out", out)
    assert result.returncode == 2
    assert "--force" in result.stderr
    assert out.read_text() == "precious"


def test_the_demo_refuses_a_folder_of_somebody_else(program: Program, tmp_path: Path) -> None:
    mine = tmp_path / "demo" / "images" / "mine.jpg"
    mine.parent.mkdir(parents=True)
    mine.write_text("precious")
    result = program("demo", "--out", tmp_path / "demo")
    assert result.returncode == 2
    assert "exists already" in result.stderr
    assert mine.read_text() == "precious"


def test_a_terminated_program_leaves_nothing_half_written(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "autolights", "simulate", "images", "--out", str(tmp_path / "images")]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as process:
        deadline = time.monotonic() + 60
        while not list(tmp_path.glob(".images*.tmp/images/train/*")) and time.monotonic() < deadline:
            time.sleep(0.1)
        assert list(tmp_path.iterdir()), "it never began"
        process.terminate()
        assert process.wait(timeout=60) == 143
    assert not list(tmp_path.iterdir())


def test_full_disk_is_told_in_a_line(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def fill_the_disk() -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(program_module, "app", fill_the_disk)

    with pytest.raises(SystemExit, match="1"):
        program_module.main()
    assert capsys.readouterr().err == "error: No space left on device\n"
