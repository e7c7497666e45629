"""Samplers designed for a class of integrands, and certificates of their gain."""

from __future__ import annotations

import hashlib
import json
import math
import shutil
import warnings
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, final, overload
from uuid import uuid4

import numpy as np

from mcspectra.core.cache import cache_folder
from mcspectra.core.checks import Array, as_choice, as_integer
from mcspectra.core.confidence import student_t
from mcspectra.core.decoding import path_to_write
from mcspectra.core.errors import (
    FileFormatError,
    McspectraError,
    NoGainWarning,
    NotPowerOfTwoWarning,
    Parameter,
    ParameterError,
    warn,
)
from mcspectra.core.progress import report
from mcspectra.core.results import dataset
from mcspectra.core.streams import RngLike, Stream
from mcspectra.densities import Density
from mcspectra.improve.designs.objectives import Objective, as_objective
from mcspectra.improve.designs.searches import KINDS, Design, SearchSettings, mean_variances
from mcspectra.improve.learned import LEARNED, LearnSettings, learned_density
from mcspectra.samplers import Sampler
from mcspectra.samplers import sampler as sampler_of
from mcspectra.samplers.registry import as_sampler

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["certificate", "design"]

_VERSION = 5  # Version of the searches; the cache ignores samplers of other versions


@final
@dataclass(frozen=True)
class DesignSettings:
    """Settings of the cache of designs and of certificates."""

    # The cache identifies a class by its text and by values of random integrands of the class.
    # The text alone does not identify a class, because different functions may have the same text.
    # Values of `cache_members` random integrands at `cache_points` random points are used.
    # Integrands may be 0 outside a small region: 64 points missed disks of radius 0.1.
    # A region of volume 1e-3 is missed by 8192 points with probability 3e-4.
    cache_points: int = 2**13
    cache_members: int = 256
    # Samplers with which designs and certificates are compared by default.
    # The listed samplers usually have the least variance.
    # Folded lattices have less variance than others for smooth integrands.
    rivals: tuple[str, ...] = (
        "sobol | owen",
        "pmj02",
        "pmj02-blue-noise",
        "korobov | shift",
        "rank1-lattice | shift",
        "fibonacci | shift",
        "korobov | shift | mirror(mode='fold')",
        "rank1-lattice | shift | mirror(mode='fold')",
        "fibonacci | shift | mirror(mode='fold')",
    )
    # Limits of the comparison of a design with its rivals, before the design is returned.
    # `check_members`: number of integrands from the class.
    # `check_realizations`: number of realizations of the sampler for each group of integrands.
    # `check_evaluations`: maximum number of evaluations of each sampler.
    # Integrands of the same group are estimated with the same realizations.
    # 20 groups of 32 realizations have 620 degrees of freedom.
    # The relative standard error of a variance is then 6 %.
    check_members: int = 2000
    check_realizations: int = 32
    check_evaluations: int = 2**24
    # A certificate divides the integrands of a class into this number of groups.
    # For each group of integrands, samplers are drawn with other random numbers.
    # Errors from 20 groups have 19 degrees of freedom. Student's t widens intervals by 7 %.
    groups: int = 20


_SETTINGS = DesignSettings()


@overload
def design(
    kind: Literal["density"],
    objective: Any,
    n: int,
    *,
    dims: int | None = None,
    rng: RngLike = 0,
    path: str | PathLike[str] | None = None,
    family: str | None = None,
    sampler: Sampler | str | None = None,
    budget: int | None = None,
    defensive: float | None = None,
) -> Density: ...


@overload
def design(
    kind: str,
    objective: Any,
    n: int,
    *,
    dims: int | None = None,
    rng: RngLike = 0,
    path: str | PathLike[str] | None = None,
    settings: SearchSettings | None = None,
) -> Sampler: ...


def design(
    kind: str,
    objective: Any,
    n: int,
    *,
    dims: int | None = None,
    rng: RngLike = 0,
    path: str | PathLike[str] | None = None,
    family: str | None = None,
    sampler: Sampler | str | None = None,
    budget: int | None = None,
    defensive: float | None = None,
    settings: SearchSettings | None = None,
) -> Sampler | Density:
    """Search a sampler with a small mean variance over a class of integrands, or learn a density.

    Parameters
    ----------
    kind
        Kind of the result. The following list states what is optimized for each kind.
        ``"lattice"``: the generating vector. In 2-D all vectors are tried.
        In more dims the vector is built axis by axis.
        ``"polynomial-lattice"`` and ``"digital-net"``: generator matrices.
        ``"owen"``: 64 Owen scramblings of Sobol' points, which keep the quality parameter t.
        ``"strata"``: the shape of strata, and how points of different strata form a set.
        ``"points"``: sets that share the cells of a grid, or one set optimized on the torus.
        ``"density"``: an importance density, see `learned_density`.
    objective
        If the kind is ``"density"``, the integrand for which the density is learned.
        For a sampler: the class of integrands for which it is designed. A class is one of:
        a spec with random parameters ``uniform(a, b)`` or ``normal(mean, sd)``.
        If the integrand accepts a list for such a parameter, one value is drawn for each axis;
        ``"gaussians"``, short for ``"gaussian(center=uniform(0, 1), width=uniform(0.1, 0.4))"``;
        ``"disks"``, with random centers and radii;
        ``"half-spaces"``, with a uniform direction through a uniform point;
        a function ``generator -> integrand``;
        a list of classes and integrands with equal shares, such as the pixels of a scene;
        ``{"spectrum": P}``, where P contains the powers P(m) = E|f_m|² for m = −h … h.
        P is an array (2h + 1, …), or a function of frequencies m of shape (k, d).
        A function also needs the entry ``"half_width": h``;
        ``{"covariance": C}``, where C contains C_ml = E[f_m conj(f_l)].
        C is a matrix, or a function of m and l. The last axis of m varies fastest in the matrix.
    n
        Number of points. Nets and trees require powers of two.
    dims
        Number of dims, up to 8. The default is the number of dims of the integrands.
        If the integrands exist in any number of dims, the default is 2.
    rng
        Seed. The same seed gives the same sampler.
    path
        File for the sampler or the density, with the suffix .json.
        Point sets are stored in a .npz file of the same name. The default is the cache folder.
        In the .json file, the path of the sets is relative to the folder of this file.
        In the spec of the result, the path is relative to the current folder.
    family
        Family of a learned density: the argument `kind` of `learned_density`.
        The default is ``"mixture"``.
    sampler
        Sampler for which a density is learned. The default is ``"sobol | owen"``.
    budget
        Maximum number of evaluations with which a density is learned.
    defensive
        Lower bound of a learned density, as in `learned_density`.
    settings
        Settings for the search of a sampler (`mcspectra.improve.designs.searches.SearchSettings`).

    Returns
    -------
    Sampler or Density
        The sampler is unbiased for every integrand. The spec of the sampler creates it again.
        If the sampler has stored sets, the spec names the file of these sets.
        On new integrands of the class, a usual sampler may prove better with 95 % confidence.
        If `settings.return_rival` is true, the better usual sampler is returned in that case.
        The warning `NoGainWarning` is then given.

    Raises
    ------
    CountError
        If samplers of this kind do not exist with n points.
    ParameterError
        If the kind is unknown, or if an option does not belong to the kind (density or sampler).
        If the objective is empty, constant or unreadable, or if dims are out of range.
    DomainError
        If values of an integrand are not finite.
    FileFormatError
        If the file of the sampler cannot be written.

    Notes
    -----
    The objective is the expected variance tr(C_f C_S); see `improve.designs.searches`.
    For other classes, variances may be larger than with usual samplers: see `certificate`.
    If the search is interrupted (Ctrl-C), the best sampler found so far is returned.
    The result of an interrupted search is not put into the cache.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> mcs.design("lattice", "gaussian(width=0.3)", 21).spec
    'rank1-lattice(vector=[1, 8]) | shift'
    """
    kind = as_choice("kind", kind, (*KINDS, "density"))
    of_densities = {"family": family, "sampler": sampler, "budget": budget, "defensive": defensive}
    if kind == "density":
        if settings is not None:
            raise ParameterError(
                Parameter("settings"), " is for samplers; leave it out with density."
            )
        return learned_density(
            objective,
            "mixture" if family is None else as_choice("family", family, tuple(LEARNED)),
            sampler or "sobol | owen",
            n,
            dims=dims,
            evaluations=None if budget is None else LearnSettings().checked("budget", budget),
            defensive=0.05 if defensive is None else defensive,
            rng=rng,
            path=path,
        )
    for name, value in of_densities.items():
        if value is not None:
            raise ParameterError(Parameter(name), f" is for densities; leave it out with {kind}.")
    settings = SearchSettings() if settings is None else settings
    if not isinstance(settings, SearchSettings):
        raise ParameterError(
            Parameter("settings"), f" is {settings!r:.80}; give a SearchSettings, or leave it out."
        )
    n = as_integer("n", n, least=1, most=2**16)
    goal = as_objective(objective, dims)
    stream = Stream.from_rng(rng)
    chosen = path_to_write(path, "a file for the sampler", (".json",))

    # Search the cache for the sampler. Its key contains values of integrands of the class
    probes = Stream(0).uniforms(0, _SETTINGS.cache_points, goal.dims)
    values = goal.functions(_SETTINGS.cache_members, Stream(0).generator(0))(probes)
    words = (f"{_VERSION} {kind} {n} {stream.key} {settings} {values.shape} {goal.text} ").encode()
    name = hashlib.sha256(words + np.round(values, 12).astype("<f8").tobytes()).hexdigest()
    kept = cache_folder() / "designs" / f"{name[:32]}.json"
    with suppress(OSError, ValueError, KeyError, McspectraError):
        read = json.loads(kept.read_text())
        found = sampler_of(read["spec"], goal.dims)
        if read["note"]:
            warn(read["note"], NoGainWarning)
        return found if chosen is None else _saved(found, chosen)

    # If the user interrupts before the first result, return a usual sampler with a warning
    usual = sampler_of("korobov | shift", goal.dims)
    best, begun, finished = Design(math.inf, 0.0, lambda _: usual), False, False
    try:
        for found_design in KINDS[kind](goal, n, stream, settings):
            begun = True
            report(f"design of {kind}, {n} points", found_design.done)
            if found_design.variance <= best.variance:
                best = found_design
        finished = True
    except KeyboardInterrupt:
        pass
    report(f"design of {kind}, {n} points", 1.0)
    target = kept if finished else kept.with_name(f"{name[:24]}-interrupted-{uuid4().hex[:8]}.json")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        made, note = best.make(target.with_suffix(".npz")), ""
        if not begun:
            note = (
                "The search was interrupted before its first result, so the sampler is "
                f"{usual.spec}, not a design; let the search run longer."
            )
        elif finished and settings.return_rival:
            # Check whether a usual sampler has less variance over integrands that were not used
            made, note = _better_rival(goal, made, n, stream.child(5))
        if note:
            target.with_suffix(".npz").unlink(missing_ok=True)
            warn(note, NoGainWarning)
        target.write_text(json.dumps({"spec": made.spec, "dims": goal.dims, "note": note}) + "\n")
        return made if chosen is None else _saved(made, chosen)
    except OSError as error:
        raise FileFormatError(
            f"The sampler cannot be written to {error.filename}: {error.strerror}; give a folder "
            "that exists and can be written, as path= or MCSPECTRA_CACHE."
        ) from None


def _saved(found: Sampler, target: Path) -> Sampler:
    """Copy a sampler and its sets from the cache to a file of the user."""
    spec = found.spec
    source = next((w for w in spec.split("'") if w.endswith(".npz")), None)
    if source is not None:
        copy = target.with_suffix(".npz")
        shutil.copyfile(source, copy)
        # The file names its sets relative to its own folder, so that both can be moved together
        stored = spec.replace(repr(source), repr(copy.name))
        spec = spec.replace(repr(source), repr(str(copy)))
    else:
        stored = spec
    target.write_text(json.dumps({"spec": stored, "dims": found.dims}) + "\n")
    return sampler_of(spec, found.dims)


def certificate(
    sampler: Sampler | str,
    objective: Any,
    n: int,
    *,
    dims: int | None = None,
    rivals: Sequence[Sampler | str] | None = None,
    members: int = 2000,
    realizations: int = 32,
    rng: RngLike = 1,
) -> xr.Dataset:
    """Measure a sampler's mean variance over new integrands of a class, next to usual samplers.

    Parameters
    ----------
    sampler
        The designed sampler, or any other sampler.
    objective, n
        Same as in `design`. If the class is a list, all its integrands are measured.
    dims
        Number of dims. The default is the number of dims of the sampler.
    rivals
        Samplers that are compared with the design.
        The default samplers are the nets sobol | owen, pmj02 and pmj02-blue-noise.
        Shifted lattices (Korobov, rank-1 and Fibonacci) are also included, with and without folds.
        Default samplers that have no sets of n points in these dims are left out.
    members
        Number of random integrands of the class, which are divided into 20 groups.
    realizations
        Number of independent point sets of each sampler for each group of integrands.
    rng
        Seed, which should differ from the seed of the design.

    Returns
    -------
    xarray.Dataset
        `mean_variance(sampler)` with `mean_variance_ci` is the mean variance over the class.
        `design_ratio` with `design_ratio_ci` compares the sampler with its rivals.
        The ratio is the mean variance of the sampler divided by the variance of the best rival.
        The best rival is chosen in one half of the groups, and compared in the other half.
        The 95 % intervals of mean variances use Student's t, with one value for each group.
        The 95 % interval of the ratio comes from a jackknife over groups.
        The attribute `best_rival` names the rival with the least mean variance.
        If the ratio is above 1, use the best rival instead of the design.

    Raises
    ------
    ParameterError
        If there is no rival, or if all variances of the best rival are zero.
        Wrong arguments raise the same errors as in `design`.
    """
    groups = _SETTINGS.groups
    given = as_sampler(sampler, dims)
    goal = as_objective(objective, given.dims)
    n = given.check_count(n)
    members = as_integer("members", members, least=groups)
    realizations = as_integer("realizations", realizations, least=2)
    if rivals is not None and (isinstance(rivals, str | bytes) or not isinstance(rivals, Sequence)):
        raise ParameterError(f"rivals is {rivals!r:.80}; give a list of samplers.")
    samplers = [given, *_rivals(rivals, given.dims, n)]
    if len(samplers) == 1:
        raise ParameterError("There is no rival; give one sampler at least.")
    sums = _sums_of_groups(goal, samplers, n, members, realizations, Stream.from_rng(rng))
    means = sums.mean(axis=1)
    best = 1 + int(means[1:].argmin())
    if not means[best] > 0.0:
        raise ParameterError(f"The variance of {samplers[best].spec} vanishes; there is no ratio.")
    spread = student_t(groups) * sums.std(axis=1, ddof=1) / math.sqrt(groups)
    # The least of several estimated variances is too small on average.
    # Therefore find the best rival on one half of the groups, and use it for the other half
    halves = sums.reshape(len(samplers), -1, 2)
    chosen = 1 + halves.sum(axis=1)[1:, ::-1].argmin(axis=0)
    beaten = halves[chosen, :, (0, 1)].T.ravel()
    ratio, low, high = _ratio(sums[0], beaten)
    return dataset(
        {
            "mean_variance": (("sampler",), means),
            "mean_variance_ci": (
                ("sampler", "bound"),
                np.stack([means - spread, means + spread], -1),
            ),
            "design_ratio": ((), ratio),
            "design_ratio_ci": (("bound",), np.array([low, high])),
        },
        {"sampler": [each.spec for each in samplers], "bound": ["low", "high"]},
        objective=goal.text,
        n=n,
        best_rival=samplers[best].spec,
        members=members,
        realizations=realizations,
    )


def _rivals(given: Sequence[Sampler | str] | None, dims: int, n: int) -> list[Sampler]:
    """Return the given rivals, or default rivals that have n points in these dims."""
    found = []
    for rival in _SETTINGS.rivals if given is None else given:
        with suppress(*([McspectraError] if given is None else [])):
            made = as_sampler(rival, dims)
            made.check_count(n)
            found.append(made)
    return found


def _sums_of_groups(
    goal: Objective,
    samplers: Sequence[Sampler],
    n: int,
    members: int,
    realizations: int,
    stream: Stream,
) -> Array:
    """Return each sampler's mean variance over each group of integrands: (samplers, groups).

    Integrands and realizations of different groups are independent of each other.
    """
    groups = _SETTINGS.groups
    sums = np.empty((len(samplers), groups))
    for group in range(groups):
        values = goal.draw(members // groups, stream.generator(group))
        for place, each in enumerate(samplers):
            seed = int(stream.child(group).child(place).key)
            sums[place, group] = mean_variances(values, each, n, realizations, seed).sum()
            report("comparison of samplers", (group + (place + 1) / len(samplers)) / groups)
    return sums


def _ratio(above: Array, below: Array) -> tuple[float, float, float]:
    """Return the ratio of two sums over groups, and its 95 % interval from a jackknife."""
    groups, ratio = len(above), float(above.sum() / below.sum())
    left = (above.sum() - above) / (below.sum() - below)
    error = float(np.sqrt((groups - 1) / groups * ((left - left.mean()) ** 2).sum()))
    width = student_t(groups) * error
    return ratio, max(ratio - width, 0.0), ratio + width


def _better_rival(goal: Objective, made: Sampler, n: int, stream: Stream) -> tuple[Sampler, str]:
    """Return the design, or a usual sampler with less variance.

    Also return a sentence about the usual sampler. The sentence is empty if the design is returned.
    """
    realizations = _SETTINGS.check_realizations
    members = _SETTINGS.check_evaluations // (n * realizations)
    members = min(_SETTINGS.check_members, max(_SETTINGS.groups, members))
    with warnings.catch_warnings():
        # Ignore warnings about unbalanced point sets: such rivals have large variances
        warnings.simplefilter("ignore", NotPowerOfTwoWarning)
        rivals = [rival for rival in _rivals(None, goal.dims, n) if rival.unbiased]
        sums = _sums_of_groups(goal, [made, *rivals], n, members, realizations, stream)
    best = 1 + int(sums[1:].sum(axis=1).argmin())
    if not sums[best].sum() > 0.0:
        return made, ""
    ratio, low, high = _ratio(sums[0], sums[best])
    if low <= 1.0:
        return made, ""
    rival = rivals[best - 1]
    return rival, (
        f"The best design has {ratio:.3g} times (95 %: {low:.3g} to {high:.3g}) the mean variance "
        f"of {rival.spec}, which is returned instead; other kinds of designs may have less."
    )
