"""Images from wherever users have them: files, folders, globs, videos and cameras, one after the other."""

import glob
import re
import threading
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
        cameras: Whether a camera is welcome, which gives images until `stop`.

    Attributes:
        paths: The files and cameras, each once.
        skipped: Files of which nothing decoded, and cameras that gave nothing, so far.
        bad_frames: How many frames of each video, or gaps of a camera, did not decode, so far.
        missing_frames: How many frames of each video its header promises beyond those that came. Where the header only
            gives a length in time (WebM, Matroska) that is an estimate.
        lost: Cameras that fell silent without having been stopped.

    Raises:
        UsageError: If an input does not exist, is of an unknown kind, or holds no image, or if a camera is not welcome
            or not the only input.
    """

    def __init__(self, inputs: Sequence[str | Path], *, cameras: bool = False) -> None:
        if not inputs:
            raise UsageError("no images given")
        names = _Names()
        self._names: dict[Path, str] = {}
        for given in inputs:
            for path, name in _expand(str(given)):
                if path not in self._names:
                    self._names[path] = names.unused(name, folder=_is_video(path) or _camera(path) is not None)
        self.paths = tuple(self._names)
        if self.live and not cameras:
            raise UsageError("a camera has no end: give images or videos here")
        if self.live and len(self.paths) > 1:
            raise UsageError("a camera must be the only input: nothing comes after it")
        self.skipped: list[Path] = []
        self.bad_frames: Counter[Path] = Counter()
        self.missing_frames: Counter[Path] = Counter()
        self.lost: list[Path] = []
        self._stop = threading.Event()

    def stop(self) -> None:
        """Let the image at hand be the last one."""
        self._stop.set()

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
            if self._stop.is_set():
                return
            camera = _camera(path)
            if camera is not None:
                yield from self._frames(path, name, camera_frames(camera, self._stop))
                if not self._stop.is_set() and path not in self.skipped:
                    self.lost.append(path)
            elif _is_video(path):
                yield from self._frames(path, name, video_frames(path))
            else:
                image = _read_image(path)
                if image is None:
                    self.skipped.append(path)
                else:
                    yield SourceImage(path, None, name, image)

    def _frames(self, path: Path, name: str, frames: Iterator[ImageArray | None]) -> Iterator[SourceImage]:
        there = 0
        for number, image in enumerate(frames):
            if image is None:
                self.bad_frames[path] += 1
            else:
                there += 1
                yield SourceImage(path, number, f"{name}/{number:06d}", image)
            if self._stop.is_set():
                return
        if not there:
            self.skipped.append(path)
        elif _is_video(path):
            missing = frame_count(path) - there - self.bad_frames[path]
            if missing > 0:
                self.missing_frames[path] = missing


def _read_image(path: Path) -> ImageArray | None:
    """(H, W, 3) uint8, or None if it does not decode.

    Not `cv2.imread`: that fills what a truncated JPEG lacks with grey, and lights would be missed in it unnoticed.
    """
    try:
        image = cv2.imdecode(np.fromfile(path, dtype=np.uint8), cv2.IMREAD_COLOR)
    except (cv2.error, OSError):  # of no bytes, of absurd size, or not to be read
        return None
    return None if image is None else np.asarray(image, dtype=np.uint8)


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


class _Names:
    """Names for results of which no two meet: of images a file, of videos and cameras a folder of numbered files."""

    def __init__(self) -> None:
        self._taken: set[str] = set()
        self._video_folders: set[str] = set()
        self._image_folders: set[str] = set()
        self._next_number: Counter[str] = Counter()

    def unused(self, name: str, *, folder: bool) -> str:
        """The name, or with the first number behind it that makes it unique."""
        candidate = name
        while self._meets(candidate, folder):
            # Counting goes on where it stopped: a thousand cameras may each have a 000001.jpg.
            self._next_number[name] += 1
            candidate = f"{name}_{self._next_number[name] + 1}"
        self._taken.add(candidate)
        if folder:
            self._video_folders.add(candidate)
        else:
            self._image_folders.add(str(Path(candidate).parent))
        return candidate

    def _meets(self, name: str, folder: bool) -> bool:
        if name in self._taken:
            return True
        # Frames are called by their number alone, so an image beside them meets one only by a number.
        image = Path(name)
        return (
            name in self._image_folders if folder else str(image.parent) in self._video_folders and image.name.isdigit()
        )
