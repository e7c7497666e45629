"""Laws of samplers: what they state agrees with what is declared and drawn, and all that follows from them."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
from tests.samplers.rows import ROWS

import mcspectra as mcs
from mcspectra.core.errors import CountError, ParameterError
from mcspectra.samplers import RANDOMIZATIONS
from mcspectra.samplers.law import (
    Choice,
    Fixed,
    Folded,
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
)

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


def test_scrambles_add_up_to_the_strongest():
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
def test_laws_agree_with_what_samplers_declare(row):
    """Uniform points, fixed sets and the number of points, of every sampler with every step it accepts."""
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
    """Realizations that repeat four sets told errors that fell as if all were sets of their own."""
    sampler = mcs.sampler("gaussian-blue-noise(sets=4, iterations=20) | shift", dims=2)
    errors = []
    for realizations in (4, 40, 160):
        found = mcs.power_spectrum(sampler, 16, half_width=4, realizations=realizations, rng=1)
        errors.append(found["power_se"].to_numpy())
        assert found.attrs["student_t"] == pytest.approx(3.182446, rel=1e-6)
    np.testing.assert_allclose(errors[1], errors[0], rtol=0.02)
    np.testing.assert_allclose(errors[2], errors[0], rtol=0.02)


def test_nested_and_linear_scrambles_have_one_variance():
    """They have the same law of pairs; lms fell to an extrapolation in four dims."""
    f = mcs.integrand("genz-gaussian", dims=4)
    owen, lms = (mcs.predict(f, f"sobol | {s}", [256, 1024]) for s in ("owen", "lms"))
    assert lms["method"].values.tolist() == owen["method"].values.tolist()
    np.testing.assert_allclose(lms["predicted_variance"], owen["predicted_variance"], rtol=1e-12)


def test_offsets_of_the_probe_are_not_the_points():
    """Points and offsets were multiples of one vector: 0.24 of the variance in four dims, ± 7 %."""
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
    """One uniform point in each of n slabs along the first axis: a sampler from outside, with a law."""

    name: ClassVar[str] = "slabs"
    dims: int = 3

    def _points(self, n, stream, first, count):
        x = stream.uniforms(first, count, n * self.dims).reshape(count, n, self.dims)
        x[..., 0] = np.minimum((np.arange(n) + x[..., 0]) / n, np.nextafter(1.0, 0.0))
        return x

    def _law(self, n: int) -> Law:
        return Strata(n=n, dims=self.dims, sides=(n, *(1,) * (self.dims - 1)))


class TestStranger:
    """A sampler that no module of the package knows is predicted by its law."""

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

    def test_bench(self):
        found = mcs.sampler_bench(
            [self.sampler, "random"], counts=[16, 64], dims=[3], realizations=20
        )
        assert self.sampler.spec in found["sampler"].values
