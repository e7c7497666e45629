"""Generators of QMCPy as samplers: equal points, correct counts, no guesses."""

import os
import sys

import numpy as np
import pytest
from tests.conftest import NO_QMCPY

import mcspectra as mcs
from mcspectra.core.errors import CountError, FileFormatError, MissingDependency, ParameterError
from mcspectra.core.streams import Stream
from mcspectra.quality.nets import net_t_value
from mcspectra.samplers import Sampler, as_sampler, sampler
from mcspectra.samplers.engines import QmcpySampler

qmcpy = pytest.importorskip("qmcpy", reason=f"{NO_QMCPY}; all of tests/samplers/test_qmcpy.py")


def seed_of(rng, realization):
    k0, k1 = Stream.from_rng(rng).keys(realization, 1)[0]
    return np.random.SeedSequence([int(k0), int(k1)])


@pytest.mark.parametrize(
    ("name", "options", "n"),
    [
        ("DigitalNetB2", {}, 16),
        ("DigitalNetB2", {"randomize": "NUS"}, 16),
        ("DigitalNetB2", {"order": "GRAY"}, 11),
        ("Lattice", {}, 16),
        ("Lattice", {"order": "GRAY"}, 11),
        ("Halton", {}, 11),
        ("Faure", {}, 9),
        ("Kronecker", {}, 11),
        ("KorobovLattice", {}, 31),
        ("LatinHypercube", {}, 11),
        ("IIDStdUniform", {}, 11),
    ],
)
def test_points_equal_those_of_the_generator(name, options, n):
    source = sampler(f"qmcpy(generator={name!r}, options={options!r})", 3)
    assert source.unbiased
    given = {"warn": False} if name in ("Halton", "Faure", "Kronecker") else {}
    for r in (0, 5):
        made = getattr(qmcpy, name)(3, replications=None, seed=seed_of(9, r), **given, **options)
        np.testing.assert_array_equal(
            source.draw(n, rng=9, first=r)[0], made.gen_samples(n, warn=False)
        )


@pytest.mark.parametrize("name", ["DigitalNetB2", "Lattice", "Halton", "IIDStdUniform"])
def test_an_instance_is_a_pattern_for_fresh_ones(name):
    made = getattr(qmcpy, name)(2, seed=4)
    before = made(4)
    source = Sampler.from_qmcpy(made)
    assert (source.dims, source.unbiased) == (2, True)
    np.testing.assert_array_equal(source.draw(16, rng=3), sampler_of(name).draw(16, rng=3))
    np.testing.assert_array_equal(Sampler.from_qmcpy(made).draw(4, rng=3), source.draw(4, rng=3))
    np.testing.assert_array_equal(made(4)[: len(before)].shape, before.shape)
    assert name in source.spec


def sampler_of(name):
    return Sampler.from_qmcpy(name, dimension=2)


def test_names_classes_and_instances_are_taken_everywhere():
    by_name = sampler("qmcpy(generator='Lattice')", 3)
    assert Sampler.from_qmcpy("Lattice", dims=3) == by_name
    assert Sampler.from_qmcpy(qmcpy.Lattice, dimension=3) == by_name
    assert as_sampler(qmcpy.Lattice, 3) == by_name
    assert as_sampler(qmcpy.Lattice(3, seed=1), 3).dims == 3
    assert mcs.convergence("gaussian", qmcpy.Lattice(2), [4, 8], realizations=10).sizes["n"] == 2
    with pytest.raises(ParameterError, match="3 dims, but 2 dims are needed"):
        as_sampler(qmcpy.Lattice(3), 2)


def test_scrambled_nets_are_nets():
    for points in sampler("qmcpy", 2).draw(64, realizations=20, rng=1):
        assert net_t_value(points) == 0


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("DigitalNetB2", {"randomize": "FALSE"}),
        ("DigitalNetB2", {"randomize": "LMS"}),
        ("Lattice", {"randomize": "FALSE"}),
        ("Halton", {"randomize": "FALSE"}),
        ("LatinHypercube", {"randomize": "FALSE"}),
        ("Hammersley", {}),
    ],
)
def test_unrandomised_generators_do_not_claim_to_be_unbiased(name, options):
    assert not Sampler.from_qmcpy(name, dims=2, **options).unbiased


def test_counts_are_powers_of_two_where_the_order_needs_them():
    net = sampler("qmcpy", 2)
    with pytest.raises(CountError, match="nearest counts are 8 and 16") as caught:
        net.draw(10)
    assert caught.value.nearest == (8, 16)
    assert net.nearest_count(1000) == 1024
    lattice = Sampler.from_qmcpy("Lattice", dims=2)
    with pytest.raises(CountError, match="at most 1048576 points"):
        lattice.draw(2**21)
    with pytest.raises(CountError, match="cannot make 5 points: KorobovLattice: n=5 is not"):
        Sampler.from_qmcpy("KorobovLattice", dims=2).draw(5)


class Edge(qmcpy.IIDStdUniform):
    """Points whose largest coordinate is `largest`."""

    largest = 1.0

    def _gen_samples(self, *args, **kwargs):
        points = super()._gen_samples(*args, **kwargs)
        points[..., 0, 0] = self.largest
        return points


class Beyond(Edge):
    largest = 1.0000001


class Bad(Edge):
    largest = np.nan


def test_coordinates_rounded_to_1_lie_just_below():
    points = Sampler.from_qmcpy(Edge, dims=2).draw(4, rng=1)[0]
    assert points[0, 0] == np.nextafter(1.0, 0.0)


@pytest.mark.parametrize(("cls", "words"), [(Beyond, r"must lie in \[0,1\)"), (Bad, "NaN")])
def test_points_outside_the_unit_cube_are_errors(cls, words):
    source = Sampler.from_qmcpy(cls, dims=2)
    assert not source.unbiased or cls.__name__ in source.spec
    with pytest.raises(ParameterError, match=words):
        source.draw(4)


@pytest.mark.parametrize(
    ("given", "arguments", "words"),
    [
        ("DigitalNetB3", {}, "Did you mean 'DigitalNetB2'"),
        ("DummySampler", {}, "no generator 'DummySampler'"),
        (3, {}, "3 is not a generator"),
        (int, {}, "is not a generator"),
        ("Lattice", {"dims": 2, "dimension": 2}, "give one of them"),
        ("Lattice", {"dims": 0}, "dimension is 0"),
        ("Lattice", {"dims": 10**4}, "cannot be made in 10000 dims"),
        ("Lattice", {"seed": 3}, "seed is not an option"),
        ("Lattice", {"replications": 3}, "replications is not an option"),
        ("Lattice", {"randomize": "sometimes"}, "randomize='sometimes'"),
        ("Lattice", {"colour": 3}, "colour"),
        (qmcpy.Lattice(2, replications=3, seed=1), {}, "replications or chosen dimensions"),
        (qmcpy.Lattice([1, 3], seed=1), {}, "replications or chosen dimensions"),
        (qmcpy.Lattice(2, seed=1), {"dims": 3}, "for 2 dims, not for 3"),
        (qmcpy.Lattice(2, seed=1), {"randomize": "FALSE"}, "already has its arguments"),
    ],
)
def test_bad_generators_and_arguments(given, arguments, words):
    with pytest.raises(ParameterError, match=words):
        Sampler.from_qmcpy(given, **arguments)


def test_options_must_be_names_with_values():
    with pytest.raises(ParameterError, match="names with values"):
        QmcpySampler(options=[1])


def test_a_missing_package_is_one_sentence(monkeypatch):
    monkeypatch.setitem(sys.modules, "qmcpy", None)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(MissingDependency, match=r"pip install 'mcspectra\[qmcpy\]'"):
        sampler("qmcpy")


@pytest.mark.parametrize(
    ("generator", "key", "lines"),
    [
        ("DigitalNetB2", "generating_matrices", "2\n2\n8\n3\n4 2 1\n4 6 7\n"),
        ("Lattice", "generating_vector", "2\n8\n1\n3\n"),
    ],
)
def test_tables_are_files_and_never_come_from_the_network(
    tmp_path, monkeypatch, generator, key, lines
):
    """QMCPy asked a server for every name first, so a spec sent paths of this machine there."""
    asked = []
    monkeypatch.setattr("urllib.request.urlopen", lambda *given, **_: asked.append(given))
    (tmp_path / "table.txt").write_text(lines)
    os.mkfifo(tmp_path / "pipe.txt")

    def spec(name):
        return f"qmcpy(generator={generator!r}, options={{{key!r}: {name!r}, 'randomize': False}})"

    assert sampler(spec(str(tmp_path / "table.txt"))).draw(8).shape == (1, 8, 2)
    for name, words in {
        str(tmp_path / "none.txt"): "There is no file",
        str(tmp_path / "pipe.txt"): "a device or a pipe",
        "http://evil.example/a.txt": "There is no file",
        "a.npy": "does not end in one of .txt",
    }.items():
        with pytest.raises(FileFormatError, match=words):
            sampler(spec(name))
    assert asked == []
