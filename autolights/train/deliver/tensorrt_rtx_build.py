"""Build one ONNX file with TensorRT for RTX, in a process of its own: the library may end the process it runs in.

Called by `tensorrt_check` as ``python -m``, with the arguments of `build` as a JSON object; prints the result as one.
"""

import json
import sys
import time
from typing import Any


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

    class Logger(trt.ILogger):  # type: ignore[misc]
        def __init__(self) -> None:
            trt.ILogger.__init__(self)
            self.errors: list[str] = []

        def log(self, severity: Any, message: str) -> None:
            if severity in (trt.ILogger.ERROR, trt.ILogger.INTERNAL_ERROR):
                self.errors.append(message)

    started = time.perf_counter()
    logger = Logger()
    builder = trt.Builder(logger)
    network = builder.create_network(1 << int(trt.NetworkDefinitionCreationFlag.STRONGLY_TYPED))
    parser = trt.OnnxParser(network, logger)
    if not parser.parse_from_file(model):
        problem = parser.get_error(0)
        return {"error": f"node '{problem.node_name()}' ({problem.node_operator()}): {problem.desc()}"}
    config = builder.create_builder_config()
    if shapes is not None:
        profile = builder.create_optimization_profile()
        profile.set_shape(network.get_input(0).name, *map(tuple, shapes))
        config.add_optimization_profile(profile)
    if not hasattr(trt.ComputeCapability, compute_capability):
        known = [name for name in trt.ComputeCapability.__members__ if name.startswith("SM")]
        return {"error": f"TensorRT for RTX {trt.__version__} builds for {', '.join(known)}, not for this one"}
    config.num_compute_capabilities = 1
    config.set_compute_capability(getattr(trt.ComputeCapability, compute_capability), 0)
    engine = builder.build_serialized_network(network, config)
    if engine is None:
        return {"error": logger.errors[0] if logger.errors else "no engine, and no reason given"}
    return {"bytes": engine.nbytes, "seconds": time.perf_counter() - started, "version": trt.__version__}


if __name__ == "__main__":
    print(json.dumps(build(**json.loads(sys.argv[1]))))
