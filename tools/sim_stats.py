"""Print what a folder of simulated drives holds: ``python tools/sim_stats.py runs/demo/drives``."""

import argparse
from collections import Counter
from itertools import pairwise
from pathlib import Path

import numpy as np

from autolights.core import load_signals
from autolights.data import Drive, load_truth

MIN_HEIGHT_PX, MAX_FACING_DEG, HIDDEN = 8.0, 60.0, 0.5


def main() -> None:
    """Read every drive of the folder and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="holds one folder per drive")
    folder: Path = parser.parse_args().folder
    signals = load_signals()
    totals: Counter[str] = Counter()
    classes: Counter[str] = Counter()
    heights: list[float] = []
    episodes_s: list[float] = []
    for drive_yaml in sorted(folder.glob("*/drive.yaml")):
        drive = Drive.load(drive_yaml.parent, signals)
        counts: Counter[str] = Counter()
        hidden_since: dict[tuple[str, str], tuple[int, int]] = {}
        shown: dict[str, list[str]] = {}
        poses = drive.pose_buffer()
        for frame in load_truth(drive.truth_path):
            camera = drive.cameras[frame.camera]
            utm_from_cam = poses.at(frame.stamp_ns).utm_from_ins @ np.linalg.inv(camera.cam_from_ins)
            for light in frame.lights:
                _, top, _, bottom = light.box_xyxy
                towards = utm_from_cam[:3, 3] - light.position
                bearing = np.degrees(np.arctan2(towards[0], towards[1]))
                facing = abs((bearing - light.heading_deg + 180) % 360 - 180)
                near = np.linalg.norm(towards) <= camera.max_range_m
                if light.truncated or not near or bottom - top < MIN_HEIGHT_PX or facing > MAX_FACING_DEG:
                    continue
                counts["light-frames"] += 1
                counts["hidden"] += light.occlusion > HIDDEN
                counts["flashing"] += light.flashing
                counts["dark"] += light.lit_class != light.class_name
                counts["not in map"] += light.map_id is None
                classes[light.class_name] += 1
                heights.append(bottom - top)
                shown.setdefault(light.truth_id, []).append(light.class_name)
                key = (frame.camera, light.truth_id)
                if light.occlusion > HIDDEN:
                    first, _ = hidden_since.get(key, (frame.stamp_ns, 0))
                    hidden_since[key] = (first, frame.stamp_ns)
                elif key in hidden_since:
                    first, last = hidden_since.pop(key)
                    episodes_s.append((last - first) / 1e9 + 0.1)
        episodes_s += [(last - first) / 1e9 + 0.1 for first, last in hidden_since.values()]
        changes = sum(a != b for names in shown.values() for a, b in pairwise(names))
        print(f"{drive.name}: {_shares(counts)}, {changes} changes of state in view")
        totals += counts
    print(f"all: {_shares(totals)}")
    print("classes:", {name: classes[name] for name in signals.classes if name != "4-off"})
    edges = [8, 12, 16, 24, 32, 48, 64, 96, 200]
    print("heights px:", dict(zip(edges, np.histogram(heights, [*edges[:-1], 200])[0].tolist(), strict=False)))
    if episodes_s:
        quartiles = np.percentile(episodes_s, [25, 50, 75, 100]).round(2).tolist()
        print(f"hidden episodes: {len(episodes_s)}, quartiles and longest {quartiles} s")


def _shares(counts: Counter[str]) -> str:
    total = max(counts["light-frames"], 1)
    names = ("hidden", "flashing", "dark", "not in map")
    return f"{total} light-frames, " + ", ".join(f"{100 * counts[name] / total:.1f} % {name}" for name in names)


if __name__ == "__main__":
    main()
