"""The three terms: variance of an estimator predicted and explained from spectra.

docs/theory.md, "The three terms", "Contributions and bands". No M × M matrix is stored. In primary
space every technique has its own integrand and points, and the sums run over (technique, m).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal, final

import numpy as np
from msgspec import Meta

from mcspectra.core import options
from mcspectra.core.analysis import Counted, Need, Reduction, Subject
from mcspectra.core.checks import Array
from mcspectra.core.errors import ParameterError
from mcspectra.core.memory import memory_of
from mcspectra.core.parallel import realization_blocks
from mcspectra.core.results import dataset
from mcspectra.core.streams import RngLike, Stream
from mcspectra.estimators.moments import rounding_floor
from mcspectra.measure.bands import check_bands, make_bands
from mcspectra.measure.blindness import blindness_of, is_fixed
from mcspectra.measure.doors import answer
from mcspectra.measure.sums import BATCHES, Partition, TermSums, Variables, student_t
from mcspectra.measure.views import Frequencies, View

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["MAX_MATRIX", "Terms", "variance_terms"]

MAX_MATRIX = 4096
"""Most frequencies of a full cross matrix: two of that size take 0.5 GiB."""

_TERMS = ("dc_term", "power_term", "cross_term")
_WITH_ERROR = ("contribution", "band_covariance", "coefficient_covariance", "cross_matrix")


@final
class Terms(Counted, frozen=True, kw_only=True):
    """The three terms of the variance at one n: dc, power and cross."""

    function = "variance_terms"
    verb = "variance"
    several = ("sampler",)
    split = "terms"
    variables = (
        *(f"{name}{part}" for name in _TERMS for part in ("", "_se", "_ci")),
        *(f"{name}{part}" for name in _WITH_ERROR for part in ("", "_se")),
        *(f"{name}{part}" for name in ("predicted_variance", "measured_variance", "captured")
          for part in ("", "_ci")),
        *("mean", "mean_se", "power_contribution", "truncated_variance", "captured_by_half_width"),
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
        """The spectra fit, and there are such bands."""
        estimator, several = subject.estimator, len(subject.samplers)
        for sampler in subject.samplers:
            estimator.check_sampler(sampler, self.n)
        frequencies = self._frequencies(subject)
        check_bands(self.bands, frequencies.basis)
        size, evaluations = frequencies.size, sum(estimator.counts)
        if self.cross_matrix and size > MAX_MATRIX:
            raise ParameterError(
                f"The cross matrix of {size} frequencies takes {32 * size**2 / 2**30:.3g} GiB; ask "
                f"for at most {MAX_MATRIX} frequencies, or use contribution and band_covariance."
            )
        kept = several * (size + (2 * size * size if self.cross_matrix else 0))
        each = self.realizations * evaluations * self.n * estimator.evaluations_per_point
        return Need(
            cost=float(several * self.realizations * (evaluations * self.n + size)),
            memory=memory_of(self.n, estimator.dims, evaluations, kept),
            evaluations=several * each,
        )

    def reduction(self, subject: Subject, stream: Stream) -> Reduction[list[TermSums]]:
        """Sums over all realisations of each sampler; a block is a batch too."""
        estimator, samplers, n = subject.estimator, subject.samplers, self.n
        frequencies = self._frequencies(subject)
        view = frequencies.view(n, self)
        bands = make_bands(self.bands, view.basis)
        partition = view.partition(bands.of, self.cross_matrix)
        # Coordinates of a realisation or, where they are more, the numbers of its spectra
        numbers = max(n * estimator.dims * sum(estimator.counts), 2 * partition.double.size)
        blocks = realization_blocks(self.realizations, numbers, multiple=2, least=BATCHES)

        def block(index: int) -> list[TermSums]:
            return [sums_of(estimator.draw(s, n, stream, *blocks[index])) for s in samplers]

        def sums_of(points: list[Array]) -> TermSums:
            estimates = estimator.estimate(points).reshape(len(points[0]), -1)
            return TermSums.of(view.coefficients(points), estimates, partition)

        def result(totals: list[TermSums]) -> xr.Dataset:
            # The variables of every sampler, then all of them on a dim sampler
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
                if is_fixed(estimator, sampler):  # what is left is rounding
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

            # Frequencies along m and l: themselves in 1-D, else a running number with m_0, m_1 … beside it
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

            # Labels as an attribute: arrays of strings have no place in zarr's specification yet.
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
                batches=totals[0].batches.count if totals[0].batches else 0,
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
            cost=self.need(subject).cost,
            result=result,
        )

    def _frequencies(self, subject: Subject) -> Frequencies:
        """The basis functions, which are the same for all samplers."""
        samplers = subject.samplers if self.basis == "auto" else subject.samplers[:1]
        found = [Frequencies.of(Subject(subject.estimator, s), self, self.n) for s in samplers]
        names = {s.spec: each.basis.name for s, each in zip(samplers, found, strict=True)}
        if len(set(names.values())) > 1:
            chosen = ", ".join(f"{basis} for {sampler}" for sampler, basis in names.items())
            raise ParameterError(
                f"basis is 'auto', which is {chosen}; name one basis, or analyze the samplers one by one."
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
    """Predict the variance of an estimator from spectra, term by term, and measure it beside.

    Parameters
    ----------
    estimator, sampler, n
        What is analysed: an estimator with one sampler or a list of different ones, which share
        realisations' random numbers; `n` counts each technique's points in units of its ``counts``.
    dims
        Number of dims of a function, and of a spec that leaves it open; by default those of a sampler
        that is not a spec.
    half_width
        Frequencies m run over {−half_width … half_width}^d. By default 64, or twice n^(1/d) as a power
        of two where that is more; fewer where f has none beyond, or there would be more than 2^17.
    realizations
        Independent realisations, at least 2.
    rng
        Seed (SPEC 7). Realisation r uses the points of ``sampler.draw(n, rng=rng, first=r)``.
    basis
        ``"fourier"``, ``"cosine"``, ``"walsh"`` or ``"haar"`` (`mcspectra.spectra.bases`), or ``"auto"``:
        the one that fits the sampler's randomisation, which the attribute ``basis`` then names; a
        list of samplers needs one that fits them all.
    space
        ``"domain"``: f with the warped, weighted points (the paper's view); ``"primary"``: g(u) with
        the sampler's own points, where discontinuities made by the warp are visible. By default the
        domain, where there is one.
    bands
        ``"radial"``, ``"dyadic"``, ``"anova"``, ``"wedge"``, or an integer label ≥ 0 for every basis
        function: `mcspectra.measure.bands.make_bands`.
    cross_matrix
        Also return C_ml and conj(f_m) f_l C_ml in full, for at most `MAX_MATRIX` frequencies.
    engine, eps
        See `mcspectra.spectra.transforms`.
    workers
        Threads; all processors by default. Results do not depend on it.
    max_evaluations
        Most evaluations of the integrand: what takes more is refused, where that is known before it starts.

    Returns
    -------
    xarray.Dataset
        ``dc_term``, ``power_term``, ``cross_term``, ``predicted_variance`` (their sum) with ``_ci``,
        ``measured_variance`` with ``_ci``, ``captured`` with ``_ci`` (predicted/measured, NaN where the
        measured variance is rounding noise), ``energy_share``, the part of ∫f² within the half width, and
        ``tail_term``, the variance of the rest if points were random to it, ``contribution`` and ``power_contribution`` on m0, m1,
        …, ``band_covariance(band, band_other)``, ``truncated_variance(half_width)`` and
        ``captured_by_half_width(half_width)``; a dim sampler for a list, a dim channel where f has
        several, a dim technique on maps of a primary space with several. With `cross_matrix`, ``coefficient_covariance(m, l)``
        and ``cross_matrix(m, l)``. Standard errors ``_se`` of the terms, ``contribution``,
        ``band_covariance`` and both matrices, and ``_ci`` of the terms, by batch means (from 4
        realisations on): their number is the attribute ``batches``, and 95 % is Student's t with one
        degree of freedom less; that of ``captured`` is of its logarithm, wider where few batches
        hold most of the error. A set that is the same every time has no variance; the attribute ``note``
        says so, and, as that of `convergence`, where the estimates missed what makes theirs: the upper
        end of ``measured_variance_ci`` is then infinite, and the lower one of ``captured_ci`` 0.

    Raises
    ------
    ParameterError
        A value is out of range, dims disagree, or the matrix would be too large.

    Warns
    -----
    InfiniteWeightVarianceWarning
        ∫1/p diverges: the terms are infinite in the domain view and are given as NaN or infinity.

    Notes
    -----
    O(R (n + M log M)) time and O(M + bands²) memory. 95 % intervals follow from the kurtosis of the
    estimates. A truncated spectrum predicts part of the variance: see ``captured``; `mcspectra.predict`
    predicts all of it.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> estimator = mcs.Estimator("linear", dims=1)
    >>> terms = mcs.variance_terms(estimator, "jittered", 8, realizations=200, rng=1)
    >>> bool(terms["cross_term"] < 0 < terms["power_term"])
    True
    """
    return answer(Terms, locals())


def _variables(total: TermSums, view: View, partition: Partition) -> Variables:
    """All result variables with a leading channel axis; errors are NaN where no two blocks say them."""
    sums, measured, batches, basis = total.sums, total.measured, total.batches, view.basis
    assert batches is not None  # the first block has two realisations at least
    f, degrees = partition.coefficients, sums.count - 1
    shape = (len(f), len(view.transforms), basis.stored)
    maps, pairs = ("channel", "technique", *basis.names), ("channel", "band", "band_other")
    by_width = ("channel", "half_width")

    def interval(value: Array, half: Array) -> tuple[tuple[str, ...], Array]:
        return ("channel", "bound"), np.stack([value - half, value + half], axis=-1)

    # The terms, their sum, and what is measured beside
    terms = np.stack(sums.terms(partition))
    predicted = terms[0] + terms[1] + terms[2]
    variables: Variables = {
        "predicted_variance": (("channel",), predicted),
        "predicted_variance_ci": (("channel", "bound"), sums.truncated.variance_ci[:, -1]),
        "measured_variance": (("channel",), measured.variance),
        "measured_variance_ci": (("channel", "bound"), measured.variance_ci),
        "mean": (("channel",), measured.mean),
        "mean_se": (("channel",), measured.mean_se),
    }
    for name, value, error in zip(_TERMS, terms, batches.term_errors(), strict=True):
        variables[name] = ("channel",), value
        variables[f"{name}_se"] = ("channel",), error
        variables[f"{name}_ci"] = interval(value, student_t(batches.count) * error)

    # What part of the variance the frequencies hold; one of rounding noise captures nothing
    real = np.where(measured.variance > rounding_floor(measured.mean), measured.variance, np.nan)
    with np.errstate(invalid="ignore"):  # 0 times infinity where nothing is captured
        captured_ci = (predicted / real)[:, None] * batches.captured_factors()
    variables |= {
        "captured": (("channel",), predicted / real),
        "captured_ci": (("channel", "bound"), captured_ci),
        "truncated_variance": (by_width, sums.truncated.variance),
        "captured_by_half_width": (by_width, sums.truncated.variance / real[:, None]),
    }

    # Maps over frequencies, and pairs of bands
    diagonal = np.abs(f) ** 2 * (sums.m2 / degrees)
    for name, values in (
        ("contribution", sums.contribution(partition)),
        ("contribution_se", batches.contribution.error()),
        ("power_contribution", diagonal),
    ):
        variables[name] = maps, basis.full(values.reshape(shape))
    variables["band_covariance"] = pairs, sums.band_m2 / degrees
    variables["band_covariance_se"] = pairs, batches.band_covariance.error()

    # Full C_ml and conj(f_m) f_l C_ml; errors of conjugates are the same, |f_m f_l| scales them
    if sums.matrix is not None and batches.matrix is not None:
        # Of each coefficient of each technique: its place among those stored, whether conjugate
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


def _signed(stored: Array, index: Array, flip: Array) -> Array:
    """⟨S_a conj S_b⟩ for a, b plain or conjugated, from the stored blocks with and without conj.

    S_{−l} = conj S_l gives C_{m,−l} = Cov(S_m, conj S_l), the pseudo-covariance. In primary space
    the coefficients of the techniques follow one another.
    """
    size = len(stored)
    plain, pseudo = stored[:, :size][np.ix_(index, index)], stored[:, size:][np.ix_(index, index)]
    both = np.where(flip[:, None], plain.conj(), plain)
    mixed = np.where(flip[:, None], pseudo.conj(), pseudo)
    return np.asarray(np.where(flip[:, None] == flip[None, :], both, mixed))
