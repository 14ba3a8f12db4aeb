"""Is the map right? One fault of each kind, and what a corrected map looks like."""

import json
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from autolights.cli import main
from autolights.core import Pose, SignalSet, TrafficLightMap
from autolights.core.errors import DataError, MapError, UsageError
from autolights.data import Drive, load_map
from autolights.data.drives import MAP
from autolights.map_audit import MapAuditConfig, audit_map, find, gather_evidence, table
from autolights.map_audit.evidence import DriveEvidence, Evidence, Sighting
from autolights.pipeline import PipelineConfig

CONFIG = MapAuditConfig()


def judge(*streets: object, signals: SignalSet, config: MapAuditConfig = CONFIG, map_sigma_m: float | None = 0.25):
    evidence = []
    for street in streets:
        scene = street.scene
        drive = Drive(
            Path(), street.name, 17, "north", "ellipsoid", scene.rig,
            tuple(scene.pose(t) for t in np.arange(0, 10, 0.1)), scene.map, (),
        )  # fmt: skip
        evidence.append(gather_evidence(drive, street.sets, street.frames, signals, config))
    return find(streets[0].scene.map, evidence, config, map_sigma_m=map_sigma_m)


def test_one_fault_of_each_kind_is_found_and_nothing_else(drive_along: Callable, signals: SignalSet) -> None:
    street = drive_along()
    found = judge(street, signals=signals)
    by_kind = {finding.kind: finding for finding in found.findings}
    assert Counter(finding.kind for finding in found.findings) == dict.fromkeys(by_kind, 1)
    assert {kind: finding.light_id for kind, finding in by_kind.items()} == {
        "missing": "new-1", "extra": "ghost", "moved": "moved", "type": "odd",
    }  # fmt: skip
    assert set(found.confirmed) == {"ok-1", "ok-2", "ok-3"}
    assert found.undecided == ()

    truth = dict(zip(street.scene.truth.ids, street.scene.truth.positions, strict=True))
    missing, moved = by_kind["missing"], by_kind["moved"]
    assert np.linalg.norm(missing.position - truth["new"]) < 0.4
    assert (missing.type, missing.heading_deg, missing.intersection) == ("3", 270.0, "main")
    assert np.linalg.norm(moved.position - truth["moved"]) < 0.3
    assert moved.offset_m[1] == pytest.approx(-MOVED_ASIDE_M, abs=0.2)
    assert (by_kind["type"].map_type, by_kind["type"].type) == ("3", "5dh")
    assert by_kind["extra"].position is None

    told = {finding.kind: finding.to_json() for finding in found.findings}
    assert told["extra"]["images_seen"] == 0
    assert told["extra"]["images_missed"] >= CONFIG.min_images
    assert told["type"]["types_seen"] == {"5dh": told["type"]["images_seen"]}
    assert told["missing"]["images_seen"] >= 40
    assert told["missing"]["distances_m"]["min"] < 20 < told["missing"]["distances_m"]["max"]
    for values in told.values():
        assert len(values["examples"]) == 3
        assert json.loads(json.dumps(values)) == values


MOVED_ASIDE_M = -1.2


def test_no_light_moves_farther_than_it_can_be_the_same_one(drive_along: Callable, signals: SignalSet) -> None:
    found = judge(drive_along(), signals=signals, config=MapAuditConfig(moved_max_m=1.0))
    assert "moved" not in {finding.kind for finding in found.findings}


@pytest.mark.parametrize(("aside_m", "told"), [(2.8, ["moved"]), (5.0, [])])
def test_doubt_about_depth_does_not_count_as_way_that_a_light_has_moved(aside_m: float, told: list[str]) -> None:
    """Images put a light aside to 0.1 m, and 2.4 m behind its place to 1.5 m: together more than 3 m off."""
    lights = TrafficLightMap(("a",), ("3",), np.zeros((1, 3)), np.array([270.0]), np.array([[0.36, 1.07, 0.3]]))
    ways = [(100.0 * i, 0.0) for i in range(2)]
    seen = [Sighting("day", "front", i, (0, 0, 20, 60), 30.0, ways[i % 2], True) for i in range(40)]
    by_images, by_map = np.diag(np.array([1.5, 0.1, 0.1]) ** -2.0), np.eye(3) / 0.25**2
    covariance = np.linalg.inv(by_images + by_map)
    place = covariance @ by_images @ np.array([2.4, aside_m, 0.0])
    evidence = Evidence(seen=seen, types=Counter({"3": 40}), places=[(place, covariance)])
    found = find(lights, [DriveEvidence({"a": evidence}, {})], CONFIG, map_sigma_m=0.25)
    assert [finding.kind for finding in found.findings] == told


def test_a_map_without_faults_has_no_findings(drive_along: Callable, signals: SignalSet) -> None:
    found = judge(drive_along(fault=False), signals=signals)
    assert found.findings == ()
    assert len(found.confirmed) == 6


def test_too_little_is_no_finding(drive_along: Callable, signals: SignalSet) -> None:
    found = judge(drive_along(seconds=0.5), signals=signals)
    assert found.findings == ()
    assert set(found.undecided) == {"ok-1", "ok-2", "ok-3", "moved", "odd", "ghost"}


def test_two_short_drives_say_what_one_does_not(drive_along: Callable, signals: SignalSet) -> None:
    config = MapAuditConfig(min_images=40, min_way_m=50)
    monday, tuesday = (drive_along(name, seed=seed) for name, seed in (("monday", 7), ("tuesday", 8)))
    assert judge(monday, signals=signals, config=config).findings == ()
    found = judge(monday, tuesday, signals=signals, config=config)
    assert {finding.kind for finding in found.findings} == {"missing", "extra", "moved", "type"}
    (missing,) = (finding for finding in found.findings if finding.kind == "missing")
    assert missing.evidence.drives == ("monday", "tuesday")
    one = next(f for f in judge(monday, signals=signals).findings if f.kind == "missing")
    assert (missing.sigmas_m < 0.8 * one.sigmas_m).all(), "two drives know the place better than one"


def test_a_light_behind_a_lorry_is_not_extra(drive_along: Callable, signals: SignalSet) -> None:
    """The detector sees something else where the light should be: it may hide it."""
    lights = dict(LIGHTS_OF_STREET)
    kind, (ahead_m, aside_m, up_m), _ = lights["ok-2"]
    lights["ok-2"] = (kind, (ahead_m, aside_m, up_m), lambda t: None)
    lights["sign"] = ("5dh", (ahead_m - 1, aside_m, up_m + 0.9), lambda t: "5dh-red")
    street = drive_along(lights=lights)
    found = judge(street, signals=signals)
    assert "ok-2" in found.undecided


LIGHTS_OF_STREET = {
    "ok-1": ("3", (60.0, -9.0, 5.0), lambda t: "3-red"),
    "ok-2": ("3", (60.0, -6.0, 5.0), lambda t: "3-red"),
    "moved": ("3", (60.0, -3.0, 5.0), lambda t: "3-green"),
    "odd": ("5dh", (60.0, 3.0, 5.0), lambda t: "5dh-red"),
    "new": ("3", (60.0, 6.0, 5.0), lambda t: "3-green"),
    "ok-3": ("4", (60.0, 9.0, 5.0), lambda t: "4-rleft"),
}


def test_without_refined_places_only_large_moves_are_told(drive_along: Callable, signals: SignalSet) -> None:
    street = drive_along(config=PipelineConfig(places=None))
    found = judge(street, signals=signals, map_sigma_m=None)
    assert not found.places_judged
    assert {"missing", "extra", "type"} <= {finding.kind for finding in found.findings}


def test_folders_in_findings_page_and_corrected_map_out(
    drive_along: Callable, signals: SignalSet, tmp_path: Path
) -> None:
    street = drive_along()
    run_dir, drive_dir = street.write(tmp_path, pictures=True)
    source = drive_dir / MAP
    values = json.loads(source.read_text())
    values["name"] = "downtown"
    values["features"][0]["properties"]["pole"] = 17
    source.write_text(json.dumps(values))
    audit = audit_map([(run_dir, drive_dir)], signals, tmp_path / "audit")

    saved = json.loads((tmp_path / "audit" / "audit.json").read_text())
    assert saved == json.loads(json.dumps(audit.to_json()))
    assert sorted(f["kind"] for f in saved["findings"]) == ["extra", "missing", "moved", "type"]
    page = (tmp_path / "audit" / "audit.html").read_text()
    assert page.count("data:image/jpeg") == 12
    assert "http://" not in page
    assert "https://" not in page
    text = table(audit)
    assert text.startswith("6 lights in the map: 3 confirmed, 0 seen too little, 4 findings")
    assert "3 → 5dh" in text

    corrected = load_map(tmp_path / "audit" / "map.geojson", signals, 17, "north")
    truth = dict(zip(street.scene.truth.ids, street.scene.truth.positions, strict=True))
    assert corrected.ids == ("ok-1", "ok-2", "ok-3", "moved", "odd", "new-1")
    assert corrected.types == ("3", "3", "4", "3", "5dh", "3")
    for light_id, position in zip(corrected.ids, corrected.positions, strict=True):
        assert np.linalg.norm(position - truth.get(light_id, truth["new"])) < 0.4
    kept = json.loads((tmp_path / "audit" / "map.geojson").read_text())
    assert kept["name"] == "downtown"
    assert kept["features"][0] == values["features"][0], "what nobody found wrong stays, unknown properties too"


def test_only_what_is_asked_for_is_put_right(drive_along: Callable, signals: SignalSet, tmp_path: Path) -> None:
    run_dir, drive_dir = drive_along().write(tmp_path)
    audit_map([(run_dir, drive_dir)], signals, tmp_path / "audit", kinds=["type"])
    corrected = load_map(tmp_path / "audit" / "map.geojson", signals, 17, "north")
    given = load_map(drive_dir / MAP, signals, 17, "north")
    assert corrected.ids == given.ids
    assert [a != b for a, b in zip(corrected.types, given.types, strict=True)] == [i == "odd" for i in given.ids]
    np.testing.assert_array_equal(corrected.positions, given.positions)


def test_the_verb(
    drive_along: Callable, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    run_dir, _ = drive_along().write(tmp_path)
    arguments = ["autolights", "map-audit", str(run_dir), "--out", str(tmp_path / "audit"), "--correct", "missing"]
    monkeypatch.setattr(sys, "argv", [*arguments, "--set", "min_images=25", "--json"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 0
    told = json.loads(capsys.readouterr().out)
    assert [finding["light"] for finding in told["findings"]] == ["new-1", "ghost", "moved", "odd"]
    assert told["config"]["min_images"] == 25
    monkeypatch.setattr(sys, "argv", arguments)
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    assert "audit: exists already" in capsys.readouterr().err


def test_the_map_itself_is_replaced_only_when_asked(drive_along: Callable, signals: SignalSet, tmp_path: Path) -> None:
    pair = drive_along().write(tmp_path)
    source = pair[1] / MAP
    before = source.read_text()
    with pytest.raises(UsageError, match=r"map.geojson: exists already; choose another output or pass --force"):
        audit_map([pair], signals, tmp_path / "audit", corrected=source)
    assert source.read_text() == before
    assert not (tmp_path / "audit").exists()
    audit_map([pair], signals, tmp_path / "audit", corrected=source, force=True)
    assert "new-1" in load_map(source, signals, 17, "north").ids
    with pytest.raises(UsageError, match="audit: exists already"):
        audit_map([pair], signals, tmp_path / "audit")


def test_what_cannot_be_audited_is_named(drive_along: Callable, signals: SignalSet, tmp_path: Path) -> None:
    street = drive_along(seconds=0.3)
    run_dir, drive_dir = street.write(tmp_path / "a")
    other_run, other_drive = street.write(tmp_path / "b")
    values = json.loads((other_drive / MAP).read_text())
    values["features"][0]["properties"]["height_m"] += 0.1
    (other_drive / MAP).write_text(json.dumps(values))
    out = tmp_path / "audit"
    with pytest.raises(MapError, match=r"b.monday.map.geojson: is another map than"):
        audit_map([(run_dir, drive_dir), (other_run, other_drive)], signals, out)
    with pytest.raises(UsageError, match="corrections must be of missing, extra, moved, type, got 'all'"):
        audit_map([(run_dir, drive_dir)], signals, out, kinds=["all"])
    with pytest.raises(UsageError, match="needs one run or more"):
        audit_map([], signals, out)
    info = json.loads((run_dir / "run.json").read_text())
    (run_dir / "run.json").write_text(json.dumps(info | {"config": {**info["config"], "places": None}}))
    values["features"][0]["properties"]["height_m"] -= 0.1
    (other_drive / MAP).write_text(json.dumps(values))
    with pytest.raises(DataError, match="different settings of places"):
        audit_map([(run_dir, drive_dir), (other_run, other_drive)], signals, out)
    (run_dir / "estimates.jsonl").write_text("")
    with pytest.raises(DataError, match=r"holds no line of variant 'full'; run again with --variant full"):
        audit_map([(run_dir, drive_dir)], signals, out)
    assert not out.exists()


def test_evidence_of_many_images_from_one_place_is_little() -> None:
    def sighting(drive: str, i: int, east_m: float) -> Sighting:
        return Sighting(drive, "narrow", i, (0.0, 0.0, 1.0, 1.0), 20.0, (east_m, 0.0), True)

    standing = Evidence(seen=[sighting("a", i, 0.0) for i in range(30)])
    assert (standing.way_m, standing.drives, standing.seen_share) == (0.0, ("a",), 1.0)
    standing.missed += [sighting("b", i, 3.0) for i in range(10)]
    standing.seen += [replace(sighting("a", i, 1.0), expected=False) for i in range(20)]
    assert (standing.way_m, standing.drives) == (3.0, ("a", "b"))
    assert standing.seen_share == pytest.approx(50 / 60)
    assert standing.expected_share == 0.75
    assert Evidence().seen_share == 0.0
    assert Evidence().way_m == 0.0


def test_a_common_shift_of_all_boxes_is_no_move(drive_along: Callable, signals: SignalSet) -> None:
    street = drive_along(fault=False)
    plain = street.scene.pose
    turn = np.radians(0.5) / 2
    street.scene.pose = lambda t: Pose(
        plain(t).stamp_ns, plain(t).position, np.array([0, 0, np.sin(turn), np.cos(turn)])
    )
    found = judge(street, signals=signals)
    assert found.findings == ()
    assert len(found.confirmed) == 6
