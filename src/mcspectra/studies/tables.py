"""Tables of a study file as typed structs; every key says what it means, once for all readers.

The descriptions are what `mcspectra schema` and docs/studies.md show, and what editors offer.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

__all__ = [
    "ANALYSIS_TABLES",
    "AnovaConfig",
    "ConvergenceConfig",
    "EstimatorConfig",
    "ExactConfig",
    "MapConfig",
    "PcfConfig",
    "RemediesConfig",
    "Settings",
    "SpectrumConfig",
    "StudyConfig",
    "TechniquesConfig",
    "TermsConfig",
    "entries_of",
    "samplers_of",
]

# Larger counts than memory can hold are refused by the plan, with an estimate of what they need.
Positive = Annotated[int, Meta(ge=1, le=2**62)]
Realizations = Annotated[int, Meta(ge=2, le=10**9)]
Text = Annotated[str, Meta(min_length=1, max_length=20_000)]
Counts = Annotated[tuple[Positive, ...], Meta(min_length=1, max_length=10_000)]
HalfWidth = Annotated[int, Meta(ge=0, le=2**31)]
Window = Annotated[int, Meta(ge=2)] | Literal["auto"] | None
Grid = dict[str, list[str | int | float | bool | list[Any]]]

_REALIZATIONS = Meta(description="Independent realisations, at each count.")
_N = Meta(description="Points of each technique.")
_COUNTS = Meta(description="Numbers of points n, ascending.")
_HALF_WIDTH = Meta(description="Frequencies run from −half_width to half_width along every axis.")
_BASIS = Meta(description="fourier, cosine, walsh, haar, or auto: what fits the randomisation.")
_SPACE = Meta(description="domain or primary; by default the domain, where there is one.")
_FIT = Meta(
    description='Fit the rate to the last so many counts, all by default; "auto": as many as lie on a '
    "line."
)
_NAME = Meta(description="Name in tables and figures; all names differ.")


class _Struct(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Common flags of all tables."""


class ConvergenceConfig(_Struct, frozen=True, kw_only=True):
    """Variance against n and its rate."""

    counts: Annotated[Counts, _COUNTS]
    realizations: Annotated[
        Realizations, Meta(description="Realisations at each count; with relative_error the most.")
    ] = 1000
    fit_last: Annotated[Window, _FIT] = None
    relative_error: Annotated[
        Annotated[float, Meta(gt=0, le=1)] | None,
        Meta(description="Stop a count once its variance is known to this fraction."),
    ] = None


class TermsConfig(_Struct, frozen=True, kw_only=True):
    """The three terms of the variance at one n: dc, power and cross."""

    n: Annotated[Positive, _N]
    half_width: Annotated[HalfWidth, _HALF_WIDTH] = 64
    realizations: Annotated[Realizations, _REALIZATIONS] = 1000
    space: Annotated[Literal["domain", "primary"] | None, _SPACE] = None
    basis: Annotated[Text, _BASIS] = "fourier"
    bands: Annotated[Text, Meta(description="radial, dyadic, anova or wedge.")] = "radial"
    cross_matrix: Annotated[
        bool, Meta(description="Also store the full matrix of covariances (few frequencies only).")
    ] = False


class TechniquesConfig(_Struct, frozen=True, kw_only=True):
    """What each technique of an estimator contributes, and which one decides the rate."""

    counts: Annotated[Counts, _COUNTS]
    half_width: Annotated[HalfWidth, _HALF_WIDTH] = 64
    realizations: Annotated[Realizations, _REALIZATIONS] = 1000
    space: Annotated[Literal["domain", "primary"] | None, _SPACE] = None
    basis: Annotated[Text, _BASIS] = "fourier"
    fit_last: Annotated[Window, _FIT] = None


class SpectrumConfig(_Struct, frozen=True, kw_only=True):
    """Expected power spectrum of the (importance) samples at one n, and one of the point sets."""

    n: Annotated[Positive, _N]
    half_width: Annotated[Annotated[int, Meta(ge=1, le=2**31)], _HALF_WIDTH] = 64
    realizations: Annotated[Realizations, _REALIZATIONS] = 100
    frequency_step: Annotated[
        Annotated[float, Meta(gt=0, le=1)],
        Meta(description="Distance of frequencies; below 1 for those between the integers."),
    ] = 1.0


class PcfConfig(_Struct, frozen=True, kw_only=True):
    """Pair correlation of the sampler's points, before any warp."""

    n: Annotated[Annotated[int, Meta(ge=2, le=2**62)], _N]
    bins: Annotated[
        Annotated[int, Meta(ge=1, le=10**6)], Meta(description="Equal bins of the distance.")
    ] = 100
    realizations: Annotated[Realizations, _REALIZATIONS] = 16
    boundary: Annotated[
        Literal["toroidal", "border"],
        Meta(description="toroidal: distances wrap around; border: corrected near the faces."),
    ] = "toroidal"
    max_distance: Annotated[
        Annotated[float, Meta(gt=0, le=0.5)] | None,
        Meta(description="Largest distance; 1/2, with border 1/4, by default."),
    ] = None


class AnovaConfig(_Struct, frozen=True, kw_only=True):
    """Which axes of primary space, and pairs of them, the variance comes from."""

    n: Annotated[Positive, _N] = 1
    order: Annotated[
        Annotated[int, Meta(ge=1, le=2)], Meta(description="1: single axes; 2: pairs too.")
    ] = 2
    realizations: Annotated[Realizations, _REALIZATIONS] = 10_000


class ExactConfig(_Struct, frozen=True, kw_only=True):
    """Exact variances; NaN, with the reason as a note, where no closed form is known."""

    counts: Annotated[Counts, _COUNTS]


class RemediesConfig(_Struct, frozen=True, kw_only=True):
    """What would lower the noise at equal cost: measured, ranked, explained."""

    budget: Annotated[Positive, Meta(description="Evaluations of the integrand an estimate.")]
    kinds: Annotated[
        Annotated[tuple[Text, ...], Meta(min_length=1)] | None,
        Meta(description="Changes to try; all by default (`mcspectra remedies --help`)."),
    ] = None
    realizations: Annotated[
        Annotated[int, Meta(ge=100, le=100_000)],
        Meta(description="Realisations of each change at each of five budgets."),
    ] = 1000


class MapConfig(_Struct, frozen=True, kw_only=True):
    """Variance, rate and bottleneck at every pixel of a scene; needs the extra render."""

    name: Annotated[Text, _NAME]
    scene: Annotated[Text, Meta(description="A built-in scene or a Mitsuba XML file.")]
    samplers: Annotated[
        tuple[Text, ...] | None, Meta(description="Samplers; those of the study by default.")
    ] = None
    strategies: Annotated[
        Annotated[tuple[Text, ...], Meta(min_length=1)] | None,
        Meta(description="Some of light, bsdf, mis-light, mis-bsdf, mis; all by default."),
    ] = None
    counts: Annotated[Counts, _COUNTS] = (4, 9, 16, 36, 64)
    realizations: Annotated[Realizations, _REALIZATIONS] = 64
    crop: Annotated[
        tuple[int, int, int, int] | None,
        Meta(description="x0, y0, width and height of the part that is measured."),
    ] = None
    size: Annotated[
        tuple[int, int] | None, Meta(description="Pixels of the image; those of the film.")
    ] = None
    light: Annotated[int | Text | None, Meta(description="The one light that counts; all.")] = None
    heuristic: Annotated[Text, Meta(description="balance or power.")] = "balance"
    channel: Annotated[int | Text, Meta(description="luminance, 0, 1 or 2.")] = "luminance"
    dims: Annotated[int, Meta(description="2, or 3 to choose lights and lobes by a third.")] = 2
    points: Annotated[
        Text, Meta(description="shared, or own: realisations for each pixel alone.")
    ] = "shared"
    smoothing: Annotated[int, Meta(description="Odd: average rates over so many squared.")] = 1
    predict_every: Annotated[
        int, Meta(description="Predict at every so many pixels; 0: nowhere.")
    ] = 1


Settings = (
    ConvergenceConfig
    | TermsConfig
    | TechniquesConfig
    | SpectrumConfig
    | PcfConfig
    | AnovaConfig
    | ExactConfig
    | RemediesConfig
    | MapConfig
)


class _Analyses(_Struct, frozen=True, kw_only=True):
    """The tables of analyses: at the top for all estimators, in an estimator for it alone."""

    convergence: Annotated[ConvergenceConfig | None, Meta(description="Variance against n.")] = None
    terms: Annotated[TermsConfig | None, Meta(description="The three terms.")] = None
    techniques: Annotated[
        TechniquesConfig | None, Meta(description="Terms and rates of each technique.")
    ] = None
    spectrum: Annotated[SpectrumConfig | None, Meta(description="Power of the points.")] = None
    pcf: Annotated[PcfConfig | None, Meta(description="Pair correlation of the points.")] = None
    anova: Annotated[AnovaConfig | None, Meta(description="Variance by axes.")] = None
    exact: Annotated[ExactConfig | None, Meta(description="Exact variances.")] = None
    remedies: Annotated[RemediesConfig | None, Meta(description="What lowers the noise.")] = None


class EstimatorConfig(_Analyses, frozen=True, kw_only=True):
    """An estimator: an integrand, how it is importance-sampled, and with which samplers."""

    name: Annotated[Text, _NAME]
    dims: Annotated[
        Annotated[int, Meta(ge=1, le=1024)] | None,
        Meta(description="Number of dims, where specs leave it open."),
    ] = None
    integrand: Annotated[
        Text | None, Meta(description="Spec: `mcspectra list integrands`; or python(...).")
    ] = None
    integrands: Annotated[
        tuple[Text, ...] | None,
        Meta(description="Techniques in primary space, each with points of its own, added."),
    ] = None
    density: Annotated[
        Text | None, Meta(description="Importance density: `mcspectra list densities`.")
    ] = None
    densities: Annotated[
        tuple[Text, ...] | None,
        Meta(description="Multiple importance sampling, or one density for each channel."),
    ] = None
    heuristic: Annotated[
        str | None,
        Meta(description="balance, power(beta=2), cutoff, maximum, optimal, variance-aware."),
    ] = None
    technique_counts: Annotated[
        tuple[Positive, ...] | None,
        Meta(description="Points of each technique as multiples of n; 1 by default."),
    ] = None
    sets: Annotated[
        Literal["independent", "shared", "joint"] | None,
        Meta(description="How the techniques' points belong together; independent by default."),
    ] = None
    one_sample: Annotated[
        bool, Meta(description="Each point chooses one of the densities at random.")
    ] = False
    probabilities: Annotated[
        tuple[float, ...] | None,
        Meta(description="Of the densities with one_sample; equal by default."),
    ] = None
    selection: Annotated[
        Literal["extra", "coordinate"] | None,
        Meta(description="What chooses with one_sample: an extra coordinate, or the first."),
    ] = None
    channels: Annotated[
        Literal["own", "shared", "combined", "one"] | None,
        Meta(
            description="Colour: own or shared points for each channel's density, all densities "
            "combined by MIS, or one density for all channels."
        ),
    ] = None
    mirror: Annotated[
        Literal["integrand", "random", "uniform"] | None,
        Meta(description="Mirror the integrand, or the samples at random or into all images."),
    ] = None
    smoothed: Annotated[
        Annotated[float, Meta(gt=0)] | None,
        Meta(description="Width of the ramps that the integrand's edges are made."),
    ] = None
    samplers: Annotated[
        tuple[Text, ...] | None, Meta(description="Samplers; those of the study by default.")
    ] = None
    grid: Annotated[
        Grid | None,
        Meta(description="Values of {placeholders}: one estimator for each combination."),
    ] = None


class StudyConfig(_Analyses, frozen=True, kw_only=True):
    """A whole study file."""

    title: Annotated[Text, Meta(description="Title of the report.")]
    seed: Annotated[Annotated[int, Meta(ge=0)], Meta(description="Seed of all realisations.")] = 0
    samplers: Annotated[
        tuple[Text, ...],
        Meta(description="Samplers of all estimators: `mcspectra list samplers`, chained by |."),
    ] = ()
    time_limit: Annotated[
        Annotated[float, Meta(gt=0, le=1e9)] | None,
        Meta(description="Seconds a task may take; then it is stopped and its analysis fails."),
    ] = None
    grid: Annotated[
        Grid | None, Meta(description="Values of {placeholders} anywhere in the study.")
    ] = None
    estimators: Annotated[
        tuple[EstimatorConfig, ...], Meta(description="Tables [[estimators]].")
    ] = ()
    maps: Annotated[tuple[MapConfig, ...], Meta(description="Tables [[maps]].")] = ()


ANALYSIS_TABLES: dict[str, type[Any]] = {
    "convergence": ConvergenceConfig,
    "terms": TermsConfig,
    "techniques": TechniquesConfig,
    "spectrum": SpectrumConfig,
    "pcf": PcfConfig,
    "anova": AnovaConfig,
    "exact": ExactConfig,
    "remedies": RemediesConfig,
}
"""Tables of analyses by their names."""


def entries_of(config: StudyConfig) -> list[EstimatorConfig | MapConfig]:
    """Estimators, then maps: all that has samplers, in the order of the file."""
    return [*config.estimators, *config.maps]


def samplers_of(config: StudyConfig, entry: EstimatorConfig | MapConfig) -> tuple[str, ...]:
    """The samplers of an entry: its own, or the study's."""
    return config.samplers if entry.samplers is None else entry.samplers
