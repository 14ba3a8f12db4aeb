"""How many of a map's faults does the audit find, and how many of its findings are faults? On the suite's drives.

Usage: python tools/audit_suite.py [--scenario map_missing ...] [--set KEY=VALUE ...]

A fault counts for recall if the drive had the light in view: in `min_images` images, tall enough, within the camera's
range and facing it. `wrong_type` are the drives of `nominal` with one light in five given another type in the map.
"""

import argparse
from collections import Counter
from dataclasses import replace

import numpy as np

from autolights.core import load_config
from autolights.core.config import parse_config
from autolights.data import DetectedFrame, EstimateSet
from autolights.map_audit import Findings, MapAuditConfig, find, gather_evidence
from autolights.pipeline import LightPipeline, PipelineConfig
from autolights.suite import SuiteConfig
from autolights.suite.drives import SuiteDrive, scenario_drives
from autolights.suite.run import suite_hmm
from autolights.track import project_lights

SCENARIOS = ("map_missing", "map_extra", "map_moved", "wrong_type", "nominal", "survey", "lookalikes", "mounting_1.0")
KINDS = ("missing", "extra", "moved", "type")
_SAME_M = 1.0


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenario", nargs="+", default=SCENARIOS)
    parser.add_argument("--set", nargs="*", default=[], metavar="KEY=VALUE", help="overrides of the audit's limits")
    parser.add_argument("--drives", type=int, default=99, help="of each scenario at most")
    parser.add_argument("--verbose", action="store_true", help="name each wrong finding and each overlooked fault")
    arguments = parser.parse_args()
    suite = load_config("suite/default", SuiteConfig)
    runtime = load_config("runtime/default", PipelineConfig)
    config = parse_config({}, MapAuditConfig, arguments.set, source="--set")
    print("| scenario | drives | " + " | ".join(f"{kind}: found, of faults, false" for kind in KINDS) + " |")
    print("| --- " * (2 + len(KINDS)) + "|")
    for name in arguments.scenario:
        counts: Counter[tuple[str, str]] = Counter()
        number = 0
        for drive in scenario_drives(suite, "nominal" if name == "wrong_type" else name):
            if number >= arguments.drives:
                break
            number += 1
            if name == "wrong_type":
                drive = with_wrong_types(drive, np.random.default_rng(number))
            findings = audit(drive, suite, runtime, config)
            score(drive, findings, config, counts, arguments.verbose)
        cells = [f"{counts[k, 'found']}, {counts[k, 'faults']}, {counts[k, 'false']}" for k in KINDS]
        print(f"| {name} | {number} | " + " | ".join(cells) + " |", flush=True)


def with_wrong_types(drive: SuiteDrive, rng: np.random.Generator) -> SuiteDrive:
    """The drive with one light in five of another type in the map."""
    lights, names = drive.drive.lights, list(drive.signals.types)
    types = [
        str(rng.choice([name for name in names if name != kind])) if rng.random() < 0.2 else kind
        for kind in lights.types
    ]
    changed = replace(lights, types=tuple(types), sizes_m=drive.signals.sizes_m(types))
    return replace(drive, drive=replace(drive.drive, lights=changed))


def audit(drive: SuiteDrive, suite: SuiteConfig, runtime: PipelineConfig, config: MapAuditConfig) -> Findings:
    """Run the pipeline over a drive, then judge its map."""
    given = drive.drive
    pipeline = LightPipeline(
        None, suite_hmm(suite, drive.signals), drive.signals, given.cameras, given.lights, runtime,  # type: ignore[arg-type]
        poses=given.pose_buffer(),
    )  # fmt: skip
    sets = []
    for frames in drive.sets:
        keys = tuple((frame.camera, frame.stamp_ns) for frame in frames)
        lights = pipeline.step_detections(frames, [drive.detections[key] for key in keys])
        sets.append(EstimateSet(max(stamp for _, stamp in keys), "full", keys, tuple(lights)))
    seen = [
        DetectedFrame(stamp, camera, d.boxes_xyxy, d.scores, tuple(drive.signals.classes[i] for i in d.class_ids))
        for (camera, stamp), d in drive.detections.items()
    ]
    evidence = gather_evidence(given, sets, seen, drive.signals, config)
    return find(given.lights, [evidence], config, map_sigma_m=runtime.places.map_m if runtime.places else None)


def score(
    drive: SuiteDrive, findings: Findings, config: MapAuditConfig, counts: Counter[tuple[str, str]], verbose: bool
) -> None:
    """Count what was found, what should have been, and what is no fault."""
    lights = drive.drive.lights
    truth = {light.truth_id: light for frame in drive.truth.values() for light in frame.lights}
    by_map_id = {light.map_id: light for light in truth.values() if light.map_id is not None}
    in_view = images_in_view(drive, config)
    faults: dict[str, set[str]] = {kind: set() for kind in KINDS}
    wrong: dict[str, set[str]] = {kind: set() for kind in KINDS}  # all, however seldom in view
    for light in truth.values():
        if light.map_id is None:
            wrong["missing"].add(light.truth_id)
    for row, light_id in enumerate(lights.ids):
        if light_id.startswith("gone-"):
            wrong["extra"].add(light_id)
        elif light_id in by_map_id:
            true = by_map_id[light_id]
            if np.linalg.norm(true.position - lights.positions[row]) >= config.moved_m:
                wrong["moved"].add(light_id)
            if true.type != lights.types[row]:
                wrong["type"].add(light_id)
    for kind in KINDS:
        faults[kind] = {name for name in wrong[kind] if in_view[name] >= config.min_images}
    found: dict[str, set[str]] = {kind: set() for kind in KINDS}
    for finding in findings.findings:
        name = finding.light_id
        if finding.kind == "missing":
            assert finding.position is not None
            apart = {
                light.truth_id: float(np.linalg.norm(light.position - finding.position))
                for light in truth.values()
                if light.map_id is None and light.truth_id not in found["missing"]
            }
            nearest = min(apart, key=lambda key: apart[key], default="")
            name = nearest if nearest and apart[nearest] <= _SAME_M else name
        if name in wrong[finding.kind]:
            found[finding.kind].add(name)
        else:
            counts[finding.kind, "false"] += 1
            if verbose:
                print("  false:", drive.name, finding.to_json())
    for kind in KINDS:
        counts[kind, "faults"] += len(faults[kind])
        counts[kind, "found"] += len(found[kind] & faults[kind])
        if verbose and faults[kind] - found[kind]:
            print("  overlooked:", drive.name, kind, {name: in_view[name] for name in faults[kind] - found[kind]})


def images_in_view(drive: SuiteDrive, config: MapAuditConfig) -> Counter[str]:
    """How many images show each light (by truth id and by map id), or would if it were there, as the audit asks for."""
    count: Counter[str] = Counter()
    lights, poses = drive.drive.lights, drive.true_drive.pose_buffer()
    cosine = np.cos(np.radians(config.facing_deg))
    for (camera_name, stamp_ns), frame in drive.truth.items():
        camera, pose = drive.true_drive.cameras[camera_name], poses.at(stamp_ns)
        for light in frame.lights:
            heading = np.radians(light.heading_deg)
            to_vehicle = (pose.position - light.position)[:2]
            facing = np.array([np.sin(heading), np.cos(heading)]) @ to_vehicle / np.linalg.norm(to_vehicle)
            tall = light.box_xyxy[3] - light.box_xyxy[1] >= config.min_height_px
            near = np.linalg.norm(pose.position - light.position) <= camera.max_range_m
            if tall and near and facing >= cosine and not light.truncated and light.occlusion < 0.25:
                count[light.truth_id] += 1
                if light.map_id is not None:
                    count[light.map_id] += 1
        projected = project_lights(lights, camera, pose)
        boxes = projected.boxes_xyxy
        for i in np.flatnonzero(projected.expected & (boxes[:, 3] - boxes[:, 1] >= config.min_height_px)).tolist():
            if lights.ids[projected.indices[i]].startswith("gone-"):
                count[lights.ids[projected.indices[i]]] += 1
    return count


if __name__ == "__main__":
    main()
