"""Our samplers in Mitsuba: sets, requests, images, passes, and one sentence per error."""

import re
from pathlib import Path

import numpy as np
import pytest
from scipy import stats
from tests.processes import python

from mcspectra.cli.main import main
from mcspectra.core.errors import CountError, FileFormatError, MissingDependency, ParameterError
from mcspectra.core.streams import Stream
from mcspectra.rendering import load_mitsuba, load_scene, register_samplers, render_file
from mcspectra.rendering.backend import LARGEST_SAMPLE, import_mitsuba, threads_for_files
from mcspectra.rendering.kernel_sets import Rounds
from mcspectra.rendering.plugin import PLUGIN_VARIANTS, PaddedSets
from mcspectra.rendering.scenes import film_size

pytestmark = pytest.mark.render

LEVEL = 1e-3
SCENE = """<scene version="3.0.0">
  <default name="type" value="mcspectra"/><default name="spec" value="sobol | owen"/>
  <default name="integrator" value="direct"/><default name="passes" value="4294967295"/>
  <integrator type="$integrator"><integer name="samples_per_pass" value="$passes"/></integrator>
  <sensor type="perspective"><float name="fov" value="30"/>
    <transform name="to_world"><lookat origin="0, 3, 4" target="0, 0, 0" up="0, 1, 0"/></transform>
    <film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="6"/>
      <rfilter type="box"/></film>
    <sampler type="$type"><integer name="sample_count" value="16"/>{properties}</sampler>
  </sensor>
  <shape type="rectangle">
    <transform name="to_world"><rotate x="1" angle="-90"/><scale value="4"/></transform></shape>
  <shape type="rectangle">
    <transform name="to_world"><rotate x="1" angle="90"/><translate y="5"/></transform>
    <emitter type="area"/></shape>
</scene>"""
PROGRAM = "import sys; from mcspectra.cli.main import main; sys.exit(main(sys.argv[1:]))"
OURS = '<string name="spec" value="$spec"/>'


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("plugin")
    texts = {
        "ours": OURS,
        "joint": OURS + '<integer name="joint_dims" value="5"/>',
        "passes": OURS + '<integer name="samples_per_pass" value="4"/>',
        "stock": "",
    }
    for name, properties in texts.items():
        text = SCENE.replace("{properties}", properties)
        if name == "stock":
            text = text.replace("$type", "independent").replace(
                '<default name="type" value="mcspectra"/><default name="spec" value="sobol | '
                'owen"/>',
                "",
            )
        (folder / f"{name}.xml").write_text(text, encoding="utf-8")
    return {name: str(folder / f"{name}.xml") for name in texts}


def sampler(variant="llvm_ad_rgb", **properties):
    """An object of the plugin, in a variant that is set until the next call."""
    register_samplers(variant)
    mitsuba = import_mitsuba()
    mitsuba.set_variant(variant)
    return mitsuba.load_dict({"type": "mcspectra", **properties})


def numbers(source, *dims):
    """Draw requests of a wavefront in succession: (lanes, sum of dims)."""
    parts = [source.next_1d() if d == 1 else source.next_2d() for d in dims]
    return np.concatenate([np.atleast_2d(part.numpy()) for part in parts]).T.astype(np.float64)


def test_pads_are_the_samplers_sets_in_another_order():
    sets = PaddedSets(spec="sobol | owen", count=16)
    for dims in (1, 2):
        points = sets.pads(dims, Stream(5), 0, 40)
        assert points.shape == (40, 16, dims)
        assert points.dtype == np.float32
        cells = np.floor(points.astype(np.float64) * (16 if dims == 1 else 4)).astype(int)
        number = cells[..., 0] if dims == 1 else 4 * cells[..., 0] + cells[..., 1]
        assert (np.sort(number, axis=1) == np.arange(16)).all()


@pytest.mark.parametrize("spec", ["sobol | owen", "random"])
def test_sets_in_one_dim_share_no_numbers_with_pairs(spec):
    sets = PaddedSets(spec=spec, count=16)
    single, pair = (sets.pads(dims, Stream(5), 0, 20) for dims in (1, 2))
    # 320 and 640 numbers of 24 bits: 0.01 equal pairs are expected
    assert np.isin(single, pair).sum() <= 1


def test_sets_do_not_depend_on_how_many_are_drawn_at_once():
    sets = PaddedSets(spec="jittered", count=256, joint=4)
    whole = sets.pads(2, Stream(5), 0, 1500)  # the sets span two blocks
    np.testing.assert_array_equal(whole[1022:1026], sets.pads(2, Stream(5), 1022, 4))
    whole = sets.joints(Stream(5), 0, 600)
    np.testing.assert_array_equal(whole[511:514], sets.joints(Stream(5), 511, 3))


def test_orders_of_two_sets_are_independent():
    # Without shuffling, points in the first half would meet only points in the first half.
    points = PaddedSets(spec="sobol", count=16).pads(1, Stream(5), 0, 2000)[..., 0]
    halves = points < 0.5
    together = (halves[::2] & halves[1::2]).sum(axis=1)
    # Overlap of 8 of 16 with 8 of 16: hypergeometric, mean 4
    expected = stats.hypergeom(16, 8, 8)
    found = np.bincount(together, minlength=9)[1:8]
    mass = expected.pmf(np.arange(1, 8))
    p = stats.chisquare(found, found.sum() * mass / mass.sum()).pvalue
    assert p > LEVEL


def test_numbers_stay_below_one():
    points = PaddedSets(spec="mitsuba(sampler='independent')", count=4).pads(2, Stream(1), 0, 3)
    assert points.max() <= LARGEST_SAMPLE
    assert float(LARGEST_SAMPLE) < 1.0


@pytest.mark.parametrize("pixels", [1, 7, 509, 5000, 2**20])
def test_requests_of_a_pixel_use_different_sets(pixels):
    rounds = Rounds.of(pixels, 4, 2 * 64)
    assert 2 * 64 * rounds.size <= 2**27
    taken = {request * rounds.stride % rounds.size for request in range(509)}
    assert len(taken) == 509


def test_first_requests_of_all_pixels_use_different_sets():
    rounds = Rounds.of(300, 4, 32)
    taken = {
        (p + request * rounds.stride) % rounds.size for p in range(300) for request in range(4)
    }
    assert len(taken) == 1200


@pytest.mark.parametrize("joint", [0, 4])
def test_lanes_are_samples_of_pixels(joint):
    source = sampler(sample_count=16, joint_dims=joint)
    source.seed(3, 16 * 50)
    drawn = numbers(source, 2, 2, 1, 2).reshape(50, 16, 7)
    for columns in ((0, 1), (2, 3), (5, 6)):
        cells = np.floor(drawn[..., columns] * 4) @ [4, 1]
        assert (np.sort(cells, axis=1) == np.arange(16)).all()
    assert (np.sort(np.floor(drawn[..., 4] * 16), axis=1) == np.arange(16)).all()
    assert len(np.unique(drawn[..., 0])) > 790  # of 800 numbers; pixels share no set


def test_joint_dims_are_one_set_in_its_own_order():
    source = sampler(sample_count=16, joint_dims=4, spec="sobol", seed=9)
    source.seed(3, 16 * 2)
    drawn = numbers(source, 2, 1, 2).reshape(2, 16, 5)
    plain = PaddedSets(spec="sobol", count=16, joint=4).joints(Stream(1), 0, 1)[0]
    np.testing.assert_array_equal(drawn[0, :, :3], plain[:, :3])
    # two numbers do not fit, so they come from a separate set
    assert not np.array_equal(drawn[0, :, 3], plain[:, 3])


def test_seeds_change_points_and_are_reproducible():
    def first(seed, own):
        source = sampler(sample_count=4, seed=own)
        source.seed(seed, 32)
        return numbers(source, 2, 1)

    base = first(1, 2)
    np.testing.assert_array_equal(base, first(1, 2))
    for other in (first(2, 2), first(1, 3), first(2, 1)):
        assert not np.isin(other, base).any()


def test_clones_continue_equally_and_forks_need_a_seed():
    source = sampler(sample_count=4)
    source.seed(1, 8)
    numbers(source, 2)
    twin = source.clone()
    np.testing.assert_array_equal(numbers(source, 1, 2), numbers(twin, 1, 2))
    with pytest.raises(ParameterError, match="has no seed"):
        source.fork().next_1d()


@pytest.mark.parametrize("dims", [1, 2])
@pytest.mark.parametrize(
    "spec", ["sobol | owen", "jittered", "sobol | decorrelate(mode='digital-shift')"]
)
def test_passes_share_a_pixels_set(spec, dims):
    source = sampler(sample_count=16, spec=spec)
    source.set_samples_per_wavefront(4)
    source.seed(1, 4 * 5)
    passes = []
    for _ in range(4):
        passes.append(numbers(source, dims).reshape(5, 4, dims))
        twin = source.clone()
        np.testing.assert_array_equal(numbers(source, 1, 2), numbers(twin, 1, 2))
        source.advance()
    points = np.concatenate(passes, axis=1)
    cells = np.floor(points * (16 if dims == 1 else 4)) @ [4, 1][-dims:]
    assert (np.sort(cells, axis=1) == np.arange(16)).all()
    with pytest.raises(ParameterError, match="All 16 samples of each pixel have been used"):
        source.next_1d()


@pytest.mark.parametrize("n", [9, 16, 25])
def test_passes_of_jittered_points_take_any_count(n):
    source = sampler(sample_count=n, spec="jittered")
    source.set_samples_per_wavefront(1)
    source.seed(1, 40)
    points = []
    for _ in range(n):
        points.append(numbers(source, 2))
        source.advance()
    side = round(n**0.5)
    cells = np.floor(np.stack(points, axis=1) * side) @ [side, 1]
    assert (np.sort(cells, axis=1) == np.arange(n)).all()


@pytest.mark.parametrize(
    "spec",
    ["random", "jittered", "sobol | owen", "sobol | decorrelate(mask='blue-noise')"],
)
def test_recorded_loops_use_the_numbers_of_loops_that_are_run(files, spec):
    import drjit

    few = {"definitions": {"spec": spec, "integrator": "path"}, "seed": 3}
    recorded = render_file(files["ours"], **few)
    with drjit.scoped_set_flag(drjit.JitFlag.SymbolicLoops, False):
        run = render_file(files["ours"], **few)
    # The kernels may round the light of a path differently
    np.testing.assert_allclose(run, recorded, rtol=1e-4)


def test_scalar_sets_of_a_pixel_are_the_samplers():
    source = sampler("scalar_rgb", sample_count=16, joint_dims=2)
    source.seed(7)
    twin = source.clone()
    drawn = []
    for _ in range(16):
        sample = [*source.next_2d(), *source.next_2d(), source.next_1d()]
        assert sample == [*twin.next_2d(), *twin.next_2d(), twin.next_1d()]
        drawn.append(sample)
        source.advance()
        twin.advance()
    points = np.array(drawn, dtype=np.float64)
    for columns in ((0, 1), (2, 3)):
        cells = np.floor(points[:, columns] * 4) @ [4, 1]
        assert (np.sort(cells) == np.arange(16)).all()
    assert (np.sort(np.floor(points[:, 4] * 16)) == np.arange(16)).all()
    load_mitsuba()


def batches(file, variant="llvm_ad_rgb", spp=64, **definitions):
    """Sixteen images with different seeds."""
    register_samplers(variant)
    mitsuba = import_mitsuba()
    mitsuba.set_variant(variant)
    scene = mitsuba.load_file(file, **definitions)
    kind = int if variant.startswith("scalar") else mitsuba.UInt32
    images = [mitsuba.render(scene, spp=spp, seed=kind(s)) for s in range(16)]
    return np.stack([np.array(image, dtype=np.float64) for image in images])


def smallest_p_value(a, b):
    """Šidák-corrected p-value of the worst pixel, by Welch's test; channels are equal."""
    p = stats.ttest_ind(a[..., 0], b[..., 0], equal_var=False).pvalue
    return float(-np.expm1(p.size * np.log1p(-p.min())))


@pytest.mark.parametrize(
    ("name", "integrator", "variant"),
    [
        ("ours", "direct", "llvm_ad_rgb"),
        ("joint", "path", "llvm_ad_rgb"),
        pytest.param("ours", "path", "llvm_ad_rgb", marks=pytest.mark.slow),
        # Quicker: `test_scalar_sets_of_a_pixel_are_the_samplers`
        pytest.param("ours", "direct", "scalar_rgb", marks=pytest.mark.slow),
    ],
)
def test_images_agree_with_the_stock_sampler_and_have_less_noise(files, name, integrator, variant):
    # The plugin of the scalar variant draws each number by itself
    spp = 16 if variant == "scalar_rgb" else 64
    ours = batches(files[name], variant, spp, integrator=integrator)
    stock = batches(files["stock"], variant, spp, integrator=integrator)
    assert smallest_p_value(stock, ours) > LEVEL
    ratio = stock[..., 0].var(axis=0, ddof=1) / ours[..., 0].var(axis=0, ddof=1)
    # For equal variances, a ratio with 15 and 15 degrees of freedom exceeds this once in 1e6.
    assert np.median(ratio) > stats.f.isf(1e-6, 15 * 24, 15 * 24)


def test_an_error_of_two_percent_is_detected(files):
    ours, stock = batches(files["ours"], spp=256), batches(files["stock"], spp=1024)
    assert smallest_p_value(stock, 1.02 * ours) < LEVEL
    assert smallest_p_value(stock, ours) > LEVEL


def test_images_repeat_and_seeds_change_them(files):
    for variant in PLUGIN_VARIANTS:
        image = render_file(files["ours"], variant, spp=4, seed=1)
        np.testing.assert_array_equal(image, render_file(files["ours"], variant, spp=4, seed=1))
        assert not np.array_equal(image, render_file(files["ours"], variant, spp=4, seed=2))


def test_split_passes_give_the_image_of_one_pass(files):
    passes = {"definitions": {"passes": 4}}
    import_mitsuba().set_log_level(import_mitsuba().LogLevel.Error)
    np.testing.assert_allclose(
        render_file(files["passes"], "llvm_ad_rgb", **passes),
        render_file(files["ours"], "llvm_ad_rgb"),
        rtol=1e-5,
    )
    with pytest.raises(ParameterError, match="needs the sampler's integer samples_per_pass"):
        render_file(files["ours"], "llvm_ad_rgb", **passes)


@pytest.mark.parametrize(
    ("variant", "own_process"),
    [
        *((variant, False) for variant in PLUGIN_VARIANTS),
        pytest.param("llvm_ad_rgb", True, marks=pytest.mark.slow),
    ],
)
def test_command_writes_the_image(files, tmp_path, capsys, variant, own_process):
    out = tmp_path / "image.exr"
    command = ["render", files["ours"], "--integrator", "scene", "--variant", variant]
    command += ["-o", str(out), "--spp", "4", "--seed", "3"]
    if own_process:  # which has not started Mitsuba
        printed = python("-c", PROGRAM, *command, timeout=120, check=True).stdout
    else:
        assert main(command) == 0
        printed = capsys.readouterr().out
    assert "8 × 6 pixels" in printed
    with threads_for_files():
        written = np.array(load_mitsuba().Bitmap(str(out)), dtype=np.float64)
    # The film stores half floats.
    image = render_file(files["ours"], variant, spp=4, seed=3)
    np.testing.assert_allclose(written, image, rtol=1e-3)


@pytest.mark.parametrize("variant", PLUGIN_VARIANTS)
def test_a_sampler_replaces_the_scenes_own(files, tmp_path, variant):
    """The image equals that of a file with our sampler, and the file does not change."""
    before = Path(files["stock"]).read_bytes()
    few = {"spp": 4, "seed": 3}
    replaced = render_file(files["stock"], variant, sampler="jittered", **few)
    named = render_file(files["ours"], variant, definitions={"spec": "jittered"}, **few)
    np.testing.assert_array_equal(replaced, named)
    assert not np.array_equal(replaced, render_file(files["stock"], variant, **few))
    assert Path(files["stock"]).read_bytes() == before
    # A scene whose camera names no sampler has a default one
    bare = tmp_path / "bare.xml"
    bare.write_text(re.sub(r"<sampler.*</sampler>", "", before.decode()), encoding="utf-8")
    one = render_file(bare, variant, sampler="jittered", **few)
    np.testing.assert_array_equal(one, named)


def test_an_integrator_replaces_the_scenes_own(files):
    ours = {"definitions": {"integrator": "path"}}
    expected = render_file(files["ours"], seed=2, **ours)
    np.testing.assert_array_equal(render_file(files["ours"], integrator="path", seed=2), expected)
    with pytest.raises(ParameterError, match="cannot be read"):
        render_file(files["ours"], integrator="path(")


def test_counts_that_cannot_be_made_name_the_nearest(files):
    for variant in PLUGIN_VARIANTS:
        with pytest.raises(CountError, match="nearest counts are 9 and 16"):
            render_file(files["ours"], variant, spp=15, definitions={"spec": "jittered"})


@pytest.mark.parametrize(
    ("properties", "words"),
    [
        ({"spec": "nosuch"}, "no sampler called 'nosuch'"),
        ({"spec": 3}, "3 is not a sampler"),
        ({"spec": ""}, "sampler"),
        ({"sample_count": 15, "spec": "jittered"}, "nearest counts are 9 and 16"),
        ({"sample_count": 2**30}, "give a whole number from 1 to 65536"),
        ({"sample_count": 0}, "give a whole number from 1"),
        ({"joint_dims": 1}, "joint_dims is 1; give 0 for none, or a whole number from 2 to 64"),
        ({"joint_dims": 2.5}, "joint_dims is 2.5"),
        ({"samples_per_pass": 3}, "samples_per_pass is 3; give a divisor of sample_count, 4"),
        ({"samples_per_pass": -1}, "samples_per_pass is -1"),
        ({"seed": -1}, "seed"),
        ({"sed": 1}, "unreferenced property"),
    ],
)
def test_bad_properties(properties, words):
    with pytest.raises(RuntimeError, match=words):
        sampler(**properties)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["-D", "spec=nosuch"], "no sampler called 'nosuch'"),
        (["-D", "spec"], "give KEY=VALUE"),
        (["-D", "a=b"], "a=b"),
        (["--variant", "nosuch"], "--variant is 'nosuch'"),
        (["--sensor", "3"], "--sensor is 3"),
        (["--spp", "0"], "--spp is 0"),
        (["--seed", "4294967296"], "seed is 4294967296"),
        (["-o", "image.jpg"], "must end in .exr or .png"),
        (["-o", "nowhere/image.exr"], "in a folder that does not exist"),
    ],
)
def test_bad_commands_are_one_sentence(files, capsys, options, words):
    assert main(["render", files["ours"], "--integrator", "scene", *options]) == 2
    printed = capsys.readouterr().err
    assert words in printed
    assert printed.count("\n") == 1


def test_bad_files_are_one_sentence(tmp_path):
    with pytest.raises(FileFormatError, match="There is no scene file"):
        render_file(tmp_path / "missing.xml")
    broken = tmp_path / "broken.xml"
    broken.write_text("<scene", encoding="utf-8")
    with pytest.raises(FileFormatError, match=r"Mitsuba cannot render .*broken\.xml"):
        render_file(broken)
    blind = tmp_path / "blind.xml"
    blind.write_text('<scene version="3.0.0"/>', encoding="utf-8")
    with pytest.raises(ParameterError, match="no camera"):
        render_file(blind)


def test_scenes_with_our_sampler_can_be_analyzed(files, tmp_path):
    assert film_size(files["ours"]) == (8, 6)
    wrong = tmp_path / "wrong.xml"
    text = Path(files["ours"]).read_text(encoding="utf-8").replace("sobol | owen", "nosuch")
    wrong.write_text(text, encoding="utf-8")
    with pytest.raises(FileFormatError, match="There is no sampler called 'nosuch'") as caught:
        load_scene(str(wrong))
    assert "Traceback" not in str(caught.value)


def test_the_variant_is_restored(files):
    mitsuba = load_mitsuba()
    render_file(files["ours"], "scalar_rgb")
    assert mitsuba.variant() == "llvm_ad_rgb"


def test_without_llvm_only_the_scalar_plugin_is_made(monkeypatch):
    from mcspectra.rendering import plugin

    def missing():
        raise MissingDependency("no LLVM")

    monkeypatch.setattr(plugin, "load_mitsuba", missing)
    plugin._plugin_class.cache_clear()
    assert register_samplers() == ("scalar_rgb",)
    with pytest.raises(MissingDependency, match="no LLVM"):
        register_samplers("llvm_ad_rgb")
