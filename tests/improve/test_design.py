"""Designs: objectives, searches, certificates, and the public functions."""

import dataclasses
import functools
import itertools
import json

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import (
    CountError,
    DomainError,
    FileFormatError,
    McspectraError,
    NoGainWarning,
    ParameterError,
)
from mcspectra.core.streams import Stream
from mcspectra.improve.designs import design as doors
from mcspectra.improve.designs import searches
from mcspectra.improve.designs._kernels import improve_code
from mcspectra.improve.designs.objectives import as_objective
from mcspectra.improve.designs.searches import SearchSettings
from mcspectra.samplers import SharedCells
from mcspectra.samplers.stratified import write_cells

GAUSSIANS = "gaussian(center=uniform(0, 1), width=uniform(0.15, 0.4))"
KINDS = tuple(searches.KINDS)


# Settings with which a search takes about a second
SMALL = SearchSettings(
    cells=2**12,
    members=256,
    batches=1,
    trials=2**18,
    rounds=16,
    frequencies=2**14,
    torus_frequencies=2**12,
    table_bits=14,
    trees=16,
    net_starts=2,
    return_rival=False,
)
UNFOLDED = ["sobol | owen", "pmj02", "korobov | shift", "rank1-lattice | shift"]


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    """Give each test its own cache."""
    monkeypatch.setenv("MCSPECTRA_CACHE", str(tmp_path / "cache"))


def design(*arguments, settings=SMALL, **options):
    """Search a sampler with few members, cells and starts."""
    return mcs.design(*arguments, settings=settings, **options)


def spectrum(m):
    """Return a power spectrum that decays more slowly along a diagonal than across it."""
    along, across = (m[..., 0] + m[..., 1]) / 3.0, m[..., 0] - m[..., 1]
    return np.where((m == 0).all(-1), 0.0, 1.0 / (1.0 + along**2 + across**2) ** 2)


def dual_sum(vector, n, half):
    m = np.array(list(itertools.product(range(-half, half + 1), repeat=len(vector))))
    return spectrum(m)[m @ np.array(vector) % n == 0].sum()


def test_the_lattice_in_2d_has_the_smallest_dual_sum():
    n, half = 31, 6
    sampler = design("lattice", {"spectrum": spectrum, "half_width": half}, n)
    vector = sampler.base.vector
    sums = [dual_sum((1, z), n, half) for z in range(1, n)]
    assert np.ptp(sums) > 0.01
    assert dual_sum(vector, n, half) == pytest.approx(min(sums), rel=1e-9)
    assert "fold" not in sampler.spec  # folding would double frequencies outside the class


@pytest.mark.parametrize(
    ("kind", "n"), [("lattice", 31), ("digital-net", 16), ("owen", 16), ("strata", 16)]
)
def test_predicted_variances_of_searches_equal_measured_variances(kind, n, tmp_path):
    objective = as_objective(GAUSSIANS, 2)
    stream = Stream.from_rng(3)
    found = min(searches.KINDS[kind](objective, n, stream, SMALL), key=lambda each: each.variance)
    sampler = found.make(tmp_path / "sets.npz")

    # Average over 16 batches of 64 realizations, and over the members that the search used
    values = objective.functions(256, stream.generator(4 if kind == "digital-net" else 0))
    batches = [
        searches.mean_variances(values, sampler, n, 64, seed).sum() for seed in range(100, 116)
    ]
    sigma = np.std(batches, ddof=1) / np.sqrt(16)
    # The search itself measures nets with 64 sets; for strata, offsets inside cells add variance
    slack = {"digital-net": 5 * np.std(batches, ddof=1), "strata": 0.25 * found.variance}
    # A table of side 128 aliases (−116, 1) to (12, 1). Its amplitude is 1 %, so the power
    # changes by about 2 %
    aliased = 0.03 * found.variance
    assert abs(np.mean(batches) - found.variance) < 5 * sigma + slack.get(kind, aliased)


def test_the_gradient_of_the_energy_equals_finite_differences():
    m = np.array([[1, 0], [2, -1], [0, 3]])
    power = np.array([1.0, 0.5, 0.25])
    function = searches._energy(m, power, 2)
    x = np.random.default_rng(1).random((5, 2))
    value, gradient = function(x)
    waves = np.exp(-2j * np.pi * (x @ m.T)).mean(axis=0)
    assert value == pytest.approx((power * np.abs(waves) ** 2).sum(), rel=1e-8)
    step = 1e-5
    for i, j in itertools.product(range(5), range(2)):
        moved = x.copy()
        moved[i, j] += step
        back = x.copy()
        back[i, j] -= step
        slope = (function(moved)[0] - function(back)[0]) / (2 * step)
        assert gradient[i, j] == pytest.approx(slope, abs=1e-5)


def test_flipped_trees_keep_elementary_intervals():
    sampler = design("owen", "gaussians", 16)
    assert "points(" in sampler.spec
    sets = np.load(str(sampler.base.path))["points"]
    assert len(sets) == 16
    for points in sets:
        for level in range(5):
            cells = np.floor(points * [2**level, 2 ** (4 - level)]).astype(int)
            assert len(np.unique(cells, axis=0)) == 16


@pytest.mark.parametrize("kind", KINDS)
def test_designs_halve_the_variance_of_unfolded_rivals(kind):
    few = dataclasses.replace(SMALL, trials=2**16, frequencies=2**13)
    sampler = design(kind, GAUSSIANS, 64, rng=5, settings=few)
    assert sampler.unbiased
    found = mcs.certificate(sampler, GAUSSIANS, 64, rivals=UNFOLDED, members=200, rng=11)
    assert found["design_ratio_ci"].values[1] < 0.5
    assert float(found["design_ratio"]) == pytest.approx(
        float(found["mean_variance"][0] / found["mean_variance"][1:].min())
    )


@pytest.mark.slow
def test_lattices_in_3d_are_better_than_sobol_for_rotated_bells():
    """The class has narrow, rotated bells.

    A search that used 40 frequencies per axis alone gave 1.5 times the variance of sobol | owen.
    """

    def bell(generator):
        turn = np.linalg.qr(generator.standard_normal((3, 3)))[0]
        width, center = generator.uniform(0.08, 0.5, 3), generator.random(3)
        return mcs.Integrand.from_function(
            lambda x: np.exp(-0.5 * (((x - center) @ turn / width) ** 2).sum(axis=-1)), dims=3
        )

    few = dataclasses.replace(SMALL, judge_members=64)
    made = design("lattice", bell, 256, dims=3, settings=few)
    found = mcs.certificate(made, bell, 256, rivals=["sobol | owen"], members=400, realizations=16)
    assert found["design_ratio_ci"].values[1] < 0.9


def test_the_certificate_of_a_rival_has_the_ratio_one():
    found = mcs.certificate("sobol | owen", GAUSSIANS, 16, rivals=["sobol | owen"], dims=2, rng=2)
    low, high = found["design_ratio_ci"].values
    assert low < 1.0 < high
    assert high - low < 0.3


def test_several_equal_rivals_have_the_ratio_one():
    """The ratio is not biased, although the smallest of six means is a sixth too small.

    The standard deviation of the mean ratio is 0.03.
    """
    ratios = [
        mcs.certificate(
            "sobol | owen",
            ["gaussian(width=0.2)"],
            16,
            rivals=["sobol | owen"] * 6,
            dims=2,
            members=20,
            realizations=8,
            rng=seed,
        )["design_ratio"]
        for seed in range(40)
    ]
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.1)


def test_members_have_the_parameters_of_the_spec():
    objective = as_objective("gaussian(center=[0.5, 0.5], width=uniform(0.2, 0.2001))", 2)
    values = objective.draw(8, np.random.default_rng(0))(np.array([[0.5, 0.7]]))
    np.testing.assert_allclose(values * 8**0.5, np.exp(-0.5), rtol=2e-3)


def test_a_list_of_integrands_is_a_class_with_equal_shares():
    f, g = mcs.integrand("gaussian", dims=2), mcs.integrand("disk", dims=2)
    x = np.random.default_rng(0).random((50, 2))
    values = as_objective([f, g], 2).whole(x)
    np.testing.assert_allclose((values**2).sum(0), 0.5 * (f(x) ** 2 + g(x) ** 2))
    mixed = as_objective(["gaussians", g], 2)
    assert mixed.whole is None
    assert len(mixed.draw(10, np.random.default_rng(0))(x)) == 6  # five Gaussians and the disk


@pytest.mark.parametrize("level", [-1.0, 1.0, -1e-18])
def test_flips_that_change_nothing_end_a_search(level):
    found = improve_code(np.full(64, level), np.zeros(3, np.int64), 6, np.empty(8, np.int64))
    assert found == pytest.approx(level)


def test_a_covariance_gives_functions_with_that_covariance():
    half, rng = 1, np.random.default_rng(2)
    members = rng.standard_normal((6, 3, 3))
    grid = np.arange(-half, half + 1)
    m = np.array(list(itertools.product(grid, repeat=2)))
    coefficients = np.array(
        [[sum(c[i, j] * (1 if (i, j) == (abs(a), abs(b)) else 0) for i, j in np.ndindex(2, 2))
          for a, b in m] for c in members]
    )  # fmt: skip
    matrix = coefficients.T @ coefficients.conj()
    x = rng.random((20, 2))
    real = coefficients @ np.exp(2j * np.pi * (m @ x.T))  # symmetric coefficients give cosines
    whole = as_objective({"covariance": matrix}, 2).whole(x)
    np.testing.assert_allclose(whole.T @ whole, (real.T @ real.conj()).real, atol=1e-9)
    assert np.abs(real.imag).max() < 1e-9


def test_the_same_seed_gives_the_same_sampler_with_and_without_cache(tmp_path, monkeypatch):
    first = design("strata", "disks", 9, rng=4).draw(9, realizations=5, rng=1)
    again = design("strata", "disks", 9, rng=4, path=tmp_path / "mine.json")
    np.testing.assert_array_equal(again.draw(9, realizations=5, rng=1), first)
    assert str(tmp_path / "mine.npz") in again.spec
    spec = json.loads((tmp_path / "mine.json").read_text())["spec"]
    assert spec == "shared-cells(path='mine.npz')"  # relative to the folder of the file
    monkeypatch.chdir(tmp_path)
    np.testing.assert_array_equal(mcs.sampler(spec).draw(9, realizations=5, rng=1), first)
    monkeypatch.setenv("MCSPECTRA_CACHE", str(tmp_path / "other"))
    fresh = design("strata", "disks", 9, rng=4)
    np.testing.assert_array_equal(fresh.draw(9, realizations=5, rng=1), first)


def test_classes_of_small_spots_have_different_cache_keys(tmp_path, monkeypatch):
    """Cache keys differ although 64 probe points miss both spots."""
    monkeypatch.setenv("MCSPECTRA_CACHE", str(tmp_path))

    def spot(x, y, half):
        return mcs.Integrand.from_function(
            lambda u: 1.0 * (np.abs(u - [x, y]) < half).all(axis=-1), dims=2
        )

    for pair in (
        ["disk(center=[0.22, 0.30], radius=0.1)", "disk(center=[0.81, 0.12], radius=0.1)"],
        [[spot(0.22, 0.301, 0.09)], [spot(0.809, 0.2, 0.05)]],
    ):
        first, second = (design("strata", each, 16) for each in pair)
        assert first.spec != second.spec


def test_a_design_in_a_file_can_be_moved_with_its_sets(tmp_path, monkeypatch):
    monkeypatch.setenv("MCSPECTRA_CACHE", str(tmp_path / "cache"))
    (tmp_path / "sets").mkdir()
    monkeypatch.chdir(tmp_path)
    found = design("strata", "gaussians", 16, path="mine.json")
    assert found.spec == "shared-cells(path='mine.npz')"
    made = found.draw(16, rng=3)
    for name in ("mine.json", "mine.npz"):
        (tmp_path / name).rename(tmp_path / "sets" / name)
    monkeypatch.chdir(tmp_path / "sets")
    spec = json.loads((tmp_path / "sets" / "mine.json").read_text())["spec"]
    assert np.array_equal(mcs.sampler(spec, dims=2).draw(16, rng=3), made)


def test_an_interrupt_keeps_the_best_and_is_not_cached(monkeypatch):
    def interrupted(*arguments):
        yield from itertools.islice(searches.KINDS["lattice"](*arguments), 1)
        raise KeyboardInterrupt

    def at_once(*_):
        raise KeyboardInterrupt
        yield

    monkeypatch.setattr(doors, "KINDS", {"lattice": at_once})
    with pytest.warns(NoGainWarning, match="interrupted before its first result"):
        assert design("lattice", "gaussians", 13).spec == "korobov | shift"
    real = dict(searches.KINDS)
    monkeypatch.setattr(doors, "KINDS", {"lattice": interrupted})
    assert design("lattice", "gaussians", 13).spec.endswith(
        "| shift"
    )  # the search stopped after its first result
    monkeypatch.setattr(doors, "KINDS", real)
    assert "fold" in design("lattice", "gaussians", 13).spec


def test_starting_with_cosets_of_a_net_is_better():
    """Short searches that start with cosets of a net end with less variance."""
    ratios = []
    for cosets in (True, False):
        settings = dataclasses.replace(SMALL, trials=2**14, rounds_of_many_dims=48, cosets=cosets)
        found = design("points", "gaussians", 64, dims=4, settings=settings)
        told = mcs.certificate(found, "gaussians", 64, rivals=["sobol | owen"], members=400)
        ratios.append(told["design_ratio_ci"].values)
    assert ratios[0][1] < ratios[1][0]


def _random_points(*_):
    yield searches.Design(0.0, 1.0, lambda _: mcs.sampler("random", 2))


def test_a_design_that_loses_to_a_rival_is_replaced_by_it(tmp_path, monkeypatch):
    """The rival is also in the cache and in the user's file."""
    monkeypatch.setattr(doors, "KINDS", {"lattice": _random_points})
    few = dataclasses.replace(doors._SETTINGS, check_members=400)
    monkeypatch.setattr(doors, "_SETTINGS", few)
    for options in ({}, {}, {"path": tmp_path / "mine.json"}):
        with pytest.warns(NoGainWarning, match="times .* the mean variance of .*instead"):
            made = mcs.design("lattice", GAUSSIANS, 64, **options)
        assert made.spec.endswith("| shift | mirror(mode='fold')")
    assert json.loads((tmp_path / "mine.json").read_text())["spec"] == made.spec
    found = mcs.certificate(made, GAUSSIANS, 64, members=400, rng=8)
    assert found["design_ratio_ci"].values[0] < 1.1


def test_folded_lattices_and_blue_noise_are_rivals():
    found = mcs.certificate("sobol | owen", GAUSSIANS, 64, dims=2, members=100, rng=2)
    assert found.attrs["best_rival"].endswith("| shift | mirror(mode='fold')")
    assert "pmj02-blue-noise" in found["sampler"].values
    assert found["design_ratio_ci"].values[0] > 2.0


def test_shared_cells_are_uniform_and_invalid_cells_are_refused(tmp_path):
    path = tmp_path / "cells.npz"
    cells = np.indices((4, 2)).reshape(2, -1).T.reshape(2, 4, 2) + 1
    write_cells(path, cells * np.array([1, -1]))
    sampler = SharedCells(path=str(path))
    x = sampler.draw(4, realizations=4000, rng=1)
    assert (x >= 0).all()
    assert (x < 1).all()
    np.testing.assert_allclose(x.mean(axis=(0, 1)), 0.5, atol=5 * np.sqrt(1 / 12 / 4000))
    for wrong in (cells[:1].repeat(2, 0), cells[:, :3], cells * 0, cells.astype(float)):
        np.savez(path, cells=wrong)
        with pytest.raises(FileFormatError, match="cells"):
            SharedCells(path=str(path))
    with pytest.raises(FileFormatError, match="There is no file"):
        mcs.sampler("shared-cells(path='no.npz')")


@pytest.mark.parametrize(
    ("kind", "objective", "n", "dims", "error", "words"),
    [
        ("best", "gaussians", 16, 2, ParameterError, "lattice, polynomial-lattice"),
        ("owen", "gaussians", 15, 2, CountError, "power of two"),
        ("digital-net", "gaussians", 1, 2, CountError, "power of two"),
        ("strata", "gaussians", 2**14, 2, CountError, "kind='lattice'"),
        ("lattice", "gaussians", 0, 2, McspectraError, "n is 0"),
        ("lattice", "gaussians", 16, 9, ParameterError, "dims is 9"),
        ("lattice", [], 16, 2, ParameterError, "empty list"),
        ("lattice", "constant", 16, 2, ParameterError, "constant"),
        ("lattice", "gausian", 16, 2, McspectraError, "gaussian"),
        ("lattice", "gaussian(width=uniform(2, 1))", 16, 2, McspectraError, "low < high"),
        ("lattice", "gaussian(width=uniform(-2, -1))", 16, 2, ParameterError, "width"),
        ("lattice", {"spectrum": np.full((3, 3), np.nan)}, 16, 2, ParameterError, "finite"),
        ("lattice", {"spectrum": -np.ones((3, 3))}, 16, 2, ParameterError, "negative"),
        ("lattice", {"spectrum": np.zeros((3, 3))}, 16, 2, ParameterError, "constant"),
        ("lattice", {"spectrum": np.ones((3, 2))}, 16, 2, ParameterError, "shape"),
        ("lattice", {"covariance": -np.eye(9)}, 16, 2, ParameterError, "Hermitian"),
        ("lattice", {"power": 1}, 16, 2, ParameterError, "'spectrum' or"),
        ("lattice", 3.5, 16, 2, ParameterError, "3.5"),
        ("lattice", lambda rng: "disk(radius=0)", 16, 2, ParameterError, "radius"),
        ("lattice", lambda x: x.sum(-1), 16, 2, ParameterError, "from_function"),
        ("lattice", "gaussian(dims=9)", 16, None, ParameterError, "dims is 9"),
    ],
)
def test_bad_input_is_refused_with_a_sentence(kind, objective, n, dims, error, words):
    with pytest.raises(error, match=words):
        design(kind, objective, n, dims=dims)


def test_settings_are_for_samplers_only_and_part_of_the_cache_key():
    with pytest.raises(ParameterError, match="settings is for samplers"):
        design("density", "gaussian", 16)
    with pytest.raises(ParameterError, match="settings is 3; give a SearchSettings"):
        design("lattice", "gaussian", 16, settings=3)
    quick = SearchSettings(cells=2**10, members=32, trials=2**12, return_rival=False)
    one, other = (dataclasses.replace(quick, rounds=r) for r in (4, 5))
    cells = [
        design("strata", "gaussians", 16, settings=each).draw(16, realizations=4, rng=0)
        for each in (one, other)
    ]
    assert not np.array_equal(*cells)


F3 = mcs.Integrand.from_function(lambda x: x.prod(axis=-1), dims=3)


@pytest.mark.parametrize(
    ("objective", "dims"),
    [
        (lambda rng: F3, 3),
        (F3, 3),
        (["gaussians", F3], 3),
        ("gaussian(center=[0.1, 0.2, 0.3], width=uniform(0.1, 0.2), dims=3)", 3),
        ({"spectrum": np.ones((3, 3, 3, 3))}, 4),
        ({"spectrum": spectrum}, 2),
        ("half-spaces", 2),
        (GAUSSIANS, 2),
    ],
)
def test_dims_are_derived_from_the_class(objective, dims):
    assert as_objective(objective).dims == dims


def test_values_that_are_not_finite_are_refused():
    f = mcs.integrand("gaussian", dims=2)
    poles = mcs.Integrand.from_function(lambda x: x[..., 0] ** 2, dims=2)
    object.__setattr__(poles, "function", lambda x: np.where(x[..., 0] > 0.5, np.inf, 1.0))
    with pytest.raises((DomainError, ParameterError), match="finite"):
        design("lattice", [f, poles], 16)


def test_the_verb_prints_and_writes_spec_and_certificate(tmp_path, monkeypatch, capsys):
    from mcspectra.cli import designs as verb
    from mcspectra.cli.main import main

    monkeypatch.setattr(verb.mcs, "design", functools.partial(mcs.design, settings=SMALL))
    out = tmp_path / "mine.json"
    arguments = [
        "design",
        "lattice",
        GAUSSIANS,
        "-n",
        "8",
        "-o",
        str(out),
        "--members",
        "40",
        "--json",
    ]
    assert main(arguments) == 0
    said = json.loads(capsys.readouterr().out)
    assert said == json.loads(out.read_text())
    assert mcs.sampler(said["spec"]).draw(8).shape == (1, 8, 2)
    low, high = said["certificate"]["design_ratio_ci"]
    assert 0 <= low < high
    nowhere = str(tmp_path / "no" / "mine.json")
    assert main(["design", "lattice", "gaussians", "-n", "5", "-o", nowhere]) == 2
    assert "cannot be written" in capsys.readouterr().err
    assert main(["design", "owen", "gaussians", "-n", "9"]) == 2
    assert "power of two" in capsys.readouterr().err


def test_the_verb_saves_the_rival_that_its_certificate_prefers(tmp_path, monkeypatch, capsys):
    """`design` and the certificate measure separately; the certificate decides."""
    from mcspectra.cli import designs as verb
    from mcspectra.cli.main import main

    monkeypatch.setattr(verb.mcs, "design", lambda *_, **__: mcs.sampler("random", 2))
    out = tmp_path / "mine.json"
    for n, rival, told in (
        ("64", "rank1-lattice | shift | mirror(mode='fold')", "it is saved instead"),
        ("16", "pmj02-blue-noise", "its points are not uniform, so this design is kept"),
    ):
        words = ["design", "lattice", GAUSSIANS, "-n", n, "--members", "40", "-o", str(out)]
        assert main(words) == 0
        assert f"{rival} has less variance than this design; {told}" in capsys.readouterr().out
        saved = json.loads(out.read_text())
        assert saved["spec"] == (rival if n == "64" else "random")
        assert saved["certificate"]["sampler"][0] == "random"
