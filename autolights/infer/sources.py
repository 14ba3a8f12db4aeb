"""Images from wherever users have them: files, folders, globs, videos and cameras, one after the other."""

import glob
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from autolights.core import ImageArray
from autolights.core.errors import UsageError
from autolights.core.image_files import IMAGE_ENDINGS
from autolights.infer.videos import camera_frames, frame_count, video_frames

VIDEO_ENDINGS = frozenset({".avi", ".m4v", ".mkv", ".mov", ".mp4", ".mpeg", ".mpg", ".webm"})


_CAMERA = re.compile(r"camera:(\d+)")


@dataclass(frozen=True, eq=False)
class SourceImage:
    """One image.

    Attributes:
        path: The file that it comes from, or ``camera:N``.
        frame: Its number in the video or since the camera was opened, from 0; None for a file that is an image.
        picture_name: A relative path without ending under which a result may be stored; unique among all images.
        image_bgr: (H, W, 3) uint8, turned upright where the file says how (EXIF).
    """

    path: Path
    frame: int | None
    picture_name: str
    image_bgr: ImageArray


class ImageSources:
    """Iterate over images; what cannot be decoded is left out and remembered.

    Args:
        inputs: Image or video files, folders (searched through, in alphabetical order), globs, or cameras as
            ``camera:0``.

    Attributes:
        paths: The files and cameras, each once.
        skipped: Files of which nothing decoded, and cameras that gave nothing, so far.
        bad_frames: How many frames of each video or camera did not decode, so far.

    Raises:
        UsageError: If an input does not exist, is of an unknown kind, or holds no image.
    """

    def __init__(self, inputs: Sequence[str | Path]) -> None:
        if not inputs:
            raise UsageError("no images given")
        self._names: dict[Path, str] = {}
        for given in inputs:
            for path, name in _expand(str(given)):
                if path not in self._names:
                    self._names[path] = _unused(name, set(self._names.values()))
        self.paths = tuple(self._names)
        self.skipped: list[Path] = []
        self.bad_frames: Counter[Path] = Counter()

    @property
    def live(self) -> bool:
        """Whether a camera is among them: it ends when it is told to."""
        return any(_camera(path) is not None for path in self.paths)

    @property
    def expected_images(self) -> int | None:
        """How many images there will be if all decode, for videos what their headers say; None with a camera."""
        return None if self.live else sum(frame_count(path) if _is_video(path) else 1 for path in self.paths)

    def __iter__(self) -> Iterator[SourceImage]:
        for path, name in self._names.items():
            camera = _camera(path)
            if camera is not None:
                yield from self._frames(path, name, camera_frames(camera))
            elif _is_video(path):
                yield from self._frames(path, name, video_frames(path))
            else:
                image = cv2.imread(str(path), cv2.IMREAD_COLOR)
                if image is None:
                    self.skipped.append(path)
                else:
                    yield SourceImage(path, None, name, np.asarray(image, dtype=np.uint8))

    def _frames(self, path: Path, name: str, frames: Iterator[ImageArray | None]) -> Iterator[SourceImage]:
        there = 0
        for number, image in enumerate(frames):
            if image is None:
                self.bad_frames[path] += 1
            else:
                there += 1
                yield SourceImage(path, number, f"{name}/{number:06d}", image)
        if not there:
            self.skipped.append(path)


def _expand(given: str) -> list[tuple[Path, str]]:
    """Files behind one input, each with the name of its picture."""
    path = Path(given)
    if _CAMERA.fullmatch(given):
        return [(path, given.replace(":", ""))]
    if path.is_dir():
        files = [file for file in sorted(path.rglob("*")) if _is_readable(file)]
        if not files:
            raise UsageError(f"{path}: no images or videos in this folder")
        return [(file, str(file.relative_to(path).with_suffix(""))) for file in files]
    if path.is_file():
        if not _is_readable(path):
            known = ", ".join(sorted(IMAGE_ENDINGS | VIDEO_ENDINGS))
            raise UsageError(f"{path}: neither an image nor a video by its ending; known: {known}")
        return [(path, path.stem)]
    matches = [Path(match) for match in sorted(glob.glob(given, recursive=True))]
    files = [match for match in matches if _is_readable(match)]
    if not files:
        raise UsageError(f"{given}: no such file or folder, and no image matches it as a pattern")
    return [(file, file.stem) for file in files]


def _camera(path: Path) -> int | None:
    """Number of the camera, None for files."""
    match = _CAMERA.fullmatch(str(path))
    return int(match[1]) if match else None


def _is_video(path: Path) -> bool:
    return path.suffix.lower() in VIDEO_ENDINGS


def _is_readable(path: Path) -> bool:
    return path.is_file() and path.suffix.lower() in IMAGE_ENDINGS | VIDEO_ENDINGS


def _unused(name: str, taken: set[str]) -> str:
    """The name, or with the first number behind it that makes it unique."""
    candidate, number = name, 2
    while candidate in taken:
        candidate, number = f"{name}_{number}", number + 1
    return candidate
