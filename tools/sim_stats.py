"""Print what a folder of simulated drives holds: ``python tools/sim_stats.py runs/demo/drives``."""

import argparse
from collections import Counter
from itertools import pairwise
from pathlib import Path

import numpy as np

from autolights.core import load_signals
from autolights.data import Drive, load_truth
from autolights.evaluate.in_view import lights_in_view

HIDDEN = 0.5  # a light counts as hidden from this share of its box on
HEIGHT_EDGES_PX = (8, 12, 16, 24, 32, 48, 64, 96, 200)


def main() -> None:
    """Read every drive of the folder, count the lights in view and print shares per drive and overall."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="holds one folder per drive")
    folder: Path = parser.parse_args().folder
    signals = load_signals()
    totals: Counter[str] = Counter()
    classes: Counter[str] = Counter()
    heights_px: list[float] = []
    episodes_s: list[float] = []
    for drive_yaml in sorted(folder.glob("*/drive.yaml")):
        drive = Drive.load(drive_yaml.parent, signals)
        poses = drive.pose_buffer()
        counts: Counter[str] = Counter()
        hidden: dict[tuple[str, str], list[tuple[int, bool]]] = {}
        shown: dict[str, list[str]] = {}
        for frame in load_truth(drive.truth_path):
            for light in lights_in_view(frame.lights, drive.cameras[frame.camera], poses.at(frame.stamp_ns)):
                is_hidden = light.occlusion > HIDDEN
                counts["light-frames"] += 1
                counts["hidden"] += is_hidden
                counts["flashing"] += light.flashing
                counts["dark"] += light.lit_class != light.class_name
                counts["not in map"] += light.map_id is None
                classes[light.class_name] += 1
                heights_px.append(light.box_xyxy[3] - light.box_xyxy[1])
                shown.setdefault(light.truth_id, []).append(light.class_name)
                hidden.setdefault((frame.camera, light.truth_id), []).append((frame.stamp_ns, is_hidden))
        for views in hidden.values():
            episodes_s += _episodes_s(views)
        changes = sum(a != b for names in shown.values() for a, b in pairwise(names))
        print(f"{drive.name}: {_shares(counts)}, {changes} changes of state in view")
        totals += counts
    print(f"all: {_shares(totals)}")
    print("classes:", {name: classes[name] for name in signals.classes if name in classes})
    print(
        "heights px:", dict(zip(HEIGHT_EDGES_PX, np.histogram(heights_px, HEIGHT_EDGES_PX)[0].tolist(), strict=False))
    )
    if episodes_s:
        deciles = np.percentile(episodes_s, [10, 50, 90, 100]).round(2).tolist()
        print(f"hidden episodes: {len(episodes_s)}; 10 %, 50 %, 90 % and all are shorter than {deciles} s")


def _episodes_s(views: list[tuple[int, bool]]) -> list[float]:
    """Lengths of the stretches in which one light is hidden from one camera, from (stamp, hidden) in order of time."""
    lengths_s, start_ns = [], None
    for stamp_ns, is_hidden in views:
        if is_hidden and start_ns is None:
            start_ns = stamp_ns
        elif not is_hidden and start_ns is not None:
            lengths_s.append((stamp_ns - start_ns) / 1e9)
            start_ns = None
    return lengths_s


def _shares(counts: Counter[str]) -> str:
    total = max(counts["light-frames"], 1)
    names = ("hidden", "flashing", "dark", "not in map")
    return f"{total} light-frames, " + ", ".join(f"{100 * counts[name] / total:.1f} % {name}" for name in names)


if __name__ == "__main__":
    main()
