"""Two tracks, one light: which tracks were never two detections of one image, and hang in one place."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np
from pydantic import Field

from autolights.core import Config, FloatArray, TrafficLightMap
from autolights.track.observation import SetObservation
from autolights.track.place_book import PlaceBook

_MOST_PAIRS = 1000  # beyond it those of tracks that are gone are forgotten
_NEAR_HEIGHTS = 0.75  # lights whose boxes are farther apart than this in an image are two


class DuplicateConfig(Config):
    """When two tracks are taken for one light.

    Attributes:
        images: In so many images one of the two was detected and the other was not, though both should be in view; a
            single image that shows both keeps them apart for good.
        across_m: Seen from the vehicle their places are no farther aside of each other than this; heads hang at least
            a metre apart.
        along_m: Nor farther behind each other, where depth is not known better,
        sigmas: and by no more than so many standard deviations of the difference.
    """

    images: int = Field(default=10, ge=1)
    across_m: float = Field(default=0.4, gt=0)
    along_m: float = Field(default=3.0, gt=0)
    sigmas: float = Field(default=2.5, gt=0)


class Duplicates:
    """Finds tracks that are one light.

    Lights are named by keys: the row of the map, or −1 − track id.

    Args:
        lights: The map.
        config: Limits.
    """

    def __init__(self, lights: TrafficLightMap, config: DuplicateConfig) -> None:
        self._lights = lights
        self._config = config
        self._apart: set[tuple[int, int]] = set()
        self._alone: Counter[tuple[int, int]] = Counter()

    def take_in(self, observations: SetObservation, unmapped: TrafficLightMap) -> None:
        """Learn from one set of frames which lights that look like one were seen together, and which were not.

        Args:
            observations: The images.
            unmapped: The unmapped lights as the images were held against, track ids for names.
        """
        projected, images = observations.projected, observations.known_in
        mine = (projected.indices >= len(self._lights)).nonzero()[0]
        if not len(mine):
            return
        left, top, right, bottom = projected.boxes_xyxy.T
        across, down, limits = left + right, top + bottom, 2 * _NEAR_HEIGHTS * (bottom - top)  # all of them twice
        beside, below = across[mine, None] - across, down[mine, None] - down
        limits = np.minimum(limits[mine, None], limits)
        near = beside * beside + below * below <= limits * limits
        near &= images[mine, None] == images
        if np.count_nonzero(near) == len(mine):  # each with itself
            return
        near &= mine[:, None] > np.arange(len(projected))  # each pair once
        detected = np.zeros(len(projected), dtype=bool)
        detected[observations.association.matches[:, 0]] = True
        for i, other in np.argwhere(near).tolist():
            own = int(mine[i])
            pair = self._key(projected.indices[own], unmapped), self._key(projected.indices[other], unmapped)
            if detected[own] and detected[other]:
                self._apart.add(pair)
                self._alone.pop(pair, None)
            elif (detected[own] or detected[other]) and projected.expected[own] and projected.expected[other]:
                self._alone[pair] += pair not in self._apart
        if len(self._alone) + len(self._apart) > _MOST_PAIRS:
            living = {-1 - int(track) for track in unmapped.ids}
            self._forget(lambda key: key < 0 and key not in living)

    def found(self, places: PlaceBook, vehicle: FloatArray) -> Iterator[tuple[int, int]]:
        """Pairs that are one light, each light in one pair at most.

        Args:
            places: What is known of places.
            vehicle: (3,) metres: where the vehicle is.

        Yields:
            Key of an unmapped light and of the other one, mapped or unmapped.
        """
        taken: set[int] = set()
        for pair, count in list(self._alone.items()):
            if count < self._config.images or pair in self._apart or not taken.isdisjoint(pair):
                continue
            if self._in_one_place(pair, places, vehicle):
                taken.update(pair)
                yield pair

    def forget(self, key: int) -> None:
        """A light is no more, or is another one now."""
        self._forget(lambda other: other == key)

    def to_json(self) -> dict[str, Any]:
        """All that is remembered, as JSON-ready values."""
        return {
            "apart": [self._names(pair) for pair in sorted(self._apart)],
            "alone": [[*self._names(pair), count] for pair, count in self._alone.items()],
        }

    def restore(self, values: dict[str, Any]) -> None:
        """Remember what `to_json` gave.

        Raises:
            KeyError: If a light is not on the map.
            ValueError: If it is damaged.
        """
        row_of_id = {light_id: row for row, light_id in enumerate(self._lights.ids)}

        def pair(names: Iterable[Any]) -> tuple[int, int]:
            first, second = (row_of_id[name] if isinstance(name, str) else int(name) for name in names)
            return first, second

        self._apart = {pair(names) for names in values["apart"]}
        self._alone = Counter({pair(names): int(count) for *names, count in values["alone"]})

    def _in_one_place(self, pair: tuple[int, int], places: PlaceBook, vehicle: FloatArray) -> bool:
        known = [places.place_of(key) for key in pair]
        if known[0] is None or known[1] is None:
            return False
        (one, one_covariance), (other, other_covariance) = known[0], known[1]
        apart = one - other
        ray = (one + other) / 2 - vehicle
        ray = ray / max(float(np.linalg.norm(ray)), 1e-9)
        along_m = float(apart @ ray)
        across_m = float(np.linalg.norm(apart - along_m * ray))
        sigma_m = float(np.sqrt(ray @ (one_covariance + other_covariance) @ ray))
        limit_m = min(self._config.along_m, self._config.sigmas * sigma_m)
        return across_m <= self._config.across_m and abs(along_m) <= max(limit_m, self._config.across_m)

    def _key(self, index: int, unmapped: TrafficLightMap) -> int:
        count = len(self._lights)
        return int(index) if index < count else -1 - int(unmapped.ids[index - count])

    def _names(self, pair: tuple[int, int]) -> list[str | int]:
        return [self._lights.ids[key] if key >= 0 else key for key in pair]

    def _forget(self, gone: Callable[[int], bool]) -> None:
        self._apart = {pair for pair in self._apart if not (gone(pair[0]) or gone(pair[1]))}
        for pair in [pair for pair in self._alone if gone(pair[0]) or gone(pair[1])]:
            del self._alone[pair]
