"""The table of bad input: the input, its interface (Python, command line or TOML), the message.

`test_bad_input.py` runs every row and compares it with tests/bad_input.md.
``python -m tests.bad_input`` writes that table from the program's current output.
"""

import contextlib
import io
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

TABLE = Path(__file__).with_name("bad_input.md")

STUDY = """\
title = "t"
samplers = ["jittered"]
[convergence]
counts = [4, 16]
realizations = 10
[[estimators]]
name = "a"
integrand = "gaussian"
"""

HEAD = [
    "# Bad input and its answers",
    "",
    "Made by `python -m tests.bad_input`; every row is a test. Commands exit with 2.",
    "",
    "| interface | given | answer | message |",
    "|---|---|---|---|",
]


@dataclass(frozen=True)
class Row:
    """One bad input; `words` must be in the answer."""

    door: str  # "python", "command" or "toml"
    given: str
    words: str


def _rows(door, *pairs):
    return [Row(door, given, words) for given, words in pairs]


PYTHON = _rows(
    "python",
    ("mcs.sampler('jiterd', dims=2)", "Did you mean 'jittered'"),
    ("mcs.sampler('jittered(', dims=2)", "opens a bracket"),
    ("mcs.sampler('jittered(cells=4)', dims=2)", "no parameter 'cells'"),
    ("mcs.sampler('jittered(dims=__import__(\"os\").getpid())')", "not a literal"),
    ("mcs.sampler('jittered', dims=0)", "at least 1"),
    ("mcs.sampler('shift | jittered', dims=2)", "randomization"),
    ("mcs.sampler('multi-jittered', dims=3)", "dims"),
    ("mcs.sampler('jittered', dims=2).draw(250)", "225 and 256"),
    ("mcs.sampler('random', dims=2).draw(0)", "from 1"),
    ("mcs.sampler('random', dims=2).draw(float('nan'))", "whole number"),
    ("mcs.sampler('random', dims=2).draw(4, realizations=0)", "realizations"),
    ("mcs.sampler('random', dims=2).draw(4, rng=-1)", "rng"),
    ("mcs.sampler('random', dims=2).draw(2**31, realizations=4)", "at a time"),
    ("mcs.Sampler.from_points([[0.5, 1.5]])", "must lie in [0,1)"),
    ("mcs.Sampler.from_points([[0.5, float('nan')]])", "NaN"),
    ("mcs.Sampler.from_points([[0.5 + 0.1j, 0.2]])", "not an array of real numbers"),
    ("mcs.Sampler.from_points(np.ma.masked_greater([[0.1, 0.2]], 0.15))", "masked"),
    ("mcs.Sampler.from_points([])", "at least one point"),
    ("mcs.Sampler.from_points(np.full((2, 4, 2), 0.5)).draw(4, realizations=3)", "2"),
    ("mcs.Sampler.from_files('no-such.dat')", "no-such.dat"),
    ("mcs.Sampler.from_qmcpy('DigitalNetB3')", "Did you mean 'DigitalNetB2'"),
    ("mcs.sampler('qmcpy', dims=2).draw(10)", "8 and 16"),
    ("mcs.sampler(\"qmcpy(options={'seed': 3})\")", "not an option"),
    ("mcs.sampler(\"mitsuba(sampler='sobol')\")", "ldsampler"),
    ("mcs.sampler(\"mitsuba(sampler='orthogonal')\").draw(16)", "9 and 25"),
    ("mcs.quality_figures('random')", "give the number of points to draw"),
    ("mcs.quality_figures('random', 16, figures=['diafony'])", "Did you mean 'diaphony'"),
    ("mcs.quality.diaphony(np.full((10**5, 2), 0.5))", "give at most 8192"),
    ("mcs.quality.nearest_distances([[0.5, 0.5]])", "at least two"),
    ("mcs.density('linear(slope=3)', dims=1)", "slope"),
    ("mcs.density('piecewise-constant(values=[0, 0])')", "values"),
    ("mcs.density('truncated-normal(sigma=0)', dims=1)", "sigma"),
    ("mcs.density('uniform', dims=2).pdf([0.5])", "shape"),
    (
        "mcs.Density.from_functions(pdf=lambda x: 2 * x[..., 0], sample=lambda u: u, dims=1)",
        "pdf",
    ),
    ("mcs.density('uniform', dims=2).pdf([[0.5, 1.5]])", "[0,1)"),
    ("mcs.integrand('gaussian', dims=2)([[0.5, 2.0]])", "unit cube"),
    ("mcs.integrand('gaussian', dims=10**9)", "1024"),
    ("mcs.integrand('disk(radius=-1)')", "radius"),
    ("mcs.integrand('gaussian', dims=2).fourier([[0.5, 1]])", "integer"),
    ("mcs.integrand('gaussian', dims=2)(np.zeros((4, 3)))", "(..., 2)"),
    ("mcs.Integrand.from_function(lambda x: x[..., 0] * np.nan, dims=1)", "NaN"),
    ("mcs.Integrand.from_function('x**2', dims=1)", "callable"),
    (
        "mcs.Estimator(mcs.integrand('linear', dims=1), 'piecewise-constant(values=[0, 1])')",
        "positive wherever f is not 0",
    ),
    (
        "mcs.variance_terms(mcs.Estimator('gaussian', dims=2), mcs.sampler('random', dims=3), 8)",
        "2 dims",
    ),
    (
        "mcs.variance_terms(mcs.Estimator('gaussian', dims=2), 'random', 8, half_width=10**5)",
        "half_width",
    ),
    (
        "mcs.variance_terms(mcs.Estimator('gaussian', dims=2), 'random', 8, cross_matrix=True)",
        "GiB",
    ),
    ("mcs.convergence(mcs.Estimator('gaussian', dims=2), 'random', [16, 4])", "ascending"),
    ("mcs.convergence(3, 'random', [4, 16])", "not an estimator"),
    ("mcs.convergence('gaussian', 3, [4, 16])", "Sampler.from_function"),
    ("mcs.remedies(abs, 'jittered', 64)", "dims is missing"),
    ("mcs.profile(lambda x: float(x[0]), dims=2)", "vectorized=False"),
    ("mcs.profile(lambda x: x, dims=2)", "one component at a time, such as lambda x: f(x)[..., 0]"),
    ("mcs.profile(lambda x: x, dims=2, vectorized=False)", "such as lambda x: f(x)[0]"),
    ("mcs.profile(np.full((2, 50), np.nan))", "The draws hold 100 NaN or infinite values; give"),
    ("mcs.integrate(lambda x: x[:, 0], dims=1, budget=3)", "of sobol | owen; give at least 8."),
    ("mcs.integrate(mcs.Estimator('gaussian', dims=2), dims=3, budget=64)", "leave dims out."),
    ("mcs.integrand('formula(expression=\"log(x)\")')(np.zeros((1, 2)))", "for example at (0, 0)"),
    ("mcs.design('lattice', lambda x: x.sum(-1), 16)", "from_function"),
    ("mcs.convergence('gaussian', 'random', 16)", "counts"),
    ("mcs.convergence('gaussian', ['random', 'random'], [4, 16])", "twice"),
    ("mcs.power_spectrum('random', 16, frequency_step=1e300)", "frequency_step"),
    ("mcs.pair_correlation('random(dims=50)', 64)", "dims"),
    ("mcs.closed_form_power('poisson-disk', 16, [[1, 1]])", "No closed-form"),
    ("mcs.power_spectrum('random', 16, frequency_step=0)", "frequency_step"),
    ("mcs.spectra.power_at('random', 16, [])", "one row per frequency"),
    ("mcs.spectra.power_at('random', 16, [[float('nan'), 1]])", "NaN"),
    ("mcs.spectra.power_at('random', 16, [[1e300, 1]])", "phases"),
    ("mcs.spectra.power_at('random', 16, 'x')", "real numbers"),
    ("mcs.spectra.power_at('random(dims=3)', 16, [[1, 1]])", "2 dims"),
    ("mcs.spectra.power_at('random', 16, [[1, 1]], eps=float('inf'))", "eps"),
    ("mcs.closed_form_power('random', 16, [])", "one row per frequency"),
    ("mcs.closed_form_power('random', 10**30, [[1, 0]])", "2147483648"),
    (
        "mcs.spectra.closed_form_covariance('poisson-disk', 16, [[1, 0]], [[1, 0]])",
        "No closed-form",
    ),
    ("mcs.spectra.closed_form_covariance('jittered', 16, [[1, 0]], [[1]])", "shape (..., 2)"),
    (
        "mcs.spectra.closed_form_covariance('jittered', 16, np.ones((9, 2)), np.ones((3, 2)))",
        "do not broadcast",
    ),
    ("mcs.spectra.closed_form_walsh_power('sobol', 16, [[1, 1]])", "add digital-shift or owen"),
    ("mcs.spectra.closed_form_walsh_power('sobol | owen', 16, [[-1, 1]])", "whole numbers from 0"),
    ("mcs.spectra.closed_form_pair_correlation('sobol', 16, [0.1])", "No closed-form"),
    ("mcs.spectra.closed_form_pair_correlation('jittered', 16, [0.7])", "0 to 1/2"),
    ("mcs.spectra.closed_form_pair_correlation('jittered', 16, [float('nan')])", "0 to 1/2"),
    ("mcs.pair_correlation('random', 1)", "at least 2"),
    ("mcs.pair_correlation('random', 64, bins=0)", "bins"),
    ("mcs.pair_correlation('random', 64, bins=10**9)", "bins"),
    ("mcs.pair_correlation('random', 64, max_distance=float('nan'))", "max_distance"),
    ("mcs.pair_correlation('random', 64, max_distance=0.5, boundary='border')", "inside"),
    ("mcs.pair_correlation('random', 64, boundary='open')", "toroidal, border"),
    ("mcs.pair_correlation('random', 10**7)", "fewer points"),
    ("mcs.predict('gaussian', 'sobol', [16], method='pair-correlation')", "stationary"),
    (
        "mcs.predict('gaussian', 'poisson-disk', [10**6], method='pair-correlation')",
        "too many pairs",
    ),
    (
        "mcs.predict('gaussian', 'sobol | owen', [16], method='torus')",
        "The method torus does not apply",
    ),
    ("mcs.predict('gaussian', 'random', [16], method='torsu')", "Did you mean 'torus'"),
    ("mcs.predict('gaussian', 'random', [16], method='exact', tolerance=0)", "tolerance is 0"),
    (
        "mcs.predict('gaussian', 'random', [16], method='measured', realizations=3)",
        "realizations is 3",
    ),
    ("mcs.predict(None, 'random', [16])", "not an estimator"),
    ("mcs.spectra.radial_statistics(3)", "power_spectrum returns"),
    ("mcs.spectra.slices(np.zeros((5, 5)))", "power_spectrum returns"),
    (
        "mcs.spectra.slices(mcs.spectra.power_at('random', 4, [[1, 1]], realizations=2))",
        "whole grid",
    ),
    (
        (
            "mcs.spectra.wedge_means(mcs.power_spectrum(mcs.sampler('random', dims=1), 4, "
            "half_width=2))"
        ),
        "wedges need two",
    ),
    ("mcs.spectra.wedge_means(mcs.power_spectrum('random', 4, half_width=2), 10**9)", "360"),
    ("mcs.spectra.wedge_means(mcs.power_spectrum('random', 4, half_width=2), float('nan'))", "360"),
    ("mcs.spectra.low_frequency_exponent('random')", "power_spectrum returns"),
    (
        "mcs.spectra.low_frequency_exponent(mcs.power_spectrum('random', 4, half_width=1))",
        "larger half_width",
    ),
    (
        (
            "mcs.spectra.low_frequency_exponent(mcs.power_spectrum('random', 4, half_width=8), "
            "up_to=100)"
        ),
        "at most 8",
    ),
    (
        (
            "mcs.spectra.low_frequency_exponent(mcs.power_spectrum('random', 4, half_width=8, "
            "realizations=1))"
        ),
        "two or more",
    ),
    ("mcs.spectra.gain_coefficients('random', 16)", "such as sobol"),
    ("mcs.spectra.gain_coefficients('sobol', 16, levels=100, dims=2)", "levels"),
    ("mcs.spectra.gain_coefficients('sobol', 2**30, dims=2)", "lower levels, n or dims"),
    ("mcs.spectra.nested_variances(3, 3)", "not an integrand"),
    ("mcs.spectra.nested_variances(mcs.integrand('gaussian', dims=4), 20)", "cells"),
    ("mcs.covariance_modes('gaussian', 'jittered', 16, modes=0)", "modes"),
    ("mcs.covariance_modes('gaussian', 'jittered', 16, half_width=1000, modes=1000)", "GiB"),
    ("mcs.covariance_modes('gaussian', 'jittered', 16, half_width=2, band=[])", "labels"),
    ("mcs.covariance_modes('gaussian', 'jittered', 16, basis='sine')", "cosine"),
    ("mcs.covariance_modes('gaussian', 'jittered', 17)", "16 and 25"),
    ("mcs.anova_variances('gaussian', order=3)", "from 1 to 2"),
    ("mcs.anova_variances('gaussian', realizations=10**9)", "GiB"),
    ("mcs.anova_variances(mcs.Estimator('gaussian', dims=100))", "from 1 to 64"),
    ("mcs.anova_variances(float('nan'))", "not an estimator"),
    ("mcs.prediction.predicted_rate(float('nan'), 3, dims=2)", "b is nan"),
    ("mcs.prediction.predicted_rate(2, 'bump', dims=2)", "jump"),
    ("mcs.prediction.predicted_rate(2, 1.5, dims=2)", "greater than 2"),
    ("mcs.prediction.predicted_rate(2, 3, dims=0)", "dims"),
    ("mcs.prediction.integrand_decay(None)", "not an integrand"),
    ("mcs.prediction.integrand_decay('gaussian', half_width=2)", "half_width"),
    (
        "mcs.measure.realizations_needed('gaussian', 'random', 16, relative_error=0)",
        "at least 0.0001",
    ),
    (
        "mcs.measure.realizations_needed('gaussian', 'random', 16, relative_error=1e-9)",
        "at least 0.0001",
    ),
    ("mcs.measure.realizations_needed('gaussian', 'random', 16, max_realizations=1)", "from 2"),
    ("mcs.exact_variance('gaussian', 'sobol', 16)", "No exact variance"),
    ("mcs.exact_variance('disk', 'jittered', 10**8)", "evaluations"),
    ("mcs.convergence('gaussian', 'random', [4, 16], fit_last='all')", "'auto'"),
    ("mcs.convergence('gaussian', 'random', [4, 16], relative_error=2)", "at most 1"),
    ("mcs.variance_terms('gaussian', 'random', 8, half_width=5, basis='haar')", "4 or 8"),
    ("mcs.variance_terms('gaussian', 'random', 8, bands='rings')", "radial, dyadic, anova"),
    ("mcs.density('power(exponent=-1)', dims=1)", "exponent"),
    ("mcs.density('exponential(rate=inf)', dims=1)", "rate"),
    ("mcs.density('tent(peak=1.5)', dims=1)", "peak"),
    ("mcs.density('piecewise-linear(values=[])')", "values"),
    ("mcs.density('piecewise-linear(values=[0, 0])')", "0"),
    ("mcs.density('bilinear(values=[[1, -1], [1, 1]])')", "values"),
    ("mcs.density('piecewise-constant(values=[1, 2], warp=\"spiral\")')", "hilbert"),
    ("mcs.density('product(parts=[])')", "parts"),
    ("mcs.density('mixture(parts=[\"uniform\"], weights=[-1])', dims=1)", "weights"),
    (
        'mcs.density(\'mixture(parts=["uniform", "tent"], selection="split")\', dims=1)',
        "split_mixture",
    ),
    ("mcs.density('defensive(density=\"linear\", share=0)', dims=1)", "share"),
    ("mcs.density('disk(radius=0.7)')", "radius"),
    ("mcs.density('hemisphere(weighting=\"sine\")')", "cosine"),
    ("mcs.density('environment(channel=7)')", "channel"),
    ("mcs.density('environment(path=\"no-such.exr\")')", "no-such.exr"),
    (
        (
            "mcs.density('spherical-rectangle(corner=[0,0,1], edge0=[1,0,0], edge1=[2,0,0], "
            "origin=[0,0,0])')"
        ),
        "no area",
    ),
    (
        "mcs.density('spherical-triangle(a=[0,0,0], b=[1,0,0], c=[0,1,0], origin=[0,0,0])')",
        "origin",
    ),
    ("mcs.Density.from_functions(pdf=lambda x: 3 * x[..., 0], dims=1)", "1.5"),
    ("mcs.Density.from_functions(pdf=lambda x: -1 + 0 * x[..., 0], dims=1)", "negative"),
    ("mcs.Estimator('gaussian', 'disk')", "positive wherever"),
    ("mcs.MultipleImportance('gaussian', ['uniform', 'linear'], heuristic='powr')", "power"),
    (
        "mcs.MultipleImportance('gaussian', ['uniform', 'linear'], heuristic='power(beta=-1)')",
        "beta",
    ),
    (
        "mcs.MultipleImportance('gaussian', ['uniform', 'linear'], heuristic='cutoff(alpha=2)')",
        "alpha",
    ),
    ("mcs.MultipleImportance('gaussian', ['uniform', 'linear'], counts=(1, 0))", "counts"),
    (
        "mcs.MultipleImportance('gaussian', ['uniform', 'linear'], counts=(1, 2), sets='shared')",
        "shared",
    ),
    ("mcs.MultipleImportance('gaussian', ['uniform', 'linear'], sets='twin')", "joint"),
    ("mcs.estimators.OneSampleMIS('gaussian', ['uniform', 'linear'], [0.5, 0.6])", "probabilities"),
    (
        "mcs.estimators.OneSampleMIS('gaussian', ['uniform', 'linear'], [1, float('nan')])",
        "probabilities",
    ),
    ("mcs.technique_terms('gaussian', 'random', [16, 4])", "ascending"),
    ("mcs.estimators.ChannelSampling('gaussian', ['uniform', 'linear'])", "scalar"),
    ("mcs.estimators.channel_estimators('environment', ['uniform'])", "one for each channel"),
    ("mcs.Mirrored('gaussian', 'sideways')", "integrand"),
    (
        "mcs.improve.mirror_study('gaussian', 'jittered', [4, 16], mirrorings=['sideways'])",
        "uniform",
    ),
    ("mcs.smoothed('step(at=0.3)', 0, dims=1)", "width"),
    ("mcs.smoothed('gaussian', 0.1, method='distance')", "box"),
    ("mcs.improve.smoothing_scan('disk', 'jittered', 16, [0.2, 0.1])", "ascending"),
    ("mcs.improve.smoothing_scan('disk', 'jittered', 16, [float('nan')])", "widths"),
    ("mcs.improve.strata_shift_scan('disk', 'jittered', 17)", "16 and 25"),
    ("mcs.improve.strata_shift_scan('disk', 'jittered', 16, offsets=[float('inf')])", "offset"),
    ("mcs.improve.best_alignment('disk', 'jittered | shift', 16)", "shift"),
    ("mcs.aligned('gaussian', [0.5, 1.5], 16)", "edges"),
    ("mcs.quality.warp_quality('uniform', resolution=10**6)", "resolution"),
    ("mcs.quality.warp_quality(mcs.density('uniform', dims=3))", "dims"),
    ("mcs.explain.primary_picture(mcs.integrand('gaussian', dims=3))", "1 or 2 dims"),
    ("mcs.explain.primary_picture('gaussian', technique=1)", "technique"),
    ("mcs.measure.chain_error([0.5])", "at least 10 draws"),
    ("mcs.measure.chain_error(np.zeros((2, 3, 4, 5)))", "(chain, draw, quantity)"),
    ("mcs.measure.chain_error(np.full(20, np.nan))", "hold 20 NaN"),
    ("mcs.measure.chain_error(np.arange(20.0), weights=-np.ones(20))", "negative"),
    ("mcs.measure.chain_error(np.full(20, 1e300))", "between 1e-100 and 1e+100"),
    ("mcs.predict('gaussian', 'random', 16)", "counts"),
    ("mcs.predict('gaussian', 'random', '16,abc')", "counts is '16,abc'"),
    ("mcs.predict('gaussian', 'random', [])", "counts has no values"),
    ("mcs.predict('gaussian', 'random', [16, float('nan')])", "counts is nan"),
    ("mcs.predict('gaussian', 'random', [2**40])", "2147483648"),
    ("mcs.predict('gaussian', [], [16])", "at least one"),
    ("mcs.predict('gaussian', ['random', 'random'], [16])", "listed twice"),
    ("mcs.predict(['gaussian', 'disk'], 'random', [16])", "predict takes one estimator at a time"),
    (
        "mcs.predict(mcs.integrand('disk', dims=3), mcs.sampler('random', dims=2), [4])",
        "3 dims are",
    ),
    ("mcs.plan('gaussian', 'random', target_error=float('inf'))", "target_error is inf"),
    ("mcs.plan('gaussian', ['random', 'random'], target_error=0.1)", "listed twice"),
    ("mcs.plan(['gaussian', 'disk'], 'random', target_error=0.1)", "plan takes one estimator"),
    ("mcs.integrate(lambda x: x[:, 0], budget=1000)", "dims is missing"),
    ("mcs.integrate('gaussian', budget=0)", "budget is 0"),
    ("mcs.integrate('gaussian', budget=2**60)", "integrate would take about"),
    ("mcs.integrate('gaussian', budget=1000, sampler='sobol')", "add owen or shift"),
    ("mcs.profile(lambda x: x[:, 0])", "dims is missing"),
    ("mcs.profile('gaussian', budget=float('nan'))", "budget is nan"),
    ("mcs.remedies('gaussian', 'jittered', 0)", "budget"),
    ("mcs.remedies('gaussian', 'jittered', float('nan'))", "budget"),
    ("mcs.remedies('gaussian', 'jittered', 64, realizations=5)", "realizations"),
    ("mcs.remedies('gaussian', 'jittered', 64, kinds=['magic'])", "kinds"),
    ("mcs.remedies('gaussian', 'jittered', 64, kinds='mirrored')", "kinds"),
)

COMMAND = _rows(
    "command",
    ("gallery", "The verb 'gallery' is now 'mcspectra bench'."),
    ("anova gaussian", "'mcspectra variance --split axes'"),
    ("exact gaussian --sampler sobol -n 16", "'mcspectra predict --method exact'"),
    ("--frob doctor", "no option '--frob' before the verb"),
    ("run study.toml --out page.html", "the name of a file; give a folder"),
    ("frobnicate", "no verb"),
    ("points no-such-sampler -n 16", "no sampler"),
    ("points jittered -n 250", "225 and 256"),
    ("points jittered -n many", "whole number"),
    ("points jittered", "-n"),
    ("profile draws.npy draws.txt", "'draws.txt' is not a file of draws"),
    ("profile draws.npy", "There is no file"),
    ("profile draws.npy --budget 512", "--budget is for integrands"),
    ("profile gaussian --weights w", "--weights is for files of draws"),
    ("predict gaussian --sampler random --counts 16,abc", "--counts is 'abc'"),
    ("predict gaussian --sampler random --counts 16,4", "ascending"),
    ("predict gaussian --sampler random --sampler random --counts 4", "listed twice"),
    ("predict gaussian --sampler random(dims=3) --counts 4", "random has dims=3, but 2"),
    ("predict gaussian --sampler random --counts 4 -o no/x.html", "'no/x.html' cannot be written"),
    ("predict gaussian --sampler random --counts 4 -o no/x.png", "'no/x.png' cannot be written"),
    ("plan gaussian --sampler random --target-error nan", "--target-error is nan"),
    ("plan gaussian --sampler random --target-error 0", "--target-error is 0"),
    ("profile gaussian --budget 0", "--budget is 0"),
    ("profile gaussian --sampler jiterd", "Did you mean 'jittered'"),
    ("integrate gaussian --budget 1.5e0", "--budget is 1.5; give a whole number"),
    ("integrate gaussian --budget 1e999", "--budget is '1e999'; give a whole number"),
    ("integrate gaussian --budget 999999999999999999", "integrate would take about"),
    ("points random -n 4 --seed -3", "--seed"),
    ("points random -n 4 -d 0", "--dims"),
    ("points random -n 4 -o points.xyz", "points.xyz has the extension '.xyz'; points need .dat"),
    ("points random -n 4 -o p", "p has no extension"),
    ("points random -n 4 -o no/such/folder/p.dat", "no/such/folder"),
    ("points random -n 4 -o no/such/folder/p.svg", "no/such/folder"),
    ("points random -n 2000000 -o p.png", "too many for a plot"),
    ("points random -n 4 -o p.dat -o p.xyz", "p.xyz has the extension '.xyz'"),
    ("points random -n 4 --quality -m 0", "--realizations"),
    ("points points(path='no-such.npz') -n 4", "no-such.npz"),
    ("points command('./mine{n}') -n 4", "--allow-code './mine{n}'"),
    ("points python('os') -n 4", "--allow-code os"),
    ("points command('./no-such{n}') -n 4 --allow-code ./no-such{n}", "cannot be run"),
    ("points command('./mine{k}') -n 4 --allow-code ./mine{k}", "{k} stands for nothing"),
    ("points points(path='no-such*.dat') -n 4", "No file matches 'no-such*.dat'"),
    ("points sobol(base=3) -n 4", "base 3 needs a table"),
    ("points sobol(directions='no-such.dat') -n 4", "no-such.dat"),
    ("bench random -n 16", "two counts and one number of dims"),
    ("bench random random", "The sampler random is listed twice"),
    ("bench random -d 65", "dims is 65"),
    ("bench random --block 16,16,4", "--block needs --screen"),
    ("bench random --screen gaussain", "Did you mean"),
    ("bench random --screen gaussian --block 16,16", "--block is '16,16'; give W,H,T"),
    ("bench random --screen gaussian -n 4,16", "--counts has 2 numbers; with --screen give one"),
    ("bench random --screen gaussian --alpha 2", "alpha is 2.0"),
    ("bench random --screen gaussian -o r.docx", "it must end in .html, .csv, .png, .svg or .pdf"),
    ("bench tiles(path='no-such.npy') --screen gaussian", "There is no file no-such.npy"),
    ("bench command('./no-such{x}{y}') --screen gaussian", "--allow-code './no-such{x}{y}'"),
    (
        "bench command('./no{width}{height}') --screen gaussian --allow-code ./no{width}{height}",
        "the program './no6464' cannot be run",
    ),
    (
        "bench command('./no{x}{y}{frame}') --screen gaussian --allow-code ./no{x}{y}{frame}",
        "would run 524,288 processes",
    ),
    ("bench random -o r.docx", "it must end in .html, .pdf, .csv, .tex or .pgf"),
    ("bench random -o study.toml/page", "give a folder inside one that can be written"),
    ("bench random --style book", "it must be one of page, paper"),
    ("bench random --style paper", "give its name with -o"),
    ("bench random --style paper -o r.pdf", "'r.pdf' is a file"),
    ("bench random --width 3in", "add --style paper"),
    ("bench random --style paper --width 3ft -o figures", "give 1 to 20 inches"),
    ("bench random --style paper --font-size 0 -o figures", "at least 3"),
    ("design density gaussian -n 64 --members 40", "--members is for samplers"),
    ("design owen gaussian -n 64 --family mixture", "--family is for densities"),
    ("design strate gaussian -n 64", "Did you mean 'strata'"),
    ("init study.toml --schema", "--schema writes no file"),
    ("init --markdown", "--markdown is for --schema"),
    ("export out", "-o"),
    ("render veach --sensor 1", "--sensor is for whole paths; give --integrator."),
    ("render veach --integrator path --strategy mis", "--strategy is for direct light"),
    ("points random -n 4 --frobnicate", "--frobnicate"),
    ("points random -n 4 --quality high", "nrecognized arguments: high"),
    ("spectrum random -n 16 --frequency-step fast", "--frequency-step"),
    ("spectrum random -n 4 --half-width 0", "--half-width is 0; give a whole number of at least 1"),
    ("spectrum random -n 4 --half-width 100000", "use at most 1.34e+08: --half-width ≤ 5792"),
    ("spectrum random -n 4 -d 5 --half-width 2 --engine nufft", "use --engine direct."),
    ("spectrum random -n 16 -o picture.gif", ".png"),
    ("spectrum points(path='no-such.bin') -n 16", "no-such.bin"),
    ("variance no-such --sampler random -n 16", "no integrand"),
    ("variance gaussian --sampler random -n 16 --space time", "primary"),
    ("variance gaussian --sampler random -n 4 --eps 0.5", "--eps is 0.5; give a finite number"),
    (
        "variance gaussian --sampler random -n 16 --basis haar --half-width 12",
        "needs a power of two",
    ),
    ("variance gaussian --sampler random -n 16 --realizations 1", "from 2 to"),
    ("variance linear -d 1 --density linear(slope=5) --sampler random -n 4", "slope"),
    ("remedies gaussian --sampler random --sampler jittered --budget 64", "given twice"),
    ("variance gaussian --sampler random -n 16 --heuristic power", "two or more"),
    ("converge gaussian --sampler random --sampler random --counts 16,32", "twice"),
    ("converge gaussian --sampler random --counts 16,x", "whole number"),
    ("converge gaussian --sampler jittered --counts 16,20", "16 and 25"),
    (
        (
            "converge gaussian --sampler random --counts 4,16 --density uniform --density "
            "uniform --heuristic x"
        ),
        "balance",
    ),
    ("spectrum random -n 16 --show rings", "radial, slices, wedges, exponent"),
    ("spectrum random -n 16 -d 3 --half-width 2 --show wedges", "wedges need two"),
    ("spectrum random -n 16 --half-width 1 --show exponent", "three lengths"),
    ("pcf random -n 1", "'mcspectra pcf' needs n of at least 2"),
    ("pcf random -n 64 --bins 0", "--bins"),
    ("pcf random -n 64 --bins 1000000000", "bins"),
    ("pcf random -n 64 --boundary open", "toroidal, border"),
    ("pcf random -n 64 --max-distance nan", "--max-distance"),
    ("pcf random -n 64 --max-distance 2", "at most 0.5"),
    ("pcf random -n 4 --boundary border --max-distance 0.5", "--max-distance is 0.5; with"),
    ("pcf random -n 64 --max-distance far", "greater than 0"),
    ("pcf random -n 10000000", "fewer points"),
    ("pcf random -n 16 -d 50", "dims"),
    ("pcf no-such -n 16", "no sampler"),
    ("pcf points(path='no-such.dat') -n 16", "no-such.dat"),
    ("predict gaussian --sampler sobol --counts 16 --method exact", "No exact variance is known"),
    (
        "predict gaussian --sampler poisson-disk --counts 16 --method exact",
        "known for poisson-disk",
    ),
    ("predict gaussian --sampler jittered --counts 17 --method exact", "16 and 25"),
    ("predict gaussian --sampler jittered --counts 16, --method exact", "--counts"),
    ("predict gaussian --sampler jittered --counts 0 --method exact", "at least 1"),
    ("predict disk --sampler jittered --counts 100000000 --method exact", "evaluations"),
    ("predict gaussian --sampler jittered --counts 16 --method routes", "--method is 'routes'"),
    ("predict gaussian --sampler jittered -n 17", "16 and 25"),
    ("predict gaussian --sampler jittered -n 16,", "--counts"),
    ("predict gaussian --sampler jittered -n 0", "at least 1"),
    ("design density gaussian -n 64 --budget 100", "--budget is 100"),
    ("variance gaussian --split axis", "--split is 'axis'; it must be one of terms, techniques"),
    ("variance gaussian --sampler random -n 4 --order 1", "--order is for --split axes; give that"),
    ("variance gaussian --sampler random -n 4,8", "-n is '4,8'; give a whole number"),
    ("variance gaussian --split axes --order 3", "from 1 to 2"),
    ("variance gaussian --split axes --cross-matrix", "--cross-matrix is for --split terms"),
    ("variance gaussian --split axes -m 1", "from 2 to"),
    ("variance gaussian --split axes -m 1e9", "or give --order 1."),
    ("variance gaussian --split axes -d 100", "from 1 to 64"),
    ("variance gaussian --split axes --sampler jittered -n 17", "16 and 25"),
    *(
        (f"variance gaussian --split modes --sampler jittered -n 16 {options}", words)
        for options, words in (
            ("--modes 0", "--modes"),
            ("--half-width 1000 --modes 1000", "or a smaller --half-width."),
            ("--band 9999", "band"),
            ("--bands rings", "wedge"),
            ("--basis sine", "cosine"),
            ("--passes 1", "--passes"),
        )
    ),
    ("variance gaussian --split modes -n 16", "--sampler"),
    (
        "variance gaussian --sampler random -n 16 --max-evaluations 10",
        (
            "'mcspectra variance' takes at least 16000 evaluations of the integrand, and "
            "--max-evaluations"
        ),
    ),
    (
        "converge gaussian --sampler random --counts 4,16 --fit-last 3",
        "at most 2, the number of counts",
    ),
    (
        "converge gaussian --sampler random --counts 4,16 --fit-last 1",
        "--fit-last is 1; give a whole",
    ),
    (
        "converge gaussian --sampler random --counts 4,16 --fit-last=nan",
        "--fit-last is 'nan'; give a whole number of at least 2, or 'auto'.",
    ),
    ("converge gaussian --sampler random --counts 4,16 --relative-error 0", "at least 0.0001"),
    (
        "converge gaussian --sampler random --counts 4,16 --relative-error=nan",
        "--relative-error is",
    ),
    ("converge gaussian --sampler random --counts 4,16 --relative-error=x", "--relative-error is"),
    ("list pixels", "samplers"),
    ("frames nowhere --filter blur", "There is no filter called 'blur'"),
    ("frames nowhere --filter gaussian(sigma=-1)", "sigma"),
    ("frames nowhere --filter-command denoise", "{input} and {output}"),
    ("frames nowhere --filter-timeout 0", "--filter-timeout"),
    ("frames frames --reference small/0.npy", "the frames have (8, 8); give a reference"),
    ("frames frames --reference t{frame}.npy", "these are frames of one view; give one file"),
    ("frames frames --filter-command denoise-{inputs}-{outputs}", "not sequences; give {input}"),
    ("frames frames --filter-command denoise-{inputs}-{output}", "{inputs} and {outputs}"),
    ("gate frames", "give NEW and REFERENCE"),
    ("gate nowhere frames", "There is no nowhere"),
    ("gate frames nowhere", "There is no nowhere"),
    ("gate frames frames --level 2", "--level is 2"),
    ("gate frames frames --level nan", "--level is nan"),
    ("gate frames frames --target 0", "--target is 0"),
    ("gate frames frames --target inf", "--target is inf"),
    ("gate frames frames --spp 0", "--spp is 0"),
    ("gate frames frames --spp-reference 1.5", "--spp-reference is"),
    ("gate frames small", "give frames of one view"),
    ("gate frames nan", "has no finite pixel"),
    ("gate frames study.toml", "study.toml"),
    ("gate frames frames --make-reference x.exr", "leave REFERENCE out"),
    ("gate nowhere --make-reference x.exr", "There is no nowhere"),
    ("gate frames broken.npy", "broken.npy"),
    ("run no-such-file.toml", "no-such-file.toml"),
    ("run study.toml --workers 0", "--workers"),
    ("run study.toml --dashboard 1", "--dashboard is for clusters; also give --cluster."),
    ("run study.toml --cluster here", "The cluster's address is 'here'; give tcp://HOST:PORT"),
    ("run study.toml --cluster local --dashboard x", "--dashboard is 'x'"),
    ("render veach --film foo", "--film is 'foo'; it must be one of"),
    ("variance gaussian --sampler random -n 16 --mirror sideways", "integrand"),
    ("variance gaussian --sampler random -n 16 --engine cloud", "nufft"),
    ("variance gaussian --sampler random -n 16 --shares 1,2", "two or more"),
    ("variance gaussian --sampler random -n 16 --density disk", "positive wherever"),
    (
        (
            "converge gaussian --sampler random --counts 4,16 --density uniform --density linear "
            "--shares 1,x"
        ),
        "--shares",
    ),
    (
        "variance gaussian --sampler random -n 4 --density uniform --density linear --shares 1",
        "--shares is 1; give 2 numbers",
    ),
    ("remedies gaussian --sampler random", "--budget"),
    ("remedies gaussian --sampler random --budget many", "--budget"),
    ("remedies gaussian --sampler random --budget 64 -m 5", "realizations"),
    ("remedies gaussian --sampler random --budget 64 --kind magic", "--kind"),
    ("remedies gaussian --sampler random --budget 99999999999", "budget"),
)

TOML = _rows(
    "toml",
    ("title = ", "not valid TOML"),
    ("", "title"),
    (STUDY.replace("samplers", "smaplers"), "Did you mean 'samplers'"),
    (STUDY.replace("realizations = 10", "realizations = 1"), "give a whole number from 2"),
    (
        STUDY.replace("realizations = 10", "realizations = 'ten'"),
        "realizations is 'ten'; give a whole number",
    ),
    (STUDY.replace("[4, 16]", "[16, 4]"), "ascending"),
    (STUDY.replace("[4, 16]", "[4, 17]"), "16 and 25"),
    (STUDY.replace("[4, 16]", "[]"), "counts has no values"),
    (STUDY.replace("[4, 16]", "[4, 1e30]"), "counts[1] is 1e+30; give a whole number"),
    (STUDY.replace('"jittered"', '"jitered"'), "Did you mean 'jittered'"),
    (STUDY.replace('"gaussian"', '"gaussian(width=-1)"'), "width"),
    (STUDY.replace('"gaussian"', "\"image(path='no-such.png')\""), "no-such.png"),
    (STUDY.replace('integrand = "gaussian"', ""), "either integrand or integrands"),
    (STUDY + 'density = "uniform"\ndensities = ["uniform"]\n', "give one of them"),
    (STUDY + STUDY[STUDY.index("[[") :], "two estimators"),
    (STUDY.replace('["jittered"]', "[]"), "samplers has no values"),
    (STUDY.replace("[convergence]", "[convergences]"), "Did you mean 'convergence'"),
    (STUDY + "predict = { counts = [16, 4] }\n", "ascending"),
    (STUDY + "predict = { counts = '16,abc' }\n", "give one flat list"),
    (STUDY + "plan = { target_error = nan }\n", "a finite number greater than 0"),
    (STUDY + "profile = { budget = 0 }\n", "budget is 0; give a whole number from 256"),
    (STUDY.replace("[convergence]\ncounts = [4, 16]\nrealizations = 10\n", ""), "no analysis"),
    ("seed = -1\n" + STUDY, "of at least 0"),
    (STUDY + 'heuristic = "power"\n', "give densities"),
    (STUDY + "terms = { n = 4, half_width = 100000 }\n", "half_width"),
    (STUDY + "terms = { n = 4, cross_matrix = true }\n", "GiB"),
    (STUDY + 'terms = { n = 4, space = "time" }\n', "domain, primary"),
    (STUDY + 'terms = { n = 4, basis = "sine" }\n', "cosine"),
    (STUDY + 'terms = { n = 4, half_width = 5, basis = "haar" }\n', "4 or 8"),
    (STUDY + 'terms = { n = 4, bands = "rings" }\n', "radial, dyadic, anova"),
    (STUDY.replace("= 10", '= 10\nfit_last = "all"'), "'auto'"),
    (STUDY.replace("= 10", "= 10\nfit_last = 3"), "at most 2, the number of counts"),
    (STUDY.replace("= 10", "= 10\nrelative_error = 0.0"), "at least 0.0001"),
    (STUDY.replace("= 10", "= 10\nrelative_error = nan"), "relative_error"),
    (STUDY.replace("= 10", "= 10\nrelative_error = 1e-9"), "at least 0.0001"),
    (STUDY.replace('["jittered"]', '["jittered", "jittered()"]'), "same sampler"),
    ("a = " + "[" * 3000, "nested too deeply"),
)

ROWS = [*PYTHON, *COMMAND, *TOML]


def answer(row, folder):
    """Run a row; return its exit code (or exception) and the message."""
    if row.door == "python":
        return _python_answer(row.given)
    if row.door == "toml":
        (folder / "bad.toml").write_text(row.given, encoding="utf-8")
        code, text = _command_answer(["run", "bad.toml", "--out", "out", "--quiet"], folder)
        return code, text
    return _command_answer(row.given.split(), folder)


def _python_answer(code):
    import numpy as np

    import mcspectra as mcs

    try:
        eval(code, {"mcs": mcs, "np": np})
    except mcs.McspectraError as error:
        return type(error).__name__, str(error)
    return "nothing", "no error was raised"


def _command_answer(arguments, folder):
    from mcspectra.cli.main import main

    (folder / "study.toml").write_text(STUDY, encoding="utf-8")
    if "frames" in arguments:
        _write_frames(folder)
    out, err = io.StringIO(), io.StringIO()
    with contextlib.chdir(folder), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main(arguments)
    return str(code), (err.getvalue() or out.getvalue()).strip()


GIVEN = {"study.toml", "bad.toml", "frames", "small", "nan", "broken.npy"}
"""Names of the input files and folders of the rows."""


def _write_frames(folder):
    """Write frames of two sizes, frames without finite pixels, and a broken file."""
    import numpy as np

    rng = np.random.default_rng(1)
    for name, size, value in (("frames", 8, 1.0), ("small", 4, 1.0), ("nan", 8, np.nan)):
        (folder / name).mkdir(exist_ok=True)
        for k in range(2):
            np.save(folder / name / f"{k}.npy", value * (1 + rng.random((size, size))))
    (folder / "broken.npy").write_text("no array", encoding="utf-8")


def line(row, code, text):
    """Return the row of the table for the program's output."""
    given = _difference(row.given) if row.door == "toml" else row.given
    first = text.splitlines()[0].replace("mcspectra: ", "", 1)
    given = f"`{_cell(given if len(given) < 200 else given[:40] + ' …')}`"
    return "| " + " | ".join([row.door, given, _cell(code), _cell(first)]) + " |"


def table():
    """Return the table as Markdown, from the program's current output."""
    with tempfile.TemporaryDirectory() as name:
        lines = [line(row, *answer(row, Path(name))) for row in ROWS]
    return "\n".join([*HEAD, *lines]) + "\n"


def _difference(text):
    """Return the lines of a bad study that the good one lacks."""
    good = STUDY.splitlines()
    extra = [line for line in text.splitlines() if line and line not in good]
    missing = [line for line in good if line and line not in text.splitlines()]
    if extra:
        return "; ".join(extra)
    if not text:
        return "(empty file)"
    return f"(without: {'; '.join(missing)})" if missing else "(an estimator twice)"


def _cell(text):
    return text.replace("|", "\\|").replace("\n", " ")


if __name__ == "__main__":
    TABLE.write_text(table(), encoding="utf-8")
    sys.stdout.write(f"{len(ROWS)} rows in {TABLE}\n")
