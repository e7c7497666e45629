"""Samplers designed for a class of integrands, and certificates of what they gain."""

from __future__ import annotations

import hashlib
import json
import math
import shutil
from collections.abc import Sequence
from contextlib import suppress
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, overload
from uuid import uuid4

import numpy as np

from mcspectra.core.cache import cache_folder
from mcspectra.core.checks import as_choice, as_integer
from mcspectra.core.decoding import path_to_write
from mcspectra.core.errors import FileFormatError, McspectraError, Parameter, ParameterError
from mcspectra.core.progress import report
from mcspectra.core.results import dataset
from mcspectra.core.streams import RngLike, Stream
from mcspectra.densities import Density
from mcspectra.improve.designs.objectives import as_objective
from mcspectra.improve.designs.searches import KINDS, Design, mean_variances
from mcspectra.improve.learned import learned_density
from mcspectra.samplers import Sampler
from mcspectra.samplers import sampler as sampler_of
from mcspectra.samplers.registry import as_sampler

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["certificate", "design"]

_VERSION = 3  # of the searches: samplers of another one are not taken from the cache
# Points and members whose values name a class in the cache, beside its text: of functions alone the
# values tell, and they may be 0 but for a small spot
_PROBES, _MEMBERS = 2**13, 256
_RIVALS = (
    "sobol | owen",
    "pmj02",
    "korobov | shift",
    "rank1-lattice | shift",
    "fibonacci | shift",
)
_GROUPS = 20  # of members, each with realisations of its own
_T95 = 2.0930240544082634  # 97.5 % quantile of Student's t, 19 degrees of freedom


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
) -> Sampler | Density:
    """Search a sampler of small expected variance over a class of integrands, or learn a density for one.

    Parameters
    ----------
    kind
        ``"lattice"`` (generating vectors: all in 2-D, else axis after axis), ``"polynomial-lattice"``,
        ``"digital-net"`` (generator matrices), ``"owen"`` (64 trees of Sobol' points, flipped; t stays),
        ``"strata"`` (shape, and how points of different strata go together) or ``"points"`` (free sets: sets that share
        out a grid, or one on the torus by its gradient); or ``"density"``: `learned_density`.
    objective
        Of a density the integrand. Of a sampler the class. A spec, parameters of which may be ``uniform(a, b)`` or ``normal(mean, sd)``, drawn for
        each axis where they can be: ``"gaussian(center=uniform(0, 1), width=uniform(0.1, 0.4))"``;
        ``"gaussians"`` (that one), ``"disks"`` or ``"half-spaces"`` (a uniform direction through a uniform
        point); a function ``generator -> integrand``; a list of all these, in equal shares, such as the
        pixels of a scene; ``{"spectrum": P}`` with the powers P(m) = E|f_m|², an array (2h + 1, …) of
        m = −h … h or, with ``"half_width": h``, a callable of m (k, d); ``{"covariance": C}``,
        C_ml = E[f_m conj(f_l)] as a matrix of these m in C order, or a callable of m and l.
    n
        Number of points. Nets and trees take powers of two.
    dims
        Number of dims, up to 8; by default those of the integrands, or 2 where they have any.
    rng
        Seed. The same seed gives the same sampler.
    path
        File to keep the sampler or the density in, .json; sets, where there are any, go into a .npz file of the
        same name. By default the cache folder.
    family, sampler, budget, defensive
        Of a density alone: `kind` (by default ``"mixture"``), `sampler` (``"sobol | owen"``), `evaluations` and
        `defensive` of `learned_density`.

    Returns
    -------
    Sampler or Density
        Unbiased for every integrand. Its `spec` makes it again; kinds with sets name their file.

    Raises
    ------
    CountError
        The kind has no sets of n points.
    ParameterError
        Unknown kind; an option of densities with a sampler; an objective that is empty, constant or cannot be read; dims out of range.
    DomainError
        Values of an integrand are not finite.
    FileFormatError
        The sampler cannot be written.

    Notes
    -----
    The objective is the expected variance tr(C_f C_S), by `improve.designs.searches`. Variances for
    other classes may be larger than those of usual samplers: see `certificate`. Interrupting the search
    (Ctrl-C) keeps the best sampler so far, and leaves it out of the cache.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> mcs.design("lattice", "gaussian(width=0.3)", 21).spec
    'rank1-lattice(vector=[1, 8]) | shift'
    """
    kind = as_choice("kind", kind, (*KINDS, "density"))
    of_densities = {"family": family, "sampler": sampler, "budget": budget, "defensive": defensive}
    if kind == "density":
        return learned_density(
            objective,
            family or "mixture",
            sampler or "sobol | owen",
            n,
            dims=dims,
            evaluations=budget,
            defensive=0.05 if defensive is None else defensive,
            rng=rng,
            path=path,
        )
    for name, value in of_densities.items():
        if value is not None:
            raise ParameterError(Parameter(name), f" is for densities; leave it out with {kind}.")
    n = as_integer("n", n, least=1, most=2**16)
    goal = as_objective(objective, dims)
    stream = Stream.from_rng(rng)
    chosen = path_to_write(path, "a file for the sampler", (".json",))

    # Take it from the cache, where a class is known by its values
    probes = Stream(0).uniforms(0, _PROBES, goal.dims)
    values = goal.functions(_MEMBERS, Stream(0).generator(0))(probes)
    words = f"{_VERSION} {kind} {n} {stream.key} {values.shape} {goal.text} ".encode()
    name = hashlib.sha256(words + np.round(values, 12).astype("<f8").tobytes()).hexdigest()
    kept = cache_folder() / "designs" / f"{name[:32]}.json"
    with suppress(OSError, ValueError, KeyError, McspectraError):
        found = sampler_of(json.loads(kept.read_text())["spec"], goal.dims)
        return found if chosen is None else _saved(found, chosen)

    # Where nothing is found before an interrupt there is a usual sampler
    usual = sampler_of("korobov | shift", goal.dims)
    best, finished = Design(math.inf, 0.0, lambda _: usual), False
    try:
        for candidate in KINDS[kind](goal, n, stream):
            report(f"design of {kind}, {n} points", candidate.done)
            if candidate.variance <= best.variance:
                best = candidate
        finished = True
    except KeyboardInterrupt:
        pass
    report(f"design of {kind}, {n} points", 1.0)
    target = kept if finished else kept.with_name(f"{name[:24]}-interrupted-{uuid4().hex[:8]}.json")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        made = best.make(target.with_suffix(".npz"))
        target.write_text(json.dumps({"spec": made.spec, "dims": goal.dims}) + "\n")
        return made if chosen is None else _saved(made, chosen)
    except OSError as error:
        raise FileFormatError(
            f"The sampler cannot be written to {error.filename}: {error.strerror}; give a folder that "
            "exists and can be written, as path= or MCSPECTRA_CACHE."
        ) from None


def _saved(found: Sampler, target: Path) -> Sampler:
    """Copy a sampler from the cache, with its sets, to a file of the user's."""
    spec = found.spec
    source = next((w for w in spec.split("'") if w.endswith(".npz")), None)
    if source is not None:
        copy = str(target.with_suffix(".npz").resolve())  # it loads from any folder
        shutil.copyfile(source, copy)
        spec = spec.replace(repr(source), repr(copy))
    target.write_text(json.dumps({"spec": spec, "dims": found.dims}) + "\n")
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
    """Measure the mean variance over fresh members of a class, beside that of other samplers.

    Parameters
    ----------
    sampler
        The designed sampler, or any other.
    objective, n
        As of `design`. Of a class that is a list all integrands are measured: there are no others.
    dims
        Number of dims; by default that of the sampler.
    rivals
        Samplers to compare with. By default sobol | owen, pmj02, and shifted Korobov, rank-1 and
        Fibonacci lattices: those that can make n points in these dims.
    members
        How many members are drawn, in 20 groups.
    realizations
        Independent sets for each group.
    rng
        Seed, another one than that of the design.

    Returns
    -------
    xarray.Dataset
        `mean_variance(sampler)` with `mean_variance_ci`, and `design_ratio`, `design_ratio_ci`: that of the
        sampler over that of the best rival, chosen for each half of the groups by the other. 95 % intervals
        by Student's t over groups, of the ratio by the jackknife.

    Raises
    ------
    ParameterError
        There is no rival, all variances of the best one vanish, or as of `design`.
    """
    given = as_sampler(sampler, dims)
    goal = as_objective(objective, given.dims)
    n = given.check_count(n)
    members = as_integer("members", members, least=_GROUPS)
    realizations = as_integer("realizations", realizations, least=2)
    samplers = [given]
    if rivals is not None and (isinstance(rivals, str | bytes) or not isinstance(rivals, Sequence)):
        raise ParameterError(f"rivals is {rivals!r:.80}; give a list of samplers.")
    for rival in _RIVALS if rivals is None else rivals:
        with suppress(*([McspectraError] if rivals is None else [])):
            made = as_sampler(rival, given.dims)
            made.check_count(n)
            samplers.append(made)
    if len(samplers) == 1:
        raise ParameterError("There is no rival; give one sampler at least.")

    # Groups of members, each with its own realisations, are independent of one another
    stream = Stream.from_rng(rng)
    sums = np.empty((len(samplers), _GROUPS))
    for group in range(_GROUPS):
        values = goal.draw(members // _GROUPS, stream.generator(group))
        for place, each in enumerate(samplers):
            seed = int(stream.child(group).child(place).key)
            sums[place, group] = mean_variances(values, each, n, realizations, seed).sum()
            report("certificate", (group + (place + 1) / len(samplers)) / _GROUPS)
    means = sums.mean(axis=1)
    best = 1 + int(means[1:].argmin())
    if not means[best] > 0.0:
        raise ParameterError(f"The variance of {samplers[best].spec} vanishes; there is no ratio.")
    spread = _T95 * sums.std(axis=1, ddof=1) / math.sqrt(_GROUPS)
    # The least of several estimates is too small: each half of the groups has the rival that is best in the other
    halves = sums.reshape(len(samplers), -1, 2)
    chosen = 1 + halves.sum(axis=1)[1:, ::-1].argmin(axis=0)
    beaten = halves[chosen, :, (0, 1)].T.ravel()
    ratio = sums[0].sum() / beaten.sum()
    left = (sums[0].sum() - sums[0]) / (beaten.sum() - beaten)
    width = _T95 * float(np.sqrt((_GROUPS - 1) / _GROUPS * ((left - left.mean()) ** 2).sum()))
    return dataset(
        {
            "mean_variance": (("sampler",), means),
            "mean_variance_ci": (
                ("sampler", "bound"),
                np.stack([means - spread, means + spread], -1),
            ),
            "design_ratio": ((), ratio),
            "design_ratio_ci": (("bound",), np.array([max(ratio - width, 0.0), ratio + width])),
        },
        {"sampler": [each.spec for each in samplers], "bound": ["low", "high"]},
        objective=goal.text,
        n=n,
        best_rival=samplers[best].spec,
        members=members,
        realizations=realizations,
    )
