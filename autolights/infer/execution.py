"""How a model is run: by which library, on what, with how many threads."""

import os
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Literal, Self, TypeAlias

from pydantic import Field, model_validator

from autolights.core import Config, ModelInfo
from autolights.infer.session import OnnxSession, Session

Backend: TypeAlias = Literal["onnxruntime", "openvino", "tensorrt"]


class Execution(Config):
    """One way of running a model.

    Attributes:
        backend: ``onnxruntime``, ``openvino`` where that package is installed, or ``tensorrt`` for the engine that
            `autolights export --tensorrt` has built beside the model.
        providers: Of ONNX Runtime, in order of preference, by its own names; empty: the CPU.
        threads: All that detection may use on the CPU; null leaves the choice to the backend.
        streams: How many images of one `Detector.batch` are worked on at a time; they share the threads.
        spin_us: How long an idle thread of ONNX Runtime looks for work before it sleeps, microseconds. A little is
            faster on a quiet machine and slower beside other busy programs; see docs/inference.md.
        bfloat16: Let OpenVINO round to bfloat16 where the CPU is faster so; see `OpenVinoSession`.
    """

    backend: Backend = "onnxruntime"
    providers: tuple[str, ...] = ()
    threads: int | None = Field(default=None, ge=1)
    streams: int = Field(default=1, ge=1)
    spin_us: int = Field(default=0, ge=0, le=1000)
    bfloat16: bool = False

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.backend != "onnxruntime" and (self.providers or self.spin_us):
            raise ValueError("providers and spin_us are choices of the backend 'onnxruntime'")
        if self.backend != "openvino" and self.bfloat16:
            raise ValueError("bfloat16 is a choice of the backend 'openvino'")
        return self

    @classmethod
    def for_images(
        cls,
        images_at_once: int,
        *,
        backend: Backend = "onnxruntime",
        providers: Sequence[str] = (),
        threads: int | None = None,
    ) -> Self:
        """For sets of so many images: a CPU works on them side by side as far as it has threads.

        Two images of a nano at 640 x 416 took 0.7 of the time so, on 2 cores.
        """
        on_cpu = backend != "tensorrt" and not providers
        streams = max(min(images_at_once, threads or usable_cpus()), 1) if on_cpu else 1
        return cls(backend=backend, providers=tuple(providers), threads=threads, streams=streams)

    @property
    def threads_of_stream(self) -> int | None:
        """Threads of each of the streams; None leaves the choice to the backend."""
        if self.streams == 1:
            return self.threads
        return max((self.threads or usable_cpus()) // self.streams, 1)

    def __str__(self) -> str:
        """For tables: backend or provider, threads, streams."""
        where = self.providers[0].removesuffix("ExecutionProvider") if self.providers else self.backend
        words = [where + (" bfloat16" if self.bfloat16 else "")]
        if self.threads is not None:
            words.append(f"{self.threads} thread{'s' * (self.threads > 1)}")
        if self.streams > 1:
            words.append(f"{self.streams} streams")
        if self.spin_us:
            words.append(f"spin {self.spin_us} us")
        return ", ".join(words)


def usable_cpus() -> int:
    """Logical CPUs that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def openvino_is_installed() -> bool:
    """Whether the backend ``openvino`` can be chosen."""
    return find_spec("openvino") is not None


def open_session(
    model_path: Path, info: ModelInfo, execution: Execution, *, threads: int | None, sha256: str = ""
) -> Session:
    """Load a model, of the given hash if there is one; errors are those of the session's class."""
    if execution.backend == "openvino":
        from autolights.infer.openvino_session import OpenVinoSession

        return OpenVinoSession(model_path, info, sha256=sha256, threads=threads, bfloat16=execution.bfloat16)
    if execution.backend == "tensorrt":
        from autolights.infer.tensorrt_session import TensorRtSession

        return TensorRtSession(model_path, info, sha256=sha256)
    return OnnxSession(
        model_path,
        info,
        sha256=sha256,
        providers=execution.providers,
        threads=threads,
        spin_us=execution.spin_us,
        one_launch=execution.streams == 1,
    )
