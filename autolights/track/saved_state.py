"""Whether a saved tracking state is one to go on from."""

from typing import Any

from autolights.core.errors import DataError
from autolights.track.config import TrackConfig

STATE_FORMAT = 4


def refuse_other(values: dict[str, Any], signals_name: str, config: TrackConfig) -> None:
    """Refuse a state of another format, signal description or setting.

    Args:
        values: As `TrackManager.to_json` gave them.
        signals_name: Of our signal description.
        config: Ours.

    Raises:
        DataError: The text says what differs.
        KeyError: If something is missing.
    """
    if values.get("format") != STATE_FORMAT:
        raise DataError(f"tracking state: format {values.get('format')!r} is not {STATE_FORMAT}; start without it")
    _check_same("signals", values["signals"], signals_name)
    for name, ours in config.model_dump(mode="json").items():
        _check_same(f"setting track.{name}", values["config"].get(name), ours)


def _check_same(what: str, saved: object, ours: object) -> None:
    if saved != ours:
        raise DataError(f"tracking state: {what} was {saved!r} when it was saved and is {ours!r} now")
