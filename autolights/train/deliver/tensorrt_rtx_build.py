"""Build one ONNX file with TensorRT for RTX, in a process of its own: the library may end the process it runs in.

Called by `tensorrt_check` as ``python -m``, with the arguments of `build` as a JSON object; prints the result as one.
"""

import json
import sys
import time
from pathlib import Path
from typing import Any

from autolights.train.deliver.tensorrt_plan import RefusedModelError, build_plan


def build(model: str, compute_capability: str, shapes: list[list[int]] | None) -> dict[str, Any]:
    """Parse and build.

    Args:
        model: Path of the ONNX file.
        compute_capability: Like ``SM75``.
        shapes: Smallest, usual and largest input shape where some are free.

    Returns:
        ``bytes`` of the engine and ``seconds``, or ``error``.
    """
    import tensorrt_rtx as trt

    def configure(builder: Any, config: Any) -> None:
        if not hasattr(trt.ComputeCapability, compute_capability):
            known = [name for name in trt.ComputeCapability.__members__ if name.startswith("SM")]
            raise RefusedModelError(
                f"TensorRT for RTX {trt.__version__} builds for {', '.join(known)}, not for this one"
            )
        config.num_compute_capabilities = 1
        config.set_compute_capability(getattr(trt.ComputeCapability, compute_capability), 0)

    started = time.perf_counter()
    try:
        plan = build_plan(trt, Path(model).read_bytes(), shapes, configure)
    except RefusedModelError as error:
        return {"error": str(error)}
    return {"bytes": plan.nbytes, "seconds": time.perf_counter() - started}


if __name__ == "__main__":
    print(json.dumps(build(**json.loads(sys.argv[1]))))
