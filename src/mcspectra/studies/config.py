"""Study files: typed TOML, checked as a whole before anything runs.

A study names samplers and estimators and, in the tables `convergence`, `terms` and `spectrum`, what
is analysed; an estimator may override any of them. Unknown keys, wrong types and values out of
range are errors that name the place. Relative paths inside spec strings are relative to the file.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from mcspectra.core.errors import ConfigError, close_match_hint

__all__ = [
    "ConvergenceConfig",
    "EstimatorConfig",
    "SpectrumConfig",
    "StudyConfig",
    "TermsConfig",
    "decode_study",
    "read_study",
]

_LARGEST_FILE = 4 * 2**20
Positive = Annotated[int, msgspec.Meta(ge=1, le=2**31)]
Realizations = Annotated[int, msgspec.Meta(ge=2, le=10**9)]
Text = Annotated[str, msgspec.Meta(min_length=1, max_length=20_000)]


class _Struct(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Common flags of all tables."""


class ConvergenceConfig(_Struct, frozen=True, kw_only=True):
    """Table ``convergence``: variance against n and its rate.

    `fit_last` counts are fitted, ``"auto"``: as many as lie on a line. With `relative_error` each
    count stops once its variance is known to that fraction; `realizations` is then the most.
    """

    counts: Annotated[tuple[Positive, ...], msgspec.Meta(min_length=1)]
    realizations: Realizations = 1000
    fit_last: Annotated[int, msgspec.Meta(ge=2)] | Literal["auto"] | None = None
    relative_error: Annotated[float, msgspec.Meta(gt=0, le=1)] | None = None


class TermsConfig(_Struct, frozen=True, kw_only=True):
    """Table ``terms``: the three terms at one n. Without `space`: domain where there is one.

    `basis` and `bands` are as for `variance_terms`; the plan checks them.
    """

    n: Positive
    half_width: Annotated[int, msgspec.Meta(ge=0)] = 64
    realizations: Realizations = 1000
    space: Literal["domain", "primary"] | None = None
    basis: Text = "fourier"
    bands: Text = "radial"
    cross_matrix: bool = False


class SpectrumConfig(_Struct, frozen=True, kw_only=True):
    """Table ``spectrum``: the expected power spectrum of the (importance) samples at one n."""

    n: Positive
    half_width: Annotated[int, msgspec.Meta(ge=1)] = 64
    realizations: Realizations = 100


class EstimatorConfig(_Struct, frozen=True, kw_only=True):
    """Table ``[[estimators]]``.

    `integrand` alone is plain sampling, with `density` importance sampling, with `densities` (and
    `heuristic`, `technique_counts`) multiple importance sampling; `integrands` is a sum of
    techniques that are given in primary space.
    """

    name: Text
    dims: Annotated[int, msgspec.Meta(ge=1, le=1024)] | None = None
    integrand: Text | None = None
    integrands: tuple[Text, ...] | None = None
    density: Text | None = None
    densities: tuple[Text, ...] | None = None
    heuristic: str | None = None
    technique_counts: tuple[Positive, ...] | None = None
    samplers: tuple[Text, ...] | None = None
    convergence: ConvergenceConfig | None = None
    terms: TermsConfig | None = None
    spectrum: SpectrumConfig | None = None


class StudyConfig(_Struct, frozen=True, kw_only=True):
    """A whole study file."""

    title: Text
    seed: Annotated[int, msgspec.Meta(ge=0)] = 0
    samplers: tuple[Text, ...] = ()
    estimators: Annotated[tuple[EstimatorConfig, ...], msgspec.Meta(min_length=1)]
    convergence: ConvergenceConfig | None = None
    terms: TermsConfig | None = None
    spectrum: SpectrumConfig | None = None


def read_study(path: str | Path) -> StudyConfig:
    """Read and check a study file.

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
    return decode_study(text, str(file))


def decode_study(text: str, source: str = "study") -> StudyConfig:
    """Check the text of a study file; `source` names it in messages."""
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{source} is not valid TOML: {error}.") from None
    except RecursionError:
        raise ConfigError(f"{source} is nested too deeply for a study.") from None
    try:
        config = msgspec.convert(table, StudyConfig, strict=True)
    except msgspec.ValidationError as error:
        raise ConfigError(f"{source}: {_explained(str(error))}") from None
    _check_names(config, source)
    return config


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
    tables = {
        "convergence": ConvergenceConfig,
        "terms": TermsConfig,
        "spectrum": SpectrumConfig,
        "estimators": EstimatorConfig,
    }
    last = path.rpartition(".")[2].partition("[")[0]
    return tuple(tables.get(last, StudyConfig).__struct_fields__)


def _check_names(config: StudyConfig, source: str) -> None:
    names = [e.name for e in config.estimators]
    for name in names:
        if names.count(name) > 1:
            raise ConfigError(f"{source}: two estimators are called {name!r}; names must differ.")
    for e in config.estimators:
        samplers = e.samplers if e.samplers is not None else config.samplers
        if not samplers:
            raise ConfigError(
                f"{source}: the estimator {e.name!r} has no samplers; list some there or at the top."
            )
        if len(set(samplers)) < len(samplers):
            raise ConfigError(f"{source}: the estimator {e.name!r} lists a sampler twice.")
        if (e.integrand is None) == (e.integrands is None):
            raise ConfigError(
                f"{source}: the estimator {e.name!r} needs either integrand or integrands."
            )
        if e.density is not None and e.densities is not None:
            raise ConfigError(
                f"{source}: the estimator {e.name!r} has density and densities; give one of them."
            )
        if e.densities is None and (e.heuristic is not None):
            raise ConfigError(
                f"{source}: the estimator {e.name!r} has a heuristic, which weights densities; "
                "give densities, or leave it out."
            )
        if e.densities is None and e.integrands is None and e.technique_counts is not None:
            raise ConfigError(
                f"{source}: the estimator {e.name!r} has technique_counts but one technique; "
                "give densities or integrands, or leave it out."
            )
        if e.integrands is not None and (e.density is not None or e.densities is not None):
            raise ConfigError(
                f"{source}: the estimator {e.name!r} has integrands, which carry their densities "
                "inside; leave density and densities out."
            )
