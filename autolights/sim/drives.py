"""Two-camera drives with poses, a map and truth, in the drive format."""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

from autolights.core import FloatArray, load_signals, save_config
from autolights.core.atomic import new_folder
from autolights.core.progress import track
from autolights.core.transforms import transform_points
from autolights.data import FrameRecord, TruthFrame, TruthLight, write_drive
from autolights.sim.config import DrivesConfig
from autolights.sim.heads import HeadPainter
from autolights.sim.programme import check_types
from autolights.sim.render import render
from autolights.sim.script import Script, write_script
from autolights.sim.sensor import expose
from autolights.sim.survey import heading_deg, map_ids, survey
from autolights.sim.vehicle import measure_poses
from autolights.sim.view import View
from autolights.sim.visibility import amodal_box, inside_share, occlusion
from autolights.sim.workers import in_order


def simulate_drives(config: DrivesConfig, out_dir: Path, *, force: bool = False) -> None:
    """Write each drive to a folder of its name in `out_dir`; same seed, same bytes.

    Args:
        config: What to simulate.
        out_dir: Appears when all drives are complete.
        force: Replace what is there.

    Raises:
        UsageError: If `out_dir` exists and `force` is not set, or the signal description has an unknown type.
    """
    signals = load_signals(config.signals)
    check_types(signals)
    with new_folder(Path(out_dir), force=force) as folder:
        tasks = _tasks(config, folder)
        frames = in_order(_write_frame, tasks, workers=config.workers)
        shown = track(frames, description="simulating drives", total=len(tasks), unit="images")
        truth = list(zip(tasks, shown, strict=True))
        for index, drive in enumerate(config.drives):
            script = write_script(config, index, signals)
            rng = np.random.default_rng([config.seed, index, _SURVEY])
            of_drive = [(task, frame) for task, frame in truth if task.index == index]
            write_drive(
                folder / drive.name,
                name=drive.name,
                utm_zone=config.utm_zone,
                hemisphere="north",
                height_datum="ellipsoid",
                cameras=script.cameras,
                poses=measure_poses(script.motion, script.utm_from_town, script.start_ns, config.pose, rng),
                lights=survey(script, config.survey, rng),
                frames=[FrameRecord(task.stamp_ns, frame.camera, task.path) for task, frame in of_drive],
                truth=[frame for _, frame in of_drive],
                extra={"seed": config.seed, "simulated": drive.model_dump(mode="json")},
            )
        save_config(config, folder / "config.yaml")


# Independent random streams beside the script's own.
_SURVEY, _STAMPS, _SENSOR = 1, 2, 3


@dataclass(frozen=True)
class _Task:
    """One image: everything a worker needs, small enough to be sent."""

    config_json: str
    index: int
    camera: int
    frame: int
    stamp_ns: int
    path: Path
    folder: Path


def _tasks(config: DrivesConfig, folder: Path) -> list[_Task]:
    """All images in the order of time, drive by drive; makes their folders."""
    config_json = config.model_dump_json()
    tasks = []
    for index, drive in enumerate(config.drives):
        rng = np.random.default_rng([config.seed, index, _STAMPS])
        start_ns = _script(config_json, index).start_ns
        for camera in config.cameras:
            (folder / drive.name / "images" / camera.name).mkdir(parents=True)
        for frame in range(round(drive.duration_s * config.frame_rate_hz)):
            for i, camera in enumerate(config.cameras):
                late_s = camera.stamp_offset_ms / 1e3 + float(rng.normal(0, config.stamp_jitter_ms)) / 1e3
                stamp_ns = start_ns + round((frame / config.frame_rate_hz + late_s) * 1e9)
                path = Path("images") / camera.name / f"{frame:05d}.jpg"
                tasks.append(_Task(config_json, index, i, frame, stamp_ns, path, folder / drive.name))
    return tasks


def _write_frame(task: _Task) -> TruthFrame:
    config = _config(task.config_json)
    script = _script(task.config_json, task.index)
    time_s = (task.stamp_ns - script.start_ns) / 1e9
    view = View(script.cameras[task.camera], script.motion.town_from_ins(time_s))
    painting = render(script.scene(time_s), view, _painter(task.config_json, task.index))
    rng = np.random.default_rng([config.seed, task.index, _SENSOR, task.camera, task.frame])
    image = expose(painting.image_bgr, script.sensors[task.camera], rng)
    quality = [cv2.IMWRITE_JPEG_QUALITY, config.sensor.jpeg_quality]
    (task.folder / task.path).write_bytes(cv2.imencode(".jpg", image, quality)[1].tobytes())
    names = map_ids(script, config.survey)
    indications = script.indications(time_s)
    lights = []
    for head in script.town.heads:
        box = amodal_box(head, view)
        distance_m = float(np.linalg.norm(head.position - view.position))
        if box is None or distance_m > config.truth_range_m or inside_share(box, view.camera.size_wh) == 0:
            continue
        shown = indications[head.id]
        lights.append(
            TruthLight(
                truth_id=head.id,
                map_id=names[head.id],
                type=head.type,
                class_name=shown.class_name,
                lit_class=shown.lit_class,
                flashing=shown.flashing,
                box_xyxy=_edges(box),
                occlusion=occlusion(head.id, box, painting.outlines),
                truncated=inside_share(box, view.camera.size_wh) < 1 - 1e-9,
                position=transform_points(script.utm_from_town, head.position),
                heading_deg=heading_deg(head, script.utm_from_town),
            )
        )
    return TruthFrame(task.stamp_ns, view.camera.name, tuple(lights))


def _edges(box_xyxy: FloatArray) -> tuple[float, float, float, float]:
    left, top, right, bottom = (float(edge) for edge in box_xyxy)
    return (left, top, right, bottom)


@lru_cache(maxsize=2)
def _config(config_json: str) -> DrivesConfig:
    return DrivesConfig.model_validate_json(config_json)


@lru_cache(maxsize=2)
def _script(config_json: str, index: int) -> Script:
    config = _config(config_json)
    return write_script(config, index, load_signals(config.signals))


@lru_cache(maxsize=2)
def _painter(config_json: str, index: int) -> HeadPainter:
    script = _script(config_json, index)
    return HeadPainter(script.signals, script.lighting)
