"""Learned densities: exact fits, chosen for the sampler, and stored in files."""

import json
import math
import os
from pathlib import Path

import numpy as np
import pytest
from tests.processes import python

import mcspectra as mcs
from mcspectra.core.errors import FileFormatError, NoGainWarning, ParameterError
from mcspectra.densities import Learned
from mcspectra.densities.learned import SplineDensity
from mcspectra.estimators import quadrature
from mcspectra.improve.learned import LEARNED, _Seen, fit_splines
from mcspectra.integrands import _quadrature

OWEN = "sobol | owen"
KINDS = list(LEARNED)
REALIZATIONS = 200
# Ratio of two estimated variances of REALIZATIONS values at 4 sigma, with Var(log s²) = 2/(R − 1)
NOISE = math.exp(4.0 * math.sqrt(2.0 * 2.0 / (REALIZATIONS - 1)))


def peaks(x):
    """Return two bells on the diagonal, which a product of marginals does not fit."""
    return sum(np.exp(-((x - c) ** 2).sum(-1) / 0.02) for c in (1 / 3, 2 / 3))


@pytest.fixture(autouse=True)
def _own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("MCSPECTRA_CACHE", str(tmp_path / "cache"))


def variance(density, n, realizations=REALIZATIONS):
    u = mcs.sampler(OWEN, dims=2).draw(n, realizations=realizations, rng=5)
    x = u if density is None else density.sample(u)
    ratio = peaks(x) if density is None else peaks(x) / density.pdf(x)
    return ratio.mean(axis=1).var(ddof=1)


def test_a_density_of_the_family_is_recovered_from_any_points():
    """The relative entropy is 0 at a density with the same cells, whatever the 2000 points are.

    A fit that maximized a mean of log p would have a noise of Σ (M − 1)/2N = 1e-2.
    """
    rng = np.random.default_rng(0)
    x = rng.random((2000, 2))
    knots = np.tile(np.linspace(0.0, 1.0, 2), (2, 1))
    table = np.array([[[0.2, 0.3, 0.5], [0.6, 0.3, 0.1]]])
    true = SplineDensity(knots=knots, defensive=0.1, shares=np.ones(1), tables=table)
    values = 7.0 * true.pdf(x)[:, None]
    found = fit_splines(x, values, np.ones(len(x)), (1, 1, 0.0), 0.1, rng)
    # L-BFGS stops at steps of 2e-9 of the entropy, which is quadratic in the error of p
    assert np.abs(found.pdf(x) / true.pdf(x) - 1.0).max() < 1e-3
    np.testing.assert_allclose(found.tables, table, atol=1e-3)


def test_the_gradient_of_the_entropy_equals_finite_differences():
    rng = np.random.default_rng(0)
    rho, weight = rng.dirichlet(np.ones(6), 2).reshape(2, 2, 3)
    seen = _Seen(basis=[], rho=rho, weight=weight, uniform=None, defensive=0.1, smooth=0.0)
    logarithm, step = rng.standard_normal((2, 3)), 1e-6
    _, slope = seen._entropy(logarithm)
    for place in np.ndindex(2, 3):
        moved = step * (np.arange(6) == np.ravel_multi_index(place, (2, 3))).reshape(2, 3)
        ends = [seen._entropy(logarithm + sign * moved)[0] for sign in (1, -1)]
        assert slope[place] == pytest.approx((ends[0] - ends[1]) / (2 * step), abs=1e-8)


@pytest.mark.parametrize("kind", KINDS)
def test_the_variance_under_the_sampler_is_smaller(kind):
    calls = 0

    def f(x):
        nonlocal calls
        calls += x[..., 0].size
        return peaks(x)

    p = mcs.improve.learned_density(f, kind, OWEN, 256, dims=2, evaluations=6000)
    assert 5000 < calls <= 6000
    assert variance(p, 256) * NOISE < variance(None, 256)
    # Weights are bounded, and the mean is within 4 standard errors of the integral
    x = np.random.default_rng(0).random((4096, 2))
    assert p.pdf(x).min() >= 0.05
    u = mcs.sampler(OWEN, dims=2).draw(256, realizations=REALIZATIONS, rng=6)
    means = (peaks(p.sample(u)) / p.pdf(p.sample(u))).mean(axis=1)
    truth = (
        2.0
        * (
            0.5
            * math.sqrt(0.02 * math.pi)
            * (math.erf((1 / 3) / math.sqrt(0.02)) + math.erf((2 / 3) / math.sqrt(0.02)))
        )
        ** 2
    )
    assert abs(means.mean() - truth) < 4.0 * means.std() / math.sqrt(REALIZATIONS)


@pytest.mark.parametrize("kind", KINDS)
def test_warps_keep_the_rate_of_nets(kind):
    """From n to 16 n, the variance falls by more than 16^1.5, because the warp is continuous.

    A jump along a curve would give 16^1.5, and a smooth integrand 16^3. The noise of 50 nets is a
    factor of 3.
    """
    p = mcs.improve.learned_density(peaks, kind, OWEN, 256, dims=2, evaluations=2**11)
    noise = math.exp(4.0 * math.sqrt(2.0 * 2.0 / 49))
    assert variance(p, 2**13, 50) * noise < variance(p, 2**9, 50) * 16.0**-1.5


def test_the_same_seed_gives_the_same_density_and_its_spec_restores_it(tmp_path):
    def made(seed, **more):
        return mcs.improve.learned_density(
            peaks, "mixture", OWEN, 64, dims=2, evaluations=512, rng=seed, **more
        )

    first = made(1)
    assert made(2).spec != first.spec
    kept = made(1, path=tmp_path / "mine.json")
    assert kept.spec == f"learned(path={str(tmp_path / 'mine.json')!r})"
    # The name of the file of `first` is the hash of its content
    assert Path(first.path).read_bytes() == Path(kept.path).read_bytes()
    x = np.random.default_rng(0).random((100, 2))
    again = mcs.density(kept.spec)
    np.testing.assert_array_equal(again.pdf(x), first.pdf(x))
    found = mcs.convergence(
        mcs.Estimator(mcs.Integrand.from_function(peaks, dims=2), again), OWEN, [64]
    )
    assert float(found["variance"][0]) < variance(None, 64)


def test_the_size_and_the_sign_of_f_do_not_matter():
    """Factors that are powers of two give the same bits, because they cause no rounding."""

    def spec(factor, kind="mixture"):
        return mcs.improve.learned_density(
            lambda x: factor * peaks(x), kind, OWEN, 64, dims=2, evaluations=512
        ).spec

    specs = [spec(factor) for factor in (1.0, -(2.0**-530), 2.0**530)]
    assert specs == specs[:1] * 3
    assert specs[0] != "uniform"


def test_threads_and_blocks_do_not_matter():
    """The number of BLAS threads and the blocks of points do not change any bit."""
    specs = [
        mcs.improve.learned_density(
            "gaussian(width=0.1, center=0.3)", kind, OWEN, 128, dims=2, evaluations=1024
        ).spec
        for kind in KINDS
    ]
    code = (
        "import mcspectra as mcs\n"
        f"for kind in {KINDS}: "
        "print(mcs.improve.learned_density('gaussian(width=0.1, center=0.3)', "
        f"kind, {OWEN!r}, 128, dims=2, evaluations=1024).spec)"
    )
    threads = "1" if os.environ["OPENBLAS_NUM_THREADS"] != "1" else "2"
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": threads}
    assert python("-c", code, env=environment, check=True).stdout.splitlines() == specs
    for spec in specs:
        assert spec != "uniform"
        p = mcs.density(spec)
        u = np.random.default_rng(0).random((1000, 2))
        whole, parts = p.sample_pdf(u), [p.sample_pdf(block) for block in np.split(u, [1, 300])]
        for a, b in zip(whole, zip(*parts, strict=True), strict=True):
            np.testing.assert_array_equal(a, np.concatenate(b))


def test_without_a_gain_the_density_is_uniform(tmp_path):
    """A constant has no variance, so no density can gain."""
    path = tmp_path / "uniform.json"
    with pytest.warns(NoGainWarning, match="constant is uniform: no candidate has less than 0.5"):
        p = mcs.improve.learned_density("constant", "mixture", OWEN, 64, dims=2, evaluations=512)
    assert p.spec == "uniform"
    with pytest.warns(NoGainWarning):
        kept = mcs.improve.learned_density(
            "constant", "mixture", OWEN, 64, dims=2, evaluations=512, path=path
        )
    x = np.random.default_rng(0).random((100, 2))
    np.testing.assert_array_equal(kept.pdf(x), 1.0)
    np.testing.assert_allclose(kept.sample(x), x, atol=1e-15)


def _three_peaks(x):
    return sum(np.exp(-((x - c) ** 2).sum(-1) / 0.004) for c in (0.2, 0.5, 0.8))


def _ridge(x):
    return np.exp(-50.0 * (x.sum(-1) - 2.0) ** 2)


@pytest.mark.filterwarnings("ignore::mcspectra.core.errors.NoGainWarning")
@pytest.mark.parametrize(
    ("f", "dims", "kind", "sampler", "seeds"),
    [
        (_three_peaks, 3, "mixture", "random", (0,)),
        (_three_peaks, 3, "spline-flow", "random", (2,)),
        (_ridge, 4, "mixture", OWEN, (1,)),
        pytest.param(_ridge, 4, "mixture", OWEN, (2,), marks=pytest.mark.slow),
    ],
)
def test_a_density_that_raises_the_variance_is_not_returned(f, dims, kind, sampler, seeds):
    """Few evaluations miss a peak or fit noise; unchecked ratios were 1.4 to 4.2."""
    u = mcs.sampler(sampler, dims=dims).draw(64, realizations=REALIZATIONS, rng=77)
    for seed in seeds:
        p = mcs.improve.learned_density(f, kind, sampler, 64, dims=dims, evaluations=2048, rng=seed)
        x = p.sample(u)
        ratio = (f(x) / p.pdf(x)).mean(axis=1).var() / f(u).mean(axis=1).var()
        assert p.spec == "uniform" or ratio < 1.0


@pytest.mark.parametrize("sampler", ["jittered", pytest.param(OWEN, marks=pytest.mark.slow)])
def test_exact_variances_equal_measured_variances(sampler, monkeypatch):
    """In 2-D, the knots lie along curves of primary space.

    Quadrature searches for details of f/p at an eighth of the points, because f has none.
    """
    for module in (_quadrature, quadrature):
        monkeypatch.setattr(module, "PROBE", 2**14)
    _quadrature.probe.cache_clear()
    f = mcs.Integrand.from_function(peaks, dims=2)
    estimator = mcs.Estimator(
        f, mcs.improve.learned_density(f, "mixture", OWEN, 64, evaluations=2048)
    )
    exact = mcs.exact_variance(estimator, sampler, 16, tolerance=0.05)
    found = mcs.convergence(estimator, sampler, [16], realizations=4 * REALIZATIONS)
    # Means of 16 values are nearly normal, so Var(s²) = 2 σ⁴/(R − 1); allow 4 sigma
    assert float(found["variance"][0]) == pytest.approx(
        exact, rel=0.05 + 4.0 * math.sqrt(2.0 / (4 * REALIZATIONS - 1))
    )
    _quadrature.probe.cache_clear()


def test_errors_say_what_to_do(tmp_path):
    def learn(f=peaks, kind="mixture", sampler=OWEN, n=64, **options):
        return mcs.improve.learned_density(
            f, kind, sampler, n, **{"dims": 2, "evaluations": 512, **options}
        )

    def never(x):
        raise AssertionError("evaluated before all else was checked")

    folder = tmp_path / "folder.json"
    folder.mkdir()
    for options, error, words in [
        ({"kind": "flow"}, ParameterError, "spline-flow"),
        ({"sampler": "sobol"}, ParameterError, "add owen or shift"),
        ({"evaluations": 100}, ParameterError, "evaluations"),
        ({"defensive": 0.0}, ParameterError, "defensive"),
        ({"dims": None}, ParameterError, "dims is missing"),
        ({"f": 3}, ParameterError, "a function of points"),
        ({"f": lambda x: 0.0 * x[:, 0]}, ParameterError, "f is 0 at all 256"),
        ({"f": lambda x: np.log(x[:, 0] - 0.5)}, ParameterError, "NaN or infinite"),
        ({"f": lambda x: np.ones((len(x), 2))}, ParameterError, "one component at a time"),
        ({"f": never, "n": 2**14}, ParameterError, "give 131072 or more"),
        ({"f": never, "path": tmp_path / "no" / "x.json"}, FileFormatError, "cannot be written"),
        ({"f": never, "path": folder}, FileFormatError, "cannot be written"),
        ({"f": never, "path": tmp_path / "x.npz"}, FileFormatError, ".json"),
    ]:
        with pytest.raises(error, match=words), np.errstate(invalid="ignore"):
            learn(**options)


@pytest.mark.parametrize(
    "text", ["{}", "[1]", "no", "[" * 10**5, '{"format": "mcspectra density 1"}']
)
def test_other_files_are_refused(tmp_path, text):
    path = tmp_path / "density.json"
    path.write_text(text)
    with pytest.raises(FileFormatError, match="json is not a learned density, or is damaged; give"):
        Learned(path=path)
    with pytest.raises(FileFormatError, match="There is no file"):
        mcs.density(f"learned(path={str(tmp_path / 'none.json')!r})")
    os.mkfifo(tmp_path / "pipe.json")
    os.truncate(path, 2**40)
    for name, words in (("pipe", "a device or a pipe; give"), ("density", "MB of memory to read")):
        with pytest.raises(FileFormatError, match=words):
            Learned(path=tmp_path / f"{name}.json")


def test_invalid_tables_are_refused(tmp_path):
    path = tmp_path / "density.json"
    with pytest.warns(NoGainWarning):
        mcs.improve.learned_density(
            "constant", "mixture", OWEN, 4, dims=1, evaluations=512, path=path
        )
    good = json.loads(path.read_text())
    for name, value in [
        ("defensive", 0.0),
        ("knots", [[0.0, 0.5]]),
        ("knots", [0.0, 1.0]),
        ("knots", [[]]),
        ("tables", [[[0.5, 0.5], [1.0]]]),
        ("shares", [0.5]),
        ("tables", [[[0.5, 0.7, -0.2]]]),
        ("gates", [[[1.0]]]),
    ]:
        path.write_text(json.dumps({**good, name: value}))
        with pytest.raises(FileFormatError, match="is not a learned density"):
            Learned(path=path)


def test_the_verb_writes_a_density_and_refuses_options_of_samplers(tmp_path, capsys):
    from mcspectra.cli.main import main

    path = tmp_path / "density.json"
    copy = tmp_path / "copy.json"
    words = (
        f"design density gaussian(width=0.05) -n 64 --budget 4096 -m 200 -o {path} -o {copy} --json"
    )
    assert main(words.split()) == 0
    density = mcs.density(f"learned(path={str(path)!r})")
    assert density.dims == 2
    assert path.read_bytes() == copy.read_bytes()
    for words, said in (
        (
            "density gaussian -n 64 --members 40",
            "--members is for samplers; leave it out with density",
        ),
        ("owen gaussian -n 64 --budget 4096", "--budget is for densities; leave it out with owen"),
        ("density gaussian -n 64 -o a.txt", "does not end in one of .json"),
    ):
        assert main(["design", *words.split()]) == 2
        assert said in capsys.readouterr().err


def test_design_of_a_density_equals_learned_density():
    options = {"dims": 2, "rng": 3}
    made = mcs.design(
        "density", "gaussian(width=0.1)", 64, budget=1024, family="spline-flow", **options
    )
    f = mcs.integrand("gaussian(width=0.1)", 2)
    expected = mcs.improve.learned_density(f, "spline-flow", OWEN, 64, evaluations=1024, rng=3)
    x = np.random.default_rng(0).random((20, 2))
    np.testing.assert_array_equal(made.pdf(x), expected.pdf(x))
    with pytest.raises(ParameterError, match="family is for densities; leave it out with owen"):
        mcs.design("owen", "gaussian", 64, family="mixture")
