"""From the painted scene to the camera's picture: blur, exposure, colour cast, vignetting, noise."""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from autolights.core import FloatArray, ImageArray
from autolights.sim.config import SensorConfig


@dataclass(frozen=True)
class SensorState:
    """One draw of `SensorConfig`: fixed for an image, or for one camera over a drive.

    Attributes:
        exposure_ev: Stops.
        noise_grey: Standard deviation, grey levels.
        blur_px: Standard deviation.
        motion_px: Length of the shake; 0 for none.
        motion_deg: Its direction in the image.
        gains: Of blue, green and red.
        vignetting: Loss in the corners.
    """

    exposure_ev: float
    noise_grey: float
    blur_px: float
    motion_px: float
    motion_deg: float
    gains: tuple[float, float, float]
    vignetting: float


def draw_sensor(config: SensorConfig, noise_gain: float, rng: np.random.Generator) -> SensorState:
    """Draw a state; `noise_gain` comes from the light of the scene."""
    shaking = rng.uniform() < config.motion_blur_share
    motion = float(rng.uniform(*config.motion_blur_px))
    blue, green, red = (float(1 + rng.uniform(-config.cast, config.cast)) for _ in range(3))
    return SensorState(
        exposure_ev=float(rng.uniform(*config.exposure_ev)),
        noise_grey=float(rng.uniform(*config.noise_grey)) * noise_gain,
        blur_px=float(rng.uniform(*config.blur_px)),
        motion_px=motion if shaking else 0.0,
        motion_deg=float(rng.uniform(0, 180)),
        gains=(blue, green, red),
        vignetting=float(rng.uniform(*config.vignetting)),
    )


def expose(scene: ImageArray, state: SensorState, rng: np.random.Generator) -> ImageArray:
    """The picture that the sensor takes of a painted (H, W, 3) scene; the scene stays as it is."""
    image = cv2.GaussianBlur(scene, (0, 0), state.blur_px) if state.blur_px > 0.25 else scene
    if state.motion_px > 1:
        image = cv2.filter2D(image, -1, _shake(round(state.motion_px), round(state.motion_deg / 15) * 15))
    image = cv2.LUT(image, _response(state.exposure_ev, state.gains))
    height, width = image.shape[:2]
    image = cv2.multiply(image, _vignette(width, height, round(state.vignetting, 2)), scale=1 / 255)
    # A window of a stored noise picture: drawing fresh numbers for each pixel would take longer than all the rest.
    noise = _noise(width + 256, height + 256)
    x, y = int(rng.integers(256)), int(rng.integers(256))
    gain = state.noise_grey / _NOISE_GREY
    window = noise[y : y + height, x : x + width]
    return np.asarray(cv2.addWeighted(image, 1.0, window, gain, -128 * gain), dtype=np.uint8)


_NOISE_GREY = 30.0


@lru_cache(maxsize=2)
def _noise(width: int, height: int) -> ImageArray:
    """(height, width, 3) Gaussian noise about 128, partly common to the channels."""
    rng = np.random.default_rng(4_000)
    common, own = rng.normal(0, 0.8, (height, width, 1)), rng.normal(0, 0.6, (height, width, 3))
    return np.clip(128 + _NOISE_GREY * (common + own), 0, 255).round().astype(np.uint8)


@lru_cache(maxsize=64)
def _vignette(width: int, height: int, loss: float) -> ImageArray:
    across, down = np.linspace(-1, 1, width, dtype=np.float32), np.linspace(-1, 1, height, dtype=np.float32)
    falloff = 255 * (1 - loss * (np.add.outer(down * down, across * across) / 2) ** 1.3)
    return np.repeat(falloff.round().astype(np.uint8)[..., None], 3, axis=2)


@lru_cache(maxsize=64)
def _response(exposure_ev: float, gains: tuple[float, float, float]) -> ImageArray:
    levels = np.arange(256) / 255
    # Exposure acts on light, the picture holds its gamma-encoded value.
    light = levels**2.2 * 2**exposure_ev
    encoded = np.minimum(light, 1.0) ** (1 / 2.2)
    curves = [np.clip(255 * encoded * gain, 0, 255) for gain in gains]
    return np.stack(curves, axis=-1).round().astype(np.uint8).reshape(1, 256, 3)


@lru_cache(maxsize=64)
def _shake(length: int, angle_deg: int) -> FloatArray:
    kernel = np.zeros((2 * length + 1, 2 * length + 1), np.float32)
    reach = length / 2 * np.array([np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))])
    ends = [tuple(int(v) for v in np.round((length + s * reach) * 16)) for s in (-1, 1)]
    cv2.line(kernel, ends[0], ends[1], 1.0, 1, cv2.LINE_8, 4)
    return np.asarray(kernel / kernel.sum())
