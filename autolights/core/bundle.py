"""The bundle: everything that travels from training to the car, in one verified folder."""

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import autolights
from autolights.core.atomic import new_folder, sha256
from autolights.core.config import Config, save_config
from autolights.core.confusion import ConfusionMatrix
from autolights.core.errors import AutolightsError, BundleError
from autolights.core.hmm import HmmParameters, load_hmm, save_hmm
from autolights.core.json_files import read_json_object, validated, write_json
from autolights.core.model_info import FORMAT_VERSION, ModelInfo
from autolights.core.signals import SignalSet, load_signals

MODEL, SIGNALS, HMM, CONFUSION, MANIFEST = "model.onnx", "signals.yaml", "hmm.json", "confusion.json", "manifest.json"


class Manifest(Config):
    """``manifest.json``: the table of contents with hashes."""

    format_version: int
    program_version: str
    model: ModelInfo
    sha256: dict[str, str]


@dataclass(frozen=True, eq=False)
class Bundle:
    """A detector and the HMMs that were fitted to its errors.

    Attributes:
        model: What ``model.onnx`` expects and yields.
        model_path: The ONNX file; `save` copies it.
        signals: The signal description.
        hmm: One model per type.
        confusion: The confusion matrix behind the HMMs.
    """

    model: ModelInfo
    model_path: Path
    signals: SignalSet
    hmm: dict[str, HmmParameters]
    confusion: ConfusionMatrix

    def __post_init__(self) -> None:
        for what, classes in (("model", self.model.classes), ("confusion matrix", self.confusion.classes)):
            if classes != self.signals.classes:
                raise BundleError(
                    f"the {what} knows the classes {list(classes)}, "
                    f"the signal description '{self.signals.name}' {list(self.signals.classes)}"
                )
        if self.model.score_threshold != self.confusion.score_threshold:
            raise BundleError(
                f"the confusion matrix was counted from score {self.confusion.score_threshold}, the model runs from "
                f"{self.model.score_threshold}; give `val` and `export` the same score threshold"
            )
        missing = [name for name in self.signals.types if name not in self.hmm]
        if missing:
            raise BundleError(f"{HMM} has no model for type '{missing[0]}'; run `autolights fit-hmm` again")
        for name, parameters in self.hmm.items():
            if name not in self.signals.types or parameters.states != self.signals.states_of(name):
                raise BundleError(f"{HMM}: the states of type '{name}' are not those of the signal description")

    def save(self, directory: Path, *, force: bool = False) -> None:
        """Write the bundle; it appears whole or not at all.

        Raises:
            UsageError: If `directory` exists and `force` is not set.
            BundleError: If there is no model file.
        """
        if not self.model_path.is_file():
            raise BundleError(f"{self.model_path}: no such model; make one with `autolights export`")
        with new_folder(directory, force=force) as folder:
            shutil.copyfile(self.model_path, folder / MODEL)
            save_config(self.signals, folder / SIGNALS)
            save_hmm(folder / HMM, self.hmm)
            self.confusion.save(folder / CONFUSION)
            manifest = Manifest(
                format_version=FORMAT_VERSION,
                program_version=autolights.__version__,
                model=self.model,
                sha256={name: sha256(folder / name) for name in (MODEL, SIGNALS, HMM, CONFUSION)},
            )
            write_json(folder / MANIFEST, manifest.model_dump(mode="json"))

    @classmethod
    def load(cls, directory: Path) -> Self:
        """Read and verify a bundle: every hash is checked before anything is used.

        Raises:
            BundleError: If a file is missing or altered, the format is newer, or the parts do not fit each other.
        """
        manifest = _read_manifest(directory / MANIFEST)
        for name in (MODEL, SIGNALS, HMM, CONFUSION):
            path = directory / name
            if not path.is_file():
                raise BundleError(f"{path}: missing; copy the whole bundle or make it again with `autolights bundle`")
            if sha256(path) != manifest.sha256.get(name):
                raise BundleError(f"{path}: its SHA-256 differs from the manifest's: altered or damaged since bundling")
        try:
            return cls(
                model=manifest.model,
                model_path=directory / MODEL,
                signals=load_signals(directory / SIGNALS),
                hmm=load_hmm(directory / HMM),
                confusion=ConfusionMatrix.load(directory / CONFUSION),
            )
        except BundleError as error:
            raise BundleError(f"{directory}: {error}") from error
        except AutolightsError as error:
            raise BundleError(str(error)) from error


def _read_manifest(path: Path) -> Manifest:
    values = read_json_object(path, error=BundleError, hint="is this a bundle?")
    version = values.get("format_version")
    if not isinstance(version, int):
        raise BundleError(f"{path}: no format_version; is this a bundle?")
    if version > FORMAT_VERSION:
        raise BundleError(
            f"{path}: format {version} is newer than {FORMAT_VERSION}; upgrade autolights or export again"
        )
    if version < FORMAT_VERSION:
        raise BundleError(
            f"{path}: format {version} is older than {FORMAT_VERSION}; make it again: export, then bundle"
        )
    return validated(Manifest, values, path, error=BundleError)
