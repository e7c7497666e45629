"""Analyze one pixel: its contents, the rate of each strategy, and the causes.

Strategies are light sampling, BSDF sampling, and both combined by a heuristic (balance or power).
Combined strategies take n samples of each technique.
Variances of all strategies are measured and predicted with several samplers.
Terms, the bottleneck and remedies use one sampler, the first that is not ``random``.
"""

from __future__ import annotations

import functools
import itertools
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any, TypeAlias, final

import numpy as np
import xarray as xr

from mcspectra.core.analysis import Subject
from mcspectra.core.checks import as_choice, as_integer
from mcspectra.core.display import counted, shown
from mcspectra.core.errors import Parameter, ParameterError, close_match_hint
from mcspectra.core.parallel import MAX_REALIZATIONS, available_workers
from mcspectra.core.progress import report
from mcspectra.core.results import dataset
from mcspectra.core.streams import Stream
from mcspectra.estimators import AbstractEstimator, Estimator
from mcspectra.explain.diagnosis import diagnose
from mcspectra.explain.primary import primary_picture
from mcspectra.improve.remedy import Remedies
from mcspectra.improve.remedy import remedies as find_remedies
from mcspectra.measure.converge import convergence
from mcspectra.measure.techniques import technique_terms
from mcspectra.measure.terms import variance_terms
from mcspectra.prediction.prediction import predict
from mcspectra.quality.jumps import curve_length
from mcspectra.rendering.backend import LOCK, compilations
from mcspectra.rendering.costs import SceneCost, timed_part
from mcspectra.rendering.pixel import (
    Pixel,
    PixelView,
    check_channel,
    check_view,
    describe_pixel,
    incident_light,
    pixel_mis,
)
from mcspectra.rendering.rendered import preview
from mcspectra.rendering.scene_checks import camera_rays, integrator_note, warn_integrator
from mcspectra.rendering.scenes import (
    Scene,
    as_scene,
    emitter_names,
    film_size,
    named_pixels,
    scene_name,
)
from mcspectra.samplers import Sampler, as_sampler

__all__ = [
    "EFFORTS",
    "PIXEL_SAMPLERS",
    "PIXEL_STRATEGIES",
    "PixelEffort",
    "analyse_pixel",
    "check_compared",
    "find_pixel",
    "plan_pixel",
]

PIXEL_STRATEGIES = ("light", "bsdf", "balance", "power")
"""Light and BSDF sampling, and multiple importance sampling of both by two heuristics."""

PIXEL_SAMPLERS = ("random", "jittered", "jittered | shift", "sobol | owen")
"""Samplers that are compared by default."""

_HEURISTICS = ("balance", "power")
_TECHNIQUES = ("light", "bsdf")
_BASES = ("auto", "fourier")
_QUICK_REMEDIES = ("unshifted", "mirrored", "sampler", "heuristic", "techniques")
_ROUNDING = 1e-5  # Largest rounding step of float32, relative to the largest |g|
_MOST_SAMPLES = 2**22
_LEAST_BUDGET = 8  # Smallest budget: the total number of evaluations of both techniques
_FEWEST = 100  # Smallest number of realizations for remedies

Parts: TypeAlias = "dict[str, xr.Dataset]"


@final
@dataclass(frozen=True, kw_only=True)
class PixelEffort:
    """Numbers that determine how much is measured for a pixel.

    Attributes
    ----------
    counts
        Numbers of samples n of each technique, by dims.
    realizations
        Number of estimates for each n.
    half_width
        Half width of the spectra, by dims.
    resolution
        Resolution of pictures in pixels per side.
    remedies
        Kinds of remedies to try; None tries all.
    """

    counts: dict[int, tuple[int, ...]]
    realizations: int
    half_width: dict[int, int]
    resolution: int
    remedies: tuple[str, ...] | None


EFFORTS = {
    "quick": PixelEffort(
        counts={2: (16, 64, 256, 1024), 3: (8, 64, 512)},
        realizations=200,
        half_width={2: 32, 3: 8},
        resolution=128,
        remedies=_QUICK_REMEDIES,
    ),
    "full": PixelEffort(
        counts={2: (16, 64, 256, 1024, 4096), 3: (8, 64, 512, 4096)},
        realizations=1000,
        half_width={2: 64, 3: 12},
        resolution=256,
        remedies=None,
    ),
}
"""Efforts: "quick" takes about a minute, and "full" several minutes."""


def analyse_pixel(
    scene: Scene,
    x: int | str,
    y: int | None = None,
    *,
    light: int | str | None = None,
    channel: str | int = "luminance",
    dims: int = 2,
    samplers: Sequence[Sampler | str] = PIXEL_SAMPLERS,
    counts: Sequence[int] | None = None,
    realizations: int | None = None,
    budget: int | None = None,
    remedies: bool = True,
    effort: str = "quick",
    rng: int = 0,
    workers: int | None = None,
) -> xr.DataTree:
    """Measure, predict and explain the noise of a pixel's direct illumination.

    Parameters
    ----------
    scene, light
        Same as in the class `Pixel`.
    x, y
        Coordinates of the pixel. Alternatively, ``x`` alone is the name of a pixel
        (see `named_pixels`).
    channel
        ``"luminance"``, 0, 1 or 2.
    dims
        Number of dims: 2, or 3 if a third coordinate chooses a light or a lobe of the BSDF.
    samplers
        Samplers or their spec strings, all different.
    counts, realizations, budget
        Counts n of samples of each technique, at least two, ascending.
        Number of estimates for each n.
        Number of evaluations at which remedies are ranked, by default twice the largest n.
        The default values of these numbers depend on `effort`.
    remedies
        Whether to search for remedies that lower the noise.
    effort
        How much is measured: ``"quick"`` or ``"full"``. The dict `EFFORTS` lists the numbers.
    rng
        Seed of all analyses; each analysis returns the same result as when called alone.
    workers
        Number of threads; all processors by default. Results do not depend on it.

    Returns
    -------
    xarray.DataTree
        ``convergence``: variances from `mcspectra.convergence` for each strategy, sampler and n.
        ``predict/STRATEGY``: predicted variances and their methods, for each sampler and n.
        The predicted variances are results of `mcspectra.predict`.
        ``terms/STRATEGY/VIEW``: result of `mcspectra.variance_terms` in primary space.
        VIEW is ``auto`` (the basis that fits the sampler) or ``fourier``.
        ``techniques``: result of `mcspectra.technique_terms` for the balance heuristic.
        ``pictures/NAME``: pictures by `mcspectra.explain.primary_picture`; only in 2 dims.
        NAME is ``light``, ``bsdf``, or the share of a technique, such as ``balance-light``.
        Steps from float32 rounding are removed from the pictures.
        ``incident``: `incident_light`.
        ``picture``: a small image of the scene from few paths, ``image`` on (y, x, channel).
        ``remedies``: result of `mcspectra.remedies` for the balance heuristic.
        Attributes of the root describe the pixel and what the pixel shows.
        The attribute ``sampler`` is the sampler of the variance terms.
        The text ``diagnosis_STRATEGY`` describes the causes of the noise with this sampler, and
        ``cause_STRATEGY`` the most important cause.

    Raises
    ------
    McspectraError
        If `Pixel` raises an error, or if the named pixel does not exist.
        If a sampler does not support a count.
    """
    work = _Work.of(
        scene, x, y, light, channel, dims, samplers, counts, realizations, budget, effort, rng,
        workers,
    )  # fmt: skip
    request, view, chosen, options = work.scene, work.view, work.effort, work.options
    ns, explained = work.counts, work.explained

    # Make each strategy once, so that its quadratures are computed only once
    singles, strategies = work.strategies()

    # The search for remedies takes longest, so it runs in a thread parallel to the measurements
    with ThreadPoolExecutor(1) as beside:
        searched = (
            beside.submit(
                find_remedies,
                strategies["balance"],
                explained,
                work.budget,
                kinds=chosen.remedies,
                **{**options, "realizations": max(_FEWEST, options["realizations"])},
            )
            if remedies
            else None
        )
        report("pixel: rates", 0.0)
        curves = work.rates(strategies, options["realizations"])
        curves = curves.rename(estimator="strategy").assign_coords(strategy=list(strategies))
        specs = [estimator.spec for estimator in strategies.values()]
        parts: Parts = {"convergence": curves.assign_coords(spec=("strategy", specs))}
        report("pixel: predictions", 0.2)
        for strategy, estimator in strategies.items():
            parts[f"predict/{strategy}"] = work.predicted(estimator)
        report("pixel: terms", 0.4)
        for strategy, estimator in strategies.items():
            for basis, found in work.terms(estimator, options["realizations"]).items():
                parts[f"terms/{strategy}/{basis}"] = found
        report("pixel: techniques", 0.6)
        parts["techniques"] = technique_terms(
            strategies["balance"], explained, ns, basis="auto", **work.spectra
        )
        report("pixel: pictures", 0.8)
        v = view
        parts["incident"] = incident_light(
            v.scene, v.x, v.y, light=v.light, channel=v.channel, resolution=2 * chosen.resolution
        )
        for strategy, estimator in strategies.items():
            for t in range(len(estimator.counts) if dims == 2 else 0):
                share = strategy in _HEURISTICS
                name = f"{strategy}-{_TECHNIQUES[t]}" if share else strategy
                parts[f"pictures/{name}"] = work.picture(estimator, t)
        image = preview(request, "direct")
        parts["picture"] = dataset({"image": (("y", "x", "channel"), image)})
        if searched is not None:
            parts["remedies"] = searched.result()
    report("pixel", 1.0)

    # Describe the measurement, and diagnose each strategy
    tree: xr.DataTree = xr.DataTree.from_dict(dict(parts))
    with LOCK:
        lights = emitter_names(request)
    tree.attrs = {
        "scene": scene_name(request).strip("'"),
        "x": view.x,
        "y": view.y,
        "film": film_size(request),
        **describe_pixel(request, view.x, view.y),
        "camera": camera_rays(request),
        "scene_note": integrator_note(request),
        "light": "all" if light is None else light,
        "lights": lights,
        "channel": view.channel,
        "dims": dims,
        "value": float(singles["light"].integral),
        "sampler": explained.spec,
        "counts": ns,
        "realizations": options["realizations"],
        "rng": options["rng"],
    }
    for strategy, estimator in strategies.items():
        diagnosis = diagnose(estimator, explained, Stream.from_rng(options["rng"]))
        tree.attrs[f"diagnosis_{strategy}"] = diagnosis.text
        tree.attrs[f"cause_{strategy}"] = diagnosis.main
    return tree


@final
@dataclass(frozen=True, kw_only=True)
class _Work:
    """Checked arguments of the analysis of one pixel, and its parts."""

    scene: Scene
    view: PixelView
    effort: PixelEffort
    sources: Sequence[Sampler]
    counts: Sequence[int]
    budget: int
    options: Mapping[str, Any]

    @staticmethod
    def of(
        scene: Scene, x: int | str, y: int | None, light: int | str | None, channel: str | int,
        dims: int, samplers: Sequence[Sampler | str], counts: Sequence[int] | None,
        realizations: int | None, budget: int | None, effort: str, rng: int, workers: int | None,
    ) -> _Work:  # fmt: skip
        """Find the pixel, and check all arguments before any work."""
        x, y = find_pixel(scene, x, y)
        request = as_scene(scene)
        as_integer("dims", dims, least=2, most=3)
        check_channel(channel)
        view = check_view(PixelView(request, x, y, light, channel, dims), bsdf=True)
        warn_integrator(request)
        chosen = EFFORTS[as_choice("effort", effort, tuple(EFFORTS))]
        asked = chosen.counts[dims] if counts is None else counts
        sources, ns = check_compared(samplers, asked, dims, most=_MOST_SAMPLES)
        number = chosen.realizations if realizations is None else realizations
        options: dict[str, Any] = {
            "realizations": as_integer("realizations", number, least=4, most=MAX_REALIZATIONS),
            "rng": as_integer("rng", rng, least=0),
            "workers": available_workers(workers),
        }
        total = 2 * ns[-1] if budget is None else budget
        total = as_integer("budget", total, least=_LEAST_BUDGET, most=2**24)
        return _Work(
            scene=request, view=view, effort=chosen, sources=sources, counts=ns, budget=total,
            options=options,
        )  # fmt: skip

    @property
    def explained(self) -> Sampler:
        """The sampler that gets terms, bottleneck and remedies."""
        return next((s for s in self.sources if s.spec != "random"), self.sources[0])

    @property
    def spectra(self) -> dict[str, Any]:
        """Options of spectra in primary space."""
        width = self.effort.half_width[self.view.dims]
        return {"half_width": width, "space": "primary", **self.options}

    def strategies(self) -> tuple[dict[str, Pixel], dict[str, AbstractEstimator]]:
        """Return the integrands of single techniques, and the estimators of all strategies."""
        v = self.view
        given: dict[str, Any] = {"light": v.light, "channel": v.channel, "dims": v.dims}
        singles = {
            s: Pixel(scene=self.scene, x=v.x, y=v.y, strategy=s, **given) for s in _TECHNIQUES
        }
        made: dict[str, AbstractEstimator] = {s: Estimator(g) for s, g in singles.items()}
        made |= {h: pixel_mis(self.scene, v.x, v.y, heuristic=h, **given) for h in _HEURISTICS}
        return singles, made

    def rates(self, strategies: Mapping[str, AbstractEstimator], realizations: int) -> xr.Dataset:
        """Measure the variances of all samplers and strategies."""
        options = {**self.options, "realizations": realizations}
        return convergence(list(strategies.values()), self.sources, self.counts, **options)

    def predicted(self, estimator: AbstractEstimator) -> xr.Dataset:
        """Predict the variances of all samplers."""
        shared = {name: self.options[name] for name in ("rng", "workers")}
        return predict(estimator, self.sources, self.counts, **shared)

    def terms(self, estimator: AbstractEstimator, realizations: int) -> dict[str, xr.Dataset]:
        """Measure the variance terms in each basis."""
        # Use the middle count n instead of the largest n.
        # For smaller n, a truncated spectrum captures a larger share of the variance
        middle = self.counts[(len(self.counts) - 1) // 2]
        options = {**self.spectra, "realizations": realizations}
        return {
            basis: variance_terms(estimator, self.explained, middle, basis=basis, **options)
            for basis in _BASES
        }

    def picture(self, estimator: AbstractEstimator, technique: int) -> xr.Dataset:
        """Draw the values of a technique in primary space."""
        side = self.effort.resolution
        return _without_rounding(primary_picture(estimator, technique=technique, resolution=side))


def plan_pixel(
    scene: Scene,
    x: int | str,
    y: int | None = None,
    *,
    light: int | str | None = None,
    channel: str | int = "luminance",
    dims: int = 2,
    samplers: Sequence[Sampler | str] = PIXEL_SAMPLERS,
    counts: Sequence[int] | None = None,
    realizations: int | None = None,
    budget: int | None = None,
    remedies: bool = True,
    effort: str = "quick",
    rng: int = 0,
    workers: int | None = None,
) -> SceneCost:
    """Return what `analyse_pixel` with these arguments would do, and how long it would take.

    Rates and terms are timed with few realizations. All parts but the rates are timed for light
    sampling, and take as long for each technique of the other strategies.
    """
    begin = time.perf_counter()
    work = _Work.of(
        scene, x, y, light, channel, dims, samplers, counts, realizations, budget, effort, rng,
        workers,
    )  # fmt: skip
    number, ns, estimators = work.options["realizations"], work.counts, work.strategies()[1]

    def parts(sampler: int) -> None:
        estimator = work.strategies()[1]["light"]
        replace(work, sources=work.sources[:sampler]).predicted(estimator)
        if dims == 2:
            work.picture(estimator, 0)
        diagnose(estimator, work.explained, Stream.from_rng(rng))

    with compilations() as compiled:
        preview(work.scene, "direct")
        parts(1)  # loads all kernels
    seconds = time.perf_counter() - begin - sum(compiled)
    start = time.perf_counter()
    parts(len(work.sources))
    single = time.perf_counter() - start
    single += timed_part(lambda few: work.terms(work.strategies()[1]["light"], few), number).seconds
    techniques = sum(len(each.counts) for each in estimators.values())
    seconds += techniques * single
    rates = timed_part(functools.partial(work.rates, estimators), number)
    samples = techniques * sum(ns) * len(work.sources)
    seconds += rates.seconds
    if remedies:
        given, tried = estimators["balance"], max(_FEWEST, number)
        kinds: Any = work.effort.remedies
        search = Remedies(budget=work.budget, realizations=tried, kinds=kinds)
        cost = search.need(Subject(given, work.explained)).cost
        seconds += cost * rates.each / samples
    return SceneCost(
        scene=scene_name(work.scene).strip("'"),
        what=f"{number} estimates of n = {', '.join(map(str, ns))} with "
        f"{counted(len(estimators), 'strategy')} and "
        f"{counted(len(work.sources), 'sampler')}" + (", and remedies" if remedies else ""),
        size=film_size(work.scene),
        pixels=1,
        samples=number * samples,
        samples_per_second=samples / rates.each,
        seconds=seconds,
    )


def find_pixel(scene: Scene, x: int | str, y: int | None) -> tuple[int, int]:
    """Return the pixel (x, y), or the named pixel; raise `ParameterError` for an unknown name."""
    if y is not None and not isinstance(x, str):
        return x, y  # The caller checks that the pixel is on the film
    if y is not None or not isinstance(x, str):
        raise ParameterError(
            f"The pixel is {shown(x)}, {shown(y)}; give x and y, or the name of a pixel."
        )
    names = named_pixels(scene)
    if x in names:
        return names[x]
    there = close_match_hint(x, names)[0] if names else ""
    raise ParameterError(
        f"The scene {scene_name(scene)} has no pixel named {shown(x)}; give x and y.{there}"
    )


def check_compared(
    samplers: Sequence[Sampler | str], counts: Sequence[int], dims: int, *, most: int
) -> tuple[list[Sampler], list[int]]:
    """Check the samplers to compare and their counts, of at most `most` points each.

    Raises
    ------
    McspectraError
        If an argument is not a list, or a sampler is listed twice.
        If there are fewer than two counts, counts do not ascend, or a sampler rejects a count.
    """
    if isinstance(samplers, str) or not samplers:
        raise ParameterError(f"samplers is {shown(samplers)}; give a list of samplers.")
    sources = [as_sampler(s, dims) for s in samplers]
    if len({s.spec for s in sources}) < len(sources):
        raise ParameterError(f"samplers is {shown(list(samplers))}; give each only once.")
    ns = [as_integer("counts", n, least=1, most=most) for n in counts]
    for source, n in itertools.product(sources, ns):
        source.check_count(n)
    if len(ns) < 2 or any(b <= a for a, b in itertools.pairwise(ns)):
        raise ParameterError(
            Parameter("counts"), f" is {ns}; give at least two ascending counts for a rate."
        )
    return sources, ns


def _without_rounding(picture: xr.Dataset) -> xr.Dataset:
    """Remove the jumps of a picture that come from float32 rounding, not from discontinuities."""
    kept, floor = picture.copy(), _ROUNDING * float(np.abs(picture["primary_value"]).max())
    for name in ("primary_jump", "face_jump"):
        kept[name] = (
            picture[name].where(picture[name] > floor, 0.0).assign_attrs(picture[name].attrs)
        )
    inside, faces = kept["primary_jump"].values, kept["face_jump"].values
    lengths = [curve_length(inside > 0), np.count_nonzero(faces) / faces.shape[1]]
    heights = [float(h[h > 0].mean()) if h.any() else 0.0 for h in (inside, faces)]
    for name, values in (("length", lengths), ("height", heights)):
        kept[f"primary_jump_{name}"] = picture[f"primary_jump_{name}"].copy(data=values)
    return kept.assign_attrs(smallest_jump=floor)
