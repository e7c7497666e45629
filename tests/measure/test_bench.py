"""The bench: its numbers equal those of the analyses, and its ranks hold simultaneously."""

import functools
import zlib

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import McspectraError, ParameterError
from mcspectra.measure import bench
from mcspectra.measure.bench import free_of, making_seconds, ranks, standard_tasks
from mcspectra.samplers import Jittered, Owen, Shift

SMALL = {"counts": (16, 64), "realizations": 40}


@pytest.fixture(scope="module", autouse=True)
def estimator_of():
    """Share the estimators of all benches, which keep the quadratures of their integrands."""
    with pytest.MonkeyPatch.context() as patch:
        shared = functools.cache(mcs.Estimator)
        patch.setattr(bench, "Estimator", shared)
        yield shared


@pytest.fixture(scope="module")
def result(estimator_of):
    return mcs.sampler_bench(["random", "jittered", "sobol"], **SMALL)


def test_variances_equal_those_of_convergence(result, estimator_of):
    seed = np.random.SeedSequence([0, zlib.crc32(b"jittered")])
    for k in (0, 6, 7):
        estimator = estimator_of(str(result["integrand_spec"].values[k]), dims=2)
        alone = mcs.convergence(estimator, "jittered", (16, 64), realizations=40, rng=seed)
        one = result.sel(sampler="jittered").isel(integrand=k)
        for name in ("variance", "variance_ci", "rate", "rate_ci"):
            np.testing.assert_allclose(one[name].values, alone[name].values, rtol=1e-12)


def test_figures_equal_those_of_quality_figures(result):
    seed = np.random.SeedSequence([0, zlib.crc32(b"jittered")])
    figures = mcs.quality_figures("jittered", 64, figures=["diaphony"], realizations=8, rng=seed)
    one = float(result["diaphony"].sel(sampler="jittered", n=64))
    assert one == pytest.approx(float(figures["diaphony"].mean()), rel=1e-12)
    # Jittered points have little power at low frequencies; random points have full power there
    low = result["radial_power"].isel(radius=0) * 64
    assert float(low.sel(sampler="jittered")) < 0.2
    assert float(low.sel(sampler="random")) > 0.6
    assert (result["points_per_second"] > 0).all()


def test_results_do_not_depend_on_the_other_samplers(result):
    alone = mcs.sampler_bench(["jittered"], **SMALL)
    for name in ("variance", "rate_ci", "radial_power", "pair_correlation", "star_discrepancy"):
        np.testing.assert_array_equal(
            alone[name].values[0], result[name].sel(sampler="jittered").values
        )


def test_fixed_sets_are_randomized_and_a_note_says_so(result):
    assert (
        "sobol has too few different sets: its variances are measured with sobol | owen"
        in result.attrs["note"]
    )
    sobol = result.sel(sampler="sobol")
    assert (sobol["variance"] > 0).all()
    assert (
        float(sobol["t_value"].sel(n=64)) == 0.0
    )  # the figure is that of the set without randomization
    one, many = np.random.default_rng(1).random((2, 40, 16, 2))
    few, some = (mcs.Sampler.from_points(each) for each in (one[:3], many))
    assert free_of(few, [16])[0].steps == (Shift(),)
    assert free_of(some, [16]) == (some, "")
    scrambled, step = free_of(mcs.sampler("sobol"), [16])
    assert (type(scrambled.steps[0]), step) == (Owen, "owen")
    assert free_of(mcs.sampler("box-jitter"), [16])[1] == ""


def test_nets_in_files_are_scrambled_and_lattices_are_shifted(tmp_path):
    """A shifted digital net has 40 times the variance of a scrambled one at n = 1024."""
    counts = (64, 1024)
    for name, spec in (("net", "sobol"), ("lattice", "rank1-lattice"), ("blue", "poisson-disk")):
        for n in counts:
            points = mcs.sampler(spec, dims=2).draw(n, rng=1)
            mcs.core.pointfiles.write_points(tmp_path / f"{name}_{n}.dat", points)
    specs = [f"points(path={str(tmp_path / name)!r})" for name in ("net_*", "lattice_*", "blue_*")]
    found = mcs.sampler_bench(specs, counts=counts, realizations=100)
    assert found["randomization"].values.tolist() == ["owen", "shift", "shift"]
    assert "| owen; points(" in found.attrs["note"]
    smooth = found["variance"].sel(integrand="gaussian (smooth), 2-D", n=1024)
    f = mcs.integrand("genz-gaussian(a=3.515)", dims=2)
    for k, spec in enumerate(("sobol | owen", "rank1-lattice | shift")):
        plain = mcs.convergence(f, spec, [1024], realizations=400, rng=2)["variance"]
        assert 0.5 < float(smooth[k]) / float(plain[0]) < 2.0  # standard error of 15 to 20 %


def test_a_function_without_randomness_is_randomized():
    def same(n, rng):
        return np.random.default_rng(1).random((n, 1))

    source = mcs.Sampler.from_function(same, dims=1)
    found = mcs.sampler_bench([source, "random"], counts=[4, 16], dims=1, realizations=10)
    assert (found["variance"].values > 0).all()
    assert "are measured with" in found.attrs["note"]


def test_only_the_given_sets_are_used(tmp_path):
    for n in (16, 64):
        for k in range(20):
            points = Jittered().draw(n, rng=k)[0]
            mcs.core.pointfiles.write_points(tmp_path / f"n{n}_{k}.npy", [points])
    spec = f"points(path={str(tmp_path / 'n{n}_*')!r}, name='mine')"
    found = mcs.sampler_bench([spec, "random"], counts=(10, 70, 1000), realizations=40)
    assert found["label"].values.tolist() == ["mine", "random"]
    # Each count appears once, with the 20 given sets instead of 40 realizations
    np.testing.assert_array_equal(found["points_made"][0, 0], [16, 64, np.nan])
    np.testing.assert_array_equal(np.isnan(found["variance"][0]).all("integrand"), [0, 0, 1])
    assert np.isnan(found["points_per_second"][0]).all()  # the points are read from files
    assert "note" not in found.attrs
    assert np.isnan(making_seconds(mcs.sampler(spec).then(Shift()), 16, 0))


def test_integrands_in_several_dims():
    found = mcs.sampler_bench(
        ["pmj02", "random", Jittered(dims=2)], counts=(16, 64), dims=(2, 4), realizations=20
    )
    four = found["integrand_dims"].values == 4
    assert np.isnan(found["variance"].sel(sampler="pmj02").values[four]).all()
    assert np.isnan(found["rank"].sel(sampler="jittered").values[four]).all()
    assert np.isfinite(found["variance"].sel(sampler="random").values).all()
    np.testing.assert_array_equal(found["rank"].sel(sampler="random").values[four], 1.0)
    assert "pmj02 does not allow 4-D; jittered does not allow 4-D" in found.attrs["note"]


@pytest.mark.parametrize("dims", [1, 2, 3, 10])
def test_standard_integrands_exist_and_vary(dims):
    tasks = list(standard_tasks(dims))
    assert {task.kind for task in tasks} == {"smooth", "kink", "jump"}
    assert len({task.title for task in tasks}) == len(tasks)
    x = np.random.default_rng(dims).random((4000, dims))
    for task in tasks:
        values = mcs.integrand(task.spec, dims)(x)
        assert np.isfinite(values).all()
        # No integrand is a constant or a spike that 4000 samples miss
        assert np.mean(values != values[0]) > 0.01, task
        assert np.var(values) > 0, task
        assert np.max(np.abs(values - values.mean())) < 100 * np.std(values), task


def test_intervals_of_ranks_hold_simultaneously():
    """In at least 95 % of the benches, all true ranks lie in their intervals."""
    rng = np.random.default_rng(5)
    # Two of five samplers are equal; the others differ by 1 to 8 standard errors, on four tasks
    logs = np.array([0.0, 0.0, 0.2, 0.5, 2.3])[:, None]
    true_low = 1 + (logs[:, 0] < logs).sum(axis=1)
    true_high = 5 - (logs[:, 0] > logs).sum(axis=1)
    se, trials, held, sure = 0.2, 400, 0, 0
    for _ in range(trials):
        value = np.exp(logs + se * rng.standard_normal((5, 4)))
        ends = value[..., None] * np.exp(np.array([-1.0, 1.0]) * 1.959964 * se)
        _, found = ranks(value, ends, np.full((5, 4), 64.0))
        good = (found[..., 0] <= true_high[:, None]) & (found[..., 1] >= true_low[:, None])
        held += bool(good.all())
        sure += bool((found[4] == 5).all())
    assert held >= trials * (0.95 - 3 * np.sqrt(0.95 * 0.05 / trials))
    assert sure > 0.9 * trials  # a difference of six standard errors is found


def test_a_wide_interval_gives_a_wide_rank():
    def found(variance, ci, n=(64.0, 64.0)):
        rank, ends = ranks(np.array(variance)[:, None], np.array(ci)[:, None], np.array(n)[:, None])
        return rank[:, 0].tolist(), ends[:, 0].tolist()

    # Only the facing ends of two intervals matter
    assert found([1.0, 2.0], [[0.9, 1.1], [1.8, np.inf]]) == ([1, 2], [[1, 1], [2, 2]])
    assert found([2.0, 0.5], [[1.8, 2.2], [0.4, np.inf]]) == ([2, 1], [[1, 2], [1, 2]])
    # A sampler without variance is the best for certain
    assert found([0.0, 0.5], [[0.0, 0.0], [0.4, 0.6]]) == ([1, 2], [[1, 1], [2, 2]])
    # Half the variance at twice the number of points is not better
    assert found([1.0, 0.5], [[0.9, 1.1], [0.45, 0.55]], (64.0, 128.0))[1] == [[1, 2], [1, 2]]
    rank, ends = found([1.0, np.nan], [[0.9, 1.1], [np.nan, np.nan]])
    assert (rank[0], ends[0]) == (1, [1, 1])
    assert np.isnan([rank[1], *ends[1]]).all()


@pytest.mark.parametrize(
    ("samplers", "options", "words"),
    [
        ([], {}, "Given: 0 samplers, .* give at least one sampler"),
        ("random", {}, "samplers is 'random'; give a list"),
        (["random"], {"counts": (16,)}, ", 1 count and .* two counts"),
        (["random"], {"dims": ()}, "0 choices of dims; .* one number of dims"),
        (["random"], {"dims": 65}, "dims is 65"),
        (["random"], {"counts": (0, 16)}, "counts is 0"),
        (["random"], {"realizations": 1}, "realizations is 1"),
        (["random", "random"], {}, "listed twice"),
        (["pmj02"], {"dims": 4}, "pmj02"),
        (["no-such"], {}, "no sampler called 'no-such'"),
        ([5], {}, "is not a sampler"),
    ],
)
def test_refusals(samplers, options, words):
    with pytest.raises(McspectraError, match=words) as caught:
        mcs.sampler_bench(samplers, **options)
    assert isinstance(caught.value, ParameterError)


def test_labels_of_files_with_equal_names_include_their_folders(tmp_path):
    specs = []
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        for n in (4, 16):
            points = mcs.sampler("random", dims=2).draw(n, realizations=8, rng=n)
            np.savez(tmp_path / folder / f"n{n}.npz", points=points)
        specs.append(f"points(path={str(tmp_path / folder / 'n*.npz')!r})")
    found = mcs.sampler_bench(specs, counts=(4, 16), realizations=8)
    assert found["label"].values.tolist() == specs


def test_a_single_count_is_left_out_where_other_samplers_have_several():
    """A sampler with a single possible count is left out; in 6-D, jittered has n = 1 or 64."""
    found = mcs.sampler_bench(["jittered", "random"], counts=[16, 25], dims=[2, 6], realizations=4)
    assert "jittered does not allow 6-D" in found.attrs["note"]
    high = found.isel(integrand=found["integrand_dims"].values == 6).sel(sampler="jittered")
    assert np.isnan(high["variance"].values).all()
