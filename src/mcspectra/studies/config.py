"""Study files: typed TOML, checked as a whole before anything runs.

A study names samplers and estimators and, in tables such as `convergence`, `terms` and `spectrum`,
what is analysed; an estimator may override any of them. Unknown keys, wrong types and values out of
range are errors that name the place. Relative paths inside spec strings are relative to the file.
"""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec

from mcspectra.core.errors import ConfigError, close_match_hint
from mcspectra.studies.checks import check_study
from mcspectra.studies.grids import expand_grids
from mcspectra.studies.overrides import apply_overrides
from mcspectra.studies.tables import (
    ANALYSIS_TABLES,
    ConvergenceConfig,
    EstimatorConfig,
    MapConfig,
    SpectrumConfig,
    StudyConfig,
    TermsConfig,
)

__all__ = [
    "ConvergenceConfig",
    "EstimatorConfig",
    "MapConfig",
    "SpectrumConfig",
    "StudyConfig",
    "TermsConfig",
    "decode_study",
    "read_study",
]

_LARGEST_FILE = 4 * 2**20


def read_study(path: str | Path, overrides: Sequence[str] = ()) -> StudyConfig:
    """Read and check a study file.

    Parameters
    ----------
    path
        The file.
    overrides
        Changes ``key=value``, as of ``mcspectra run --set``: `mcspectra.studies.overrides`.

    Raises
    ------
    ConfigError
        Missing or unreadable file, not TOML, or not a study; the message names the place.
    """
    file = Path(path)
    try:
        if file.exists() and not file.is_file():
            raise ConfigError(f"{str(file)!r} is not a file; give the path of a .toml file.")
        if file.stat().st_size > _LARGEST_FILE:
            raise ConfigError(f"{str(file)!r} is larger than a study file can be (4 MiB).")
        text = file.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise ConfigError(
            f"There is no study file {str(file)!r}; give the path of a .toml file."
        ) from None
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise ConfigError(f"The study file {str(file)!r} cannot be read: {reason}.") from None
    return decode_study(text, str(file), overrides)


def decode_study(text: str, source: str = "study", overrides: Sequence[str] = ()) -> StudyConfig:
    """Check the text of a study file; `source` names it in messages. Grids are expanded."""
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{source} is not valid TOML: {error}.") from None
    except RecursionError:
        raise ConfigError(f"{source} is nested too deeply for a study.") from None
    except ValueError:  # tomllib hands on what int() says of 5000 digits
        raise ConfigError(f"{source} holds a number that is too long.") from None
    table = apply_overrides(table, overrides)
    config = _converted(expand_grids(table, source), source)
    check_study(config, source)
    return config


def _converted(table: dict[str, Any], source: str) -> StudyConfig:
    try:
        return msgspec.convert(table, StudyConfig, strict=True)
    except msgspec.ValidationError as error:
        raise ConfigError(f"{source}: {_explained(str(error))}") from None


_CHOICES = {"space": "'domain' or 'primary'", "fit_last": "a number of counts or 'auto'"}


def _explained(message: str) -> str:
    """Turn msgspec's "Expected `int`, got `str` - at `$.terms.n`" into a sentence."""
    what, _, place = message.partition(" - at `$")
    path = place.rstrip("`").lstrip(".")
    where = f"{path}: " if path else ""
    marker = "unknown field `"
    field = path.rpartition(".")[2]
    if "enum value" in what and field in _CHOICES:
        what += f"; give {_CHOICES[field]}"
    if marker not in what:
        return f"{where}{what[:1].lower()}{what[1:].replace('`', '')}."
    unknown = what.split(marker)[1].split("`")[0]
    allowed = _allowed_fields(path)
    hint, close = close_match_hint(unknown, allowed)
    known = f"{where}there is no key {unknown!r}; allowed here: {', '.join(allowed)}."
    return known + (hint if close else "")


def _allowed_fields(path: str) -> tuple[str, ...]:
    tables: dict[str, Any] = {**ANALYSIS_TABLES, "estimators": EstimatorConfig, "maps": MapConfig}
    last = path.rpartition(".")[2].partition("[")[0]
    return tuple(tables.get(last, StudyConfig).__struct_fields__)
