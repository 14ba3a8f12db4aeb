"""Text tables of drives: CSV with a fixed header and JSON lines, with errors that name file and line."""

import csv
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from autolights.core.errors import DataError


def read_csv(path: Path, columns: Sequence[str]) -> Iterator[tuple[int, list[str]]]:
    """Go through the rows of a CSV file whose header must be exactly `columns`.

    Yields:
        Line number (the header is line 1) and the row's values as texts, one per column. Empty lines are skipped.

    Raises:
        DataError: If the file cannot be read, its header differs, or a row has another number of values.
    """
    rows = csv.reader(_read_text(path).splitlines())
    header = next(rows, [])
    if [name.strip() for name in header] != list(columns):
        raise DataError(f"{path}:1: the header must read {','.join(columns)}, got {','.join(header) or 'nothing'}")
    for row in rows:
        if not row:
            continue
        if len(row) != len(columns):
            raise DataError(f"{path}:{rows.line_num}: expected {len(columns)} values, got {len(row)}: {','.join(row)}")
        yield rows.line_num, [value.strip() for value in row]


def read_json_lines(path: Path) -> Iterator[tuple[int, dict[str, Any]]]:
    """Go through a file of one JSON object per line; yields line number and object, skips empty lines.

    Raises:
        DataError: If the file cannot be read or a line is no JSON object.
    """
    for number, line in enumerate(_read_text(path).splitlines(), start=1):
        if not line.strip():
            continue
        try:
            values = json.loads(line)
        except json.JSONDecodeError as error:
            raise DataError(f"{path}:{number}: not JSON ({error}); was the writing program interrupted?") from error
        if not isinstance(values, dict):
            raise DataError(f"{path}:{number}: must be an object, got {type(values).__name__}")
        yield number, values


def _read_text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror})") from error
    except UnicodeDecodeError as error:
        raise DataError(f"{path}: not UTF-8 text ({error.reason} at byte {error.start})") from error
