import struct
import time
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from autolights.core.errors import UsageError
from autolights.infer import ImageSources, videos
from autolights.infer.sources import _Names


def write_image(path, grey=100):
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.full((8, 12, 3), grey, dtype=np.uint8))


@pytest.fixture
def photos(tmp_path):
    """Two images, one of them in a subfolder, a broken one and a text."""
    write_image(tmp_path / "b.png", 20)
    write_image(tmp_path / "a" / "b.PNG", 10)
    (tmp_path / "c.jpg").write_bytes(b"not an image")
    (tmp_path / "notes.txt").write_text("not meant")
    return tmp_path


@pytest.fixture
def video(tmp_path):
    path = tmp_path / "drive.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 10, (64, 48))
    for grey in (10, 60, 110):
        writer.write(np.full((48, 64, 3), grey, dtype=np.uint8))
    writer.release()
    return path


def test_folder_in_order_with_what_does_not_decode_remembered(photos):
    sources = ImageSources([photos])

    images = list(sources)

    assert [(image.picture_name, image.frame, image.image_bgr[0, 0, 0]) for image in images] == [
        ("a/b", None, 10),
        ("b", None, 20),
    ]
    assert sources.skipped == [photos / "c.jpg"]
    assert sources.expected_images == 3


def test_glob_and_file_give_each_image_once(photos):
    sources = ImageSources([str(photos / "**" / "*.[pP]*"), photos / "b.png"])

    assert sources.paths == (photos / "a" / "b.PNG", photos / "b.png")


def test_equal_names_from_different_places_stay_apart(photos):
    images = ImageSources([photos / "a" / "b.PNG", photos / "b.png"])

    assert [image.picture_name for image in images] == ["b", "b_2"]


def test_video_frame_by_frame(video):
    sources = ImageSources([video])

    frames = list(sources)

    assert [(frame.path, frame.frame, frame.picture_name) for frame in frames] == [
        (video, i, f"drive/00000{i}") for i in range(3)
    ]
    np.testing.assert_allclose([frame.image_bgr.mean() for frame in frames], [10, 60, 110], atol=3)
    assert sources.expected_images == 3


def test_broken_video_is_skipped(tmp_path):
    path = tmp_path / "broken.avi"
    path.write_bytes(b"not a video")
    sources = ImageSources([path])

    assert list(sources) == []
    assert (sources.skipped, sources.expected_images) == ([path], 0)


class FakeCapture:
    """A camera or decoder that gives what it is told; None fails."""

    def __init__(self, greys):
        self.greys = list(greys)

    def isOpened(self):  # noqa: N802  (OpenCV's name)
        return bool(self.greys)

    def read(self):
        grey = self.greys.pop(0) if self.greys else None
        return (False, None) if grey is None else (True, np.full((4, 6, 3), grey, dtype=np.uint8))

    def get(self, _):
        return float(len(self.greys))

    def release(self):
        self.greys = []


def test_frames_after_bad_ones_are_read(monkeypatch, video):
    """A key frame may be hundreds of frames away."""
    monkeypatch.setattr(cv2, "VideoCapture", lambda _: FakeCapture([1, None, None, 4, *[None] * 400, 5]))
    sources = ImageSources([video])

    assert [(image.frame, image.image_bgr[0, 0, 0]) for image in sources] == [(0, 1), (3, 4), (404, 5)]
    assert (sources.bad_frames, sources.missing_frames, sources.skipped) == ({video: 402}, {}, [])


def write_video(path, codec, count=20):
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*codec), 10, (320, 240))
    noise = np.random.default_rng(0).integers(0, 255, (240, 320, 3), dtype=np.uint8)
    for shift in range(count):
        writer.write(np.roll(noise, 5 * shift, axis=1))
    writer.release()
    return bytearray(path.read_bytes())


def test_video_damaged_in_the_middle_is_read_to_its_end(tmp_path):
    path = tmp_path / "drive.mp4"
    data = write_video(path, "mp4v")
    middle = len(data) // 2
    data[middle : middle + len(data) // 8] = bytes(len(data) // 8)
    path.write_bytes(data)
    sources = ImageSources([path])

    numbers = [image.frame for image in sources]

    assert numbers[-1] == 19
    assert 0 < sources.bad_frames[path] == 20 - len(numbers)


def test_video_cut_short_tells_what_is_missing(tmp_path):
    path = tmp_path / "drive.avi"
    data = write_video(path, "MJPG")
    path.write_bytes(data[: len(data) // 2])
    sources = ImageSources([path])

    count = len(list(sources))

    assert 5 < count < 15
    assert sources.missing_frames == {path: 20 - count}


def jpeg(image, orientation=1):
    """A JPEG file with an EXIF tag."""
    tag = struct.pack("<HHIHH", 0x112, 3, 1, orientation, 0)
    exif = b"Exif\0\0II*\0" + struct.pack("<IH", 8, 1) + tag + bytes(4)
    data = cv2.imencode(".jpg", image)[1].tobytes()
    return data[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + data[2:]


def png_header(width, height):
    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + header + chunk(b"IDAT", zlib.compress(bytes(100))) + chunk(b"IEND", b"")


NOISE = np.random.default_rng(1).integers(0, 255, (30, 40, 3), dtype=np.uint8)


@pytest.mark.parametrize(
    ("name", "data"),
    [
        pytest.param("a.jpg", b"", id="empty"),
        pytest.param("a.jpg", jpeg(NOISE)[: len(jpeg(NOISE)) // 2], id="truncated"),
        pytest.param("a.png", png_header(100_000, 100_000), id="absurd-size"),
        pytest.param("a.png", png_header(4000, 4000), id="size-without-pixels"),
    ],
)
def test_damaged_image_is_skipped_and_the_next_one_read(tmp_path, name, data):
    (tmp_path / name).write_bytes(data)
    write_image(tmp_path / "b.png")
    sources = ImageSources([tmp_path])

    assert [image.picture_name for image in sources] == ["b"]
    assert sources.skipped == [tmp_path / name]


@pytest.mark.parametrize(
    "image", [np.full((8, 12), 70, np.uint8), np.full((8, 12, 4), 70, np.uint8), np.full((8, 12), 70 * 257, np.uint16)]
)
def test_grey_transparent_and_16_bit_images_become_bgr(tmp_path, image):
    cv2.imwrite(str(tmp_path / "a.png"), image)

    (source,) = ImageSources([tmp_path])

    assert (source.image_bgr.shape, source.image_bgr.dtype) == ((8, 12, 3), np.uint8)
    assert (source.image_bgr == 70).all()


def test_photo_is_turned_upright(tmp_path):
    image = np.zeros((16, 32, 3), dtype=np.uint8)
    image[:, :16] = 200  # stored on the left; turned by a quarter clockwise it is on top
    (tmp_path / "a.jpg").write_bytes(jpeg(image, orientation=6))

    (source,) = ImageSources([tmp_path])

    assert source.image_bgr.shape == (32, 16, 3)
    assert source.image_bgr[:14].mean() > 190 > 10 > source.image_bgr[18:].mean()


def test_video_is_turned_upright(tmp_path):
    path = tmp_path / "phone.mp4"
    data = write_video(path, "mp4v", count=2)
    straight, quarter_turn = (struct.pack(">9i", *matrix) for matrix in (
        (1 << 16, 0, 0, 0, 1 << 16, 0, 0, 0, 1 << 30), (0, 1 << 16, 0, -(1 << 16), 0, 0, 0, 0, 1 << 30)
    ))  # fmt: skip
    at = data.index(straight, data.index(b"tkhd"))
    data[at : at + 36] = quarter_turn
    path.write_bytes(data)

    assert {source.image_bgr.shape for source in ImageSources([path])} == {(320, 240, 3)}


def test_names_of_videos_and_images_never_meet(tmp_path, video):
    write_image(tmp_path / "drive" / "000000.png")
    for folder in ("x", "y", "z"):
        write_image(tmp_path / folder / "7.png")
    sources = ImageSources([tmp_path / "drive", tmp_path, *(tmp_path / folder / "7.png" for folder in "xyz")])

    names = [image.picture_name for image in sources]

    assert len(names) == len(set(names)) == 7
    assert "000000" in names
    assert "drive/000000" in names


def test_image_under_the_name_of_a_videos_frame(tmp_path, video):
    write_image(tmp_path / "other" / "drive" / "000000.png")
    sources = ImageSources([video, tmp_path / "other"])

    assert [image.picture_name for image in sources][-1] == "drive/000000_2"


def test_many_files_are_named_in_no_time(tmp_path):
    names = _Names()
    start = time.perf_counter()

    given = [names.unused("000001", folder=False) for _ in range(20_000)]

    assert len(set(given)) == 20_000
    assert time.perf_counter() - start < 10  # 0.1 s on an idle machine; comparing each with all others takes minutes


class FakeCamera:
    """A camera whose every opening gives the next list of greys and then nothing."""

    def __init__(self, *openings):
        self.openings = [list(greys) for greys in openings]
        self.greys = []

    def open(self, _index):
        self.greys = self.openings.pop(0) if self.openings else []
        return True

    def isOpened(self):  # noqa: N802  (OpenCV's name)
        return bool(self.greys)

    read, release = FakeCapture.read, FakeCapture.release


@pytest.fixture
def plug_in(monkeypatch):
    """Set what camera 2 gives, in hurried time."""

    def plug(*openings):
        camera = FakeCamera(*openings)
        monkeypatch.setattr(cv2, "VideoCapture", lambda index: camera.open(index) and camera)

    monkeypatch.setattr(videos, "_CAMERA_PATIENCE_S", 0.3)
    monkeypatch.setattr(videos, "_CAMERA_REOPEN_AFTER_S", 0.1)
    monkeypatch.setattr(videos, "_CAMERA_PAUSE_S", 0.01)
    return plug


CAMERA = Path("camera:2")


def test_camera_goes_on_after_a_gap_and_is_lost_when_it_falls_silent(plug_in):
    plug_in([7, None, None, 9])
    sources = ImageSources([CAMERA], cameras=True)

    images = list(sources)

    assert [(image.path, image.frame, image.picture_name) for image in images] == [
        (CAMERA, 0, "camera2/000000"),
        (CAMERA, 2, "camera2/000002"),
    ]
    assert (sources.live, sources.expected_images, sources.bad_frames) == (True, None, {CAMERA: 1})
    assert (sources.lost, sources.skipped) == ([CAMERA], [])


def test_camera_that_was_unplugged_is_opened_again(plug_in):
    plug_in([7], [9])
    sources = ImageSources([CAMERA], cameras=True)

    assert [image.image_bgr[0, 0, 0] for image in sources] == [7, 9]
    assert sources.bad_frames == {CAMERA: 1}


def test_camera_that_is_told_to_stop_is_not_lost(plug_in):
    plug_in([1, 2, 3])
    sources = ImageSources([CAMERA], cameras=True)

    seen = []
    for image in sources:
        seen.append(image.frame)
        sources.stop()

    assert (seen, sources.lost, sources.skipped) == ([0], [], [])


def test_camera_that_is_not_there_is_skipped(plug_in):
    plug_in()
    sources = ImageSources([CAMERA], cameras=True)

    assert list(sources) == []
    assert (sources.skipped, sources.lost) == ([CAMERA], [])


def test_camera_where_an_end_is_needed(video):
    with pytest.raises(UsageError, match="a camera has no end"):
        ImageSources([CAMERA])
    with pytest.raises(UsageError, match="must be the only input"):
        ImageSources([CAMERA, video], cameras=True)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        pytest.param("gone.jpg", r"gone\.jpg: no such file or folder, and no image matches", id="missing"),
        pytest.param("*.webp", r"\*\.webp: no such file or folder", id="pattern"),
        pytest.param("notes.txt", r"notes\.txt: neither an image nor a video by its ending; known: \.avi", id="text"),
        pytest.param("empty", r"empty: no images or videos in this folder", id="empty-folder"),
    ],
)
def test_what_cannot_be_meant(photos, name, message):
    (photos / "empty").mkdir()

    with pytest.raises(UsageError, match=message):
        ImageSources([photos / name])


def test_nothing_asked():
    with pytest.raises(UsageError, match="no images given"):
        ImageSources([])
