"""Parse an ONNX file and build a plan: the steps that TensorRT 10, 11 and their sibling for RTX cards share.

The library is a parameter, so that what a car's computer does with TensorRT is what the check does with the sibling.
Only the standard library is imported: the check starts a process for each build.
"""

from collections.abc import Callable, Sequence
from typing import Any


class RefusedModelError(Exception):
    """What parser or builder said."""


def build_plan(
    trt: Any,
    model: bytes,
    shapes: Sequence[Sequence[int]] | None,
    configure: Callable[[Any, Any], None],
    *,
    strongly_typed: bool = True,
) -> Any:
    """Build a serialised engine.

    Args:
        trt: The library.
        model: The ONNX file's bytes.
        shapes: Smallest, usual and largest input shape where some are free.
        configure: Gets the builder and its configuration before anything is built.
        strongly_typed: Keep to the types of the graph, as TensorRT 11 always does.

    Returns:
        The library's buffer of bytes.

    Raises:
        RefusedModelError: With the node's name if the parser refuses one.
    """

    class Logger(trt.ILogger):  # type: ignore[misc]
        def __init__(self) -> None:
            trt.ILogger.__init__(self)
            self.errors: list[str] = []

        def log(self, severity: Any, message: str) -> None:
            if severity in (trt.ILogger.ERROR, trt.ILogger.INTERNAL_ERROR):
                self.errors.append(message)

    logger = Logger()
    trt.init_libnvinfer_plugins(logger, "")
    builder = trt.Builder(logger)
    flag = getattr(trt.NetworkDefinitionCreationFlag, "STRONGLY_TYPED", None)  # 11 takes it and ignores it
    network = builder.create_network(1 << int(flag) if strongly_typed and flag is not None else 0)
    parser = trt.OnnxParser(network, logger)
    if not parser.parse(model):
        problem = parser.get_error(0)
        raise RefusedModelError(f"node '{problem.node_name()}' ({problem.node_operator()}): {problem.desc()}")
    config = builder.create_builder_config()
    config.profiling_verbosity = trt.ProfilingVerbosity.DETAILED  # or the inspector tells names alone
    if shapes is not None:
        profile = builder.create_optimization_profile()
        profile.set_shape(network.get_input(0).name, *map(tuple, shapes))
        config.add_optimization_profile(profile)
    configure(builder, config)
    plan = builder.build_serialized_network(network, config)
    if plan is None:
        raise RefusedModelError(logger.errors[0] if logger.errors else "no engine, and no reason given")
    return plan
