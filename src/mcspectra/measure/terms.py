"""The three terms of the variance of an estimator, which spectra predict and explain.

The theory is in docs/theory.md, "The three terms" and "Contributions and bands".
The M × M matrix of M frequencies is never stored, except on request.
In primary space every technique has its own integrand and points.
The sums then run over all techniques and all frequencies m.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal, final

import numpy as np
from msgspec import Meta

from mcspectra.core import options
from mcspectra.core.analysis import Counted, Need, Reduction, Subject, compute
from mcspectra.core.checks import Array
from mcspectra.core.confidence import rounding_floor
from mcspectra.core.errors import ParameterError
from mcspectra.core.memory import memory_of
from mcspectra.core.ordered import weighted_sum
from mcspectra.core.parallel import realization_blocks
from mcspectra.core.results import dataset
from mcspectra.core.streams import RngLike, Stream
from mcspectra.estimators.importance import as_subject
from mcspectra.measure.blindness import blindness_of, is_fixed
from mcspectra.measure.sums import (
    BATCH_SETTINGS,
    Batches,
    Partition,
    StoredGroups,
    TermSums,
    Variables,
    spread,
    student_t,
)
from mcspectra.measure.views import Frequencies, View, check_bands, make_bands
from mcspectra.samplers import Sampler

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Terms", "variance_terms"]


@dataclass(frozen=True)
class TermSettings:
    """Limit of memory for the covariances of all pairs of frequencies."""

    # Largest number of frequencies whose full matrix of covariances is returned.
    # For 4096 frequencies, the two complex matrices take 0.5 GiB.
    most_matrix: int = 4096


_SETTINGS = TermSettings()

_TERMS = ("dc_term", "power_term", "cross_term")
_WITH_ERROR = ("contribution", "band_covariance", "coefficient_covariance", "cross_matrix")


@final
class Terms(Counted, frozen=True, kw_only=True):
    """The three terms of the variance at one n: dc, power and cross."""

    function = "variance_terms"
    verb = "variance"
    pictured = True
    several = ("sampler",)
    split = "terms"
    variables = (
        *(f"{name}{part}" for name in _TERMS for part in ("", "_se", "_ci")),
        *(f"{name}{part}" for name in _WITH_ERROR for part in ("", "_se")),
        *(f"{name}{part}" for name in ("predicted_variance", "measured_variance", "captured")
          for part in ("", "_ci")),
        *("mean", "mean_se", "power_contribution", "integrand_power",
          "truncated_variance", "captured_by_half_width"),
        *("energy_share", "tail_term"),
    )  # fmt: skip
    provenance = ("estimator", "sampler", "n", "realizations", "eps", "stream_key")

    n: Annotated[int, options.COUNT]
    half_width: Annotated[
        Annotated[int, options.HALF_WIDTH] | None,
        Meta(
            description="Largest frequency along each axis; by default it is chosen for n and the "
            "integrand.",
        ),
    ] = None
    realizations: Annotated[int, options.REALIZATIONS] = 1000
    space: Annotated[Literal["domain", "primary"] | None, options.SPACE] = None
    basis: Annotated[str, options.BASIS] = "fourier"
    bands: Annotated[str, options.BANDS] = "radial"
    cross_matrix: Annotated[
        bool,
        Meta(description="Also give the full matrix of covariances, for few frequencies only."),
    ] = False
    engine: Annotated[str, options.ENGINE] = "auto"
    eps: Annotated[float, options.EPS] = 1e-9

    def need(self, subject: Subject) -> Need:
        """Check that the spectra fit into memory, and that the bands exist."""
        estimator, several = subject.estimator, len(subject.samplers)
        for sampler in subject.samplers:
            estimator.check_sampler(sampler, self.n)
        frequencies = self._frequencies(subject)
        check_bands(self.bands, frequencies.basis)
        size, evaluations = frequencies.size, sum(estimator.counts)
        if self.cross_matrix and size > _SETTINGS.most_matrix:
            raise ParameterError(
                f"The cross matrix of {size} frequencies takes {32 * size**2 / 2**30:.3g} GiB; "
                f"request at most {_SETTINGS.most_matrix} frequencies, or use contribution and "
                "band_covariance."
            )
        kept = several * (size + (2 * size * size if self.cross_matrix else 0))
        each = self.realizations * evaluations * self.n * estimator.evaluations_per_point
        return Need(
            cost=float(several * self.realizations * (evaluations * self.n + size)),
            memory=memory_of(self.n, estimator.dims, evaluations, kept),
            evaluations=several * each,
        )

    def reduction(self, subject: Subject, stream: Stream) -> Reduction[list[TermSums]]:
        """Return sums over all realizations of each sampler. Each block is a batch."""
        estimator, samplers, n = subject.estimator, subject.samplers, self.n
        frequencies = self._frequencies(subject)
        view = frequencies.view(n, self)
        bands = make_bands(self.bands, view.basis)
        partition = view.partition(bands.of, self.cross_matrix)
        # Number of coordinates of a realization, or size of its spectra if that is larger
        numbers = max(n * estimator.dims * sum(estimator.counts), 2 * partition.double.size)
        blocks = realization_blocks(
            self.realizations, numbers, multiple=2, least=BATCH_SETTINGS.least
        )

        def block(index: int) -> list[TermSums]:
            return [sums_of(s, *blocks[index]) for s in samplers]

        def sums_of(source: Sampler, first: int, count: int) -> TermSums:
            points = estimator.draw(source, n, stream, first, count)
            estimates = estimator.estimate(points).reshape(len(points[0]), -1)
            stored = StoredGroups.of(estimator.law(source, n), self.realizations, first)
            return TermSums.of(view.coefficients(points), estimates, partition, stored)

        def result(totals: list[TermSums]) -> xr.Dataset:
            # Compute the variables of every sampler, then join them along a dim sampler
            share, tail = view.energy(n)
            found: list[Variables] = []
            notes: dict[str, None] = {}
            if frequencies.diverge:
                notes["spectral terms are infinite: ∫1/p diverges"] = None
            for sampler, total in zip(samplers, totals, strict=True):
                own = _variables(total, view, partition)
                own |= {"energy_share": (("channel",), share), "tail_term": (("channel",), tail)}
                blind, said = blindness_of(estimator, sampler, n, total.measured)
                notes |= dict.fromkeys(said)
                own["measured_variance_ci"][1][blind, 1] = np.inf
                captured = own["captured_ci"][1]
                captured[blind, 0] = np.minimum(captured[blind, 0], 0.0)
                if is_fixed(estimator, sampler):  # The set is fixed: any variance is rounding noise
                    known = ("mean", "energy_share", "captured")
                    own = {
                        name: (dims, v if name.startswith(known) else np.zeros_like(v))
                        for name, (dims, v) in own.items()
                    }
                found.append(own)
            single = subject.sampler is samplers[0]
            variables: Variables = {}
            for name, (dims, value) in found[0].items():
                values = [own[name][1] for own in found]
                stacked = np.asarray(value)[None] if len(values) == 1 else np.stack(values)
                variables[name] = ("sampler", *dims), stacked
            if frequencies.diverge:
                variables = frequencies.undefined(
                    variables,
                    ("measured_variance", "mean", "energy_share"),
                    ("dc_term", "power_term", "tail_term"),
                )
            techniques, basis = len(view.transforms), view.basis
            batches = totals[0].all_batches(partition)

            # The coordinates of m and l are frequencies in 1-D.
            # In more dims the coordinates are an index, with the components m_0, m_1, …
            matrix: dict[str, Any] = {}
            if self.cross_matrix and basis.dims == techniques == 1:
                matrix = {"m": basis.axis, "l": basis.axis}
            elif self.cross_matrix:
                m = basis.axis[np.indices(basis.shape).reshape(basis.dims, -1)]
                for name in ("m", "l"):
                    matrix[name] = np.arange(basis.size * techniques)
                    for i in range(basis.dims):
                        matrix[f"{name}_{i}"] = (name, np.tile(m[i], techniques))
                    if techniques > 1:
                        each = np.repeat(np.arange(techniques), basis.size)
                        matrix[f"{name}_technique"] = (name, each)

            # Labels are an attribute, because zarr's specification has no arrays of strings yet
            about = {"long_name": bands.meaning, "units": "1", "labels": ", ".join(bands.labels)}
            places = np.arange(len(bands.labels))
            widths = np.arange(basis.half_width + 1)
            alone = {
                "sampler": single,
                "channel": not estimator.channels,
                "technique": techniques == 1,
            }
            return dataset(
                variables,
                {
                    **basis.coords,
                    "bound": ["low", "high"],
                    "band": ("band", places, about),
                    "band_other": ("band_other", places, about),
                    "half_width": ("half_width", widths, {"units": "cycles per unit"}),
                    **matrix,
                    **({} if single else {"sampler": [each.spec for each in samplers]}),
                },
                drop=[dim for dim, dropped in alone.items() if dropped],
                batches=0 if batches is None else batches.count,
                basis=basis.name,
                space=view.space,
                coefficients=view.source,
                engine=view.engine,
                note="; ".join(notes) or None,
            )

        return Reduction(
            kind=list[TermSums],
            block=block,
            blocks=len(blocks),
            result=result,
        )

    def _frequencies(self, subject: Subject) -> Frequencies:
        """Return the basis functions, which are the same for all samplers."""
        samplers = subject.samplers if self.basis == "auto" else subject.samplers[:1]
        found = [Frequencies.of(Subject(subject.estimator, s), self, self.n) for s in samplers]
        names = {s.spec: each.basis.name for s, each in zip(samplers, found, strict=True)}
        if len(set(names.values())) > 1:
            chosen = ", ".join(f"{basis} for {sampler}" for sampler, basis in names.items())
            raise ParameterError(
                f"basis is 'auto', which is {chosen}; name one basis, or analyze the samplers one "
                "by one."
            )
        return found[0]


def variance_terms(
    estimator: Any,
    sampler: Any,
    n: int,
    *,
    dims: int | None = None,
    half_width: int | None = None,
    realizations: int = 1000,
    rng: RngLike = 0,
    basis: str = "fourier",
    space: str | None = None,
    bands: str | Array = "radial",
    cross_matrix: bool = False,
    engine: str = "auto",
    eps: float = 1e-9,
    max_evaluations: int | None = None,
    workers: int | None = None,
) -> xr.Dataset:
    """Predict the variance of an estimator from spectra, term by term, and measure it.

    Parameters
    ----------
    estimator, sampler, n
        The estimator with one sampler, or with a list of different samplers.
        Samplers of a list use the same random numbers.
        Technique t draws n c_t points, where c_t is its entry in the ``counts`` of the estimator.
    dims
        Number of dims of a function, or of a spec without ``dims``.
        The default is the number of dims of the sampler, unless the sampler is a spec.
    half_width
        Frequencies m run over {−half_width … half_width}^d.
        The default is 64, or the power of two near 2 n^(1/d) if that is larger.
        The default is smaller if f has only rounding noise at the highest frequencies.
        The number of frequencies is at most 2^17 by default.
    realizations
        Number of independent realizations, at least 2.
    rng
        Seed (SPEC 7). Realization r uses the points of ``sampler.draw(n, rng=rng, first=r)``.
    basis
        The basis is ``"fourier"``, ``"cosine"``, ``"walsh"`` or ``"haar"``
        (`mcspectra.spectra.bases`).
        ``"auto"`` is the basis that fits the sampler's randomization.
        The attribute ``basis`` names the basis. It must fit all samplers of a list.
    space
        ``"domain"`` uses f with the warped, weighted points, like the reproduced paper.
        ``"primary"`` uses g(u) with the sampler's own points.
        The primary view shows discontinuities of the warp.
        The default is the domain view, if there is a domain.
    bands
        One of the partitions ``"radial"``, ``"dyadic"``, ``"anova"`` and ``"wedge"``.
        Another choice is an array with an integer label ≥ 0 for every basis function.
        The function `mcspectra.measure.views.make_bands` describes the partitions into bands.
    cross_matrix
        Whether to return C_ml and conj(f_m) f_l C_ml in full, for at most 4096 frequencies.
    engine, eps
        See `mcspectra.spectra.transforms`.
    workers
        Number of threads. The default is all processors. It has no effect on results.
    max_evaluations
        Maximum number of evaluations of the integrand.
        If an analysis needs more evaluations, an error is raised, usually before the start.

    Returns
    -------
    xarray.Dataset
        ``dc_term``, ``power_term`` and ``cross_term`` are the three terms.
        ``predicted_variance`` is the sum of the three terms,
        and ``measured_variance`` is the sample variance of the estimates.
        The terms, their sum and the measured variance have 95 % intervals ``_ci``.
        ``captured`` with ``_ci`` is predicted/measured.
        ``captured`` is NaN if the measured variance is rounding noise.

        ``energy_share`` is the part of ∫f² within the half width.
        ``tail_term`` is the variance of all frequencies beyond the half width, for random points.
        ``contribution`` and ``power_contribution`` are maps on m0, m1, ….
        ``band_covariance(band, band_other)`` is the covariance of the estimates of two bands.
        ``truncated_variance(half_width)`` is the predicted variance for each smaller half width.
        ``captured_by_half_width(half_width)`` is ``truncated_variance`` over the measured variance.
        With `cross_matrix` there are ``coefficient_covariance(m, l)`` and ``cross_matrix(m, l)``.

        A list of samplers adds a dim sampler, and several channels add a dim channel.
        Several techniques in primary space add a dim technique on maps.

        Standard errors ``_se`` come from batch means and need at least 4 realizations.
        The terms, ``contribution``, ``band_covariance`` and both matrices have standard errors.
        The attribute ``batches`` is the number of batches.
        95 % intervals use Student's t. Its degrees of freedom are the number of batches minus one.
        The interval of ``captured`` is logarithmic.
        The interval of ``captured`` is wider if most of the error comes from a few batches.

        A set that is always the same has no variance, which the attribute ``note`` reports.
        The note also names estimates that may have missed most of the variance (see `convergence`).
        If estimates may have missed most of the variance, ``measured_variance_ci`` ends at ∞.
        If estimates may have missed most of the variance, the lower end of ``captured_ci`` is 0.

    Raises
    ------
    ParameterError
        If a value is out of range, dims disagree, or the matrix would be too large.

    Warns
    -----
    InfiniteWeightVarianceWarning
        If ∫1/p diverges, where p is the density of the points.
        The terms of the domain view are then infinite and given as NaN or infinity.

    Notes
    -----
    The time is O(R (n + M log M)) for R realizations of n points and M frequencies.
    The memory is O(M + bands²).
    95 % intervals follow from the kurtosis of the estimates.
    A truncated spectrum predicts part of the variance, which ``captured`` reports.
    The function `mcspectra.predict` predicts the whole variance.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> estimator = mcs.Estimator("linear", dims=1)
    >>> terms = mcs.variance_terms(estimator, "jittered", 8, realizations=200, rng=1)
    >>> bool(terms["cross_term"] < 0 < terms["power_term"])
    True
    """
    subject = as_subject(estimator, sampler, dims=dims, lists=True)
    return compute(Terms.of(locals()), subject, rng, workers)


def _variables(total: TermSums, view: View, partition: Partition) -> Variables:
    """Return all variables with a channel axis first. Errors are NaN for fewer than two blocks."""
    sums, measured, basis = total.sums, total.measured, view.basis
    batches = total.all_batches(partition)
    assert batches is not None  # The first block has at least two realizations
    f, degrees = partition.coefficients, sums.count - 1
    shape = (len(f), len(view.transforms), basis.stored)
    maps, pairs = ("channel", "technique", *basis.names), ("channel", "band", "band_other")
    by_width = ("channel", "half_width")

    def interval(value: Array, half: Array) -> tuple[tuple[str, ...], Array]:
        return ("channel", "bound"), np.stack([value - half, value + half], axis=-1)

    # Add the terms, their sum, and the measured variance, with their intervals
    terms = np.stack(sums.terms(partition))
    predicted = terms[0] + terms[1] + terms[2]
    variables: Variables = {
        "predicted_variance": (("channel",), predicted),
        "predicted_variance_ci": (("channel", "bound"), _predicted_ci(total, batches)),
        "measured_variance": (("channel",), measured.variance),
        "measured_variance_ci": (("channel", "bound"), measured.variance_ci),
        "mean": (("channel",), measured.mean),
        "mean_se": (("channel",), measured.mean_se),
    }
    for name, value, error in zip(_TERMS, terms, batches.term_errors(), strict=True):
        variables[name] = ("channel",), value
        variables[f"{name}_se"] = ("channel",), error
        variables[f"{name}_ci"] = interval(value, student_t(batches.count) * error)

    # The captured part of the variance is NaN if the variance is rounding noise
    real = np.where(measured.variance > rounding_floor(measured.mean), measured.variance, np.nan)
    with np.errstate(invalid="ignore"):  # 0 · ∞ is NaN if the frequencies have no power
        captured_ci = (predicted / real)[:, None] * batches.captured_factors()
    variables |= {
        "captured": (("channel",), predicted / real),
        "captured_ci": (("channel", "bound"), captured_ci),
        "truncated_variance": (by_width, sums.truncated.variance),
        "captured_by_half_width": (by_width, sums.truncated.variance / real[:, None]),
    }

    # Store maps over frequencies, and covariances of pairs of bands
    diagonal = np.abs(f) ** 2 * (sums.m2 / degrees)
    for name, values in (
        ("contribution", sums.contribution(partition)),
        ("contribution_se", batches.contribution.error()),
        ("power_contribution", diagonal),
        ("integrand_power", np.abs(f) ** 2),
    ):
        variables[name] = maps, basis.full(values.reshape(shape))
    variables["band_covariance"] = pairs, sums.band_m2 / degrees
    variables["band_covariance_se"] = pairs, batches.band_covariance.error()

    # Compute the matrices of C_ml and of conj(f_m) f_l C_ml.
    # In the second matrix, the errors of C_ml are multiplied by |f_m f_l|
    if sums.matrix is not None and batches.matrix is not None:
        # Find the position of each coefficient of each technique among the stored coefficients.
        # Also find out whether the stored coefficient is conjugated
        techniques, (place, conjugate) = len(view.transforms), basis.whole()
        index = (np.arange(techniques)[:, None] * basis.stored + place).ravel()
        flip = np.tile(conjugate, techniques)
        c = _signed(sums.matrix / degrees, index, flip)
        error = _signed(batches.matrix.error(), index, flip)
        g = np.where(flip, f[:, index].conj(), f[:, index])
        size = np.abs(g)
        triple = ("channel", "m", "l")
        variables |= {
            "coefficient_covariance": (("m", "l"), c),
            "coefficient_covariance_se": (("m", "l"), error),
            "cross_matrix": (triple, g.conj()[:, :, None] * g[:, None, :] * c),
            "cross_matrix_se": (triple, size[:, :, None] * size[:, None, :] * error),
        }
    return variables


def _predicted_ci(total: TermSums, batches: Batches) -> Array:
    """Return a 95 % interval of dc + power + cross, (C, 2), wider if few sets are stored."""
    truncated = total.sums.truncated
    interval = truncated.variance_ci[:, -1]
    if total.by_group is None or batches.count < 2:
        return interval if total.by_group is None else np.full_like(interval, np.nan)
    value, sums = truncated.variance[:, -1], batches.values[:, :3].sum(axis=1)
    error = spread(sums - weighted_sum(batches.share, sums), batches.share)
    with np.errstate(invalid="ignore", divide="ignore"):
        factor = np.exp(student_t(batches.count) * error / value)
    ends = np.stack([value / factor, value * factor], axis=-1)
    return np.stack(
        [np.fmin(interval[:, 0], ends[:, 0]), np.fmax(interval[:, 1], ends[:, 1])], axis=-1
    )


def _signed(stored: Array, index: Array, flip: Array) -> Array:
    """Return ⟨S_a conj S_b⟩ for plain or conjugated a and b, from the stored blocks.

    The left half of `stored` holds ⟨S_a conj S_b⟩, and the right half holds ⟨S_a S_b⟩.
    From S_{−l} = conj S_l follows the pseudo-covariance C_{m,−l} = Cov(S_m, conj S_l).
    In primary space the coefficients of the techniques follow one another.
    """
    size = len(stored)
    plain, pseudo = stored[:, :size][np.ix_(index, index)], stored[:, size:][np.ix_(index, index)]
    both = np.where(flip[:, None], plain.conj(), plain)
    mixed = np.where(flip[:, None], pseudo.conj(), pseudo)
    return np.asarray(np.where(flip[:, None] == flip[None, :], both, mixed))
