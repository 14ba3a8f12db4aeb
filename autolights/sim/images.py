"""Labelled images for training and validation, in the YOLO layout."""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
import yaml

from autolights.core import FloatArray, ImageArray, SignalSet, load_signals, save_config
from autolights.core.atomic import new_folder, write_text
from autolights.core.boxes import clip, cxcywh_from_xyxy
from autolights.core.progress import track
from autolights.core.transforms import rigid
from autolights.sim.actors import VehicleKind, pedestrian, vehicle
from autolights.sim.config import ImagesConfig, LightingName
from autolights.sim.disturbances import disturbed_look, ordinary_look
from autolights.sim.ground import draw_ground
from autolights.sim.heads import HeadPainter
from autolights.sim.lighting import LIGHTINGS, Lighting
from autolights.sim.programme import check_types
from autolights.sim.render import Painting, Scene, Shown, render
from autolights.sim.rig import INS_HEIGHT_M, build_cameras, rotation_from_angles
from autolights.sim.sensor import draw_sensor, expose
from autolights.sim.solids import Solid
from autolights.sim.town import LANE_CENTERS_M, JunctionPlan, Town, build_town
from autolights.sim.view import View
from autolights.sim.visibility import amodal_box, inside_share, occlusion
from autolights.sim.workers import in_order

Split = Literal["train", "val"]
_PAINTS = (
    (40.0, 38.0, 36.0),
    (225.0, 225.0, 225.0),
    (150.0, 150.0, 152.0),
    (46.0, 40.0, 170.0),
    (140.0, 84.0, 44.0),
    (60.0, 96.0, 60.0),
    (70.0, 140.0, 190.0),
)


@dataclass(frozen=True, eq=False)
class LabelledImage:
    """One image and its labels.

    Attributes:
        image_bgr: (H, W, 3).
        class_ids: n indices into the signal description's classes.
        boxes_xyxy: (n, 4) pixels, cut at the image's edges.
    """

    image_bgr: ImageArray
    class_ids: tuple[int, ...]
    boxes_xyxy: FloatArray


def simulate_images(config: ImagesConfig, out_dir: Path, *, force: bool = False) -> None:
    """Write ``data.yaml``, ``images/{train,val}/*.jpg`` and ``labels/{train,val}/*.txt``; same seed, same bytes.

    Args:
        config: What to simulate.
        out_dir: Appears when it is complete.
        force: Replace what is there.

    Raises:
        UsageError: If `out_dir` exists and `force` is not set, or the signal description has an unknown type.
    """
    signals = load_signals(config.signals)
    check_types(signals)
    with new_folder(Path(out_dir), force=force) as folder:
        for split, count in (("train", config.train_images), ("val", config.val_images)):
            for kind in ("images", "labels"):
                (folder / kind / split).mkdir(parents=True)
            tasks = [_Task(config, split, i, folder) for i in range(count)]  # type: ignore[arg-type]
            done = in_order(_write_image, tasks, workers=config.workers)
            for _ in track(done, description=f"simulating {split} images", total=count, unit="images"):
                pass
        description = {
            "names": list(signals.classes),
            "train": "images/train",
            "val": "images/val",
            "signals": signals.name,
        }
        write_text(folder / "data.yaml", yaml.safe_dump(description, sort_keys=False))
        save_config(config, folder / "config.yaml")


def simulate_image(config: ImagesConfig, split: Split, index: int) -> LabelledImage:
    """Draw one image of a town of its own; depends on seed, split and index alone."""
    rng = np.random.default_rng([config.seed, 0 if split == "train" else 1, index])
    signals = load_cached_signals(config.signals)
    lighting = LIGHTINGS[_draw_lighting(config, rng)]
    town = build_town(signals, draw_plans(signals, rng, empty=rng.uniform() < config.empty_share), rng)
    camera = build_cameras(config.cameras)[int(rng.integers(len(config.cameras)))]
    view = View(camera, _draw_pose(config, town, rng))
    eye_x = float(view.position[0])
    scene = Scene(
        town=town,
        ground=draw_ground(town.markings, eye_x, eye_x + 150, lighting),
        lighting=lighting,
        solids=_draw_traffic(town, eye_x, rng),
        shown=draw_shown(config, signals, town, rng),
    )
    painting = render(scene, view, _painter(config.signals, lighting))
    class_ids, boxes = _label(config, signals, scene, view, painting)
    sensor = draw_sensor(config.sensor, lighting.noise_gain, rng)
    return LabelledImage(expose(painting.image_bgr, sensor, rng), class_ids, boxes)


@dataclass(frozen=True)
class _Task:
    config: ImagesConfig
    split: Split
    index: int
    folder: Path


def _write_image(task: _Task) -> None:
    labelled = simulate_image(task.config, task.split, task.index)
    height, width = labelled.image_bgr.shape[:2]
    name = f"{task.split}_{task.index:05d}"
    fractions = cxcywh_from_xyxy(labelled.boxes_xyxy) / (width, height, width, height)
    lines = [
        f"{class_id} " + " ".join(f"{value:.6f}" for value in row)
        for class_id, row in zip(labelled.class_ids, fractions, strict=True)
    ]
    (task.folder / "labels" / task.split / f"{name}.txt").write_text("".join(line + "\n" for line in lines))
    quality = [cv2.IMWRITE_JPEG_QUALITY, task.config.sensor.jpeg_quality]
    encoded = cv2.imencode(".jpg", labelled.image_bgr, quality)[1]
    (task.folder / "images" / task.split / f"{name}.jpg").write_bytes(encoded.tobytes())


def _draw_lighting(config: ImagesConfig, rng: np.random.Generator) -> LightingName:
    names = list(config.lighting)
    weights = np.array([config.lighting[name] for name in names])
    return names[int(rng.choice(len(names), p=weights / weights.sum()))]


def draw_plans(signals: SignalSet, rng: np.random.Generator, *, empty: bool) -> list[JunctionPlan]:
    """Two junctions; types as frequent as they have classes, so that all classes are about equally frequent."""
    if empty:
        return [JunctionPlan(()), JunctionPlan(())]
    types = list(signals.types)
    weights = np.array([len(signals.types[name].states) for name in types], dtype=np.float64)
    weights /= weights.sum()

    def draw() -> str:
        return str(rng.choice(types, p=weights))

    return [
        JunctionPlan(
            over_lanes=tuple(draw() for _ in range(int(rng.integers(2, 5)))),
            right_mast=draw() if rng.uniform() < 0.5 else None,
            left_mast=draw() if rng.uniform() < 0.4 else None,
            near_side=draw() if rng.uniform() < 0.4 else None,
        )
        for _ in range(2)
    ]


def _draw_pose(config: ImagesConfig, town: Town, rng: np.random.Generator) -> FloatArray:
    """(4, 4) somewhere before the first junction's heads, in some lane, not quite straight."""
    near, far = config.distance_m
    # Uniform in 1 / distance would be uniform in size; the mean of both favours neither large nor small heads.
    distance = rng.uniform(near, far) if rng.uniform() < 0.5 else 1 / rng.uniform(1 / far, 1 / near)
    x = town.junctions[0].heads_m - float(distance)
    y = float(rng.choice(LANE_CENTERS_M)) + float(rng.normal(0, 0.5))
    rotation = rotation_from_angles(float(rng.normal(0, 3.5)), float(rng.normal(0, 0.9)), float(rng.normal(0, 0.9)))
    return rigid(rotation, np.array([x, y, INS_HEIGHT_M + float(rng.uniform(-0.25, 0.5))]))


def draw_shown(config: ImagesConfig, signals: SignalSet, town: Town, rng: np.random.Generator) -> dict[str, Shown]:
    """Each head for itself, all classes of its type alike: nothing can be guessed from its neighbours."""
    shown = {}
    for head in town.heads:
        states = signals.states_of(head.type)
        look = ordinary_look(config.disturbance, rng)
        if rng.uniform() < config.disturbance.share:
            look = disturbed_look(config.disturbance, look, rng)
        shown[head.id] = Shown(states[int(rng.integers(len(states)))], look)
    return shown


def _draw_traffic(town: Town, eye_x: float, rng: np.random.Generator) -> list[Solid]:
    """Cars that wait, come and cross, people on the crossings, sometimes something large close by."""
    solids: list[Solid] = []

    def add(kind: VehicleKind, x: float, y: float, yaw: float) -> None:
        paint = _PAINTS[int(rng.integers(len(_PAINTS)))]
        solids.append(vehicle(kind, paint, braking=rng.uniform() < 0.6).placed(np.array([x, y, 0.0]), yaw))

    kinds: tuple[VehicleKind, ...] = ("car", "car", "car", "van", "lorry")
    for lane in (*LANE_CENTERS_M, 1.8, 5.25, 8.7):
        x = eye_x + float(rng.uniform(9, 30))
        while x < eye_x + 110 and rng.uniform() < 0.55:
            kind = kinds[int(rng.integers(len(kinds)))]
            if kind == "car" or x > eye_x + 22 or lane > 0:
                add(kind, x, lane, 0.0 if lane < 0 else np.pi)
            x += float(rng.uniform(12, 45))
    for junction in town.junctions:
        middle = sum(junction.street_m) / 2
        if middle < eye_x + 6:
            continue
        if rng.uniform() < 0.3:
            kind = kinds[int(rng.integers(len(kinds)))]
            add(
                kind,
                middle + float(rng.uniform(-3, 3)),
                float(rng.uniform(-14, 14)),
                float(rng.choice([-1, 1])) * np.pi / 2,
            )
        people = range(int(rng.integers(0, 4)))
        solids += [_person(junction.stop_line_m + 2.4, float(rng.uniform(-13, 13)), eye_x, rng) for _ in people]
    if rng.uniform() < 0.12:
        add("van" if rng.uniform() < 0.5 else "lorry", eye_x + float(rng.uniform(12, 18)), LANE_CENTERS_M[0], 0.0)
    if rng.uniform() < 0.08:
        solids.append(_person(eye_x + float(rng.uniform(3, 6)), float(rng.uniform(-9, -1)), eye_x, rng))
    return solids


def _person(x: float, y: float, eye_x: float, rng: np.random.Generator) -> Solid:
    paint = _PAINTS[int(rng.integers(len(_PAINTS)))]
    umbrella = _PAINTS[int(rng.integers(len(_PAINTS)))] if rng.uniform() < 0.5 else None
    across = float(rng.choice([-1, 1])) * np.pi / 2
    return pedestrian(paint, umbrella=umbrella).placed(np.array([max(x, eye_x + 2.5), y, 0.0]), across)


def _label(
    config: ImagesConfig, signals: SignalSet, scene: Scene, view: View, painting: Painting
) -> tuple[tuple[int, ...], FloatArray]:
    class_ids, boxes = [], []
    for head in scene.town.heads:
        box = amodal_box(head, view)
        if box is None or head.facing_deg(view.position) > config.max_facing_deg:
            continue
        if box[3] - box[1] < config.min_height_px or inside_share(box, view.camera.size_wh) < config.min_inside:
            continue
        if occlusion(head.id, box, painting.outlines) > config.max_occlusion:
            continue
        class_ids.append(signals.class_ids[scene.shown[head.id].lit_class])
        boxes.append(clip(box, view.camera.size_wh))
    return tuple(class_ids), np.array(boxes, dtype=np.float64).reshape(-1, 4)


@lru_cache(maxsize=4)
def load_cached_signals(name: str) -> SignalSet:
    """The signal description, read once per process."""
    return load_signals(name)


@lru_cache(maxsize=8)
def _painter(signals: str, lighting: Lighting) -> HeadPainter:
    return HeadPainter(load_cached_signals(signals), lighting)
