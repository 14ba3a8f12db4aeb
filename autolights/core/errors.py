"""Everything that autolights raises on purpose.

::

    AutolightsError              exit code 1
    ├── UsageError               exit code 2: what was asked for cannot be done as asked
    │   └── ConfigError          a YAML key or an override is wrong
    ├── DataError                a file of the outside world breaks its format
    │   ├── CalibrationError
    │   ├── MapError
    │   ├── CheckpointError
    │   └── BundleError
    ├── PoseError                no pose can be given for a stamp
    ├── TrainingError            a run cannot go on (a loss that is not finite, ...)
    ├── ParityError              an exported model does not agree with the one it came from
    └── AccuracyError            an 8-bit model sees less than is allowed
"""


class AutolightsError(Exception):
    """Base of all errors whose text is meant for the user."""

    exit_code = 1


class UsageError(AutolightsError):
    """The request itself is wrong: a folder that is missing, an output that exists."""

    exit_code = 2


class ConfigError(UsageError):
    """A configuration file or a dotted override is wrong."""


class DataError(AutolightsError):
    """A file exists but does not hold what its format promises."""


class CalibrationError(DataError):
    """A camera calibration that no camera can have."""


class MapError(DataError):
    """A map that cannot be used."""


class CheckpointError(DataError):
    """A checkpoint that cannot be read or does not fit."""


class BundleError(DataError):
    """A bundle that is incomplete, altered, or from another format version."""


class PoseError(AutolightsError):
    """The vehicle's pose is not known at the stamp that was asked for."""


class TrainingError(AutolightsError):
    """Training cannot go on."""


class ParityError(AutolightsError):
    """An exported model disagrees with its source beyond tolerance."""


class AccuracyError(AutolightsError):
    """An 8-bit model loses more than is allowed."""
