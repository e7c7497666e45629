"""Keys of a study: the estimators they build, and contradictions between them."""

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import ConfigError
from mcspectra.studies import make_plan
from mcspectra.studies.files import decode_study

HEAD = """
title = "t"
samplers = ["jittered"]
[convergence]
counts = [4, 16]
realizations = 20
[[estimators]]
name = "a"
"""
STEP = 'integrand = "step(at=0.3)"\ndims = 1\n'
TWO = 'integrand = "linear"\ndims = 1\ndensities = ["uniform", "linear(slope=1)"]\n'
SUM = 'integrands = ["linear", "step(at=0.3)"]\ndims = 1\n'
TWO_DENSITIES = ["uniform", "linear(slope=1)"]


def _estimator(keys, tmp_path):
    return make_plan(decode_study(HEAD + keys), tmp_path).cells[0].subject.estimator


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        (STEP, lambda: mcs.Estimator("step(at=0.3)", dims=1)),
        (STEP + 'density = "linear(slope=1)"',
         lambda: mcs.Estimator("step(at=0.3)", "linear(slope=1)", dims=1)),
        (STEP + "smoothed = 0.1", lambda: mcs.Estimator(mcs.smoothed("step(at=0.3)", 0.1, dims=1))),
        (STEP + 'mirror = "integrand"', lambda: mcs.Mirrored("step(at=0.3)", "integrand", dims=1)),
        (STEP + 'mirror = "random"', lambda: mcs.Mirrored("step(at=0.3)", "random", dims=1)),
        (STEP + 'mirror = "uniform"', lambda: mcs.Mirrored("step(at=0.3)", "uniform", dims=1)),
        (TWO, lambda: mcs.MultipleImportance("linear", TWO_DENSITIES, dims=1)),
        (TWO + 'heuristic = "power(beta=3)"\ntechnique_counts = [1, 2]',
         lambda: mcs.MultipleImportance(
             "linear", TWO_DENSITIES, dims=1, heuristic="power(beta=3)", counts=[1, 2])),
        (TWO + 'sets = "shared"',
         lambda: mcs.MultipleImportance("linear", TWO_DENSITIES, dims=1, sets="shared")),
        (TWO + "one_sample = true",
         lambda: mcs.estimators.OneSampleMIS("linear", TWO_DENSITIES, dims=1)),
        (TWO + 'one_sample = true\nprobabilities = [0.25, 0.75]\nselection = "coordinate"',
         lambda: mcs.estimators.OneSampleMIS(
             "linear", TWO_DENSITIES, [0.25, 0.75], dims=1, selection="coordinate")),
        (SUM + 'sets = "joint"\ntechnique_counts = [1, 2]',
         lambda: mcs.estimators.TechniqueSum(
             ["linear", "step(at=0.3)"], dims=1, sets="joint", counts=[1, 2])),
    ],
)  # fmt: skip
def test_keys_make_the_estimators_of_the_library(tmp_path, keys, expected):
    built, wanted = _estimator(keys, tmp_path), expected()
    assert type(built) is type(wanted)
    assert (built.spec, built.counts, built.dims) == (wanted.spec, wanted.counts, wanted.dims)
    u = np.random.default_rng(1).random((7, built.dims))
    for t in range(len(built.counts)):
        assert np.array_equal(built.primary_values(t, u), wanted.primary_values(t, u))


@pytest.fixture
def colour(tmp_path):
    from PIL import Image

    pixels = np.random.default_rng(2).integers(20, 250, (8, 8, 3)).astype(np.uint8)
    Image.fromarray(pixels).save(tmp_path / "c.png")
    return tmp_path


@pytest.mark.parametrize("way", ["own", "shared", "combined"])
def test_channels_make_channel_estimators(colour, way):
    specs = [f"image(path='{{folder}}c.png', channel={c})" for c in range(3)]
    listed = ", ".join(f'"{s.format(folder="")}"' for s in specs)
    keys = f'integrand = "image(path=\'c.png\')"\ndensities = [{listed}]\nchannels = "{way}"\n'
    built = _estimator(keys, colour)
    made = mcs.estimators.channel_estimators(
        f"image(path='{colour}/c.png')", [s.format(folder=f"{colour}/") for s in specs]
    )
    wanted = made["mis" if way == "combined" else way]
    assert type(built) is type(wanted)
    assert built.spec == wanted.spec
    u = np.random.default_rng(1).random((5, 2))
    for t in range(3):
        assert np.array_equal(built.primary_values(t, u), wanted.primary_values(t, u))


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        (STEP + 'integrands = ["linear"]', "either integrand or integrands"),
        (STEP + "technique_counts = [1]", "but one technique"),
        (TWO + "one_sample = true\ntechnique_counts = [1, 2]", "but one technique"),
        ('integrands = ["linear"]\ndims = 1\ndensity = "uniform"', "carry their densities inside"),
        ('integrands = ["linear"]\ndims = 1\nsmoothed = 0.1', "cannot be smoothed"),
        (STEP + 'sets = "shared"', "belong to several techniques"),
        (STEP + "one_sample = true", "no densities to choose from"),
        (TWO + "probabilities = [0.5, 0.5]", "belong to one_sample"),
        (TWO + 'channels = "one"', "which needs density"),
        (STEP + 'channels = "own"', "which needs densities"),
        (TWO + 'channels = "own"', "no channels: it is scalar"),
        (TWO + 'channels = "own"\nheuristic = "power"', "takes no heuristic"),
        (TWO + 'channels = "combined"\none_sample = true', "channels and one_sample"),
        (TWO + "one_sample = true\nprobabilities = [0.5]", "probabilities"),
        (TWO + 'sets = "sharde"', "sets is 'sharde'.*Did you mean 'shared'"),
        (TWO + "one_sample = 1", r"\[0\].one_sample is 1; give True or False"),
        (STEP + 'samplers = ["random", ""]', r"\[0\].samplers\[1\] is ''; give a text"),
        (STEP + "predict = { counts = [4, 16.5] }",
         r"predict.counts\[1\] is 16.5; give a whole number"),
        (STEP + "predict = 3", r"estimators\[0\].predict is 3; give a table"),
        (STEP + "predict = {}", r"estimators\[0\].predict: the key 'counts' is missing"),
        (STEP + "terms = { n = 4, bands = 3 }", "terms.bands is 3; it must be one of radial"),
        (STEP + 'mirror = "both"', "mirror"),
        (STEP + "smoothed = 0", r"\[0\].smoothed is 0; give a finite number greater than 0"),
        (STEP + "smoothed = nan", "smoothed|width"),
        (STEP + "anova = { order = 3 }", "anova.order is 3; give a whole number from 1 to 2"),
        (STEP + 'remedies = { budget = 64, kinds = ["mirorred"] }', "Did you mean 'mirrored'"),
        (STEP + "remedies = { budget = 64, kinds = [] }", "kinds"),
        (STEP + "remedies = { budget = 64, realizations = 99 }",
         "99; give a whole number from 100"),
        (TWO + "remedies = { budget = 1 }",
         "remedies: budget is 1; give a whole number of at least"),
        (STEP + "predict = { counts = [16, 4] }", "give ascending numbers"),
        (STEP + "techniques = { counts = [] }", "counts"),
        (STEP + "pcf = { n = 1 }", "pcf: pair_correlation needs n of at least 2"),
        (STEP + "pcf = { n = 4, max_distance = 0.6 }", "0.6; .* at most 0.5"),
        (STEP + "spectrum = { n = 4, frequency_step = 0 }", "frequency_step"),
        (STEP + "spectrum = { m = 4 }", "there is no key 'm'; allowed here: n"),
        ('integrand = "linear"\ndims = 65\nanova = {}\nsamplers = ["random"]', "from 1 to 64"),
    ],
)  # fmt: skip
def test_contradicting_or_invalid_keys_are_refused(tmp_path, keys, words):
    with pytest.raises(ConfigError, match=words):
        _estimator(keys, tmp_path)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("title = 't'", "nothing to study"),
        ("title = 't'\n[[maps]]\nname = 'm'\nscene = 'veach'", "has no samplers"),
        (HEAD + STEP + "[[maps]]\nname = 'a'\nscene = 'veach'", "names must differ"),
        ("title = 't'\n[[maps]]\nname = 'm'\nscene = 'x'\nspam = 1", "'spam'"),
        ("title = 't'\nseed = " + "9" * 5000, "number with too many digits"),
        # The time of tomllib grew with the square of the parts of a key: hours for a megabyte
        ("a." * 500_000 + "b = 1", "nested too deeply"),
        ("x = { " + '"a" . ' * 100_000 + "b = 1 }", "nested too deeply"),
        (
            "title = 't'\ntime_limit = 1e-300",
            "time_limit is 1e-300; give a finite number at least 0.01",
        ),
        (
            "title = 't'\nestimators = 3",
            r"estimators is 3; give a list of tables, \[\[estimators\]\]",
        ),
        ("title = 't'\nestimators = [3]", r"estimators\[0\] is 3; give a table"),
        ("title = 't'\nmaps = [3]", r"maps\[0\] is 3; give a table"),
        ("title = 't'\nsamplers = 'random'", "samplers is 'random'; give one flat list"),
    ],
)
def test_invalid_studies_are_refused(text, words):
    with pytest.raises(ConfigError, match=words):
        decode_study(text)


def test_whole_numbers_may_be_written_as_floats():
    text = HEAD.replace("[4, 16]", "[1e1, 1e3]") + 'integrand = "gaussian"\ndims = 2.0\n'
    study = decode_study("seed = 7e0\n" + text)
    found = (study.seed, study.estimators[0].dims, *study.analyses["convergence"].counts)
    assert found == (7, 2, 10, 1000)
    assert {type(each) for each in found} == {int}


@pytest.mark.parametrize("value", ["'LONG'", "['LONG']", "{ a = 'LONG' }"])
@pytest.mark.parametrize("key", ["n", "half_width", "eps", "basis", "cross_matrix"])
def test_long_values_are_shown_in_part(key, value):
    text = f"{HEAD}{STEP}terms = {{ {'' if key == 'n' else 'n = 4, '}{key} = {value} }}"
    with pytest.raises(ConfigError, match=f"terms.{key}") as caught:
        decode_study(text.replace("LONG", "x" * 10_000))
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ("counts = [4, 4]", "give ascending numbers"),
        ("counts = [7, 9]", "jittered"),
        ("scene = '../room.xml'", "outside the study's folder"),
        ("counts = [4, 1073741824]", "memory"),
    ],
)
def test_invalid_maps_are_refused(tmp_path, keys, words):
    scene = "" if "scene" in keys else "scene = 'veach'\n"
    text = f"title = 't'\nsamplers = ['jittered']\n[[maps]]\nname = 'm'\n{scene}{keys}"
    with pytest.raises(ConfigError, match=words):
        make_plan(decode_study(text), tmp_path)
