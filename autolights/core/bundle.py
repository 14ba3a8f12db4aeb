"""The bundle: everything that travels from training to the car, in one verified folder."""

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import autolights
from autolights.core.atomic import new_folder, sha256
from autolights.core.config import Config, save_config
from autolights.core.confusion import ConfusionMatrix, CountedWith
from autolights.core.errors import AutolightsError, BundleError
from autolights.core.hmm import HmmParameters, load_hmm, save_hmm
from autolights.core.json_files import read_json_object, validated, write_json
from autolights.core.model_guard import inspect_model, read_model
from autolights.core.model_info import FORMAT_VERSION, ModelInfo
from autolights.core.signals import SignalSet, load_signals

MODEL, SIGNALS, HMM, CONFUSION, MANIFEST = "model.onnx", "signals.yaml", "hmm.json", "confusion.json", "manifest.json"
_HASHED = (MODEL, SIGNALS, HMM, CONFUSION)


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
        model_sha256: Of ``model.onnx`` in a bundle that was loaded, and a detector runs no other; empty in one that is
            being made.
    """

    model: ModelInfo
    model_path: Path
    signals: SignalSet
    hmm: dict[str, HmmParameters]
    confusion: ConfusionMatrix
    model_sha256: str = ""

    def __post_init__(self) -> None:
        if self.model.head == "efficient-nms":
            raise BundleError(
                "the head efficient-nms yields no class vectors, and tracking needs them; "
                "export with --head end2end or --head raw"
            )
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
        if self.model_sha256:
            self._check_counted_with(self.model_sha256)

    def save(self, directory: Path, *, force: bool = False) -> None:
        """Write the bundle; it appears whole or not at all.

        Raises:
            UsageError: If `directory` exists and `force` is not set.
            BundleError: If there is no model file, it holds what no export writes, or it is an 8-bit model and the
                confusion matrix or the HMMs come from another one.
        """
        model = _inspected(self.model_path)
        self._check_counted_with(hashlib.sha256(model).hexdigest())
        with new_folder(directory, force=force) as folder:
            (folder / MODEL).write_bytes(model)
            save_config(self.signals, folder / SIGNALS)
            save_hmm(folder / HMM, self.hmm)
            self.confusion.save(folder / CONFUSION)
            manifest = Manifest(
                format_version=FORMAT_VERSION,
                program_version=autolights.__version__,
                model=self.model,
                sha256={name: sha256(folder / name) for name in _HASHED},
            )
            write_json(folder / MANIFEST, manifest.model_dump(mode="json"))

    def _check_counted_with(self, model_sha256: str) -> None:
        """An 8-bit model errs in its own way, so the HMMs must know the errors of this very file."""
        if self.model.precision != "int8":
            return
        counted = {"confusion matrix": self.confusion.counted_with}
        for name, parameters in self.hmm.items():
            counted[f"HMM of type '{name}'"] = CountedWith.from_json(parameters.provenance.get("counted_with"))
        for what, model in counted.items():
            if model is None or model.sha256 != model_sha256:
                raise BundleError(
                    f"the {what} was counted with {model or 'an unknown model'}, not with this int8 model "
                    f"({model_sha256[:12]}…): `autolights val` on the exported model, then `fit-hmm` and `bundle`"
                )

    @classmethod
    def load(cls, directory: Path) -> Self:
        """Read and verify a bundle: nothing is used before its hash is checked.

        A bundle consists of the five files in this folder and nothing else: the manifest cannot name others, and links
        out of the folder are refused.

        Raises:
            BundleError: If a file is missing or altered, the format is another one, the parts do not fit each other, or
                the model holds what no export writes (see `core.model_guard`).
        """
        manifest = _read_manifest(_inside(directory, MANIFEST))
        if set(manifest.sha256) != set(_HASHED):
            raise BundleError(
                f"{directory / MANIFEST}: sha256 must name {', '.join(_HASHED)}, got {', '.join(manifest.sha256)}"
            )
        paths = {name: _inside(directory, name) for name in _HASHED}
        _inspected(paths[MODEL], manifest.sha256[MODEL])
        for name in (SIGNALS, HMM, CONFUSION):
            if sha256(paths[name]) != manifest.sha256[name]:
                raise BundleError(
                    f"{paths[name]}: its SHA-256 differs from the manifest's: altered or damaged since bundling"
                )
        try:
            return cls(
                model=manifest.model,
                model_path=paths[MODEL],
                signals=load_signals(paths[SIGNALS]),
                hmm=load_hmm(paths[HMM]),
                confusion=ConfusionMatrix.load(paths[CONFUSION]),
                model_sha256=manifest.sha256[MODEL],
            )
        except BundleError as error:
            raise BundleError(f"{directory}: {error}") from error
        except AutolightsError as error:
            raise BundleError(str(error)) from error


def _inside(directory: Path, name: str) -> Path:
    """The file of that name in the folder itself, not behind a link that leaves it."""
    path = directory / name
    if not path.is_file():
        raise BundleError(f"{path}: missing; copy the whole bundle or make it again with `autolights bundle`")
    if path.resolve().parent != directory.resolve():
        raise BundleError(f"{path}: a link out of the bundle; copy the file itself into the folder")
    return path


def _inspected(path: Path, wanted_sha256: str = "") -> bytes:
    """The bytes of a model that holds only what an export writes."""
    data = read_model(path, wanted_sha256)
    try:
        inspect_model(data)
    except BundleError as error:
        raise BundleError(f"{path}: {error}") from error
    return data


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
