"""Laws of samplers agree with their declared properties and their points."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
from tests.samplers.rows import ROWS

import mcspectra as mcs
from mcspectra.core.errors import CountError, NoClosedForm, ParameterError
from mcspectra.core.streams import Stream
from mcspectra.prediction.known import Known
from mcspectra.prediction.prediction import predicted
from mcspectra.samplers import RANDOMIZATIONS
from mcspectra.samplers.law import (
    Choice,
    Fixed,
    Folded,
    GroupedAxes,
    Independent,
    Law,
    Mirrored,
    Moved,
    PairedAxes,
    Scrambled,
    Shifted,
    Stationary,
    Strata,
    Unknown,
    independent_sets,
    latin_hypercube,
    scrambled,
    shifted,
)
from mcspectra.spectra.closed_forms import moments_of
from mcspectra.testing import check_sampler

ROOTS = {
    "random": Independent,
    "jittered": Strata,
    "antithetic-jittered": Strata,
    "box-jitter": Strata,
    "regular": Fixed,
    "uniform-jitter": Shifted,
    "latin-hypercube": PairedAxes,
    "n-rooks": PairedAxes,
    "multi-jittered": PairedAxes,
    "sobol": Fixed,
    "halton(scramble='owen')": Scrambled,
    "rank1-lattice": Fixed,
    "kronecker": Fixed,
    "pmj": Choice,
    "pmj02": Scrambled,
    "poisson-disk": Stationary,
    "determinantal": Stationary,
    "perturbed-lattice": Stationary,
    "correlated-multi-jittered": Unknown,
    "random | shift": Independent,
    "jittered | shift": Shifted,
    "jittered | strata-shift": Moved,
    "jittered | owen": Strata,
    "latin-hypercube | shuffle": PairedAxes,
    "rank1-lattice | shift | strata-shift": Shifted,
    "sobol | digital-shift": Scrambled,
    "sobol | shift | mirror(mode='fold')": Folded,
    "jittered | mirror": Mirrored,
    "poisson-disk | shift": Stationary,
    "poisson-disk | random-rotation": Stationary,
    "jittered | subset": Strata,
    "sobol | skip(count=64)": Fixed,
}


@pytest.mark.parametrize(("spec", "root"), ROOTS.items())
def test_the_root_of_a_law(spec, root):
    sampler = mcs.sampler(spec, dims=2)
    law = sampler.law(sampler.nearest_count(64))
    assert type(law) is root
    assert law.dims == 2


def test_successive_scrambles_become_the_strongest_one():
    law = mcs.sampler("sobol | digital-shift | lms | permute", dims=2).law(64)
    assert isinstance(law, Scrambled)
    assert (law.kind, law.nested_pairs, law.xor) == ("linear", True, False)
    alone = mcs.sampler("sobol | lms(shift=False)", dims=2).law(64)
    assert not alone.uniform
    assert not alone.nested_pairs
    assert mcs.sampler("sobol | lms(shift=False) | digital-shift", dims=2).law(64).nested_pairs


STEPS = ["", *(f" | {name}" for name in RANDOMIZATIONS)]


@pytest.mark.parametrize(
    "row", [row for row in ROWS if "{path}" not in row.spec], ids=lambda row: row.spec
)
def test_laws_agree_with_declared_properties(row):
    """Uniformity, fixed sets and counts, for every sampler with every step that it accepts."""
    dims, count = next(iter(row.counts.items()))
    for step in STEPS:
        try:
            sampler = mcs.sampler(f"{row.spec}{step}", dims=dims)
            n = sampler.check_count(sampler.nearest_count(count))
        except (ParameterError, CountError):
            continue
        law = sampler.law(n)
        assert (law.n, law.dims) == (n, dims), sampler.spec
        if sampler.as_chain(n).fixed:
            assert law.fixed, sampler.spec
        if sampler.unbiased:
            assert law.uniform, sampler.spec


def test_the_count_inside_mirror_images():
    law = mcs.sampler("jittered | mirror(mode='uniform')", dims=2).law(64)
    assert (law.n, law.inner.n) == (64, 16)


@pytest.mark.parametrize(
    ("spec", "sets"),
    [("poisson-disk", None), ("void-and-cluster(sets=3) | shift", 3), ("sobol | owen", None)],
)
def test_independent_sets(spec, sets):
    assert independent_sets(mcs.sampler(spec, dims=2).law(16)) == sets


def test_errors_of_power_follow_the_number_of_sets():
    """Errors of realizations that repeat four sets must not fall as for independent sets."""
    sampler = mcs.sampler("gaussian-blue-noise(sets=4, iterations=20) | shift", dims=2)
    errors = []
    for realizations in (4, 40, 160):
        found = mcs.power_spectrum(sampler, 16, half_width=4, realizations=realizations, rng=1)
        errors.append(found["power_se"].to_numpy())
        assert found.attrs["student_t"] == pytest.approx(3.182446, rel=1e-6)
    np.testing.assert_allclose(errors[1], errors[0], rtol=0.02)
    np.testing.assert_allclose(errors[2], errors[0], rtol=0.02)


def test_nested_and_linear_scrambles_have_one_variance():
    """Both have the same law of pairs; lms once fell back to an extrapolation in four dims."""
    f = mcs.integrand("genz-gaussian", dims=4)
    found = mcs.predict(f, ["sobol | owen", "sobol | lms"], [64])
    owen, lms = (found.isel(sampler=i) for i in (0, 1))
    assert lms["method"].values.tolist() == owen["method"].values.tolist()
    np.testing.assert_allclose(lms["predicted_variance"], owen["predicted_variance"], rtol=1e-12)


def test_offsets_of_the_probe_are_not_the_points():
    """Points and offsets were once multiples of one vector: 0.24 of the variance in 4-D, ± 7 %."""
    f = mcs.Integrand.from_function(lambda x: (((x - 0.5) ** 2).sum(-1) < 0.2) * 1.0, dims=4)
    n = 1024
    found = mcs.predict(f, "kronecker | shift", [n])
    low, high = found["predicted_variance_ci"].values[0]
    sampler = mcs.sampler("kronecker | shift", dims=4)
    values = f(sampler.draw(n, realizations=2000, rng=5)).mean(axis=1)
    error = 4 * values.var(ddof=1) * np.sqrt(2 / 1999)  # four standard errors
    assert low - error < values.var(ddof=1) < high + error


@dataclass(frozen=True, kw_only=True)
class Slabs(mcs.Sampler):
    """One uniform point in each of n slabs along the first axis: an external sampler with a law."""

    name: ClassVar[str] = "slabs"
    dims: int = 3

    def _points(self, n, stream, first, count):
        x = stream.uniforms(first, count, n * self.dims).reshape(count, n, self.dims)
        x[..., 0] = np.minimum((np.arange(n) + x[..., 0]) / n, np.nextafter(1.0, 0.0))
        return x

    def _law(self, n: int) -> Law:
        return Strata(n=n, dims=self.dims, sides=(n, *(1,) * (self.dims - 1)))


class TestExternalSamplerWithLaw:
    """Predictions for an external sampler follow from its law."""

    sampler = Slabs()
    integrand = mcs.integrand("gaussian(center=0.3, width=0.4)", dims=3)

    def test_exact_and_measured_variances(self):
        exact = mcs.exact_variance(self.integrand, self.sampler, 16)
        curve = mcs.convergence(self.integrand, self.sampler, [16], realizations=2000, rng=1)
        low, high = curve["variance_ci"].values[0]
        assert low < exact < high

    def test_prediction(self):
        found = mcs.predict(self.integrand, self.sampler, [16, 64])
        exact = [mcs.exact_variance(self.integrand, self.sampler, n) for n in (16, 64)]
        np.testing.assert_allclose(found["predicted_variance"], exact, rtol=1e-2)
        assert found["method"].values.tolist() == ["exact", "exact"]

    def test_closed_forms(self):
        m = np.array([[1, 0, 0], [0, 1, 0], [16, 0, 0], [2, 1, -1]])
        power = mcs.closed_form_power(self.sampler, 16, m)
        spectrum = mcs.power_spectrum(self.sampler, 16, half_width=16, realizations=200, rng=2)
        measured, se = (
            np.array([float(spectrum[v].sel(m0=a, m1=b, m2=c)) for a, b, c in m])
            for v in ("power", "power_se")
        )
        assert (np.abs(measured - power) < 5 * se + 1e-12).all()

    def test_plan_and_profile(self):
        planned = mcs.plan(self.integrand, self.sampler, target_error=1e-2)
        assert np.isfinite(planned["planned_n"])
        found = mcs.profile(self.integrand, sampler=self.sampler, budget=1024)
        assert "slabs" in str(found)

    @pytest.mark.slow  # `TestGroupedAxes` has a quicker bench
    def test_bench(self):
        found = mcs.sampler_bench(
            [self.sampler, "random"], counts=[16, 64], dims=[3], realizations=20
        )
        assert self.sampler.spec in found["sampler"].values


@dataclass(frozen=True, kw_only=True)
class LatticeWithStrata(mcs.Sampler):
    """A shifted rank-1 lattice in 3 of 5 dims, and jittered points in random order in the rest."""

    name: ClassVar[str] = "lattice-with-strata"
    min_dims: ClassVar[int] = 5
    max_dims: ClassVar[int | None] = 5
    dims: int = 5

    def _points(self, n, stream, first, count):
        side = round(n**0.5)
        steps = np.arange(n)[:, None] * self.vector(n) % n / n
        x = (steps + stream.child(1).uniforms(first, count, 3)[:, None]) % 1.0
        inside = stream.child(2).uniforms(first, count, 2 * n).reshape(count, n, 2)
        y = (np.stack(np.divmod(np.arange(n), side), axis=1) + inside) / side
        order = stream.child(3).uniforms(first, count, n).argsort(axis=1)
        y = np.take_along_axis(y, order[..., None], axis=1)
        return np.minimum(np.concatenate([x, y], axis=2), np.nextafter(1.0, 0.0))

    @staticmethod
    def vector(n):
        return np.array([1, 19, 19**2 % n])

    def _counts_near(self, n):
        side = int(n**0.5)
        return side**2 or None, side**2 if side**2 == n else (side + 1) ** 2

    def _law(self, n: int) -> Law:
        side = round(n**0.5)
        lattice = Fixed(n=n, dims=3, vector=tuple(self.vector(n).tolist()), even=True)
        strata = Strata(n=n, dims=2, sides=(side, side))
        return GroupedAxes(n=n, dims=5, parts=(shifted(lattice), strata))


class TestGroupedAxes:
    """An external sampler whose groups of axes have different laws."""

    sampler = LatticeWithStrata()

    def test_the_contract_of_samplers(self):
        check_sampler(self.sampler)

    def test_closed_forms_of_power_and_covariance(self):
        rng = np.random.default_rng(1)
        m, other = rng.integers(-2, 3, (2, 40, 5))
        other[:20] = m[:20]
        m[-2:], other[-2:] = (
            [[0, 0, 0, 1, 0], [0, 0, 0, 1, 2]],
            [[0, 0, 0, -1, 0], [0, 0, 0, 1, -2]],
        )
        points, n = self.sampler.draw(16, realizations=8000, rng=2), 16
        s, t = (np.exp(-2j * np.pi * points @ k.T).mean(axis=1) for k in (m, other))
        products = (s - s.mean(axis=0)) * (t - t.mean(axis=0)).conj()
        exact = mcs.spectra.closed_form_covariance(self.sampler, n, m, other)
        error = products.std(axis=0) / np.sqrt(len(points))
        # Approximately normal: 40 numbers, each within 4.5 standard errors
        assert (np.abs(products.mean(axis=0) - exact) < 4.5 * error + 1e-12).all()
        power = mcs.closed_form_power(self.sampler, n, m)
        own = np.abs(s) ** 2
        off = np.abs(own.mean(axis=0) - power)
        assert (off < 4.5 * own.std(axis=0) / np.sqrt(len(points)) + 1e-12).all()

    @pytest.mark.parametrize(
        ("cosines", "sines"),
        [
            ([[1, -1, 0, 1, 0], [0, 0, 0, 0, 1]], [[0, 0, 1, 0, 1]]),
            pytest.param(
                [[1, 0, 0, 1, 0], [1, 0, 0, -1, 0], [0, 1, 0, 0, 0]],
                [[0, 0, 0, 1, -1]],
                marks=pytest.mark.slow,
            ),
        ],
    )
    def test_variances_of_waves_that_mix_both_groups(self, cosines, sines):
        """Sums over pairs of frequencies give the whole variance."""

        def waves(x):
            turns = (2 * np.pi * (x @ np.array(m, float).T) for m in (cosines, sines))
            return sum(h(t).sum(-1) for h, t in zip((np.cos, np.sin), turns, strict=True))

        f = mcs.Integrand.from_function(waves, dims=5, integral=0.0)
        predicted = mcs.predict(f, self.sampler, [64], method="covariance", half_width=1)
        means = waves(self.sampler.draw(64, realizations=3000, rng=3)).mean(axis=1)
        found, measured = float(predicted["predicted_variance"][0]), means.var(ddof=1)
        assert abs(found - measured) < 4.5 * measured * np.sqrt(2 / 2999)

    @pytest.mark.parametrize(
        "text",
        [
            pytest.param("exp(x0+x1/2+x2/3+x3+x4/2)", marks=pytest.mark.slow),
            pytest.param("where(x0+x1-x3+0.5*x4<0.6,1,0)", marks=pytest.mark.slow),
            pytest.param("max(x2+x3-1,0)*x1", marks=pytest.mark.slow),
        ],
    )
    def test_predictions_of_functions_that_mix_both_groups(self, text):
        """Intervals from pairs of points (with a shift) or from other counts cover the variance."""
        f = mcs.integrand(f"formula(expression='{text}')", dims=5)
        samplers = [self.sampler, self.sampler.then(mcs.samplers.Shift())]
        found = mcs.predict(f, samplers, [64]).isel(n=0)
        for i, sampler in enumerate(samplers):
            curve = mcs.convergence(f, sampler, [64], realizations=4000, rng=4)
            measured, spec = float(curve["variance"][0]), sampler.spec
            low, high = found["predicted_variance_ci"].values[i]
            # 4.5 standard errors of 2.2 %
            assert low - 0.1 * measured < measured < high + 0.1 * measured, spec
        if "where" not in text:  # jumps across many axes take other counts
            assert str(found["method"].values[1]) != "extrapolated"

    def test_predictions_of_a_product_that_mixes_both_groups(self):
        """Pairs of shifted points give the variance of a product, whose fit is quick."""

        def product(x):
            return (1.0 + x[..., 1]) * np.exp(x[..., 2] - x[..., 3]) * (1.0 + x[..., 4] ** 2)

        integral = 1.5 * (np.e - 1.0) * (1.0 - np.exp(-1.0)) * 4.0 / 3.0
        f = mcs.Integrand.from_function(product, dims=5, integral=integral)
        sampler = self.sampler.then(mcs.samplers.Shift())
        found = predicted(sampler.law(64), Known(f), Stream.from_rng(0), "auto")
        means = product(sampler.draw(64, realizations=2000, rng=4)).mean(axis=1)
        # 4.5 standard errors of 3.2 %
        assert abs(found.variance[0] - means.var()) < found.error[0] + 0.14 * means.var()
        assert found.error[0] < 0.3 * found.variance[0]  # Eight drawn lattices are shifted
        assert found.method != "extrapolated"
        with pytest.raises(NoClosedForm, match="No law of pairs"):  # Other counts are measured
            mcs.predict(f, self.sampler, [64], method="subsets", max_evaluations=2**30)

    def test_profile_and_bench(self):
        f = mcs.integrand("genz-gaussian", dims=5)
        assert "lattice-with-strata" in str(mcs.profile(f, sampler=self.sampler, budget=1024))
        found = mcs.sampler_bench(
            [self.sampler, "random"], counts=[16, 64], dims=[5], realizations=20
        )
        assert np.isfinite(found["rate"].sel(sampler=self.sampler.spec)).all()

    def test_randomizations_wrap_products(self):
        law = self.sampler.law(16)
        assert (shifted(law).stationary, law.stationary, law.uniform) == (True, False, True)
        parts = tuple(shifted(part) for part in law.parts)
        both = GroupedAxes(n=16, dims=5, parts=parts)
        assert shifted(both) is both
        shift = self.sampler.then(mcs.samplers.Shift())
        m = np.array([[1, 0, 0, 1, 0], [0, 0, 0, 4, 0], [0, 0, 0, 1, 0]])
        power = mcs.closed_form_power(shift, 16, m)
        np.testing.assert_allclose(power, mcs.closed_form_power(self.sampler, 16, m))
        # Strata in powers of the base keep their law, and the lattice is scrambled separately
        lattice = scrambled(law.parts[0], "digital-shift", (2,) * 3)
        assert isinstance(lattice, Scrambled)
        net = Fixed(n=4, dims=2, bases=(2, 2), digital=True).of(mcs.sampler("sobol", dims=2))
        strata = Strata(n=4, dims=1, sides=(4,))
        product = scrambled(GroupedAxes(n=4, dims=3, parts=(net, strata)), "nested", (2,) * 3)
        own = GroupedAxes(n=4, dims=3, parts=(scrambled(net, "nested", (2, 2)), strata))
        m = np.random.default_rng(1).integers(-5, 6, (30, 3)).astype(float)
        np.testing.assert_allclose(
            moments_of(product, "product", m).power(m), moments_of(own, "own", m).power(m)
        )


def test_a_latin_hypercube_is_a_product_of_strata_of_single_axes():
    n, m = 8, np.random.default_rng(1).uniform(-9, 9, (50, 3))
    other = m[::-1].copy()
    single = Strata(n=n, dims=1, sides=(n,))
    product = moments_of(GroupedAxes(n=n, dims=3, parts=(single,) * 3), "product", m, other)
    latin = moments_of(latin_hypercube(n, 3), "latin", m, other)
    np.testing.assert_allclose(product.power(m), latin.power(m), atol=1e-14)
    np.testing.assert_allclose(product.covariance(m, other), latin.covariance(m, other), atol=1e-14)
    # Groups may consist of any axes
    pair = Strata(n=9, dims=2, sides=(3, 3))
    split = GroupedAxes(
        n=9, dims=3, parts=(pair, Strata(n=9, dims=1, sides=(9,))), axes=((0, 2), (1,))
    )
    straight = GroupedAxes(n=9, dims=3, parts=split.parts)
    swap = [0, 2, 1]
    np.testing.assert_allclose(
        moments_of(split, "split", m).power(m),
        moments_of(straight, "straight", m).power(m[:, swap]),
        atol=1e-14,
    )


@pytest.mark.parametrize(
    ("n", "axes", "words"),
    [(8, ((0,), (0,)), "list each of its 2 axes once"), (9, ((0,), (1,)), "must have n = 9")],
)
def test_groups_with_wrong_axes_or_counts_are_refused(n, axes, words):
    part = Strata(n=8, dims=1, sides=(8,))
    with pytest.raises(ParameterError, match=words):
        GroupedAxes(n=n, dims=2, parts=(part, part), axes=axes)
