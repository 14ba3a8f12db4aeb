"""Where the lights really stand: surveyed and unmapped ones, mounting and pose errors, estimated together.

Every box tells a direction and, through the housing's size, a depth. Both are off by errors w that all lights share (a
camera looks past its calibration, the vehicle stands beside its pose) and by errors x of the light alone (its place in
the map, its size). Lights know nothing of each other but through w. So the information matrix of the whole problem is
an arrow, and its exact solution costs one 4 × 4 inverse for each light:

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
from pydantic import Field

from autolights.core import BoolArray, CameraModel, Config, FloatArray, IntArray, Pose
from autolights.core.boxes import cxcywh_columns
from autolights.core.light_box import light_corners
from autolights.core.shots import Shots

_EDGE_PX = 2.0  # a box that ends this close to the image's edge may be cut by it
_HUBER = 3.0  # standard deviations from which an error counts linearly: half-hidden heads
_VAGUE_M = 100.0  # an unmapped light can be anywhere
_NEVER_NS = -(2**62)
_SETTLED_S = 10.0  # a light that is not seen for so long has told all it has to tell of the shared errors
# Unknowns: of a light three metres and the logarithm of its size; shared are the pose's three metres, then the angles.
_LIGHT, _POSE = 4, 3
_NEAREST_M = 0.1
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


class PlaceConfig(Config):
    """What is known of all errors before anything is seen: standard deviations, per axis.

    Attributes:
        map_m: Of a light's place in the map.
        size_share: Of a housing's height against its type's, and of how tightly the detector draws boxes.
        box_px: Of a box's edges.
        box_share: The same in heights of the box; both add up as variances.
        rotation_deg: Of each camera's mounting.
        position_m: Of what is constant in the error of the poses.
        wander_deg: Of the vehicle's attitude, from place to place.
        wander_m: Of its position, from place to place.
        decorrelation_m: Errors of boxes and poses hang together over so many metres of way,
        decorrelation_s: or so many seconds where the vehicle stands.
        drift_deg: How far a mounting wanders in a minute.
        drift_m: How far the constant error of the poses wanders in a minute.
        every_s: Images of a camera that follow sooner say nothing new of a light's place.
        projected_sigmas: Lights of the map are looked for where the images showed them, but no farther from their place
            in the map than so many times `map_m`; 0 looks for them where the map has them.
    """

    map_m: float = Field(default=0.25, gt=0)
    size_share: float = Field(default=0.04, gt=0)
    box_px: float = Field(default=1.0, gt=0)
    box_share: float = Field(default=0.03, ge=0)
    rotation_deg: float = Field(default=0.3, gt=0)
    position_m: float = Field(default=0.05, gt=0)
    wander_deg: float = Field(default=0.1, ge=0)
    wander_m: float = Field(default=0.06, ge=0)
    decorrelation_m: float = Field(default=2.0, gt=0)
    decorrelation_s: float = Field(default=5.0, gt=0)
    drift_deg: float = Field(default=0.02, ge=0)
    drift_m: float = Field(default=0.05, ge=0)
    every_s: float = Field(default=0.25, ge=0)
    projected_sigmas: float = Field(default=1.5, ge=0)


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
        c, size = len(self._cameras), _LIGHT + _POSE + 3 * len(self._cameras)
        self.positions: FloatArray = np.empty((0, 3))
        self.covariances: FloatArray = np.empty((0, 3, 3))
        self._origins: FloatArray = np.empty((0, 3))
        self._housings: FloatArray = np.empty((0, 8, 3))  # corners from the centre
        # What each light's boxes tell of itself and of the shared errors: its own part of the arrow.
        self._information: FloatArray = np.empty((0, size, size))
        self._vectors: FloatArray = np.empty((0, size))
        self._found: FloatArray = np.empty((0, _LIGHT))
        self._last_ns: IntArray = np.empty((0, c), dtype=np.int64)
        self._last_places: FloatArray = np.empty((0, c, 3))
        self._active: BoolArray = np.empty(0, dtype=bool)
        self._camera_ns = [_NEVER_NS] * c
        self._unsettled = False
        sigmas = np.full(size - _LIGHT, np.radians(config.rotation_deg))
        sigmas[:_POSE] = config.position_m
        self._start_variances: FloatArray = sigmas**2
        self._shared_information: FloatArray = np.diag(1 / self._start_variances)
        self._shared_vector: FloatArray = np.zeros(len(sigmas))
        self._shared_ns: int | None = None
        self._shared: FloatArray = np.zeros(len(sigmas))
        self._shared_covariance: FloatArray = np.diag(self._start_variances)

    def __len__(self) -> int:
        return len(self.positions)

    def shared_error(self, camera: str) -> tuple[FloatArray, FloatArray]:
        """The error that all lights of a camera share.

        Returns:
            (6,) metres east, north and up from the given pose to the true one, then radians about the camera's axes by
            which the world is seen turned; (6, 6) covariance.
        """
        columns = self._columns(camera)
        return self._shared[columns], self._shared_covariance[np.ix_(columns, columns)]

    def append(self, positions: FloatArray, headings_deg: FloatArray, sizes_m: FloatArray, *, on_map: bool) -> None:
        """Add lights.

        Args:
            positions: (m, 3) metres: the map's, or a first localisation, which only says where to begin.
            headings_deg: (m,) the way their faces look.
            sizes_m: (m, 3) width, height, depth of their types.
            on_map: Whether the positions are the map's.
        """
        m, size = len(positions), self._vectors.shape[1]
        information = self._prior(on_map=on_map)
        variance = 1 / information[0, 0]
        rows = {
            "positions": positions,
            "covariances": np.tile(variance * np.eye(3), (m, 1, 1)),
            "_origins": positions,
            "_housings": light_corners(np.zeros((m, 3)), headings_deg, sizes_m),
            "_information": np.pad(np.tile(information, (m, 1, 1)), [(0, 0), (0, size - _LIGHT), (0, size - _LIGHT)]),
            "_vectors": np.zeros((m, size)),
            "_found": np.zeros((m, _LIGHT)),
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
        due = self._due(rows, shots, images, numbers.tolist())
        if not np.count_nonzero(due):
            return
        due &= (boxes_xyxy[:, :2] >= _EDGE_PX).all(axis=1)
        due &= (boxes_xyxy[:, 2:] <= shots.optics.size_wh.T.take(images, axis=0) - _EDGE_PX).all(axis=1)
        rows, boxes, images = rows[due], cxcywh_columns(boxes_xyxy[due]), images[due]
        expected, jacobian, depths_m = self._expected(rows, shots, images, numbers)
        variances = self._variances(boxes[3], depths_m, shots, images)
        difference = _measured(boxes, shots, images) - expected
        of_place, of_shared = jacobian[..., :3], jacobian[..., _LIGHT:]
        doubt = ((of_place @ self.covariances.take(rows, axis=0)) * of_place).sum(axis=-1)
        doubt += ((of_shared @ self._shared_covariance) * of_shared).sum(axis=-1)
        surprise = np.sqrt((difference**2 / (variances + doubt)).sum(axis=1))
        news = self._news(rows, numbers.take(images), shots, images)
        weights = news * np.minimum(1.0, _HUBER / np.maximum(surprise, 1e-9))

        # Linear in the unknowns themselves, not in their changes: z − h(x̂) + J x̂ = J x + noise.
        found = self._found.take(rows, axis=0)
        told = difference + (jacobian[..., :_LIGHT] @ found[..., None])[..., 0] + of_shared @ self._shared
        scaled = (jacobian * (weights[:, None] / variances)[..., None]).swapaxes(1, 2)
        information, vectors = scaled @ jacobian, (scaled @ told[..., None])[..., 0]
        bounds = np.searchsorted(images, range(len(shots) + 1)).tolist()
        for image, number in enumerate(numbers.tolist()):  # of two images, a light gets what both tell
            here = slice(bounds[image], bounds[image + 1])
            mine = rows[here]
            self._information[mine] += information[here]
            self._vectors[mine] += vectors[here]
            self._last_ns[mine, number] = shots.poses[image].stamp_ns
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
        information[:_LIGHT, :_LIGHT] -= prior
        self._information[row] += information
        self._vectors[row] += self._vectors[other] + information[:, :3] @ shift
        later = self._last_ns[other] > self._last_ns[row]
        self._last_places[row, later] = self._last_places[other, later]
        self._last_ns[row] = np.maximum(self._last_ns[row], self._last_ns[other])
        self._information[other], self._vectors[other] = 0.0, 0.0
        self._information[other, :_LIGHT, :_LIGHT] = prior
        self._active[row], self._active[other] = True, False
        self._unsettled = True

    def settle(self, stamp_ns: int) -> None:
        """Find the most probable positions and shared errors after all that was observed so far."""
        rows = self._active.nonzero()[0]
        if not len(rows):
            return
        if self._unsettled:
            self._solve(rows)
            self._unsettled = False
        silent = self._last_ns.max(axis=1).take(rows) < stamp_ns - _SETTLED_S * 1e9
        if np.count_nonzero(silent):
            self._close(rows[silent])
            self._let_drift(stamp_ns)

    def to_json(self) -> dict[str, Any]:
        """All that is remembered, as JSON-ready values."""
        shared = (self._shared_information, self._shared_vector, self._shared, self._shared_covariance)
        return {
            "cameras": list(self._cameras),
            "lights": {name: getattr(self, name).tolist() for name in _COLUMNS},
            "shared": [values.tolist() for values in shared],
            "shared_ns": self._shared_ns,
            "camera_ns": self._camera_ns,
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
        information, vector, shared, covariance = (np.array(array, dtype=np.float64) for array in values["shared"])
        if not (information.shape == covariance.shape == self._shared_information.shape):
            raise ValueError(f"shared errors must be {self._shared_information.shape}, got {information.shape}")
        for name, column in columns.items():
            setattr(self, name, column)
        self._shared_information, self._shared_vector = information, vector
        self._shared, self._shared_covariance = shared, covariance
        self._shared_ns, self._camera_ns = values["shared_ns"], list(values["camera_ns"])

    def _prior(self, *, on_map: bool) -> FloatArray:
        """(4, 4) information about a light before anything is seen of it."""
        sigma_m = self._config.map_m if on_map else _VAGUE_M
        return np.diag(np.append(np.full(3, sigma_m**-2.0), self._config.size_share**-2.0))

    def _solve(self, rows: IntArray) -> None:
        inverse, ahead, information, vectors = self._eliminated(rows)
        self._shared_covariance = np.linalg.inv(self._shared_information + information.sum(axis=0))
        self._shared = self._shared_covariance @ (self._shared_vector + vectors.sum(axis=0))
        self._found[rows] = (inverse @ self._vectors[rows, :_LIGHT, None])[..., 0] - ahead @ self._shared
        # What was given out before stays as it was.
        self.positions, self.covariances = self.positions.copy(), self.covariances.copy()
        self.positions[rows] = self._origins[rows] + self._found[rows, :3]
        self.covariances[rows] = (inverse + ahead @ self._shared_covariance @ ahead.swapaxes(1, 2))[:, :3, :3]

    def _eliminated(self, rows: IntArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Λ_ii⁻¹ and Λ_ii⁻¹ Λ_iw of each light, and what it tells of the shared errors alone (Schur complement)."""
        information, vectors = self._information[rows], self._vectors[rows]
        inverse = np.linalg.inv(information[:, :_LIGHT, :_LIGHT])
        cross = information[:, :_LIGHT, _LIGHT:]
        ahead = inverse @ cross
        back = ahead.swapaxes(1, 2)
        return (
            inverse,
            ahead,
            information[:, _LIGHT:, _LIGHT:] - back @ cross,
            vectors[:, _LIGHT:] - (back @ vectors[:, :_LIGHT, None])[..., 0],
        )

    def _close(self, rows: IntArray) -> None:
        """Turn what lights told into prior knowledge: of the shared errors, and of each light alone."""
        if not len(rows):
            return
        inverse, ahead, information, vectors = self._eliminated(rows)
        self._shared_information = self._shared_information + information.sum(axis=0)
        self._shared_vector = self._shared_vector + vectors.sum(axis=0)
        alone = np.linalg.inv(inverse + ahead @ self._shared_covariance @ ahead.swapaxes(1, 2))
        self._information[rows], self._vectors[rows] = 0.0, 0.0
        self._information[rows, :_LIGHT, :_LIGHT] = alone
        self._vectors[rows, :_LIGHT] = (alone @ self._found[rows][..., None])[..., 0]
        self._active[rows] = False

    def _let_drift(self, stamp_ns: int) -> None:
        """Let knowledge of the shared errors age; it never gets vaguer than it was at the start."""
        elapsed_s = 0.0 if self._shared_ns is None else max(stamp_ns - self._shared_ns, 0) / 1e9
        self._shared_ns = stamp_ns
        drift = np.full(len(self._shared), np.radians(self._config.drift_deg))
        drift[:_POSE] = self._config.drift_m
        covariance = np.linalg.inv(self._shared_information)
        mean = covariance @ self._shared_vector
        covariance = covariance + np.diag(drift**2 * elapsed_s / 60)
        shrink = np.sqrt(np.minimum(1.0, self._start_variances / np.diag(covariance)))
        self._shared_information = np.linalg.inv(covariance * np.outer(shrink, shrink))
        self._shared_vector = self._shared_information @ mean

    def _due(self, rows: IntArray, shots: Shots, images: IntArray, numbers: list[int]) -> BoolArray:
        """(m,) whether something new is told: of each camera now and then all, else what it has not told of before."""
        due = self._last_ns.take(rows * len(self._cameras) + np.array(numbers).take(images)) == _NEVER_NS
        for image in np.bincount(images).nonzero()[0].tolist():
            number, stamp_ns = numbers[image], shots.poses[image].stamp_ns
            if abs(stamp_ns - self._camera_ns[number]) >= self._config.every_s * 1e9:
                due |= images == image
                self._camera_ns[number] = stamp_ns
        return np.asarray(due)

    def _expected(
        self, rows: IntArray, shots: Shots, images: IntArray, numbers: IntArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """What `_measured` should give, how it depends on the unknowns, and how far away the lights are.

        Args:
            rows: (m,) lights.
            shots: The images.
            images: (m,) which image each light is in.
            numbers: (s,) of the images' cameras.

        Returns:
            (m, 3) of `_measured`; (m, 3, u) per unit of the unknowns; (m,) metres along the camera's axis.
        """
        m, every = len(rows), np.arange(len(rows))
        firsts = _LIGHT + _POSE + 3 * numbers  # column of each camera's first angle
        turns = self._shared[firsts[:, None] - _LIGHT + np.arange(3)]
        # The world is seen turned by small angles w: q + w × q.
        turned = np.broadcast_to(np.eye(3), (len(turns), 3, 3)).copy()
        turned[:, [2, 0, 1], [1, 2, 0]] += turns
        turned[:, [1, 2, 0], [2, 0, 1]] -= turns
        rotation = (turned @ shots.cam_from_utm).take(images, axis=0)
        rays = self.positions.take(rows, axis=0) - (shots.lens + self._shared[:_POSE]).take(images, axis=0)
        depths_m = np.maximum((rays * rotation[:, 2]).sum(axis=1), _NEAREST_M)
        swollen = self._housings.take(rows, axis=0) * np.exp(self._found.take(rows * _LIGHT + 3))[:, None, None]
        corners = ((rays[:, None] + swollen) @ rotation.swapaxes(1, 2)).transpose(2, 1, 0).copy()  # (3, 8, m)
        outline = corners[:2] / np.maximum(corners[2], _NEAREST_M)
        lows, highs = np.minimum.reduce(outline, axis=1), np.maximum.reduce(outline, axis=1)
        (x, y), height = (lows + highs) / 2, highs[1] - lows[1]
        expected = np.array([x, y, height]).T

        jacobian = np.zeros((m, 3, self._vectors.shape[1]))
        scaled = rotation / depths_m[:, None, None]
        jacobian[:, :2, :3] = scaled[:, :2]
        jacobian[..., :3] -= expected[..., None] * scaled[:, 2:]
        jacobian[:, 2, 3] = height
        jacobian[..., _LIGHT : _LIGHT + _POSE] = -jacobian[..., :3]
        # About the axes to the right, down and ahead.
        by_angles = np.array([[-x * y, 1 + x * x, -y], [-1 - y * y, x * y, x], [-height * y, height * x, 0 * x]])
        columns = firsts.take(images)[:, None] + np.arange(3)
        jacobian[every[:, None, None], np.arange(3)[:, None], columns[:, None]] = by_angles.transpose(2, 0, 1)
        return expected, jacobian, depths_m

    def _columns(self, camera: str) -> IntArray:
        """(6,) of the shared errors: the pose's, then the camera's."""
        start = _POSE + 3 * self._cameras[camera]
        return np.array([0, 1, 2, start, start + 1, start + 2])

    def _variances(self, heights_px: FloatArray, depths_m: FloatArray, shots: Shots, images: IntArray) -> FloatArray:
        """(m, 3) of directions and angular heights: edges of boxes, and the vehicle's wandering."""
        config = self._config
        focal_px = shots.optics.focal_px.take(images, axis=1)
        edges = config.box_px**2 + (config.box_share * heights_px) ** 2
        of_edges = edges / (focal_px * focal_px)
        wander = np.radians(config.wander_deg) ** 2 + (config.wander_m / depths_m) ** 2
        variances = np.empty((len(edges), 3))
        variances[:, :2] = (of_edges / 2 + wander).T
        variances[:, 2] = 2 * of_edges[1]
        return variances

    def _news(self, rows: IntArray, numbers: IntArray, shots: Shots, images: IntArray) -> FloatArray:
        """(m,) how much of an independent observation each is, (1 − ρ) / (1 + ρ) for a correlation ρ with the last."""
        way = shots.vehicle.take(images, axis=0) - self._last_places[rows, numbers]
        way_m = np.sqrt((way * way).sum(axis=1))
        stamps_ns = np.array([pose.stamp_ns for pose in shots.poses])
        elapsed_s = np.abs(stamps_ns.take(images) - self._last_ns[rows, numbers]) / 1e9
        # (1 − e^−u) / (1 + e^−u) = tanh(u / 2)
        return np.asarray(
            np.tanh((way_m / self._config.decorrelation_m + elapsed_s / self._config.decorrelation_s) / 2)
        )


def _measured(boxes: FloatArray, shots: Shots, images: IntArray) -> FloatArray:
    """(m, 3) x and y of each box's centre on the plane z = 1, and its height there; distortion is taken off.

    Args:
        boxes: (4, m) centres, widths and heights, pixels.
        shots: The images.
        images: (m,) which image each box lies in, ascending.
    """
    centres, halves = boxes[:2] - 0.5, boxes[2:] / 2  # points count from the centre of the top-left pixel
    points_px = centres[:, :, None] + halves[:, :, None] * _EDGE_MIDDLES[:, None]
    left, right, top, bottom = np.moveaxis(
        shots.back_project(points_px.reshape(2, -1), images.repeat(4)).reshape(2, -1, 4), 2, 0
    )
    measured = np.empty((boxes.shape[1], 3))
    measured[:, 0] = (left[0] + right[0]) / 2
    measured[:, 1] = (top[1] + bottom[1]) / 2
    measured[:, 2] = bottom[1] - top[1]
    return measured


_EDGE_MIDDLES = np.array([[-1.0, 1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 1.0]])  # of a box's left, right, top and bottom
