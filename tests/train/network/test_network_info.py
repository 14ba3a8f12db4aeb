"""What `autolights info` tells; the figures themselves are checked where they are counted."""

import json

import pytest

from autolights.cli.info import info
from autolights.core.errors import UsageError
from autolights.core.model_info import InitialWeights
from autolights.train import YoloV5, describe_network
from autolights.train.network.checkpoint import Checkpoint


def test_a_bare_size_is_the_published_network(capsys):
    info("n")

    assert capsys.readouterr().out.splitlines() == [
        "network     YOLOv5n, 80 classes",
        "parameters  1,872,157 (1,867,405 with batch norms folded in)",
        "cost        4.56 GFLOPs at 640x640",
        "stride 8    anchors 10x13  16x30  33x23 px",
        "stride 16   anchors 30x61  62x45  59x119 px",
        "stride 32   anchors 116x90  156x198  373x326 px",
    ]


def test_a_checkpoint_tells_its_origin_and_figures(tmp_path, capsys):
    model = YoloV5("n", 2, ("red", "green"), strides=(8, 16, 32, 4))
    origin = InitialWeights(name="yolov5n.pt", sha256="0" * 64, licence="AGPL-3.0")
    metrics = {"ap": 0.41, "ap50": None}
    state = dict(model.state_dict())
    Checkpoint("n", model.classes, state, origin, 7, metrics, strides=model.strides).save(tmp_path / "best.pt")

    info(str(tmp_path / "best.pt"), input_size="320x192")
    text = capsys.readouterr().out
    info(str(tmp_path / "best.pt"), input_size="320x192", as_json=True)
    values = json.loads(capsys.readouterr().out)

    assert "GFLOPs at 320x192" in text
    assert "stride 4    anchors" in text
    assert text.endswith(
        "classes     red, green\nstarted     from yolov5n.pt, AGPL-3.0\ntrained     7 epochs; ap 0.410\n"
    )
    assert (values["strides"], values["metrics"], values["initial_weights"]["licence"]) == (
        [8, 16, 32, 4],
        metrics,
        "AGPL-3.0",
    )


def test_the_shipped_checkpoint_has_a_name():
    assert len(describe_network("base", input_wh=(64, 64)).classes) == 13


@pytest.mark.parametrize(("source", "size", "message"), [
    pytest.param("n", "640", r"--input must read WIDTHxHEIGHT in multiples of 32, .*'640'", id="no-cross"),
    pytest.param("n", "650x640", "--input must read WIDTHxHEIGHT in multiples of 32", id="no-multiple"),
    pytest.param("nowhere.pt", "640x640", r"nowhere\.pt: no such checkpoint", id="no-file"),
])  # fmt: skip
def test_wrong_requests_are_explained(source, size, message):
    with pytest.raises(UsageError, match=message):
        info(source, input_size=size)
