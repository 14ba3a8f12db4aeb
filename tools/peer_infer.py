"""The public YOLOv5's side of `bench_infer.py`: PyPI's `yolov5` in an interpreter of its own, never a dependency.

It exports a model with the package's own exporter, then times the package's own way from an image in memory to boxes
(letterbox, ONNX Runtime, suppression, as its `detect.py` calls them) whenever a line comes in on stdin.

    python peer_infer.py IMAGE.npy n yolov5n.pt THREADS FOLDER      # weights '-': random ones
"""

import contextlib
import functools
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import onnxruntime
import torch

# The package is older than torch's distrust of pickles and its new exporter, and asks ONNX Runtime for no number of
# threads: these settings stand in for arguments that it does not have.
torch.load = functools.partial(torch.load, weights_only=False)
torch.onnx.export = functools.partial(torch.onnx.export, dynamo=False)


def export(size: str, weights: str, folder: Path) -> Path:
    """Let the package write its ONNX file."""
    import yolov5
    from yolov5 import export as exporter
    from yolov5.models.yolo import Model

    path = folder / f"peer_{size}.pt"
    if weights == "-":
        torch.manual_seed(0)
        model = Model(Path(yolov5.__file__).parent / "models" / f"yolov5{size}.yaml", ch=3, nc=80)
        torch.save({"model": model.half(), "ema": None}, path)
    else:
        path.write_bytes(Path(weights).read_bytes())
    exporter.run(weights=path, imgsz=(640, 640), include=("onnx",))
    return path.with_suffix(".onnx")


def main() -> None:
    """Export, load, answer each line with milliseconds on the clock and of the CPUs, and boxes."""
    image_path, size, weights, threads, folder = sys.argv[1:]
    torch.set_num_threads(int(threads))
    cv2.setNumThreads(int(threads))
    answers = sys.stdout
    with contextlib.redirect_stdout(sys.stderr):
        path = export(size, weights, Path(folder))
        from yolov5.models.common import DetectMultiBackend
        from yolov5.utils.augmentations import letterbox
        from yolov5.utils.general import non_max_suppression, scale_boxes

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = int(threads)
        session_type = onnxruntime.InferenceSession
        onnxruntime.InferenceSession = functools.partial(session_type, sess_options=options)
        model = DetectMultiBackend(path, device=torch.device("cpu"))
        model.warmup(imgsz=(1, 3, 640, 640))
    image = np.load(image_path)

    def detect() -> int:
        blob = letterbox(image, 640, stride=32, auto=False)[0].transpose((2, 0, 1))[::-1]
        tensor = torch.from_numpy(np.ascontiguousarray(blob)).float()
        tensor /= 255
        found = non_max_suppression(model(tensor[None]), 0.25, 0.45)[0]
        if len(found):
            found[:, :4] = scale_boxes((640, 640), found[:, :4], image.shape).round()
        return len(found)

    detect()
    print("ready", file=answers, flush=True)
    for _ in sys.stdin:
        start, cpu_start = time.perf_counter(), time.process_time()
        count = detect()
        milliseconds, cpu_ms = 1e3 * (time.perf_counter() - start), 1e3 * (time.process_time() - cpu_start)
        print(milliseconds, cpu_ms, count, file=answers, flush=True)


if __name__ == "__main__":
    main()
