"""Stages of a long job: each is skipped when its result is there, unchanged, and made from the same inputs."""

import hashlib
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import autolights
from autolights.core.atomic import write_text
from autolights.core.progress import say


@dataclass(frozen=True)
class StageResult:
    """What is remembered of a stage that ran.

    Attributes:
        fingerprint: Hash of the stage's outputs; the inputs of later stages.
        minutes: How long it took when it ran.
    """

    fingerprint: str
    minutes: float


class Stages:
    """Runs stages in order and remembers them in `<root>/.stages`.

    Args:
        root: Folder of the job's results.
    """

    def __init__(self, root: Path) -> None:
        self._records = root / ".stages"
        self.results: dict[str, StageResult] = {}

    @property
    def known(self) -> bool:
        """Whether a stage of such a job has run in this folder."""
        return self._records.is_dir()

    @property
    def minutes(self) -> dict[str, float]:
        """Minutes of each stage so far, whenever it ran."""
        return {name: round(result.minutes, 2) for name, result in self.results.items()}

    def run(self, name: str, outputs: Sequence[Path], settings: Any, work: Callable[[], object]) -> None:
        """Run `work` unless its outputs are there and nothing that they depend on has changed.

        Args:
            name: Of the stage; also of its record.
            outputs: Files and folders that `work` makes; all must exist when it ends.
            settings: JSON-ready values that decide the result, beside the outputs of the stages before.
            work: Makes the outputs, replacing what is there.
        """
        key = self._key(name, settings)
        record_path = self._records / f"{name}.json"
        known = self._unchanged(record_path, key, outputs)
        if known is not None:
            say(f"[{name}] up to date ({known.minutes:.1f} min when it ran)")
            self.results[name] = known
            return
        say(f"[{name}] …")
        self._records.mkdir(parents=True, exist_ok=True)
        record_path.unlink(missing_ok=True)
        start = time.monotonic()
        work()
        result = StageResult(_fingerprint(outputs), (time.monotonic() - start) / 60)
        write_text(record_path, json.dumps({"key": key, **vars(result)}) + "\n")
        say(f"[{name}] done in {result.minutes:.1f} min")
        self.results[name] = result

    def _key(self, name: str, settings: Any) -> str:
        earlier = {stage: result.fingerprint for stage, result in self.results.items()}
        text = json.dumps([autolights.__version__, name, settings, earlier], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()

    def _unchanged(self, record_path: Path, key: str, outputs: Sequence[Path]) -> StageResult | None:
        try:
            record = json.loads(record_path.read_text())
            result = StageResult(str(record["fingerprint"]), float(record["minutes"]))
        except (OSError, ValueError, KeyError, TypeError):
            return None  # never ran, was interrupted, or the record is damaged: run again
        same = record.get("key") == key and all(path.exists() for path in outputs)
        return result if same and _fingerprint(outputs) == result.fingerprint else None


def _fingerprint(outputs: Sequence[Path]) -> str:
    """Hash of names, sizes and times of change of all files: milliseconds for thousands of images."""
    digest = hashlib.sha256()
    for output in outputs:
        files = sorted(path for path in output.rglob("*") if path.is_file()) if output.is_dir() else [output]
        for file in files:
            status = file.stat()
            name = file.relative_to(output) if file != output else file.name
            digest.update(f"{name}\0{status.st_size}\0{status.st_mtime_ns}\n".encode())
    return digest.hexdigest()
