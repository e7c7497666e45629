"""Analyze the noise of whole paths at one pixel: its rate, its causes, and remedies.

Method
------
All changes are measured at the same counts and with the same random numbers as the given path.
The function `mcspectra.improve.remedy.ranked` compares the changes at the largest count.
If Russian roulette changes, the cost of a path is measured by its number of random numbers.
The cost is relative to the scene as given, in which a path has the cost 1.
The number of random numbers grows with the iterations of the integrator's loop.
Each iteration traces one ray and at most one shadow ray.
A change that needs a pilot is compared with the given path at an equal total of paths.
The total number of paths includes the paths of the pilot.

If each path samples one light, the best probabilities p_j are proportional to √(p_j E f_j²).
The product p_j E f_j² is the second moment of light j's contribution if only j is chosen.
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, final

import numpy as np
import xarray as xr

from mcspectra.core.analysis import Subject
from mcspectra.core.checks import Array, as_choice, as_integer, as_joint_dims
from mcspectra.core.confidence import CONFIDENCE_Z
from mcspectra.core.display import counted
from mcspectra.core.errors import McspectraError, ParameterError
from mcspectra.core.parallel import MAX_REALIZATIONS, available_workers
from mcspectra.core.progress import report
from mcspectra.core.results import dataset
from mcspectra.core.streams import Stream
from mcspectra.estimators import Estimator
from mcspectra.explain.diagnosis import Diagnosis
from mcspectra.improve.answers import Candidate, simultaneous_z
from mcspectra.improve.assess import Errors, MeasuredCandidate, compare, estimates_of
from mcspectra.improve.remedy import ranked
from mcspectra.integrands import Integrand
from mcspectra.measure.anova import Anova, anova_variances
from mcspectra.measure.converge import convergence, count_stream
from mcspectra.measure.setup import Setup
from mcspectra.prediction.prediction import predict
from mcspectra.rendering.backend import compilations
from mcspectra.rendering.costs import SceneCost, timed_part
from mcspectra.rendering.padding import Padded, as_rendered, padding_note
from mcspectra.rendering.paths import (
    SCENE_INTEGRATOR,
    Dimension,
    PathPixel,
    find_integrator,
    light_selection,
    parts_by_light,
)
from mcspectra.rendering.pixel import check_channel
from mcspectra.rendering.plugin import default_spec
from mcspectra.rendering.rendered import preview
from mcspectra.rendering.scenes import Scene, emitter_names, film_size, scene_name
from mcspectra.samplers import Sampler, as_sampler
from mcspectra.studies.pixel import check_compared, find_pixel

__all__ = ["PATH_SAMPLERS", "analyse_path", "path_remedies", "plan_path", "shares_by_light"]

PATH_SAMPLERS = ("random", "latin-hypercube", "rank1-lattice | shift", "sobol | owen")
"""Samplers that are compared by default; they support any count in any number of dims.

The sampler by which paths are rendered by default is compared as well, see
`mcspectra.rendering.plugin.default_spec`.
"""

_EFFORTS = {
    # Each effort (quick or full) is a tuple of five settings.
    # An effort sets the numbers n of paths per estimate, and the number of estimates for each n.
    # It also sets the number of realizations for ANOVA.
    # The shares of lights are computed from the number of paths in the fourth setting.
    # The last setting is True if variances are also predicted
    "quick": ((16, 64, 256, 1024), 200, 10_000, 2**14, False),
    "full": ((16, 64, 256, 1024, 4096), 1000, 100_000, 2**17, True),
}
_AXES = {
    "bounce": "bounce",
    "decision": "kind of decision, at all bounces together,",
    "request": "decision",
    "coordinate": "coordinate",
}  # Names of the axes in captions
_MOST_GROUPS = 64
_MOST_SAMPLES = 2**20
_FEWEST = 100  # Minimum number of realizations to compare two changes
_LIGHTS = 1  # Label of the random stream for shares of lights
_MOST_LIGHTS = 64
_PILOT = 2**10  # Number of pilot paths for the selection of lights
_LEAST = 0.05  # Fraction of the selection probability that is divided equally among all lights
_COUNTS = 5  # Maximum number of counts to measure; the largest counts are kept
_DEPTHS = (1, 2, 3, 5)  # Depths at which roulette may start; "no roulette" is also tried
_ENDLESS = 2**16  # Limit of max_depth if there is no roulette that ends paths
_PLUGINS = {
    # Class name of an integrator, and name of its plugin
    "PathIntegrator": "path",
    "VolumetricSimplePathIntegrator": "volpath",
    "VolumetricMisPathIntegrator": "volpathmis",
    "PRBIntegrator": "prb",
}


def analyse_path(
    scene: Scene,
    x: int | str,
    y: int | None = None,
    *,
    integrator: str = "scene",
    channel: str | int = "luminance",
    dims: int | None = None,
    samplers: Sequence[Sampler | str] | None = None,
    counts: Sequence[int] | None = None,
    realizations: int | None = None,
    remedies: bool = True,
    joint_dims: int | None = None,
    effort: str = "quick",
    rng: int = 0,
    workers: int | None = None,
) -> xr.DataTree:
    """Measure and explain the noise of one pixel over all random numbers of a path.

    Parameters
    ----------
    scene, integrator
        Same as in `PathPixel`.
    channel, dims
        Same as in `PathPixel`, but the channel ``"rgb"`` is not allowed.
    x, y
        Coordinates of the pixel. Alternatively, ``x`` alone is the name of a pixel
        (see `named_pixels`).
    samplers
        Samplers or their spec strings, all different. ``remedies`` uses the last sampler.
        The default is `PATH_SAMPLERS` and the default sampler of rendered paths.
    counts, realizations
        Counts n of paths per estimate, at least two, ascending; number of estimates for each n.
    remedies
        Whether to search for remedies that lower the noise.
    joint_dims
        Number of coordinates at the start of a path that come from a single point set.
        All later coordinates of the path come from separate point sets (padding).
        See `mcspectra.rendering.variance_map`.
    effort
        ``"quick"``; or ``"full"``, which measures more, predicts variances and takes minutes.
    rng
        Seed (SPEC 7).
    workers
        Number of threads; all processors by default. Results do not depend on it.

    Returns
    -------
    xarray.DataTree
        ``convergence``: variances measured by `mcspectra.convergence` for each sampler and n.
        ``anova/KIND``: result of `mcspectra.anova_variances` for random paths, up to 64 groups.
        KIND is ``bounce``, ``decision``, ``request`` or ``coordinate``: how axes are grouped.
        With ``request``, a group has the coordinates of one decision at one bounce of the path.
        With ``coordinate``, each coordinate is a group of its own.
        ``lights``: shares of the variance by `shares_by_light`, for 2 to 64 lights.
        ``remedies``: result of `path_remedies` for the last sampler at the largest n.
        ``predict``: result of `mcspectra.predict` for each sampler and n, only with full effort.
        Attributes of the tree's root: the pixel, the integrator, and names of the coordinates.
        ``lights_note`` gives the reason if shares of lights are unknown.

    Raises
    ------
    McspectraError
        Same as in `PathPixel`; or if the named pixel does not exist.
        If a sampler does not support a count.
    """
    # Check all arguments before any work
    work = _Work.of(
        scene, x, y, integrator, channel, dims, samplers, counts, realizations, joint_dims,
        effort, rng, workers,
    )  # fmt: skip
    f, sources, ns, options = work.f, work.sources, work.counts, work.options

    # Measure the rates, then the variance components of one random path
    report("path: rates", 0.0)
    curves = work.rates(work.realizations)
    parts: dict[str, xr.Dataset] = {"convergence": curves}
    report("path: parts", 0.4)
    parts |= work.components(work.pairs)

    # Find the lights that cause the noise, and the remedies
    report("path: lights", 0.7)
    lights, note = work.lights(work.paths)
    if lights is not None:
        parts["lights"] = lights
    if remedies:
        report("path: remedies", 0.8)
        ranking = None
        if "anova/coordinate" in parts:
            shares = parts["anova/coordinate"]["total_share"].values
            made = Anova(order=1, realizations=work.pairs).need(
                Subject(Estimator(f), as_sampler("random", f.dims))
            )
            ranking = np.argsort(-shares, kind="stable"), made.evaluations
        tried = max(_FEWEST, work.realizations)
        parts["remedies"] = work.remedies(tried, ranking, lights)
    if work.predicted:
        report("path: predictions", 0.9)
        parts["predict"] = predict(f, sources, ns, **options)
    parts["picture"] = dataset({"image": (("y", "x", "channel"), preview(f.scene, f.integrator))})
    report("path", 1.0)
    tree: xr.DataTree = xr.DataTree.from_dict(dict(parts))
    tree.attrs = {
        "scene": scene_name(scene).strip("'"),
        "x": f.x,
        "y": f.y,
        "film": film_size(f.scene),
        "integrator": f.integrator,
        "channel": f.channel,
        "dims": f.dims,
        "dimensions": [str(d) for d in f.dimensions],
        "sampler": sources[-1].spec,
        "padding": padding_note(sources[-1]),
        "value": float(curves["mean"].isel(n=-1).sel(sampler=sources[-1].spec)),
        "counts": ns,
        "realizations": work.realizations,
        "lights_note": note,
        "rng": options["rng"],
    }
    return tree


@final
@dataclass(frozen=True, kw_only=True)
class _Work:
    """The parts of the analysis of one pixel, each with a size that its time is proportional to."""

    f: PathPixel
    sources: Sequence[Sampler]
    counts: Sequence[int]
    joint_dims: int | None
    realizations: int
    pairs: int
    paths: int
    predicted: bool
    options: Mapping[str, Any]

    @staticmethod
    def of(
        scene: Scene, x: int | str, y: int | None, integrator: str, channel: str | int,
        dims: int | None, samplers: Sequence[Sampler | str] | None, counts: Sequence[int] | None,
        realizations: int | None, joint_dims: int | None, effort: str, rng: int,
        workers: int | None,
    ) -> _Work:  # fmt: skip
        """Check all arguments of `analyse_path`."""
        x, y = find_pixel(scene, x, y)
        check_channel(channel)
        if joint_dims is not None:
            joint_dims = as_joint_dims("joint_dims", joint_dims)
        usual, repeats, pairs, paths, predicted = _EFFORTS[
            as_choice("effort", effort, tuple(_EFFORTS))
        ]
        f = PathPixel(scene=scene, x=x, y=y, integrator=integrator, channel=channel, dims=dims)
        asked = usual if counts is None else counts
        if samplers is None:
            _, ns = check_compared(PATH_SAMPLERS, asked, f.dims, most=_MOST_SAMPLES)
            rendered = default_spec(*ns, joint_dims=joint_dims)
            samplers = tuple(dict.fromkeys((*PATH_SAMPLERS[:-1], rendered, PATH_SAMPLERS[-1])))
        if isinstance(samplers, str) or not samplers:
            sources, ns = check_compared(samplers, asked, f.dims, most=_MOST_SAMPLES)
        padded = [as_rendered(each, f.dimensions, joint_dims) for each in samplers]
        sources, ns = check_compared(padded, asked, f.dims, most=_MOST_SAMPLES)
        return _Work(
            f=f,
            sources=sources,
            counts=ns,
            joint_dims=joint_dims,
            realizations=as_integer(
                "realizations",
                repeats if realizations is None else realizations,
                least=4,
                most=MAX_REALIZATIONS,
            ),
            pairs=pairs,
            paths=paths,
            predicted=predicted,
            options={
                "rng": as_integer("rng", rng, least=0),
                "workers": available_workers(workers),
            },
        )

    def rates(self, realizations: int) -> xr.Dataset:
        """Measure the variances of all samplers."""
        return convergence(
            self.f, self.sources, self.counts, realizations=realizations, **self.options
        )

    def components(self, pairs: int) -> dict[str, xr.Dataset]:
        """Measure the variance components of one random path, for four ways to group its axes."""
        f, parts = self.f, {}
        kinds = {  # The names of each coordinate's group
            "bounce": [f"bounce {d.bounce}" if d.bounce else "camera" for d in f.dimensions],
            "decision": [d.decision for d in f.dimensions],
            "request": [str(Dimension(d.bounce, d.decision)) for d in f.dimensions],
            "coordinate": [str(d) for d in f.dimensions],
        }
        for kind, names in kinds.items():
            order = 2 if kind == "bounce" else 1
            labels = list(dict.fromkeys(names))
            if len(labels) <= _MOST_GROUPS:
                groups = [labels.index(name) for name in names]
                found = anova_variances(
                    f, order=order, groups=groups, realizations=pairs, **self.options
                )
                axes = (label.split("x")[1:] for label in found["subset_label"].values)
                said = [" × ".join(labels[int(i)] for i in u) for u in axes]
                parts[f"anova/{kind}"] = found.assign_coords(
                    subset_label=("subset", said), axis_label=("axis", labels)
                ).assign_attrs(axes=_AXES[kind])
        return parts

    def lights(self, paths: int) -> tuple[xr.Dataset | None, str]:
        """Return the shares of lights, or None and the reason if they are unknown."""
        try:
            return shares_by_light(self.f, paths, self._stream.child(_LIGHTS)), ""
        except ParameterError as error:
            return None, str(error)

    def remedies(
        self, realizations: int, axes: tuple[Array, int] | None, lights: xr.Dataset | None
    ) -> xr.Dataset:
        """Measure the remedies for the last sampler."""
        bounces = [d.bounce for d in self.f.dimensions]
        ends = [k for k in range(2, self.f.dims) if bounces[k] > bounces[k - 1]]
        return path_remedies(
            self.f, self.sources[-1], self.counts, self._stream, realizations=realizations,
            samplers=(*PATH_SAMPLERS, "halton | permute"), ends=ends, joint_dims=self.joint_dims,
            axes=axes, lights=lights,
        )  # fmt: skip

    @property
    def _stream(self) -> Stream:
        return Stream.from_rng(self.options["rng"])


def plan_path(
    scene: Scene,
    x: int | str,
    y: int | None = None,
    *,
    integrator: str = "scene",
    channel: str | int = "luminance",
    dims: int | None = None,
    samplers: Sequence[Sampler | str] | None = None,
    counts: Sequence[int] | None = None,
    realizations: int | None = None,
    remedies: bool = True,
    joint_dims: int | None = None,
    effort: str = "quick",
    rng: int = 0,
    workers: int | None = None,
) -> SceneCost:
    """Return what `analyse_path` with these arguments would do, and how long it would take.

    Every part of the analysis is timed with few realizations, pairs or paths.
    """
    begin = time.perf_counter()
    work = _Work.of(
        scene, x, y, integrator, channel, dims, samplers, counts, realizations, joint_dims,
        effort, rng, workers,
    )  # fmt: skip
    f, sources, ns = work.f, work.sources, work.counts
    with compilations() as compiled:
        preview(f.scene, f.integrator)
    seconds = time.perf_counter() - begin - sum(compiled)
    rates = timed_part(work.rates, work.realizations)
    seconds += rates.seconds
    seconds += timed_part(work.components, work.pairs).seconds
    seconds += timed_part(work.lights, work.paths).seconds
    if remedies:
        lights, _ = work.lights(min(_PILOT, work.paths))

        def tried(number: int) -> object:
            return work.remedies(number, None, lights)

        seconds += timed_part(tried, max(_FEWEST, work.realizations)).seconds
    if work.predicted:

        def predictions(number: int) -> object:
            return predict(f, sources[:number], ns, **work.options)

        seconds += timed_part(predictions, len(sources)).seconds
    paths = work.realizations * sum(ns) * len(sources)
    return SceneCost(
        scene=scene_name(scene).strip("'"),
        what=f"{work.realizations} estimates of n = {', '.join(map(str, ns))} paths with "
        f"{counted(len(sources), 'sampler')}" + (", and remedies" if remedies else ""),
        size=film_size(f.scene),
        pixels=1,
        samples=paths,
        samples_per_second=sum(ns) * len(sources) / rates.each,
        seconds=seconds,
    )


def shares_by_light(f: PathPixel, paths: int, stream: Stream) -> xr.Dataset | None:
    """Estimate each light's share of the variance of one random path, and the best selection.

    Parameters
    ----------
    f
        The pixel.
    paths
        Number of random paths, each followed once per light.
        The first 1024 paths (the pilot) determine improved probabilities of selecting lights.
        The gain from these probabilities is measured with `paths` new paths.
    stream
        Random numbers.

    Returns
    -------
    xarray.Dataset or None
        The following variables have the dim ``light``; their intervals end in ``_ci``:
        ``light_share``, Cov(f_j, f)/Var(f) of a light's contribution f_j, with sum 1;
        ``light_mean``, the mean of the contribution;
        ``light_probability``, the current selection probability of the light;
        ``light_selection``, its improved selection probability.
        ``selection_ratio``: variance with the improved selection over that with the current one.
        For ``selection_ratio``, the variances of both selections are measured with new paths.
        None for one light, for more than 64 lights, or for a pixel without noise.

    Raises
    ------
    ParameterError
        If the radiance of a light cannot be dimmed.
    """
    names = emitter_names(f.scene)
    if not 1 < len(names) <= _MOST_LIGHTS:
        return None
    parts = parts_by_light(f, stream.generator(0).random((paths, f.dims)))
    off = parts - parts.mean(axis=1, keepdims=True)
    whole = off.sum(axis=0)
    variance = float((whole**2).mean())
    if variance == 0.0:
        return None
    shares = (off @ whole) / (paths * variance)
    influence = (off * whole - shares[:, None] * whole**2) / variance
    half = CONFIDENCE_Z * influence.std(axis=1) / math.sqrt(paths)

    # Choose lights by second moments, with a smallest probability; measure the gain on new paths
    known = light_selection(f.scene) if f.selection is None else np.array(f.selection)
    pilot = min(paths, _PILOT)
    wanted = np.sqrt(known * (parts[:, :pilot] ** 2).mean(axis=1))
    wanted = (1.0 - _LEAST) * wanted / wanted.sum() + _LEAST / len(names)
    u = stream.generator(1).random((paths, f.dims))
    squares = []
    for g in (replace(f, selection=wanted), f):
        values = g(u)
        squares.append((values - values.mean()) ** 2)
    after, before = (float(s.mean()) for s in squares)
    ratio = after / before if before else math.nan
    spread = (
        CONFIDENCE_Z * float((squares[0] / after - squares[1] / before).std()) / math.sqrt(paths)
    )
    return dataset(
        {
            "light_share": (("light",), shares),
            "light_share_ci": (("light", "bound"), np.transpose([shares - half, shares + half])),
            "light_mean": (("light",), parts.mean(axis=1)),
            "light_probability": (("light",), known),
            "light_selection": (("light",), wanted),
            "selection_ratio": ((), ratio),
            "selection_ratio_ci": (("bound",), ratio * np.exp([-spread, spread])),
        },
        {"light": names, "bound": ["low", "high"]},
        paths=paths,
        pilot=pilot * len(names),
    )


def path_remedies(
    f: PathPixel,
    sampler: Sampler,
    counts: Sequence[int],
    stream: Stream,
    *,
    realizations: int,
    samplers: Sequence[str],
    ends: Sequence[int],
    joint_dims: int | None = None,
    axes: tuple[Array, int] | None = None,
    lights: xr.Dataset | None = None,
) -> xr.Dataset:
    """Try changes to the sampling of a pixel's paths at equal cost, and rank them.

    Parameters
    ----------
    f, sampler
        Integrand that follows paths through the pixel, and the sampler before any change.
    counts, realizations
        Counts of paths per estimate, ascending, and number of estimates.
        The last count is the budget; at most the five largest counts are measured.
    stream
        Random numbers for all changes of the path, as in `mcspectra.convergence`.
    samplers, ends
        Other samplers to try, and numbers k of coordinates to try.
        For each k, the first k coordinates keep QMC points, and the others become random.
    joint_dims
        Same as in `analyse_path`.
    axes
        Coordinates in decreasing order of importance, and the number of paths that gave this order.
    lights
        The result of `shares_by_light` for this pixel, if known.

    Returns
    -------
    xarray.Dataset
        Same as in `mcspectra.remedies`.
        A ``kind`` is ``sampler``, ``joint``, ``padding``, ``order``, ``roulette`` or ``selection``.
        ``error`` is the error at the given budget. It ignores the cost of pilot paths.
        ``error_ratio`` includes the cost of pilot paths.
    """
    ns, budget = list(counts)[-_COUNTS:], int(counts[-1])
    tried: list[MeasuredCandidate] = []
    not_tried: list[str] = []

    def attempt(
        kind: str,
        name: str,
        change: str,
        make: Callable[[], Integrand] = lambda: f,
        spec: Sampler | str = "",
        pilot: int = 0,
        joint: bool = False,
    ) -> None:
        try:
            g = make()
            points = spec or sampler
            if isinstance(g, PathPixel):
                points = as_rendered(points, g.dimensions, g.dims if joint else joint_dims)
            points = as_sampler(points, g.dims)
            for n in ns:
                points.check_count(n)
            estimates = [
                estimates_of(Estimator(g), points, n, realizations, count_stream(stream, n))
                for n in ns
            ]
        except McspectraError as error:
            not_tried.append(f"{name}: {error}")
            return
        cost, note = 1.0, ""
        if kind == "roulette" and isinstance(g, PathPixel):
            cost = g.numbers_per_path / f.numbers_per_path
            note = f"Each of its paths costs {cost:.3g} times as much as a given path."
        mean = np.concatenate(estimates).mean(axis=0)
        errors = Errors.of(np.multiply(cost, ns).tolist(), estimates, mean)
        setup = Setup(Estimator(g), points)
        candidate = Candidate(kind, name, change, setup, pilot=pilot, effort=cost, note=note)
        tried.append(MeasuredCandidate.of(candidate, errors))

    attempt("given", "as given", "change nothing")

    # Try other samplers, random numbers in the last coordinates, and another order of coordinates.
    # Random numbers with the largest shares of the variance get the best coordinates of the points
    for spec in dict.fromkeys(samplers):
        if spec != sampler.spec:
            attempt("sampler", spec, f"sample with {spec}", spec=spec)
    if isinstance(sampler, Padded):
        change = f"take all {f.dims} numbers of a path jointly from {sampler.spec}"
        attempt("joint", "all coordinates joint", change, joint=True)
    for k in ends:
        change = (
            f"use points of {sampler.spec} in the first {k} coordinates, and random numbers in "
            "the others"
        )
        attempt("padding", f"{k} good coordinates", change, partial(replace, f, dims=k))
    if axes is not None:
        place = np.argsort(axes[0])  # Coordinate j of f is coordinate place[j] of the point
        ordered = Integrand.from_function(lambda u: f(u[..., place]), dims=f.dims)
        change = "assign the first coordinates of the points to the largest shares of the variance"
        whole = as_rendered(sampler.spec, f.dimensions, f.dims)
        attempt("order", "coordinates by share", change, lambda: ordered, spec=whole, pilot=axes[1])

    # Try changes of roulette, of the selection of lights, and of the integrator's heuristic
    try:
        for name, change, integrator in _other_roulettes(f):
            attempt("roulette", name, change, partial(replace, f, integrator=integrator, dims=None))
    except McspectraError as error:
        not_tried.append(f"roulette: {error}")
    name = "lights by second moment"
    if lights is None:
        number = len(emitter_names(f.scene))
        reason = (
            f"the selection needs 2 to {_MOST_LIGHTS} lights whose contributions are known; the "
            f"scene has {number}."
        )
        not_tried.append(f"{name}: {reason}")
    else:
        chosen = partial(replace, f, selection=lights["light_selection"].values)
        change = "choose lights by the roots of the second moments of their contributions"
        attempt("selection", name, change, chosen, pilot=int(lights.attrs["pilot"]))
    reason = f"{find_integrator(f.scene, f.integrator).class_name()} has no such property."
    not_tried.append(f"heuristic of MIS: {reason}")

    # Note the gain of each change if the cost of its pilot is ignored.
    # Also note the number of paths above which the gain exceeds the cost of the pilot
    given, z = tried[0].errors, simultaneous_z(2 * (len(tried) - 1))
    for k, candidate in enumerate(tried):
        if candidate.pilot:
            found, rate = compare(candidate.errors, given, budget), given.rate()[0]
            low, high = (found.log_ratio + side * z * found.log_ratio_se for side in (-1.0, 1.0))
            ratio, bounds = (
                math.exp(found.log_ratio),
                f"{math.exp(low):.3g} to {math.exp(high):.3g}",
            )
            note = (
                f"Its pilot takes {candidate.pilot} paths; without the pilot's cost, variance × "
                f"{ratio:.3g} ({bounds})"
            )
            if high < 0.0 and rate < 0.0:
                # A candidate takes n paths for an estimate, after P paths for its pilot.
                # At the same cost, the unchanged sampler takes n + P paths for an estimate.
                # At equal cost, errors are equal if the variances have the ratio ((n + P)/n)^rate.
                # Compute the number n of paths from the ratio that was measured for equal n
                pays = candidate.pilot / math.expm1(found.log_ratio / rate)
                note += f": it pays above about {float(f'{pays:.2g}'):.0f} paths."
            else:
                note += ": no gain within the interval, so it does not pay."
            tried[k] = replace(candidate, note=note)
    ranking = ranked(tried, not_tried, budget, Diagnosis([]))
    return ranking.assign_attrs(estimator=f.spec, sampler=sampler.spec, budget=budget)


def _other_roulettes(f: PathPixel) -> Iterator[tuple[str, str, str]]:
    """Yield integrators whose Russian roulette starts at another depth: name, description, spec."""
    own = find_integrator(f.scene, f.integrator)
    known = {k: int(v) for k, v in re.findall(r"(max_depth|rr_depth) = (\d+)", str(own))}
    last, first = known.get("max_depth", 0), known.get("rr_depth", 0)
    plugin, _, rest = f.integrator.strip().partition("(")
    properties = [p for p in map(str.strip, rest.removesuffix(")").split(",")) if p]
    if f.integrator == SCENE_INTEGRATOR:
        plugin = _PLUGINS.get(str(own).partition("[")[0], "")
        properties = [f"hide_emitters={own.hide_emitters}"]
        properties += [f"max_depth={last}"] * (last < _ENDLESS)
    if not (plugin and first and last):
        raise ParameterError(f"{own.class_name()} is not known to have a roulette.")
    properties = [p for p in properties if not p.startswith("rr_depth")]
    for depth in sorted({*_DEPTHS, last}):
        if depth <= min(last, _ENDLESS) and depth != min(first, last):
            name = f"roulette from depth {depth}" if depth < last else "no roulette"
            change = f"start Russian roulette at depth {depth}"
            change = change if depth < last else "disable Russian roulette"
            yield name, change, f"{plugin}({', '.join([*properties, f'rr_depth={depth}'])})"
