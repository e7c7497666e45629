"""Print variances by formula, quadrature over strata, and simulation, with the deviation in σ."""

from __future__ import annotations

import math

import mcspectra as mcs

REALIZATIONS = 4000
DISK = "disk(center=[0.463, 0.517], radius=0.27)"


def _fraction(x: float) -> float:
    return x - math.floor(x)


def _rows() -> list[tuple[str, mcs.Estimator | mcs.estimators.TechniqueSum, str, int, float]]:
    x1, x2 = mcs.Estimator("linear", dims=1), mcs.Estimator("linear", dims=2)
    a, n = 0.371, 64
    part = _fraction(a * n) * (1 - _fraction(a * n))
    step = mcs.Estimator(f"step(at={a})", dims=1)
    half_step = mcs.Integrand.from_function(lambda x: 0.5 * (x[..., 0] < a), dims=1, integral=a / 2)
    halves = mcs.estimators.TechniqueSum(
        [mcs.integrand("linear(gradient=[0.5])", dims=1), half_step]
    )
    square = mcs.Estimator("polynomial(coefficients=[0, 0, 1])", "linear(slope=2)", dims=1)
    part2 = _fraction(a * 10) * (1 - _fraction(a * 10))
    return [
        ("x", x1, "random", n, 1 / (12 * n)),
        ("x", x1, "jittered", n, 1 / (12 * n**3)),
        ("x", x1, "jittered | shift", n, 1 / (6 * n**2) - 1 / (12 * n**3)),
        (f"1[x<{a}]", step, "jittered", n, part / n**2),
        (
            "½x + ½·1[x<a], two techniques",
            halves,
            "jittered",
            n,
            1 / (48 * n**3) + part / (4 * n**2),
        ),
        ("x² / 2x", square, "random", n, 1 / (72 * n)),
        ("x (2-D)", x2, "jittered", n, 1 / (12 * n**2)),
        ("x (2-D)", x2, "jittered | shift", n, n**-1.5 / 6 - n**-2 / 12),
        (f"1[x<{a}] (2-D)", mcs.Estimator(f"step(at={a})", dims=2), "jittered", 100, part2 / 1000),
        (
            "disk R = 0.27 (limit)",
            mcs.Estimator(DISK),
            "jittered",
            4096,
            1.0428109 * 0.27 * 4096**-1.5,
        ),
    ]


def main() -> None:
    """Print one row per case."""
    print(f"{'integrand':30s} {'sampler':18s} {'n':>5s} {'formula':>12s} {'quadrature':>12s} "
          f"{'measured':>12s} {'pull/σ':>7s}")  # fmt: skip
    for label, estimator, sampler, n, formula in _rows():
        try:
            exact = f"{mcs.exact_variance(estimator, sampler, n):.6g}"
        except mcs.NoClosedForm:
            exact = "–"
        d = mcs.convergence(estimator, sampler, [n], realizations=REALIZATIONS, rng=1)
        low, high = d["variance_ci"].values[0]
        measured = float(d["variance"][0])
        se = math.log(high / low) / (2 * 1.959964)
        pull = math.log(measured / formula) / se
        print(
            f"{label:30s} {sampler:18s} {n:5d} {formula:12.6g} {exact:>12s} {measured:12.6g} "
            f"{pull:+7.2f}"
        )


if __name__ == "__main__":
    main()
