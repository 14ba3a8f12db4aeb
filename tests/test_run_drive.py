"""A tiny recorded drive through all variants: what is written, what is counted, what is refused."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest

from autolights.core import Bundle, ConfusionMatrix, Detections, HmmParameters, ImageArray, ModelInfo, SignalSet
from autolights.core.errors import DataError, UsageError
from autolights.data import Drive, FrameRecord, write_drive
from autolights.data.run_output import DETECTIONS, ESTIMATES, RUN, load_detections, load_estimates
from autolights.pipeline import PipelineConfig
from autolights.run_drive import run_drive

SETS = 5


@dataclass
class RecordedDetector:
    """Knows each image by its grey level: set and camera are written into the pixels."""

    scene: object
    calls: int = 0

    def batch(self, images_bgr: Sequence[ImageArray]) -> list[Detections]:
        self.calls += 1
        found = []
        for image in images_bgr:
            index, camera = divmod(round(float(image.mean())), 2)
            found.append(self.scene.detect(list(self.scene.rig)[camera], index / 10))
        return found


@pytest.fixture
def scene(make_scene: Callable) -> object:
    lights = {"a": ("3", (40.0, 2.0, 5.0), lambda t: "3-red"), "b": ("3", (40.0, -2.0, 5.0), lambda t: "3-green")}
    return make_scene(lights, cameras=("narrow", "wide"), speed_mps=0)


@pytest.fixture
def drive_dir(scene: object, tmp_path: Path) -> Path:
    folder = tmp_path / "town"
    (folder / "images").mkdir(parents=True)
    frames = []
    for index in range(SETS):
        for i, camera in enumerate(scene.rig):
            path = Path("images") / f"{camera}_{index}.png"
            cv2.imwrite(str(folder / path), np.full((800, 1280, 3), 2 * index + i, np.uint8))
            frames.append(FrameRecord(index * 100_000_000 + i * 4_000_000, camera, path))
    write_drive(
        folder,
        name="town",
        utm_zone=17,
        hemisphere="north",
        height_datum="ellipsoid",
        cameras=list(scene.rig.values()),
        poses=[scene.pose(t) for t in np.arange(0, 0.6, 0.05)],
        lights=scene.map,
        frames=frames,
        truth=None,
    )
    return folder


@pytest.fixture
def bundle(signals: SignalSet, hmm: dict[str, HmmParameters], tmp_path: Path) -> Bundle:
    size = len(signals.classes) + 1
    return Bundle(
        model=ModelInfo(classes=signals.classes, size_wh=(640, 416), opset=17),
        model_path=tmp_path / "bundle" / "model.onnx",
        signals=signals,
        hmm=hmm,
        confusion=ConfusionMatrix(signals.classes, np.zeros((size, size), dtype=np.int64), 0.25, 0.5),
    )


def test_all_variants_on_detections_computed_once(
    scene: object, drive_dir: Path, bundle: Bundle, tmp_path: Path
) -> None:
    detector = RecordedDetector(scene)
    out = tmp_path / "out"
    drive = Drive.load(drive_dir, bundle.signals)
    summary = run_drive(bundle, drive, PipelineConfig(), out, explain=True, detector=detector)

    assert detector.calls == SETS
    assert sorted(path.name for path in out.iterdir()) == sorted([DETECTIONS, ESTIMATES, RUN])
    estimates = load_estimates(out / ESTIMATES)
    assert [entry.variant for entry in estimates] == ["od", "fusion", "full"] * SETS
    assert estimates[0].frames == (("narrow", 0), ("wide", 4_000_000))
    assert {e.stamp_ns for e in estimates[-1].lights} == {404_000_000}
    assert [(e.map_id, e.class_name) for e in estimates[-1].lights] == [("a", "3-red"), ("b", "3-green")]
    assert len(load_detections(out / DETECTIONS)) == 2 * SETS
    line = json.loads((out / ESTIMATES).read_text().splitlines()[-1])
    assert line["explain"]["images"][0]["matches"] == [[0, 0], [1, 1]]

    info = json.loads((out / RUN).read_text())
    assert Path(info["drive"]).name == "town"
    assert info["skipped_frames"] == 0
    assert info["config"]["track"]["birth_hits"] == 2
    assert info["execution"] is None  # somebody's own detector
    assert {name: own["alarm"] for name, own in info["cameras"].items()} == {"narrow": False, "wide": False}
    assert abs(info["cameras"]["narrow"]["delay_s"]) < 0.02
    for variant in ("od", "fusion", "full"):
        times = info["variants"][variant]
        assert (times["sets"], times["images"]) == (SETS, 2 * SETS)
        total_ms = times["detect_ms"]["mean"] + times["track_ms"]["mean"]
        assert times["fps"] == pytest.approx(1000 / total_ms, rel=0.02)
    assert summary.to_json()["variants"] == info["variants"]


def test_damaged_images_and_missing_poses_are_counted(
    scene: object, drive_dir: Path, bundle: Bundle, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (drive_dir / "images" / "narrow_1.png").write_bytes(b"no image")
    poses = (drive_dir / "poses.csv").read_text().splitlines()
    (drive_dir / "poses.csv").write_text("\n".join(poses[:8]) + "\n")  # until 0.30 s, and 0.05 s more is allowed
    drive = Drive.load(drive_dir, bundle.signals)
    summary = run_drive(
        bundle, drive, PipelineConfig(), tmp_path / "out", variants=("full",), detector=RecordedDetector(scene)
    )
    assert summary.skipped == {"unreadable image": 1, "no pose": 2}
    assert (len(summary.variants["full"].track_ms), summary.variants["full"].images) == (4, 7)
    warning = capsys.readouterr().err
    assert "warning: drive town: frames left out: 1 x unreadable image, 2 x no pose" in warning
    assert json.loads((tmp_path / "out" / RUN).read_text())["skipped_frames"] == 3


def test_a_drive_of_which_nothing_can_be_used_leaves_nothing_behind(
    scene: object, drive_dir: Path, bundle: Bundle, tmp_path: Path
) -> None:
    for path in (drive_dir / "images").iterdir():
        path.write_bytes(b"no image")
    out = tmp_path / "runs" / "out"
    with pytest.raises(DataError, match=r"none of 10 frames could be used; .*wide_4\.png: does not decode"):
        run_drive(
            bundle, Drive.load(drive_dir, bundle.signals), PipelineConfig(), out, detector=RecordedDetector(scene)
        )
    assert list(out.parent.iterdir()) == []


def test_an_interrupted_run_leaves_nothing_behind(
    scene: object, drive_dir: Path, bundle: Bundle, tmp_path: Path
) -> None:
    class Interrupted(RecordedDetector):
        def batch(self, images_bgr: Sequence[ImageArray]) -> list[Detections]:
            if self.calls == 2:
                raise KeyboardInterrupt
            return super().batch(images_bgr)

    out = tmp_path / "runs" / "out"
    with pytest.raises(KeyboardInterrupt):
        run_drive(bundle, Drive.load(drive_dir, bundle.signals), PipelineConfig(), out, detector=Interrupted(scene))
    assert list(out.parent.iterdir()) == []


def test_an_existing_output_is_kept_unless_forced(
    scene: object, drive_dir: Path, bundle: Bundle, tmp_path: Path
) -> None:
    drive, detector = Drive.load(drive_dir, bundle.signals), RecordedDetector(scene)
    out = tmp_path / "out"
    out.mkdir()
    (out / "mine.txt").write_text("precious")
    with pytest.raises(UsageError, match="exists already"):
        run_drive(bundle, drive, PipelineConfig(), out, detector=detector)
    assert (out / "mine.txt").read_text() == "precious"
    assert detector.calls == 0, "refused before any work"
    run_drive(bundle, drive, PipelineConfig(), out, detector=detector, force=True)
    assert (out / RUN).is_file()


@pytest.mark.parametrize(
    ("variants", "message"),
    [
        pytest.param(("full", "best"), "must be one of od, fusion, full, got best", id="unknown"),
        pytest.param((), "must be one of od, fusion, full, got none", id="none"),
    ],
)
def test_variants_are_checked(
    scene: object, drive_dir: Path, bundle: Bundle, tmp_path: Path, variants: tuple[str, ...], message: str
) -> None:
    with pytest.raises(UsageError, match=message):
        run_drive(
            bundle,
            Drive.load(drive_dir, bundle.signals),
            PipelineConfig(),
            tmp_path / "out",
            variants=variants,
            detector=RecordedDetector(scene),
        )
