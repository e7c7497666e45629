"""The noise of whole paths at one pixel: how fast it falls, what makes it, and what would lower it."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.analysis import Subject
from mcspectra.core.checks import as_choice, as_integer
from mcspectra.core.errors import ParameterError
from mcspectra.core.parallel import available_workers
from mcspectra.core.progress import report
from mcspectra.core.streams import Stream
from mcspectra.estimators import Estimator
from mcspectra.rendering.paths import Dimension, PathPixel
from mcspectra.rendering.scenes import Scene, scene_name
from mcspectra.samplers import Sampler, as_sampler
from mcspectra.studies.path_remedies import path_remedies, shares_by_light
from mcspectra.studies.pixel import find_pixel
from mcspectra.variance.anova import Anova, anova_variances
from mcspectra.variance.convergence import convergence
from mcspectra.variance.prediction.predict import predict

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["PATH_SAMPLERS", "analyse_path"]

PATH_SAMPLERS = ("random", "latin-hypercube", "rank1-lattice | shift", "sobol | owen")
"""Samplers that are compared unless others are given: those that any number of dims leaves any count."""

_EFFORTS = {
    # counts, realisations, those of the ANOVA, paths for the shares of lights, whether variances are predicted
    "quick": ((16, 64, 256, 1024), 200, 10_000, 2**14, False),
    "full": ((16, 64, 256, 1024, 4096), 1000, 100_000, 2**17, True),
}
_MOST_GROUPS = 64
_MOST_SAMPLES = 2**20
_FEWEST = 100  # realisations that tell one change from another
_LIGHTS, _REMEDIES = 1, 2  # stream labels


def analyse_path(
    scene: Scene,
    x: int | str,
    y: int | None = None,
    *,
    integrator: str = "scene",
    channel: str | int = "luminance",
    dims: int | None = None,
    samplers: Sequence[Sampler | str] = PATH_SAMPLERS,
    counts: Sequence[int] | None = None,
    realizations: int | None = None,
    remedies: bool = True,
    effort: str = "quick",
    rng: int = 0,
    workers: int | None = None,
) -> xr.DataTree:
    """Measure and explain the noise of a pixel by an integrator, over all random numbers of a path.

    Parameters
    ----------
    scene, integrator, channel, dims
        As of `PathPixel`; one channel at a time.
    x, y
        The pixel; or the name of one as ``x`` (`named_pixels`), without ``y``.
    samplers
        Samplers or their spec strings, all different. The last is that of ``remedies``.
    counts, realizations
        Paths n of an estimate, ascending, at least two; estimates for each.
    remedies
        Whether to look for what would lower the noise.
    effort
        ``"quick"``, or ``"full"``: more of everything, and predictions, in some minutes.
    rng
        Seed (SPEC 7).
    workers
        Threads; all processors by default. Results do not depend on it.

    Returns
    -------
    xarray.DataTree
        ``convergence``: `mcspectra.convergence` on (sampler, n). ``anova/KIND``:
        `mcspectra.anova_variances` of one random path, its axes grouped by KIND: ``bounce``, ``decision``,
        ``request`` (both together) or ``coordinate`` (not grouped), each of 64 groups at most.
        ``lights``: `shares_by_light`, of 2 to 64 lights. ``remedies``: `path_remedies`, beside
        the last sampler at the largest n. ``predict``, with ``effort="full"``: `mcspectra.predict` on (sampler, n).
        Attributes of the root: the pixel, the integrator, what the coordinates are, and in ``lights_note`` why
        parts of lights are unknown.

    Raises
    ------
    McspectraError
        As of `PathPixel`; or no such named pixel; or a sampler cannot do a count.
    """
    import xarray as xr

    # Check the plan before any work
    x, y = find_pixel(scene, x, y)
    if channel == "rgb":
        raise ParameterError("channel is 'rgb'; give 'luminance', 0, 1 or 2, one at a time.")
    usual, repeats, pairs, paths, predicted = _EFFORTS[as_choice("effort", effort, tuple(_EFFORTS))]
    asked = usual if counts is None else counts
    ns = [as_integer("counts", n, least=1, most=_MOST_SAMPLES) for n in asked]
    if len(ns) < 2 or any(b <= a for a, b in itertools.pairwise(ns)):
        raise ParameterError(f"counts is {ns}; give at least two, ascending, for a rate.")
    if isinstance(samplers, str) or not samplers:
        raise ParameterError(f"samplers is {samplers!r}; give a list of samplers.")
    f = PathPixel(scene=scene, x=x, y=y, integrator=integrator, channel=channel, dims=dims)
    sources = [as_sampler(s, f.dims) for s in samplers]
    if len({s.spec for s in sources}) < len(sources):
        raise ParameterError(f"samplers is {list(samplers)!r:.80}; give each only once.")
    for source, n in itertools.product(sources, ns):
        source.check_count(n)
    options: dict[str, Any] = {
        "rng": as_integer("rng", rng, least=0),
        "workers": available_workers(workers),
    }
    number = as_integer("realizations", realizations or repeats, least=4)

    # Rates, then the parts of the variance of one random path
    report("path: rates", 0.0)
    curves = convergence(f, sources, ns, realizations=number, **options)
    parts: dict[str, xr.Dataset] = {"convergence": curves}
    report("path: parts", 0.4)
    for kind, (order, names) in _kinds(f.dimensions).items():
        labels = list(dict.fromkeys(names))
        if len(labels) <= _MOST_GROUPS:
            groups = [labels.index(name) for name in names]
            found = anova_variances(f, order=order, groups=groups, realizations=pairs, **options)
            axes = (label.split("x")[1:] for label in found["subset_label"].values)
            said = [" × ".join(labels[int(i)] for i in u) for u in axes]
            parts[f"anova/{kind}"] = found.assign_coords(
                subset_label=("subset", said), axis_label=("axis", labels)
            )

    # Which lights make the noise, and what would lower it
    report("path: lights", 0.7)
    stream, lights, note = Stream.from_rng(options["rng"]), None, ""
    try:
        lights = shares_by_light(f, paths, stream.child(_LIGHTS))
    except ParameterError as error:
        note = str(error)
    if lights is not None:
        parts["lights"] = lights
    if remedies:
        report("path: remedies", 0.8)
        bounces = [d.bounce for d in f.dimensions]
        ends = [k for k in range(2, f.dims) if bounces[k] > bounces[k - 1]]
        ranking = None
        if "anova/coordinate" in parts:
            shares = parts["anova/coordinate"]["total_share"].values
            made = Anova(order=1, realizations=pairs).need(
                Subject(Estimator(f), as_sampler("random", f.dims))
            )
            ranking = np.argsort(-shares, kind="stable"), made.evaluations
        parts["remedies"] = path_remedies(
            f, sources[-1], ns, stream.child(_REMEDIES), realizations=max(_FEWEST, number),
            samplers=(*PATH_SAMPLERS, "halton | permute"), ends=ends, axes=ranking, lights=lights,
        )  # fmt: skip
    if predicted:
        report("path: predictions", 0.9)
        parts["predict"] = predict(f, sources, ns, **options)
    report("path", 1.0)
    tree: xr.DataTree = xr.DataTree.from_dict(dict(parts))
    tree.attrs = {
        "scene": scene_name(scene).strip("'"),
        "x": f.x,
        "y": f.y,
        "integrator": f.integrator,
        "channel": f.channel,
        "dims": f.dims,
        "dimensions": [str(d) for d in f.dimensions],
        "sampler": sources[-1].spec,
        "value": float(curves["mean"].isel(n=-1).sel(sampler=sources[-1].spec)),
        "counts": ns,
        "realizations": number,
        "lights_note": note,
        "rng": options["rng"],
    }
    return tree


def _kinds(dimensions: Sequence[Dimension]) -> dict[str, tuple[int, list[str]]]:
    """Order of subsets, and the group of each coordinate, by kind of grouping."""
    bounces = [f"bounce {d.bounce}" if d.bounce else "camera" for d in dimensions]
    requests = [str(Dimension(d.bounce, d.decision)) for d in dimensions]
    return {
        "bounce": (2, bounces),
        "decision": (1, [d.decision for d in dimensions]),
        "request": (1, requests),
        "coordinate": (1, [f"{d}" for d in dimensions]),
    }
