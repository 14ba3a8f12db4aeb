"""What a runtime is told wrongly: how its cameras are mounted, where it is, and where the lights are."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from autolights.core import CameraModel, Pose, TrafficLightMap
from autolights.core.transforms import rigid, transform_points
from autolights.sim.heads import SignalHead
from autolights.sim.rig import rotation_from_angles
from autolights.sim.survey import heading_deg
from autolights.suite.config import MapErrors
from autolights.suite.scene import Scene


def turn_cameras(
    cameras: Sequence[CameraModel], error_deg: float, rng: np.random.Generator, *, lateral: bool
) -> Iterator[CameraModel]:
    """The calibration that a runtime believes in.

    Args:
        cameras: As they are.
        error_deg: By which each is turned, to one side or the other.
        rng: Decides the side.
        lateral: About the axis to the left (boxes move up and down) instead of the upright one (they move aside).
    """
    for camera in cameras:
        angle_deg = error_deg * float(rng.choice([-1, 1]))
        turn = rotation_from_angles(0 if lateral else angle_deg, angle_deg if lateral else 0, 0)
        yield replace(camera, cam_from_ins=camera.cam_from_ins @ rigid(turn, np.zeros(3))) if error_deg else camera


def shift_poses(poses: Sequence[Pose], error_m: float, rng: np.random.Generator) -> Iterator[Pose]:
    """Poses that are all off by the same horizontal distance."""
    angle = rng.uniform(0, 2 * np.pi)
    error = error_m * np.array([np.cos(angle), np.sin(angle), 0.0])
    for pose in poses:
        yield Pose(pose.stamp_ns, pose.position + error, pose.quaternion_xyzw)


def wrong_map(
    scene: Scene, errors: MapErrors, rng: np.random.Generator
) -> tuple[TrafficLightMap, dict[str, str | None]]:
    """The map that a runtime gets, and the map's name of each light by its id, None where it is missing."""
    heads = list(scene.heads)
    missing = rng.random(len(heads)) < errors.missing_share
    names: dict[str, str | None] = {
        head.id: None if gone else f"tl-{number:03d}"
        for number, (head, gone) in enumerate(zip(heads, missing, strict=True), start=1)
    }
    moved = rng.random(len(heads)) < errors.moved_share
    sides = rng.choice([-1.0, 1.0], len(heads))
    positions = np.array([head.position for head in heads])
    positions[:, 1] += np.where(moved, sides * errors.moved_m, 0.0)
    extra: list[SignalHead] = []
    for junction in scene.town.junctions:
        ours = [head for head in heads if head.intersection == junction.name and head.group == "ours"]
        for number in range(errors.extra_per_junction):
            like = ours[int(rng.integers(len(ours)))]
            place = like.position + np.array([0.0, float(rng.choice([-1, 1])) * rng.uniform(1.2, 2.5), 0.0])
            extra.append(replace(like, id=f"{junction.name}-gone-{number + 1}", position=place))
    kept = [i for i, head in enumerate(heads) if names[head.id] is not None]
    listed = [*(heads[i] for i in kept), *extra]
    town_positions = np.concatenate([positions[kept], np.array([head.position for head in extra]).reshape(-1, 3)])
    utm = transform_points(scene.utm_from_town, town_positions)
    headings = np.array([heading_deg(head, scene.utm_from_town) for head in listed])
    lights = TrafficLightMap(
        ids=(*(str(names[heads[i].id]) for i in kept), *(f"gone-{k + 1:03d}" for k in range(len(extra)))),
        types=tuple(head.type for head in listed),
        positions=utm + rng.normal(0, errors.noise_m, utm.shape),
        headings_deg=(headings + rng.normal(0, errors.heading_noise_deg, len(listed))) % 360,
        sizes_m=np.array([head.size_m for head in listed]),
        intersections=tuple(head.intersection for head in listed),
        groups=tuple(head.group for head in listed),
    )
    return lights, names
