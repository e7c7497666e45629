"""What a study's tables must keep among each other, beyond the types of their keys."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from mcspectra.core.errors import ConfigError
from mcspectra.studies.tables import EstimatorConfig, StudyConfig, entries_of, samplers_of

__all__ = ["check_study"]


def check_study(config: StudyConfig, source: str) -> None:
    """Refuse names that repeat, missing samplers and keys that contradict each other.

    Raises
    ------
    ConfigError
        The message names `source` and the estimator.
    """
    entries = entries_of(config)
    if not entries:
        raise ConfigError(f"{source}: there is nothing to study; give [[estimators]] or [[maps]].")
    _check_names([entry.name for entry in entries], source)
    for entry in entries:
        _check_samplers(samplers_of(config, entry), f"{source}: {entry.name!r}")
    for estimator in config.estimators:
        for complaint in _complaints(estimator):
            raise ConfigError(f"{source}: the estimator {estimator.name!r} {complaint}")


def _check_names(names: Sequence[str], source: str) -> None:
    if len(set(names)) < len(names):
        name = next(name for name in names if names.count(name) > 1)
        raise ConfigError(f"{source}: two estimators are called {name!r}; names must differ.")


def _check_samplers(samplers: Sequence[str], place: str) -> None:
    if not samplers:
        raise ConfigError(f"{place} has no samplers; list some there or at the top.")
    if len(set(samplers)) < len(samplers):
        raise ConfigError(f"{place} lists a sampler twice.")


def _complaints(e: EstimatorConfig) -> Iterator[str]:
    """What is wrong with the keys of an estimator, as the rest of a sentence."""
    several = e.densities is not None or e.integrands is not None
    if (e.integrand is None) == (e.integrands is None):
        yield "needs either integrand or integrands."
    if e.density is not None and e.densities is not None:
        yield "has density and densities; give one of them."
    if e.densities is None and e.heuristic is not None:
        yield "has a heuristic, which weights densities; give densities, or leave it out."
    if e.technique_counts is not None and (not several or e.one_sample):
        yield (
            "has technique_counts but one technique; give densities or integrands, or leave it out."
        )
    if e.integrands is not None and (e.density is not None or e.densities is not None):
        yield "has integrands, which carry their densities inside; leave density and densities out."
    if e.integrands is not None and e.smoothed is not None:
        yield "has integrands, which cannot be smoothed; leave smoothed out."
    if e.sets is not None and (not several or e.one_sample):
        yield "has sets, which belong to several techniques; leave it out."
    yield from _one_sample_complaints(e)
    yield from _channel_complaints(e)


def _one_sample_complaints(e: EstimatorConfig) -> Iterator[str]:
    if e.one_sample and e.densities is None:
        yield "has one_sample but no densities to choose from; give densities."
    if not e.one_sample and (e.probabilities is not None or e.selection is not None):
        yield "has probabilities or selection, which belong to one_sample = true."


def _channel_complaints(e: EstimatorConfig) -> Iterator[str]:
    if e.channels is None:
        return
    if e.channels == "one" and e.density is None:
        yield 'has channels = "one", which needs density.'
    if e.channels != "one" and e.densities is None:
        yield f'has channels = "{e.channels}", which needs densities, one for each channel.'
    if e.one_sample:
        yield "has channels and one_sample; give one of them."
    given = (e.heuristic, e.technique_counts, e.sets)
    if e.channels in ("own", "shared") and any(value is not None for value in given):
        yield f'has channels = "{e.channels}", which takes no heuristic, technique_counts or sets.'
