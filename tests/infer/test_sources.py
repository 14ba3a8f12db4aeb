import cv2
import numpy as np
import pytest

from autolights.core.errors import UsageError
from autolights.infer import ImageSources, videos


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


def test_frames_after_a_bad_one_are_read(monkeypatch, video):
    monkeypatch.setattr(cv2, "VideoCapture", lambda _: FakeCapture([1, None, None, 4, *[None] * 40, 5]))
    sources = ImageSources([video])

    assert [(image.frame, image.image_bgr[0, 0, 0]) for image in sources] == [(0, 1), (3, 4)]
    assert (sources.bad_frames, sources.skipped) == ({video: 2}, [])


def test_damaged_video_is_read_on(video):
    """Bytes in the middle of the second frame are lost: OpenCV's decoder conceals or drops it, the third is there."""
    data = bytearray(video.read_bytes())
    middle = len(data) // 2
    data[middle : middle + 40] = bytes(40)
    video.write_bytes(data)

    frames = list(ImageSources([video]))

    assert len(frames) >= 2
    assert frames[-1].image_bgr.mean() == pytest.approx(110, abs=3)


def test_camera_until_it_falls_silent(monkeypatch):
    opened = []
    monkeypatch.setattr(videos, "_CAMERA_PATIENCE_S", 0.1)
    monkeypatch.setattr(cv2, "VideoCapture", lambda index: opened.append(index) or FakeCapture([7, None, 9]))
    sources = ImageSources(["camera:2"])

    images = list(sources)

    assert opened == [2]
    assert [(str(image.path), image.frame, image.picture_name) for image in images] == [
        ("camera:2", 0, "camera2/000000"),
        ("camera:2", 2, "camera2/000002"),
    ]
    assert (sources.live, sources.expected_images, sources.bad_frames.total()) == (True, None, 1)


def test_camera_that_is_not_there_is_skipped(monkeypatch):
    monkeypatch.setattr(cv2, "VideoCapture", lambda _: FakeCapture([]))
    sources = ImageSources(["camera:9"])

    assert list(sources) == []
    assert [str(path) for path in sources.skipped] == ["camera:9"]


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
