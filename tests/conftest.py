"""A road with lights, two cameras on a moving vehicle, and a detector that is told what to see."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
import pytest
import scipy.linalg
from hypothesis import settings

from autolights.core import (
    CameraModel,
    Detections,
    FloatArray,
    HmmParameters,
    ImageArray,
    LightEstimate,
    Pose,
    PoseBuffer,
    SignalSet,
    TrafficLightMap,
    load_signals,
)
from autolights.core.light_box import light_corners, project_corners
from autolights.core.transforms import CAMERA_AXES_FROM_VEHICLE_AXES, invert_rigid, rigid
from autolights.pipeline import LightPipeline, PipelineConfig

# A busy machine makes any test slow now and then; that is no failure of the code.
settings.register_profile("no deadline", deadline=None)
settings.load_profile("no deadline")

ORIGIN = np.array([500_000.0, 4_800_000.0, 200.0])
# What a light shows the detector at a time in seconds: a class, class probabilities, or None if nothing is seen.
Script = Callable[[float], "str | dict[str, float] | None"]


def make_camera(name: str, fov_deg: float, max_range_m: float) -> CameraModel:
    focal = 640 / np.tan(np.radians(fov_deg / 2))
    return CameraModel(
        name=name,
        size_wh=(1280, 800),
        intrinsics=np.array([[focal, 0, 639.5], [0, focal, 399.5], [0, 0, 1]]),
        distortion=np.array([-0.08, 0.02, 0.0004, -0.0003]),
        cam_from_ins=rigid(CAMERA_AXES_FROM_VEHICLE_AXES, CAMERA_AXES_FROM_VEHICLE_AXES @ np.array([-0.6, 0.1, -1.1])),
        max_range_m=max_range_m,
    )


def make_hmm(signals: SignalSet, accuracy: float = 0.9) -> dict[str, HmmParameters]:
    hmm = {}
    for name in signals.types:
        states = signals.states_of(name)
        k = len(states)
        rates = signals.rates(name)
        observation = np.full((k, k), (1 - accuracy) / (k - 1))
        np.fill_diagonal(observation, accuracy)
        hmm[name] = HmmParameters(
            type=name,
            states=states,
            initial=np.full(k, 1 / k),
            rates=rates,
            nominal_dt_s=0.1,
            transition=scipy.linalg.expm(rates * 0.1).clip(min=0),
            observation=observation,
            evidence=observation.T,
            miss_probs=np.full(k, 0.1),
            counts=observation,
            provenance={},
        )
    return hmm


class Unused:
    """A detector that no test should reach."""

    def batch(self, images_bgr: Sequence[ImageArray]) -> list[Detections]:
        raise AssertionError("the scene computes detections itself")


@dataclass(frozen=True)
class Shot:
    camera: str
    stamp_ns: int


@dataclass
class Scene:
    """Lights at the end of a straight road that leads east; the vehicle drives towards them.

    `lights` maps a name to (type, offset from ORIGIN, script). The map holds them all but `off_map`, and `phantoms`.
    """

    signals: SignalSet
    lights: dict[str, tuple[str, tuple[float, float, float], Script]]
    off_map: frozenset[str] = frozenset()
    phantoms: dict[str, tuple[str, tuple[float, float, float]]] = field(default_factory=dict)
    cameras: tuple[str, ...] = ("narrow",)
    speed_mps: float = 5.0
    noise_px: float = 0.0
    accuracy: float = 0.98
    groups: bool = False  # all lights of the map belong to one signal group

    def __post_init__(self) -> None:
        rig = {"narrow": make_camera("narrow", 47.3, 64.0), "wide": make_camera("wide", 85.7, 40.0)}
        self.rig = {name: rig[name] for name in self.cameras}
        self.rng = np.random.default_rng(7)
        self.truth = self._map({name: (kind, at) for name, (kind, at, _) in self.lights.items()})
        held = {name: (kind, at) for name, (kind, at, _) in self.lights.items() if name not in self.off_map}
        self.map = self._map({**held, **self.phantoms})

    def _map(self, lights: dict[str, tuple[str, tuple[float, float, float]]]) -> TrafficLightMap:
        types = tuple(kind for kind, _ in lights.values())
        return TrafficLightMap(
            ids=tuple(lights),
            types=types,
            positions=np.array([ORIGIN + at for _, at in lights.values()]).reshape(-1, 3),
            headings_deg=np.full(len(lights), 270.0),
            sizes_m=self.signals.sizes_m(types),
            groups=("one",) * len(lights) if self.groups else (),
        )

    def pose(self, t: float) -> Pose:
        return Pose(round(t * 1e9), ORIGIN + np.array([self.speed_mps * t, 0.0, 0.5]), np.array([0.0, 0.0, 0.0, 1.0]))

    def pipeline(self, config: PipelineConfig | None = None) -> LightPipeline:
        poses = PoseBuffer(self.pose(t) for t in np.arange(0, 60, 0.1))
        return LightPipeline(Unused(), self.hmm, self.signals, self.rig, self.map, config, poses=poses)

    @property
    def hmm(self) -> dict[str, HmmParameters]:
        return make_hmm(self.signals, self.accuracy)

    def boxes(self, camera: str, t: float) -> FloatArray:
        corners = light_corners(self.truth.positions, self.truth.headings_deg, self.truth.sizes_m)
        cam = self.rig[camera]
        return project_corners(corners, cam, cam.cam_from_ins @ invert_rigid(self.pose(t).utm_from_ins))

    def detect(self, camera: str, t: float) -> Detections:
        boxes, probs = [], []
        for (_, _, script), box in zip(self.lights.values(), self.boxes(camera, t), strict=True):
            shown = script(t)
            if shown is None or np.isnan(box).any() or (box[:2] < 0).any() or (box[2:] > (1280, 800)).any():
                continue
            vector = np.full(len(self.signals.classes), 0.01)
            for name, probability in (shown if isinstance(shown, dict) else {shown: 0.9}).items():
                vector[self.signals.class_ids[name]] = probability
            boxes.append(box + self.rng.normal(0, self.noise_px, 4))
            probs.append(vector)
        n = len(boxes)
        return Detections(
            np.reshape(boxes, (n, 4)), np.full(n, 0.95), np.reshape(probs, (n, len(self.signals.classes)))
        )

    def step(self, pipeline: LightPipeline, t: float, cameras: Iterable[str] | None = None) -> list[LightEstimate]:
        names = list(self.rig if cameras is None else cameras)
        return pipeline.step_detections(self.shots(t, names), [self.detect(name, t) for name in names])

    def shots(self, t: float, cameras: Iterable[str] | None = None) -> list[Shot]:
        return [Shot(name, round(t * 1e9)) for name in (self.rig if cameras is None else cameras)]

    def drive(
        self, times: Iterable[float], config: PipelineConfig | None = None, cameras: Iterable[str] | None = None
    ) -> list[list[LightEstimate]]:
        pipeline = self.pipeline(config)
        cameras = None if cameras is None else list(cameras)
        return [self.step(pipeline, float(t), cameras) for t in times]


@pytest.fixture(scope="session")
def signals() -> SignalSet:
    return load_signals()


@pytest.fixture
def make_scene(signals: SignalSet) -> Callable[..., Scene]:
    def make(lights: dict[str, tuple[str, tuple[float, float, float], Script]], **settings: object) -> Scene:
        return Scene(**{"signals": signals, "lights": lights, **settings})  # type: ignore[arg-type]

    return make


@pytest.fixture(scope="session")
def hmm(signals: SignalSet) -> dict[str, HmmParameters]:
    return make_hmm(signals)


@pytest.fixture(scope="session")
def hmm_of() -> Callable[[SignalSet], dict[str, HmmParameters]]:
    return make_hmm
