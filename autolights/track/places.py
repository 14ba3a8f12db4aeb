"""Where the lights really stand: surveyed and unmapped ones, mounting and pose errors, estimated together.

Every box tells a direction and, through the housing's size, a depth. Both are off by errors w that all lights share (a
camera looks past its calibration, or later than it says, the vehicle stands beside its pose) and by errors x of the
light alone (its place in the map, its size). Lights know nothing of each other but through w. So the information matrix
of the whole problem is an arrow, and its exact solution costs one 4 × 4 inverse for each light:

    S = Λ_ww − Σ Λ_wi Λ_ii⁻¹ Λ_iw,   ŵ = S⁻¹ (η_w − Σ Λ_wi Λ_ii⁻¹ η_i),   x̂_i = Λ_ii⁻¹ (η_i − Λ_iw ŵ)

An angle that stays is an error of mounting, one that grows as the light comes nearer is the light's own place: it is
parallax that tells them apart, so a vehicle that stands learns little.

References:
    The paper's future work (Wu et al. 2023, Sec. VI): filtering of 3D positions. The arrow is that of bundle
    adjustment (Triggs et al. 2000, "Bundle Adjustment: A Modern Synthesis", Sec. 6).
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from autolights.core import BoolArray, CameraModel, FloatArray, IntArray, Pose
from autolights.core.boxes import cxcywh_columns
from autolights.core.light_box import light_corners
from autolights.core.shots import Shots
from autolights.track.box_measurement import CAMERA, LIGHT, POSE, box_variances, expected_boxes, measured_boxes
from autolights.track.keyframes import Keyframes, news
from autolights.track.motion import CameraMotion, Stand, rates
from autolights.track.place_config import PlaceConfig
from autolights.track.shared_errors import SharedErrors

_EDGE_PX = 2.0  # a box that ends this close to the image's edge may be cut by it
_HUBER = 3.0  # standard deviations from which an error counts linearly: half-hidden heads
_VAGUE_M = 100.0  # an unmapped light can be anywhere
_NEVER_NS = -(2**62)
_IDENTITY = np.eye(3)
_KNOWN_M = 3.0  # standard deviation of a place, mostly of its depth, that tells more than a single box does
_SETTLED_NS = 10_000_000_000  # a light unseen for so long has told all it has to tell of the shared errors
_COLUMNS = (
    "positions",
    "covariances",
    "_origins",
    "_housings",
    "_information",
    "_vectors",
    "_found",
    "_last_ns",
    "_last_places",
    "_active",
)


class LightPlaces:
    """Positions of n tracked lights, and the errors that all of them share.

    Args:
        cameras: Names; each has its own mounting error.
        config: Standard deviations.

    Attributes:
        positions: (n, 3) metres, map frame: the best estimates.
        covariances: (n, 3, 3) m² of them, what the shared errors leave open included.
    """

    def __init__(self, cameras: Sequence[str], config: PlaceConfig) -> None:
        self._config = config
        self._cameras = {name: number for number, name in enumerate(cameras)}
        c, size = len(self._cameras), LIGHT + POSE + CAMERA * len(self._cameras)
        self.positions: FloatArray = np.empty((0, 3))
        self.covariances: FloatArray = np.empty((0, 3, 3))
        self._origins: FloatArray = np.empty((0, 3))
        self._housings: FloatArray = np.empty((0, 8, 3))  # corners from the centre
        # What each light's boxes tell of itself and of the shared errors: its own part of the arrow.
        self._information: FloatArray = np.empty((0, size, size))
        self._vectors: FloatArray = np.empty((0, size))
        self._found: FloatArray = np.empty((0, LIGHT))
        self._last_ns: IntArray = np.empty((0, c), dtype=np.int64)
        self._last_places: FloatArray = np.empty((0, c, 3))
        self._active: BoolArray = np.empty(0, dtype=bool)
        self._keyframes, self._motion = Keyframes(c, config), CameraMotion(c)
        self._unsettled = False
        self._all_heard_until_ns = _NEVER_NS  # no light is silent for long before that
        self._shared = SharedErrors(c, config)

    def __len__(self) -> int:
        return len(self.positions)

    def shared_error(self, camera: str) -> tuple[FloatArray, FloatArray]:
        """The error that all lights of a camera share.

        Returns:
            (6,) metres east, north and up from the given pose to the true one, then radians about the camera's axes by
            which the world is seen turned; (6, 6) covariance.
        """
        mean, covariance = self._shared.of_camera(self._cameras[camera])
        return mean[:-1], covariance[:-1, :-1]

    def delay_s(self, camera: str) -> tuple[float, float]:
        """How long after their stamps a camera's images were exposed, and its standard deviation; seconds."""
        mean, covariance = self._shared.of_camera(self._cameras[camera])
        return float(mean[-1]), float(np.sqrt(covariance[-1, -1]))

    def known(self) -> BoolArray:
        """(n,) whether a place is known so well that a single box says nothing new of it."""
        return np.asarray(np.maximum.reduce(self.covariances.reshape(-1, 9)[:, ::4], axis=1) <= _KNOWN_M**2)

    def append(self, positions: FloatArray, headings_deg: FloatArray, sizes_m: FloatArray, *, on_map: bool) -> None:
        """Add lights.

        Args:
            positions: (m, 3) metres: the map's, or a first localisation, which only says where to begin.
            headings_deg: (m,) the way their faces look.
            sizes_m: (m, 3) width, height, depth of their types.
            on_map: Whether the positions are the map's.
        """
        m, size, prior = len(positions), self._vectors.shape[1], self._prior(on_map=on_map)
        information = np.zeros((m, size, size))
        information[:, :LIGHT, :LIGHT] = prior
        rows = {
            "positions": positions,
            "covariances": (_IDENTITY / prior[0, 0])[None].repeat(m, axis=0),
            "_origins": positions,
            "_housings": light_corners(np.zeros((m, 3)), headings_deg, sizes_m),
            "_information": information,
            "_vectors": np.zeros((m, size)),
            "_found": np.zeros((m, LIGHT)),
            "_last_ns": np.full((m, len(self._cameras)), _NEVER_NS),
            "_last_places": np.zeros((m, len(self._cameras), 3)),
            "_active": np.zeros(m, dtype=bool),
        }
        for name, values in rows.items():
            setattr(self, name, np.concatenate([getattr(self, name), values]))

    def keep(self, rows: IntArray) -> None:
        """Forget all lights but these; what the others told of the shared errors stays."""
        gone = self._active.copy()
        gone[rows] = False
        self._close(np.flatnonzero(gone))
        for name in _COLUMNS:
            setattr(self, name, getattr(self, name)[rows])

    def observe(self, rows: IntArray, boxes_xyxy: FloatArray, camera: CameraModel, pose: Pose) -> None:
        """Take in the boxes of one image; `settle` draws the conclusions.

        A box that the image's edge cuts says nothing: neither its centre nor its height is the light's.

        Args:
            rows: (m,) lights, each once.
            boxes_xyxy: (m, 4) pixels, edge coordinates, of their detections.
            camera: One of the cameras.
            pose: The vehicle's at the image's stamp.
        """
        self.observe_set(rows, boxes_xyxy, Shots.of([camera], [pose]), np.zeros(len(rows), dtype=np.int64))

    def observe_set(self, rows: IntArray, boxes_xyxy: FloatArray, shots: Shots, images: IntArray) -> None:
        """`observe` for several images at once.

        Args:
            rows: (m,) lights, in one image each once.
            boxes_xyxy: (m, 4) pixels, edge coordinates, of their detections.
            shots: The images.
            images: (m,) which image each box lies in, ascending.
        """
        numbers = np.array([self._cameras[camera.name] for camera in shots.optics.cameras])
        before = self._motion.follow(shots, numbers.tolist())
        due = self._due(rows, shots, images, numbers).nonzero()[0]
        if not len(due):
            return
        within = shots.optics.size_wh.T.take(images.take(due), axis=0) - _EDGE_PX
        boxes_xyxy = boxes_xyxy.take(due, axis=0)
        inside = (boxes_xyxy[:, :2] >= _EDGE_PX) & (boxes_xyxy[:, 2:] <= within)
        whole = (inside[:, 0] & inside[:, 1]).nonzero()[0]
        if not len(whole):
            return
        due = due.take(whole)
        rows, boxes, images = rows.take(due), cxcywh_columns(boxes_xyxy.take(whole, axis=0)), images.take(due)
        expected, jacobian, depths_m = self._expected(rows, shots, images, numbers, before)
        variances = box_variances(boxes[3], depths_m, shots, images, self._config)
        difference = measured_boxes(boxes, shots, images) - expected
        of_place, of_shared = jacobian[..., :3], jacobian[..., LIGHT:]
        doubt = ((of_place @ self.covariances.take(rows, axis=0)) * of_place).sum(axis=-1)
        doubt += ((of_shared @ self._shared.covariance) * of_shared).sum(axis=-1)
        surprise = np.sqrt((difference**2 / (variances + doubt)).sum(axis=1))
        fresh = self._news(rows, numbers.take(images), shots, images)
        weights = fresh * np.minimum(1.0, _HUBER / np.maximum(surprise, 1e-9))

        # Linear in the unknowns themselves, not in their changes: z − h(x̂) + J x̂ = J x + noise.
        found = self._found.take(rows, axis=0)
        told = difference + (jacobian[..., :LIGHT] @ found[..., None])[..., 0] + of_shared @ self._shared.mean
        scaled = (jacobian * (weights[:, None] / variances)[..., None]).swapaxes(1, 2)
        information, vectors = scaled @ jacobian, (scaled @ told[..., None])[..., 0]
        bounds = images.searchsorted(range(len(shots) + 1)).tolist()
        for image, number in enumerate(numbers.tolist()):  # of two images, a light gets what both tell
            here = slice(bounds[image], bounds[image + 1])
            mine = rows[here]
            self._information[mine] += information[here]
            self._vectors[mine] += vectors[here]
            self._last_ns[mine, number] = stamp_ns = shots.poses[image].stamp_ns
            self._all_heard_until_ns = min(self._all_heard_until_ns, stamp_ns + _SETTLED_NS)
            self._last_places[mine, number] = shots.vehicle[image]
        self._active[rows] = True
        self._unsettled = True

    def restart(self, row: int, heading_deg: float, size_m: FloatArray) -> None:
        """Forget what boxes told of an unmapped light: it is of another type, and its size is another one."""
        self._close(np.array([row]) if self._active[row] else np.empty(0, dtype=np.int64))
        fresh = LightPlaces(list(self._cameras), self._config)
        fresh.append(self.positions[row : row + 1], np.array([heading_deg]), size_m[None], on_map=False)
        for name in _COLUMNS:
            getattr(self, name)[row] = getattr(fresh, name)[0]

    def merge(self, row: int, other: int) -> None:
        """Let a light take over what boxes told of an unmapped one that is the same; the other is left empty.

        What was known of the other before anything was seen is taken off, so that it counts once.
        """
        prior = self._prior(on_map=False)
        shift = self._origins[other] - self._origins[row]
        information = self._information[other].copy()
        information[:LIGHT, :LIGHT] -= prior
        self._information[row] += information
        self._vectors[row] += self._vectors[other] + information[:, :3] @ shift
        later = self._last_ns[other] > self._last_ns[row]
        self._last_places[row, later] = self._last_places[other, later]
        self._last_ns[row] = np.maximum(self._last_ns[row], self._last_ns[other])
        self._information[other], self._vectors[other] = 0.0, 0.0
        self._information[other, :LIGHT, :LIGHT] = prior
        self._active[row], self._active[other] = True, False
        self._unsettled, self._all_heard_until_ns = True, _NEVER_NS

    def settle(self, stamp_ns: int) -> None:
        """Find the most probable positions and shared errors after all that was observed so far."""
        if self._unsettled:
            self._solve(self._active.nonzero()[0])
            self._unsettled = False
        if stamp_ns > self._all_heard_until_ns:
            self._close_silent(stamp_ns)

    def to_json(self) -> dict[str, Any]:
        """All that is remembered, as JSON-ready values."""
        return {
            "cameras": list(self._cameras),
            "lights": {name: getattr(self, name).tolist() for name in _COLUMNS},
            "shared": self._shared.to_json(),
            "keyframes": self._keyframes.to_json(),
            "motion": self._motion.to_json(),
            "unsettled": self._unsettled,
        }

    def restore(self, values: dict[str, Any]) -> None:
        """Go on from where `to_json` left off.

        Raises:
            ValueError: If it is of other cameras, or an array has another shape.
        """
        if values["cameras"] != list(self._cameras):
            raise ValueError(f"places were saved with cameras {values['cameras']}, not {list(self._cameras)}")
        n = len(values["lights"]["positions"])
        columns = {}
        for name in _COLUMNS:
            ours = getattr(self, name)
            columns[name] = np.array(values["lights"][name], dtype=ours.dtype).reshape(n, *ours.shape[1:])
        self._shared.restore(values["shared"])
        for name, column in columns.items():
            setattr(self, name, column)
        self._keyframes.restore(values["keyframes"])
        self._motion.restore(values["motion"])
        self._unsettled, self._all_heard_until_ns = bool(values["unsettled"]), _NEVER_NS

    def _prior(self, *, on_map: bool) -> FloatArray:
        """(4, 4) information about a light before anything is seen of it."""
        sigma_m = self._config.map_m if on_map else _VAGUE_M
        return np.diag(np.append(np.full(3, sigma_m**-2.0), self._config.size_share**-2.0))

    def _solve(self, rows: IntArray) -> None:
        inverse, ahead, information, vectors = self._eliminated(rows)
        self._shared.solve(information.sum(axis=0), vectors.sum(axis=0))
        self._found[rows] = (inverse @ self._vectors[rows, :LIGHT, None])[..., 0] - ahead @ self._shared.mean
        # What was given out before stays as it was.
        self.positions, self.covariances = self.positions.copy(), self.covariances.copy()
        self.positions[rows] = self._origins[rows] + self._found[rows, :3]
        self.covariances[rows] = (inverse + ahead @ self._shared.covariance @ ahead.swapaxes(1, 2))[:, :3, :3]

    def _eliminated(self, rows: IntArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Λ_ii⁻¹ and Λ_ii⁻¹ Λ_iw of each light, and what it tells of the shared errors alone (Schur complement)."""
        information, vectors = self._information[rows], self._vectors[rows]
        inverse = np.linalg.inv(information[:, :LIGHT, :LIGHT])
        cross = information[:, :LIGHT, LIGHT:]
        ahead = inverse @ cross
        back = ahead.swapaxes(1, 2)
        return (
            inverse,
            ahead,
            information[:, LIGHT:, LIGHT:] - back @ cross,
            vectors[:, LIGHT:] - (back @ vectors[:, :LIGHT, None])[..., 0],
        )

    def _close_silent(self, stamp_ns: int) -> None:
        """Close those that have not been seen for long, and note when the next one can be due."""
        rows = self._active.nonzero()[0]
        if not len(rows):
            return
        last_ns = np.maximum.reduce(self._last_ns, axis=1).take(rows)
        self._all_heard_until_ns = int(last_ns.min()) + _SETTLED_NS
        silent = rows[last_ns < stamp_ns - _SETTLED_NS]
        if len(silent):
            self._close(silent)
            self._shared.age(stamp_ns)

    def _close(self, rows: IntArray) -> None:
        """Turn what lights told into prior knowledge: of the shared errors, and of each light alone."""
        if not len(rows):
            return
        inverse, ahead, information, vectors = self._eliminated(rows)
        self._shared.keep(information.sum(axis=0), vectors.sum(axis=0))
        alone = np.linalg.inv(inverse + ahead @ self._shared.covariance @ ahead.swapaxes(1, 2))
        self._information[rows], self._vectors[rows] = 0.0, 0.0
        self._information[rows, :LIGHT, :LIGHT] = alone
        self._vectors[rows, :LIGHT] = (alone @ self._found[rows][..., None])[..., 0]
        self._active[rows] = False

    def _due(self, rows: IntArray, shots: Shots, images: IntArray, numbers: IntArray) -> BoolArray:
        """(m,) whether a box is taken in: all boxes of keyframes, and those of lights that are new to a camera."""
        if self._keyframes.take(shots, np.bincount(images).nonzero()[0].tolist(), numbers.tolist()):
            return np.ones(len(rows), dtype=bool)
        return np.asarray(self._last_ns.take(rows * len(self._cameras) + numbers.take(images)) == _NEVER_NS)

    def _expected(
        self, rows: IntArray, shots: Shots, images: IntArray, numbers: IntArray, before: list[tuple[Stand, ...]]
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """What `measured_boxes` should give, how it depends on the unknowns, and how far away the lights are.

        Args:
            rows: (m,) lights.
            shots: The images.
            images: (m,) which image each light is in.
            numbers: (s,) of the images' cameras.
            before: Of each image, the same camera's before (`CameraMotion.follow`).

        Returns:
            (m, 3) of `measured_boxes`; (m, 3, u) per unit of the unknowns; (m,) metres along the camera's axis.
        """
        velocities, turns = rates(before, shots)
        firsts = LIGHT + POSE + CAMERA * numbers  # column of each camera's first unknown
        of_cameras = self._shared.mean[firsts[:, None] - LIGHT + np.arange(CAMERA)]
        delays_s = of_cameras[:, 3:]
        angles = of_cameras[:, :3] - turns * delays_s
        # The world is seen turned by small angles w: q + w × q.
        turned = np.empty((len(angles), 3, 3))
        turned[:] = _IDENTITY
        turned[:, [2, 0, 1], [1, 2, 0]] += angles
        turned[:, [1, 2, 0], [2, 0, 1]] -= angles
        lenses = shots.lens + self._shared.mean[:POSE] + velocities * delays_s
        return expected_boxes(
            self.positions.take(rows, axis=0) - lenses.take(images, axis=0),
            self._housings.take(rows, axis=0) * np.exp(self._found.take(rows * LIGHT + 3))[:, None, None],
            (turned @ shots.cam_from_utm).take(images, axis=0),
            velocities.take(images, axis=0),
            turns.take(images, axis=0),
            firsts.take(images),
            self._vectors.shape[1],
        )

    def _news(self, rows: IntArray, numbers: IntArray, shots: Shots, images: IntArray) -> FloatArray:
        """(m,) how much of an independent observation each is, after the last of this light by this camera."""
        way = shots.vehicle.take(images, axis=0) - self._last_places[rows, numbers]
        stamps_ns = np.array([pose.stamp_ns for pose in shots.poses])
        elapsed_s = np.abs(stamps_ns.take(images) - self._last_ns[rows, numbers]) / 1e9
        return news(np.sqrt((way * way).sum(axis=1)), elapsed_s, self._config)
