"""Quality of the random streams as samplers use them: within, across and between streams.

Every statistical check passes one or several p-values to `assert_plausible`, which limits the whole
file to one false alarm in a million runs. Seeds are fixed, so that results are reproducible.
"""

import numpy as np
import pytest
from scipy import stats

from mcspectra.core import streams
from mcspectra.core.errors import ParameterError
from mcspectra.core.streams import Stream

FALSE_ALARMS = 1e-6
CHECKS = 2000  # largest number of p-values in this file
LEVEL = 1 - (1 - FALSE_ALARMS) ** (1 / CHECKS)  # Šidák

SHAPE = (1024, 1024)  # streams by numbers: 2^20 numbers per family
TWO_53 = 2.0**53


def assert_plausible(p_values):
    """Check that p-values are neither too small nor too close to 1."""
    assert_plausible.made += np.size(p_values)
    assert assert_plausible.made <= CHECKS, "raise CHECKS"
    extreme = np.minimum(p_values, 1 - np.asarray(p_values))
    assert np.min(extreme) > LEVEL / 2, f"{np.sum(extreme <= LEVEL / 2)} of {extreme.size} fail"


assert_plausible.made = 0


def _realizations():
    """Rows are consecutive realizations of one seed; coordinate j of point i is number i·d + j."""
    return Stream.from_rng(1).uniforms(0, *SHAPE)


def _seeds():
    """Rows are realization 0 of consecutive integer seeds."""
    return np.concatenate([Stream.from_rng(s).uniforms(0, 1, SHAPE[1]) for s in range(SHAPE[0])])


def _children():
    """Rows are realization 0 of the children of one stream."""
    parent = Stream.from_rng(3)
    return np.concatenate([parent.child(k).uniforms(0, 1, SHAPE[1]) for k in range(SHAPE[0])])


def _first_numbers():
    """Number 0 of 2^20 realizations: all randomness comes from the keys."""
    return Stream.from_rng(5).uniforms(0, SHAPE[0] * SHAPE[1], 1).reshape(SHAPE)


def _related_keys():
    """Rows are keys of streams that differ in few bits; users may set them, no seed does."""
    return np.concatenate([Stream(k).uniforms(0, 1, SHAPE[1]) for k in range(SHAPE[0])])


FAMILIES = {
    "realizations": _realizations,
    "seeds": _seeds,
    "children": _children,
    "first-numbers": _first_numbers,
    "related-keys": _related_keys,
}


@pytest.fixture(scope="module", params=FAMILIES)
def uniforms(request):
    return FAMILIES[request.param]()


def integers(u):
    """Return the 53 random bits of each uniform number."""
    return (u * TWO_53).astype(np.uint64)


def chi2_uniform(cells, count):
    """p-value for `cells`, integers in [0, count), being uniform."""
    return stats.chisquare(np.bincount(np.ravel(cells).astype(np.int64), minlength=count)).pvalue


def z_p_value(mean, expected, sigma):
    return stats.norm.cdf((mean - expected) / sigma)


def test_numbers_are_multiples_of_2_to_the_minus_53_below_one(uniforms):
    assert uniforms.min() >= 0.0
    assert uniforms.max() < 1.0
    np.testing.assert_array_equal(integers(uniforms) / TWO_53, uniforms)
    assert len(np.unique(integers(uniforms) % 2**11)) == 2**11  # the lowest bits are random


def test_moments(uniforms):
    """Mean, variance, third and fourth central moment, each with the σ of its estimate."""
    x = np.ravel(uniforms) - 0.5
    for power in (1, 2, 3, 4):
        expected = 0.0 if power % 2 else 0.5**power / (power + 1)
        variance = 0.5 ** (2 * power) / (2 * power + 1) - expected**2
        sigma = np.sqrt(variance / x.size)
        assert_plausible(z_p_value(np.mean(x**power), expected, sigma))


@pytest.mark.parametrize(("shift", "bits"), [(45, 8), (41, 12), (0, 8), (0, 12), (20, 12)])
def test_bits_are_uniform(uniforms, shift, bits):
    """χ² of the top bits, of the lowest of the 53 (11 … of the word), and of some between."""
    assert_plausible(chi2_uniform(integers(uniforms) >> shift & (2**bits - 1), 2**bits))


@pytest.mark.parametrize("lag", [1, 2, 3, 16])
@pytest.mark.parametrize("shift", [48, 0], ids=["top", "low"])
@pytest.mark.parametrize("axis", [0, 1], ids=["across-streams", "within"])
def test_pairs_are_independent(uniforms, axis, lag, shift):
    """χ² on 32×32 cells of pairs without common numbers, `lag` apart in or across streams."""
    five = integers(uniforms if axis else uniforms.T) >> shift & 31
    blocks = five[:, : five.shape[1] // (2 * lag) * 2 * lag].reshape(len(five), -1, 2, lag)
    assert_plausible(chi2_uniform(32 * blocks[:, :, 0] + blocks[:, :, 1], 32**2))


def test_consecutive_streams_are_uncorrelated(uniforms):
    """Correlations of neighboring rows: each by its z-score, all together by χ²."""
    x = (uniforms - 0.5) * np.sqrt(12)
    z = (x[:-1:2] * x[1::2]).sum(axis=1) / np.sqrt(x.shape[1])
    assert_plausible(stats.chi2.cdf(np.sum(z**2), z.size))
    # z sums 1024 products of kurtosis 9/5 · 9/5 = 3.24: Edgeworth adds 3 % to the tail at 7σ.
    assert np.abs(z).max() < stats.norm.isf(LEVEL / 2 / z.size)


@pytest.mark.parametrize("low", [True, False], ids=["lowest-32", "top-32"])
def test_values_collide_as_often_as_by_chance(uniforms, low):
    """Of N words of 32 bits, about λ = N²/2^33 = 128 pairs agree, with a Poisson distribution."""
    words = integers(uniforms).ravel()
    short = words & np.uint64(2**32 - 1) if low else words >> np.uint64(21)
    _, repeats = np.unique(short, return_counts=True)
    pairs = int(np.sum(repeats * (repeats - 1) // 2))
    expected = words.size * (words.size - 1) / 2**33
    assert_plausible(stats.poisson.cdf(pairs, expected))


def test_no_stream_contains_a_part_of_another():
    """2^21 numbers of 2,048 streams of all types: equal values at any lag are extremely rare.

    λ = N²/2^54 = 2^-12 pairs agree by chance; three or more with probability λ³/6 = 2.4e-12. A
    stream that is a shifted copy of another would give hundreds.
    """
    parent = Stream.from_rng(0)
    kinds = [Stream.from_rng(s) for s in range(512)] + [parent.child(k) for k in range(512)]
    rows = [s.uniforms(0, 1, 1024) for s in kinds if s != parent]
    rows += [parent.uniforms(0, 1025, 1024)]
    values = np.concatenate(rows).ravel()
    assert values.size == 2**21
    assert values.size - len(np.unique(values)) < 3


def test_streams_with_similar_keys_are_not_permutations_of_each_other():
    """Keys k0 that differ in low bits swap indices; k1, which enters later, must undo this."""
    keys = np.array([[2**63 + i, k] for i in range(64) for k in (0, 1, 2**63)], np.uint64)
    out = np.empty((len(keys), 1024))
    streams._fill_uniforms(keys, out)
    for same in (0, 1, 2):  # with equal k1 the swapped copies exist, so this test can fail
        assert len(np.unique(out[same::3])) == 1024
    assert len(np.unique(out[[0, 4, 8]])) == 3 * 1024


def mixed_again(keys, index):
    """The mix of the module docstring, implemented again with NumPy: uint64, keys (R, 2)."""
    k0, k1 = keys.T
    x = (np.uint64(index) ^ k0) * np.uint64(0x9E3779B97F4A7C15)
    x ^= x >> np.uint64(32)
    x = (x + k1) * np.uint64(0xBF58476D1CE4E5B9)
    x ^= x >> np.uint64(29)
    x *= np.uint64(0x94D049BB133111EB)
    return x ^ x >> np.uint64(32)


def test_the_mix_agrees_with_the_documentation():
    stream = Stream.from_rng(7)
    expected = mixed_again(stream.keys(5, 100), 41)
    np.testing.assert_array_equal(
        stream.uniforms(5, 100, 42)[:, 41], (expected >> np.uint64(11)) * 2.0**-53
    )
    k0, k1 = stream.keys(5, 1)[0]
    assert streams.mix_bits(k0, k1, 41) == expected[0]


# kat_vectors of Random123 [Salmon2011], philox4x32 with 10 rounds: counter, key, output
KNOWN_ANSWERS = [
    ([0] * 4, [0] * 2, [0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8]),
    (
        [0xFFFFFFFF] * 4,
        [0xFFFFFFFF] * 2,
        [0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD],
    ),
    (
        [0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344],
        [0xA4093822, 0x299F31D0],
        [0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1],
    ),
]


@pytest.mark.parametrize(("counter", "key", "output"), KNOWN_ANSWERS, ids=["0", "1", "pi"])
def test_philox_gives_the_published_answers(counter, key, output):
    """Word order: a key's low half is key word 0; outputs 0 and 1 are high and low half of k0."""
    k0, k1 = streams._philox4x32(np.uint64(key[0] | key[1] << 32), *counter)
    assert [k0 >> 32, k0 & 0xFFFFFFFF, k1 >> 32, k1 & 0xFFFFFFFF] == output


def test_bits_are_the_same_on_every_platform():
    """Golden values: a change here changes the results of every seed."""
    stream = Stream.from_rng(0)
    assert stream.key == 15793235383387715774
    assert Stream.from_rng(2**64).key == 8649202198168436674
    assert stream.child(1).key == 17899225666559050801
    assert stream.child(1 << 16).key == 18307223377801466342
    assert stream.keys(0, 1).tolist() == [[0x1F47A3EC8FF17ABB, 0x8A4D809CDDB87C00]]
    assert stream.keys(2**40, 1).tolist() == [[0x8B327F278DD77FE7, 0xC64DA2E0A2A9B6D4]]
    assert stream.uniforms(0, 2, 3).tolist() == [
        [0.5123400257981112, 0.6800407778816099, 0.2591794617511125],
        [0.4413559736250746, 0.6365644846773089, 0.6375232701367078],
    ]
    assert stream.generator(3).integers(0, 2**32, 3).tolist() == [2724735334, 401290554, 3284472128]


def test_a_realization_does_not_depend_on_what_is_drawn_with_it():
    stream = Stream.from_rng(8)
    whole = stream.uniforms(0, 10, 64)
    np.testing.assert_array_equal(stream.uniforms(3, 4, 64), whole[3:7])
    np.testing.assert_array_equal(stream.uniforms(3, 4, 5), whole[3:7, :5])
    np.testing.assert_array_equal(stream.keys(3, 4), stream.keys(0, 10)[3:7])


def test_keys_of_realizations_and_children_all_differ():
    """Realizations differ by construction (a bijection), children up to 2^-64 per pair."""
    stream = Stream.from_rng(9)
    assert len(np.unique(stream.keys(0, 2**16), axis=0)) == 2**16
    assert len({stream.child(k).key for k in range(2**12)}) == 2**12


def test_rng_follows_spec_7():
    assert Stream.from_rng(5) == Stream.from_rng(5) == Stream.from_rng(np.int64(5))
    assert Stream.from_rng(np.random.SeedSequence(5)) == Stream.from_rng(5)
    assert Stream.from_rng(5) != Stream.from_rng(6)
    assert Stream.from_rng(None) != Stream.from_rng(None)
    assert Stream.from_rng(2**200) != Stream.from_rng(0)


def test_a_generator_is_advanced_and_a_seed_sequence_is_not():
    generator, sequence = np.random.default_rng(5), np.random.SeedSequence(5)
    assert Stream.from_rng(generator) != Stream.from_rng(generator)
    assert Stream.from_rng(np.random.default_rng(5)) == Stream.from_rng(np.random.default_rng(5))
    assert Stream.from_rng(sequence) == Stream.from_rng(sequence)
    assert Stream.from_rng(sequence) != Stream.from_rng(sequence.spawn(1)[0])


@pytest.mark.parametrize("rng", [-1, 1.5, 1.0, "x", True, [1, 2], np.random.RandomState(1), np.nan])
def test_invalid_seeds_are_rejected(rng):
    with pytest.raises(ParameterError, match=r"^rng is .*; give a") as caught:
        Stream.from_rng(rng)
    assert "\n" not in str(caught.value)


def test_generators_are_reproducible_differ_and_can_spawn():
    stream = Stream.from_rng(10)
    np.testing.assert_array_equal(stream.generator(2).random(8), stream.generator(2).random(8))
    several = np.concatenate([stream.generator(r).random(8) for r in range(64)])
    assert len(np.unique(several)) == several.size
    child, twin = stream.generator(2).spawn(1)[0], stream.generator(2).spawn(1)[0]
    np.testing.assert_array_equal(child.random(8), twin.random(8))
    assert child.random() not in several
