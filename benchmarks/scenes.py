"""Compare predicted and rendered ratios of the variances of two samplers, on five scenes.

Each scene is rendered 200 times by ``mi.render`` with each sampler, with new seeds.
`mcspectra.rendering.rendered` predicts the ratio from fewer realizations of the same pixels.
A ratio is the variance of ``sobol | owen`` divided by the variance of a sampler of Mitsuba.
The ratio of a scene is the geometric mean over its pixels.
The predicted winner is wrong if the two intervals lie on opposite sides of 1.
``python -m benchmarks scenes --profile`` checks the samples per pixel that a profile states.
``python -m benchmarks scenes --bias`` tests renders against reference images with variances.
``python -m benchmarks scenes --joint`` compares several numbers of joint dims.
``python -m benchmarks scenes --default`` compares the default sampler with two others.
The option ``--scene=NAME`` limits each of these commands to one scene.
"""

import math

import numpy as np
from tests.rendering.reference_images import OURS as TESTED
from tests.rendering.reference_images import Pixels
from tests.rendering.small_scenes import SCENES

from mcspectra.core.streams import Stream
from mcspectra.profiler import profile_scene
from mcspectra.rendering import load_mitsuba
from mcspectra.rendering.paths import Tracer
from mcspectra.rendering.plugin import register_samplers
from mcspectra.rendering.rendered import Film, RenderedPixels, chosen_tiles
from mcspectra.rendering.scenes import as_scene

WIDTH, HEIGHT = 24, 16
RENDERS, PREDICTED = 200, 64
OURS = {"type": "mcspectra", "spec": "sobol | owen"}
DEFAULT = {4: 512, 16: 512, 64: 256, 256: 96, 1024: 40}  # numbers of renders, by samples per pixel
PADDED = {**OURS, "joint_dims": 0}
OTHERS = ("multijitter", "ldsampler", "independent")
LUMINANCE = (0.212671, 0.715160, 0.072169)


def images(name, plugin, spp, renders, first=0):
    """Luminance of R independent renders by Mitsuba itself, (R, pixels)."""
    mitsuba = load_mitsuba()
    scene = SCENES[name](width=WIDTH, height=HEIGHT)
    given = {"type": plugin} if isinstance(plugin, str) else plugin
    scene["sensor"]["sampler"] = {**given, "sample_count": spp}
    loaded = mitsuba.load_dict(scene)
    seeds = (mitsuba.UInt32(first + k) for k in range(renders))
    made = [np.array(mitsuba.render(loaded, spp=spp, seed=seed))[..., :3] for seed in seeds]
    return np.stack(made).reshape(renders, -1, 3) @ LUMINANCE


def ratio(ours, other, pixels):
    """Return the mean over pixels of log(Var(ours) / Var(other)), and its standard error."""
    logs = np.log(ours.var(axis=0, ddof=1)[pixels] / other.var(axis=0, ddof=1)[pixels])
    return logs.mean(), logs.std(ddof=1) / math.sqrt(len(logs))


def compare(name, spp):
    """Compare predicted with rendered ratios of variances for one scene.

    For each sampler of Mitsuba, return the predicted ratio divided by the rendered ratio.
    Also return the number of wrongly predicted winners.
    """
    scene = as_scene(SCENES[name](width=WIDTH, height=HEIGHT))
    tiles, side = chosen_tiles(Film.of(scene), WIDTH * HEIGHT, Stream.from_rng(0))
    tracer = Tracer(scene, "scene", "luminance", (WIDTH, HEIGHT))
    pixels = RenderedPixels(tracer, Film.of(scene))
    plugins = {"ours": OURS, "padded": PADDED, **{each: each for each in OTHERS}}
    rendered, predicted = {}, {}
    for k, (label, plugin) in enumerate(plugins.items()):
        rendered[label] = images(name, plugin, spp, RENDERS, 1000 * k)
        stream = Stream.from_rng(7).child(k)
        predicted[label] = pixels.estimates(plugin, spp, tiles, side, PREDICTED, stream)
    place = tiles @ [1, WIDTH]
    rendered = {label: values[:, place] for label, values in rendered.items()}
    floor = (1e-5 * np.abs(rendered["independent"].mean(axis=0))) ** 2
    noisy = np.all(
        [v.var(axis=0) > floor for v in [*rendered.values(), *predicted.values()]], axis=0
    )
    found, wrong = [], 0
    for label in ("padded", *OTHERS):
        (a, a_se), (b, b_se) = (ratio(v["ours"], v[label], noisy) for v in (predicted, rendered))
        found.append(math.exp(a - b))
        bad = a * b < 0 and abs(a) > 1.96 * a_se and abs(b) > 1.96 * b_se
        wrong += bad
        print(
            f"{name:6} {spp:4} against {label:12} predicted {math.exp(a):6.3f} "
            f"({math.exp(a - 1.96 * a_se):.3f} to {math.exp(a + 1.96 * a_se):.3f})  rendered "
            f"{math.exp(b):6.3f} ({math.exp(b - 1.96 * b_se):.3f} to "
            f"{math.exp(b + 1.96 * b_se):.3f})  predicted / rendered {found[-1]:.3f}"
            f"{'  WRONG WINNER' if bad else ''}",
            flush=True,
        )
    return found, wrong


def truth(name, target):
    """Compare the samples per pixel of a profile with many renders at powers of two."""
    scene = SCENES[name](width=WIDTH, height=HEIGHT)
    found = profile_scene(scene, target=target, seconds=30.0, rng=3)
    given = found.answer.given.name
    errors = {}
    for spp in (4, 16, 64, 256, 1024):
        values = images(name, given, spp, 100, 5000)
        seen = values.mean(axis=0) > 0
        relative = values[:, seen].std(axis=0, ddof=1) / values[:, seen].mean(axis=0)
        errors[spp] = np.quantile(relative, (0.5, 0.95))
    for k, each in enumerate(found.needed_now):
        logs = np.log([error[k] for error in errors.values()])
        # Beyond the largest number of samples, extrapolate with the slope between the last two
        ns = np.log(list(errors))
        true = math.exp(
            np.interp(-math.log(target), -logs, ns)
            if logs[-1] <= math.log(target)
            else ns[-1] + (math.log(target) - logs[-1]) * (ns[-1] - ns[-2]) / (logs[-1] - logs[-2])
        )
        low, high = each.spp_ci
        how = "truth" if true <= max(errors) else "extrapolated truth"
        print(
            f"{name:6} {given:12} target {target} at {each.share:.0%}: profile {each.spp:.0f} "
            f"({low:.0f} to {high:.0f}), {how} {true:.0f}, ratio {each.spp / true:.2f}",
            flush=True,
        )


def bias(scenes, spp=2**15):
    """Test means of our samplers, and points that are scaled by 0.97, against references."""
    for name, scene in scenes.items():
        pixels = Pixels(scene, WIDTH, HEIGHT)
        known = pixels.reference(spp)
        rows = []
        for plugin in TESTED:
            label = ", ".join(f"{k}={v}" for k, v in plugin.items() if k != "type") or "default"
            mean, own = pixels.image(plugin, 64, spp // 512, seed=2)
            rows.append((label, mean, spp // 8, own))
        rows.append(("random × 0.97", pixels.scaled(0.97, spp // 2, seed=3), spp // 2, 0.0))
        for label, mean, count, own in rows:
            passed, share = known.passes(mean, count, own)
            print(
                f"{name:6} {label:60} {share:8.2%} of the pixels agree, smallest p "
                f"{known.p_values(mean, count, own).min():.1e}: {'pass' if passed else 'FAIL'}",
                flush=True,
            )


def joint(scenes, renders=256):
    """Print variances divided by those of multijitter, for several numbers of joint dims."""
    choices = {"multijitter": "multijitter"}
    choices |= {f"joint {k}": {**OURS, "joint_dims": k} for k in (0, 2, 4, 6, 8)}
    choices |= {"independent": "independent"}
    for name, scene in scenes.items():
        pixels = Pixels(scene, WIDTH, HEIGHT)
        for spp in (4, 16, 64):
            values = {
                label: pixels.renders(plugin, spp, renders, Stream.from_rng(7).child(k))
                for k, (label, plugin) in enumerate(choices.items())
            }
            floor = (1e-5 * np.abs(values["independent"].mean(axis=0))) ** 2
            kept = np.all([each.var(axis=0) > floor for each in values.values()], axis=0)
            given = values.pop("multijitter")
            parts = []
            for label, each in values.items():
                log, se = ratio(each, given, kept)
                parts.append(f"{label} {math.exp(log):.2f} ± {1.96 * se * math.exp(log):.2f}")
            print(f"{name:6} {spp:4}  {'  '.join(parts)}", flush=True)


def default(scenes):
    """Print variances of the default sampler and of ``sobol | owen``, divided by multijitter's."""
    choices = {"multijitter": "multijitter", "sobol | owen": OURS, "default": {"type": "mcspectra"}}
    for name, scene in scenes.items():
        pixels = Pixels(scene, WIDTH, HEIGHT)
        for spp, renders in DEFAULT.items():
            values = {
                label: pixels.renders(plugin, spp, renders, Stream.from_rng(11).child(k))
                for k, (label, plugin) in enumerate(choices.items())
            }
            given = values.pop("multijitter")
            floor = (1e-6 * np.abs(given.mean(axis=0))) ** 2
            kept = np.all([each.var(axis=0) > floor for each in (given, *values.values())], axis=0)
            parts = []
            for label, each in values.items():
                log, se = ratio(each, given, kept)
                parts.append(f"{label} {math.exp(log):.2f} ± {1.96 * se * math.exp(log):.2f}")
            print(f"{name:6} {spp:4}  {'  '.join(parts)}", flush=True)


def main(*flags):
    """Print the table of the five scenes, or the samples per pixel of profiles."""
    register_samplers()
    mitsuba = load_mitsuba()
    mitsuba.set_log_level(mitsuba.LogLevel.Error)
    chosen = [flag.partition("=")[2] for flag in flags if flag.startswith("--scene=")]
    scenes = {name: SCENES[name] for name in chosen or SCENES}
    for flag, measure in (("--bias", bias), ("--joint", joint), ("--default", default)):
        if flag in flags:
            measure(scenes)
            return
    if "--profile" in flags:
        targets = {"plate": 0.1, "room": 0.1, "sky": 0.03, "lens": 0.05, "fog": 0.1}
        for name in scenes:
            truth(name, targets[name])
        return
    every, wrong = [], 0
    for name in scenes:
        for spp in (16, 64):
            found, bad = compare(name, spp)
            every += found
            wrong += bad
    away = np.abs(np.log(every))
    print(
        f"median |predicted / rendered − 1| {np.median(np.expm1(away)):.3f}, wrong winners {wrong}"
    )
