import json

import numpy as np
import pytest

from autolights.core import CameraModel, Pose
from autolights.core.boxes import cxcywh_columns
from autolights.core.light_box import light_corners, project_corners
from autolights.core.shots import Shots
from autolights.core.transforms import CAMERA_AXES_FROM_VEHICLE_AXES, invert_rigid, rigid
from autolights.track.box_measurement import box_variances, measured_boxes
from autolights.track.motion import Stand
from autolights.track.place_config import PlaceConfig
from autolights.track.places import LightPlaces

ORIGIN = np.array([500_000.0, 4_800_000.0, 200.0])
SIZE = np.array([0.36, 1.07, 0.3])
HEADING = 270.0  # of a light that faces a vehicle on its way east
# Every image counts in full, and nothing wanders: the filter's own assumptions, for oracles.
PLAIN = PlaceConfig(
    every_s=0, decorrelation_m=0.01, wander_deg=0, wander_m=0, box_px=0.5, box_share=0, drift_deg=0, drift_m=0
)


def make_camera(name: str, focal_px: float = 1460.0, turn: np.ndarray | None = None) -> CameraModel:
    mount = rigid(CAMERA_AXES_FROM_VEHICLE_AXES, np.array([0.1, 1.2, -0.5]))
    return CameraModel(
        name=name,
        size_wh=(1280, 800),
        intrinsics=np.array([[focal_px, 0, 642.0], [0, focal_px, 398.0], [0, 0, 1]]),
        distortion=np.array([-0.1, 0.03, 0.0005, -0.0005]),
        cam_from_ins=mount if turn is None else rigid(turn, np.zeros(3)) @ mount,
        max_range_m=64.0,
    )


def turned(angles: np.ndarray) -> np.ndarray:
    """Rotation about the camera's axes by small angles."""
    a, b, c = angles
    rotation, _ = np.linalg.qr(np.array([[1, -c, b], [c, 1, -a], [-b, a, 1]]))
    return rotation * np.sign(np.diag(rotation))


def pose_at(ahead_m: float, stamp_ns: int) -> Pose:
    return Pose(stamp_ns, ORIGIN + np.array([ahead_m, 0.0, 1.5]), np.array([0.0, 0.0, 0.0, 1.0]))


def boxes_of(positions: np.ndarray, camera: CameraModel, pose: Pose, size: np.ndarray = SIZE) -> np.ndarray:
    n = len(positions)
    corners = light_corners(positions, np.full(n, HEADING), np.tile(size, (n, 1)))
    return project_corners(corners, camera, camera.cam_from_ins @ invert_rigid(pose.utm_from_ins))


def row_of_lights(count: int = 4) -> np.ndarray:
    across = 2.5 * (np.arange(count) - (count - 1) / 2)
    return ORIGIN + np.stack([60 + np.arange(count) % 2, across, 6 + 0.5 * (np.arange(count) % 3)], axis=1)


def fill(places: LightPlaces, positions: np.ndarray, *, on_map: bool = True) -> np.ndarray:
    n = len(positions)
    places.append(positions, np.full(n, HEADING), np.tile(SIZE, (n, 1)), on_map=on_map)
    return np.arange(n)


def drive(
    places: LightPlaces,
    truth: np.ndarray,
    cameras: dict[str, tuple[CameraModel, CameraModel]],
    way_m: float,
    *,
    edge_px: float = 0.0,
    rng: np.random.Generator | None = None,
    rows: np.ndarray | None = None,
) -> None:
    """Past the lights at 10 m/s; of each camera the true one and the one that the vehicle believes in."""
    rows = np.arange(len(truth)) if rows is None else rows
    for step in range(int(way_m) + 1):
        pose = pose_at(float(step), step * 100_000_000)
        for true, believed in cameras.values():
            boxes = boxes_of(truth[rows], true, pose)
            if rng is not None:
                boxes = boxes + rng.normal(0, edge_px, boxes.shape)
            places.observe(rows, boxes, believed, pose)
        places.settle(pose.stamp_ns)


def test_true_boxes_of_true_lights_move_nothing() -> None:
    camera = make_camera("front")
    places = LightPlaces(["front"], PlaceConfig())
    truth = row_of_lights()
    fill(places, truth)
    drive(places, truth, {"front": (camera, camera)}, 30)
    # The far plane of a housing is bent by the lens a little otherwise than the near one: micrometres.
    np.testing.assert_allclose(places.positions, truth, atol=2e-3)
    assert (np.linalg.eigvalsh(places.covariances) > 0).all()
    assert np.trace(places.covariances, axis1=1, axis2=2).max() < 3 * PlaceConfig().map_m ** 2


def test_jacobians_are_the_numeric_ones() -> None:
    camera = make_camera("front")
    places = LightPlaces(["left", "front"], PlaceConfig())
    rows = fill(places, row_of_lights())
    pose = pose_at(20.0, 0)
    one, zeros, second = Shots.of([camera], [pose]), np.zeros(len(rows), dtype=int), np.array([1])
    earlier = Pose(-100_000_000, pose.position - np.array([1.0, 0.1, 0]), np.array([0, 0, np.sin(0.01), np.cos(0.01)]))
    before = [(Stand.of(Shots.of([camera], [earlier]), 0), Stand.of(Shots.of([camera], [pose]), 0))]
    expected, jacobian, depths_m = places._expected(rows, one, zeros, second, before)
    boxes = cxcywh_columns(boxes_of(places.positions, camera, pose))
    np.testing.assert_allclose(expected, measured_boxes(boxes, one, zeros), atol=2e-5)
    assert depths_m == pytest.approx([40.0 - 0.5, 41.0 - 0.5] * 2, abs=1e-6)

    def moved(column: int, by: float) -> np.ndarray:
        positions, found, shared = places.positions, places._found, places._shared.mean
        offset = np.zeros(jacobian.shape[2])
        offset[column] = by
        places.positions = positions + offset[:3]
        places._found, places._shared.mean = found + offset[:4], shared + offset[4:]
        result, _, _ = places._expected(rows, one, zeros, second, before)
        places.positions, places._found, places._shared.mean = positions, found, shared
        return result

    scale = np.abs(jacobian).max(axis=(0, 1))
    for column in range(jacobian.shape[2]):
        step = 1e-4
        numeric = (moved(column, step) - moved(column, -step)) / (2 * step)
        # Depth within the housing is left aside: 1 % of the row's largest entry.
        tolerance = 0.012 * max(float(scale[column]), float(np.abs(numeric).max()))
        np.testing.assert_allclose(jacobian[..., column], numeric, atol=max(tolerance, 1e-9), err_msg=str(column))


def test_images_at_once_tell_what_they_tell_one_by_one() -> None:
    rng = np.random.default_rng(3)
    cameras = [make_camera("left"), make_camera("front")]
    one, other = (LightPlaces(["front", "left"], PlaceConfig()) for _ in range(2))
    rows = fill(one, row_of_lights())
    fill(other, row_of_lights())
    for i in range(6):
        poses = [pose_at(2.0 * i, i * 200_000_000), pose_at(2.0 * i + 0.1, i * 200_000_000 + 5_000_000)]
        boxes = [
            boxes_of(row_of_lights() + 0.1, camera, pose) + rng.normal(0, 0.5, (len(rows), 4))
            for camera, pose in zip(cameras, poses, strict=True)
        ]
        some = [rows, rows[1:]]
        for mine, camera, pose, box in zip(some, cameras, poses, boxes, strict=True):
            one.observe(mine, box[mine], camera, pose)
        images = np.repeat([0, 1], [len(mine) for mine in some])
        together = np.concatenate([boxes[0], boxes[1][1:]])
        other.observe_set(np.concatenate(some), together, Shots.of(cameras, poses), images)
        for places in (one, other):
            places.settle(i * 200_000_000)
    np.testing.assert_allclose(other.positions, one.positions, rtol=0, atol=1e-9)
    np.testing.assert_allclose(other.covariances, one.covariances, rtol=1e-9)
    np.testing.assert_array_equal(other._last_ns, one._last_ns)


def test_the_arrow_is_solved_exactly() -> None:
    rng = np.random.default_rng(7)
    cameras = {name: make_camera(name, focal) for name, focal in (("narrow", 1460.0), ("wide", 690.0))}
    places = LightPlaces(list(cameras), PLAIN)
    truth = row_of_lights()
    fill(places, truth + rng.normal(0, 0.2, truth.shape))
    drive(places, truth, {n: (c, c) for n, c in cameras.items()}, 20, edge_px=0.5, rng=rng)

    n, light, shared = len(truth), 4, len(places._shared.mean)
    dense, vector = np.zeros((n * light + shared,) * 2), np.zeros(n * light + shared)
    dense[n * light :, n * light :] = places._shared.information
    for i in range(n):
        columns = np.r_[i * light : (i + 1) * light, n * light : n * light + shared]
        dense[np.ix_(columns, columns)] += places._information[i]
        vector[columns] += places._vectors[i]
    solution, covariance = np.linalg.solve(dense, vector), np.linalg.inv(dense)
    for i in range(n):
        own = slice(i * light, i * light + 3)
        np.testing.assert_allclose(places.positions[i] - places._origins[i], solution[own], atol=1e-8)
        np.testing.assert_allclose(places.covariances[i], covariance[own, own], atol=1e-8)
    np.testing.assert_allclose(places._shared.mean, solution[n * light :], atol=1e-8)


def test_one_light_with_perfect_cameras_is_a_kalman_filter() -> None:
    """A light of known size before a fixed linearisation: the closed form of a static target."""
    config = PLAIN.model_copy(update={"rotation_deg": 1e-6, "position_m": 1e-6, "size_share": 1e-6})
    camera, pose, rng = make_camera("front"), pose_at(20.0, 0), np.random.default_rng(7)
    places = LightPlaces(["front"], config)
    rows = fill(places, row_of_lights(1))
    boxes = boxes_of(row_of_lights(1) + np.array([0.3, 0.05, -0.04]), camera, pose) + rng.normal(0, 0.2, (1, 4))
    one, zeros, columns = Shots.of([camera], [pose]), np.zeros(1, dtype=int), cxcywh_columns(boxes)
    expected, jacobian, depths_m = places._expected(rows, one, zeros, zeros, [()])
    h, r = jacobian[0, :, :3], np.diag(box_variances(columns[3], depths_m, one, zeros, config)[0])
    prior = np.eye(3) * config.map_m**2
    gain = prior @ h.T @ np.linalg.inv(h @ prior @ h.T + r)
    places.observe(rows, boxes, camera, pose)
    places.settle(0)
    np.testing.assert_allclose(
        places.positions[0] - row_of_lights(1)[0], gain @ (measured_boxes(columns, one, zeros) - expected)[0], atol=1e-4
    )
    np.testing.assert_allclose(places.covariances[0], (np.eye(3) - gain @ h) @ prior, atol=1e-5)


def test_covariances_are_honest() -> None:
    """Errors drawn as the settings say: the normalised squared error is that of three degrees of freedom."""
    rng, squares = np.random.default_rng(7), []
    config = PLAIN.model_copy(update={"rotation_deg": 0.2})
    for _ in range(60):
        truth = row_of_lights()
        turn = turned(np.radians(rng.normal(0, config.rotation_deg, 3)))
        true, believed = make_camera("front", turn=turn), make_camera("front")
        places = LightPlaces(["front"], config)
        fill(places, truth + rng.normal(0, config.map_m, truth.shape))
        shift = rng.normal(0, config.position_m, 3)  # the true position, seen from the given one
        for step in range(0, 31, 2):
            given = pose_at(float(step), step * 100_000_000)
            real = Pose(given.stamp_ns, given.position + shift, given.quaternion_xyzw)
            boxes = boxes_of(truth, true, real) + rng.normal(0, config.box_px, (len(truth), 4))
            places.observe(np.arange(len(truth)), boxes, believed, given)
            places.settle(given.stamp_ns)
        error = places.positions - truth
        squares.append(float(np.einsum("ni,nij,nj->n", error, np.linalg.inv(places.covariances), error).mean()))
    # 240 lights, four of them share their errors: 3 ± 3 √(6 / 60), if it were only 60. Size is not drawn: a bit less.
    assert 1.8 < np.mean(squares) < 3.9


def test_a_mounting_error_is_told_from_errors_of_the_map() -> None:
    rng, truth = np.random.default_rng(7), row_of_lights(6)
    angles = np.radians([0.3, 1.0, 0.0])  # seen 1° to the right, 0.3° too high
    places = LightPlaces(["front"], PlaceConfig())
    surveyed = truth + rng.normal(0, 0.1, truth.shape)
    fill(places, surveyed)
    cameras = {"front": (make_camera("front", turn=turned(angles)), make_camera("front"))}
    drive(places, truth, cameras, 40, edge_px=0.8, rng=rng)
    found, covariance = places.shared_error("front")
    assert np.degrees(found[3:5]) == pytest.approx([0.3, 1.0], abs=0.12)
    assert np.degrees(np.sqrt(np.diag(covariance)[3:5])).max() < 0.15
    assert np.linalg.norm(places.positions - truth, axis=1).mean() < np.linalg.norm(surveyed - truth, axis=1).mean()


def test_a_survey_of_thirty_centimetres_is_halved_on_fifteen_metres() -> None:
    rng, before, after = np.random.default_rng(7), [], []
    camera = make_camera("front")
    for _ in range(12):
        truth = row_of_lights(5)
        places = LightPlaces(["front"], PlaceConfig())
        fill(places, truth + rng.normal(0, 0.3, truth.shape))
        before.append(np.linalg.norm(places.positions - truth, axis=1).mean())
        for step in range(25, 41):
            pose = pose_at(float(step), step * 100_000_000)
            boxes = boxes_of(truth, camera, pose) + rng.normal(0, 0.8, (5, 4))
            places.observe(np.arange(5), boxes, camera, pose)
            places.settle(pose.stamp_ns)
        after.append(np.linalg.norm(places.positions - truth, axis=1).mean())
    assert np.mean(after) <= 0.55 * np.mean(before)


def test_an_unmapped_light_gets_its_depth_from_parallax_not_from_its_size_alone() -> None:
    """The real head is 8 % higher than its type: by size alone it stands 3.2 m too near at 40 m."""
    camera, truth = make_camera("front"), ORIGIN + np.array([[70.0, 6.0, 7.0]])
    places = LightPlaces(["front"], PlaceConfig())
    rows = fill(places, truth - np.array([[5.2, 0.4, 0.4]]), on_map=False)
    error_m = {}
    for step in range(58):
        pose = pose_at(float(step), step * 100_000_000)
        places.observe(rows, boxes_of(truth, camera, pose, SIZE * 1.08), camera, pose)
        places.settle(pose.stamp_ns)
        error = (places.positions - truth)[0]
        error_m[step] = float(np.linalg.norm(error))
        assert error @ np.linalg.inv(places.covariances[0]) @ error < 9, "within three standard deviations"
    assert error_m[30] < 2.0, "at 40 m"
    assert error_m[57] < 0.5, "at 13 m, by size alone 1 m"


def test_a_standing_vehicle_learns_little() -> None:
    camera, truth = make_camera("front"), row_of_lights()
    places = LightPlaces(["front"], PlaceConfig())
    rows = fill(places, truth)
    pose = pose_at(20.0, 0)
    places.observe(rows, boxes_of(truth, camera, pose), camera, pose)
    places.settle(0)
    once = np.trace(places.covariances, axis1=1, axis2=2)
    for i in range(1, 20):
        now = Pose(i * 300_000_000, pose.position, pose.quaternion_xyzw)
        places.observe(rows, boxes_of(truth, camera, now), camera, now)
        places.settle(now.stamp_ns)
    assert (np.trace(places.covariances, axis1=1, axis2=2) > 0.6 * once).all()


def test_where_little_is_new_images_are_passed_over() -> None:
    """Standing for four seconds at ten sets a second, and driving for two: all the while a light may be new."""
    camera, truth = make_camera("front"), row_of_lights()
    places = LightPlaces(["front"], PlaceConfig(least_news=0.1, decorrelation_s=5.0, every_s=0.25, decorrelation_m=2.0))
    rows, told = fill(places, truth), []
    for i in range(60):
        pose = pose_at(20.0 + max(0, i - 40) * 1.0, i * 100_000_000)
        mine = rows if i >= 5 else rows[:-1]
        before = places._information.copy()
        places.observe(mine, boxes_of(truth, camera, pose)[: len(mine)], camera, pose)
        told.append(np.flatnonzero((places._information != before).any(axis=(1, 2))).tolist())
    every = rows.tolist()
    expected = {0: every[:-1], 5: [every[-1]]} | dict.fromkeys([11, 22, 33, 41, 44, 47, 50, 53, 56, 59], every)
    assert {i: told[i] for i in range(60) if told[i]} == expected


def test_a_camera_that_is_due_takes_the_others_along() -> None:
    cameras = [make_camera("narrow"), make_camera("wide", 690.0)]
    truth = row_of_lights()
    places = LightPlaces(["narrow", "wide"], PlaceConfig())
    rows = fill(places, truth)
    together = np.concatenate([rows, rows]), np.repeat([0, 1], len(rows))

    def observe(i: int, step: slice) -> None:
        pose = pose_at(2.0 * i, i * 100_000_000)
        shots = Shots.of(cameras[step], [pose] * len(cameras[step]))
        boxes = np.concatenate([boxes_of(truth, camera, pose) for camera in cameras[step]])
        places.observe_set(together[0][: len(boxes)], boxes, shots, together[1][: len(boxes)])

    observe(0, slice(0, 2))
    observe(3, slice(1, 2))  # the wide one alone: it will not be due at 4
    observe(4, slice(0, 2))
    assert (places._last_ns == 400_000_000).all()


def swaying(t: float, sway_rad: float) -> Pose:
    """At 10 m/s ahead, the heading to and fro every four seconds."""
    half = sway_rad * np.sin(1.5 * t) / 2
    return Pose(round(t * 1e9), pose_at(10 * t, 0).position, np.array([0, 0, np.sin(half), np.cos(half)]))


def pass_by_with_delays(
    sway_rad: float, delays_s: dict[str, float], *, seed: int = 3, pose_m: float = 0.0, pose_deg: float = 0.0
) -> LightPlaces:
    """Sixteen seconds past three rows of lights; images are exposed so long after their stamps; poses have noise."""
    rng = np.random.default_rng(seed)
    cameras = {"narrow": make_camera("narrow"), "wide": make_camera("wide", 690.0)}
    truth = np.concatenate([row_of_lights() + np.array([50.0 * k, 0, 0]) for k in range(3)])
    places = LightPlaces(list(cameras), PlaceConfig())
    rows = fill(places, truth + rng.normal(0, 0.2, truth.shape))
    for t in np.arange(0, 16, 0.1):
        exact, ahead_m = swaying(t, sway_rad), truth[:, 0] - ORIGIN[0] - 10 * t
        tilt = np.append(np.radians(rng.normal(0, pose_deg, 3)) / 2, 0.0)
        given = Pose(exact.stamp_ns, exact.position + rng.normal(0, pose_m, 3), exact.quaternion_xyzw + tilt)
        for name, camera in cameras.items():
            boxes = boxes_of(truth, camera, swaying(t + delays_s[name], sway_rad)) + rng.normal(0, 0.8, (len(rows), 4))
            seen = (ahead_m > 8) & (ahead_m < 70) & ~np.isnan(boxes[:, 0])
            places.observe(rows[seen], boxes[seen], camera, given)
        places.settle(given.stamp_ns)
    return places


@pytest.mark.parametrize("late_s", [0.05, -0.05, 0.0])
def test_a_turn_tells_how_late_a_camera_is(late_s: float) -> None:
    places = pass_by_with_delays(0.15, {"narrow": late_s, "wide": 0.0})
    for name, truth_s in (("narrow", late_s), ("wide", 0.0)):
        delay_s, sigma_s = places.delay_s(name)
        assert delay_s == pytest.approx(truth_s, abs=3 * sigma_s)
        assert sigma_s < 0.003


@pytest.mark.parametrize("seed", range(3))
def test_noise_of_the_poses_does_not_pass_for_a_delay(seed: int) -> None:
    places = pass_by_with_delays(0.0, {"narrow": 0.0, "wide": 0.0}, seed=seed, pose_m=0.03, pose_deg=0.05)
    for name in ("narrow", "wide"):
        delay_s, sigma_s = places.delay_s(name)
        assert abs(delay_s) < max(2.5 * sigma_s, 0.01)


def test_straight_on_a_delay_is_hardly_told_from_errors_of_place() -> None:
    places = pass_by_with_delays(0.0, {"narrow": 0.05, "wide": 0.0})
    delay_s, sigma_s = places.delay_s("narrow")
    assert sigma_s > 0.008
    assert 0.02 < delay_s < 0.05


@pytest.mark.parametrize("edge", range(4), ids=["left", "top", "right", "bottom"])
def test_a_cut_box_says_nothing(edge: int) -> None:
    camera, pose = make_camera("front"), pose_at(20.0, 0)
    places = LightPlaces(["front"], PlaceConfig())
    rows = fill(places, row_of_lights(1))
    box = boxes_of(row_of_lights(1), camera, pose)
    box[0, edge] = 0.5 if edge < 2 else camera.size_wh[edge - 2] - 0.5
    places.observe(rows, box, camera, pose)
    places.settle(0)
    np.testing.assert_array_equal(places.positions, row_of_lights(1))


def test_a_half_hidden_head_does_little_harm() -> None:
    camera, truth = make_camera("front"), row_of_lights(3)
    clean, harmed = LightPlaces(["front"], PlaceConfig()), LightPlaces(["front"], PlaceConfig())
    for places in (clean, harmed):
        rows = fill(places, truth)
        for step in range(0, 30, 3):
            pose = pose_at(float(step), step * 100_000_000)
            boxes = boxes_of(truth, camera, pose)
            if places is harmed and step in (15, 18):
                boxes[0, 3] = (boxes[0, 1] + boxes[0, 3]) / 2
            places.observe(rows, boxes, camera, pose)
            places.settle(pose.stamp_ns)
    np.testing.assert_allclose(harmed.positions, clean.positions, atol=0.15)


def test_the_order_of_cameras_does_not_matter() -> None:
    rng, truth = np.random.default_rng(7), row_of_lights()
    cameras = {name: make_camera(name, focal) for name, focal in (("narrow", 1460.0), ("wide", 690.0))}
    one, other = (LightPlaces(list(cameras), PlaceConfig()) for _ in range(2))
    surveyed = truth + rng.normal(0, 0.2, truth.shape)
    for places in (one, other):
        fill(places, surveyed)
    for step in range(0, 30, 3):
        pose = pose_at(float(step), step * 100_000_000)
        found = {n: boxes_of(truth, c, pose) + rng.normal(0, 1, (len(truth), 4)) for n, c in cameras.items()}
        for places, order in ((one, ["narrow", "wide"]), (other, ["wide", "narrow"])):
            for name in order:
                places.observe(np.arange(len(truth)), found[name], cameras[name], pose)
            places.settle(pose.stamp_ns)
    np.testing.assert_allclose(one.positions, other.positions, atol=1e-9)
    np.testing.assert_allclose(one.covariances, other.covariances, atol=1e-12)


def test_what_a_forgotten_light_told_of_the_camera_stays() -> None:
    truth = row_of_lights()
    places = LightPlaces(["front"], PlaceConfig())
    fill(places, truth)
    turn = turned(np.radians([0.0, 0.5, 0.0]))
    drive(places, truth, {"front": (make_camera("front", turn=turn), make_camera("front"))}, 40)
    before, _ = places.shared_error("front")
    assert np.degrees(before[4]) == pytest.approx(0.5, abs=0.1)
    places.keep(np.array([2]))
    assert len(places) == 1
    fill(places, truth[:1])
    pose = pose_at(41.0, 4_100_000_000)
    places.observe(
        np.array([0]), boxes_of(truth[2:3], make_camera("front", turn=turn), pose), make_camera("front"), pose
    )
    places.settle(pose.stamp_ns)
    after, _ = places.shared_error("front")
    assert np.degrees(after[4]) == pytest.approx(float(np.degrees(before[4])), abs=0.05)


def test_saved_and_restored_it_goes_on_the_same() -> None:
    rng, truth, camera = np.random.default_rng(7), row_of_lights(), make_camera("front")
    one = LightPlaces(["front"], PlaceConfig())
    fill(one, truth + rng.normal(0, 0.2, truth.shape))
    drive(one, truth, {"front": (camera, camera)}, 20, edge_px=0.8, rng=rng)
    other = LightPlaces(["front"], PlaceConfig())
    other.restore(json.loads(json.dumps(one.to_json())))
    pose = pose_at(25.0, 2_500_000_000)
    for places in (one, other):
        places.observe(np.arange(4), boxes_of(truth, camera, pose), camera, pose)
        places.settle(pose.stamp_ns)
    np.testing.assert_array_equal(one.positions, other.positions)
    np.testing.assert_array_equal(one.covariances, other.covariances)
    with pytest.raises(ValueError, match="saved with cameras"):
        LightPlaces(["rear"], PlaceConfig()).restore(one.to_json())


def test_a_light_of_another_type_starts_anew() -> None:
    truth, camera = row_of_lights(2), make_camera("front")
    places = LightPlaces(["front"], PlaceConfig())
    fill(places, truth, on_map=False)
    drive(places, truth, {"front": (camera, camera)}, 30)
    sure = np.trace(places.covariances[0])
    places.restart(0, HEADING, SIZE * 1.3)
    assert np.trace(places.covariances[0]) > 1000 * sure
    assert np.trace(places.covariances[1]) < 10 * sure
    pose = pose_at(31.0, 3_100_000_000)
    places.observe(np.arange(2), boxes_of(truth, camera, pose, SIZE * 1.3), camera, pose)
    places.settle(pose.stamp_ns)
    assert np.linalg.norm(places.positions[0] - truth[0]) < 0.5


def test_knowledge_of_the_mounting_ages() -> None:
    truth, camera = row_of_lights(), make_camera("front")
    places = LightPlaces(["front"], PlaceConfig(drift_deg=0.1))
    fill(places, truth)
    drive(places, truth, {"front": (camera, camera)}, 40)
    places.settle(30_000_000_000)
    sharp = places._shared.information[4, 4]
    places._shared.age(3_630_000_000_000)
    start = np.radians(0.3) ** -2
    assert start * 0.99 < places._shared.information[4, 4] < sharp
