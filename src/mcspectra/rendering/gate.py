"""A gate for continuous integration: do new renders agree with a reference?

The verdict is ``pass``, ``fail`` or ``undecided``.
The function `gate` also states how large a bias must be to be found with high probability.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any, final

import numpy as np
import xarray as xr

from mcspectra.core.checks import Array, as_integer, as_real
from mcspectra.core.display import counted
from mcspectra.core.errors import ParameterError
from mcspectra.core.results import coordinate, dataset
from mcspectra.rendering.frame_files import MOST_SPP, FrameReader, Frames
from mcspectra.rendering.gate_frames import (
    FrameSet,
    Source,
    finest_size,
    read_set,
    source_of,
    write_reference,
)
from mcspectra.rendering.gate_relabelings import relabelled
from mcspectra.rendering.gate_t_tests import cautious
from mcspectra.rendering.gate_tests import (
    Contrast,
    Found,
    Level,
    Outcome,
    frame_features,
    levels_of,
    relabelling_count,
)

__all__ = ["GATE_VERDICTS", "gate", "write_reference"]

GATE_VERDICTS = {"pass": 0, "fail": 3, "undecided": 4}
"""Exit code of the command for each verdict."""

_LEAST_LEVEL = 1e-4
# The number of relabelings is `_RELABELINGS` divided by the significance level.
# More relabelings would hardly improve the tests
_RELABELINGS = 5
_SAMPLE = 2**15  # number of tiles at which two frames are compared
_ONE_SEED = 0.9  # two frames of one set have the same seed if their errors correlate more than this
# Frames of two sets have the same seed if the correlation of their errors exceeds `_RELATED`,
# and also exceeds `_FAR` times the typical correlation of two frames
_RELATED, _FAR = 0.1, 8.0
_LEAST_PAIRS = 4
# The noise of two sets counts as equal if their variances differ by at most the factor `_EQUAL`.
# The noise also counts as equal if the variances do not differ at the significance level `_DOUBT`
_EQUAL, _DOUBT = 1.25, 0.01
_COPY = 1e-6  # images that differ by less than this fraction of their mean are copies
# Fraction of the significance level for one test: does the mean depend on the samples per pixel?
_TREND_SHARE = 0.2
_BINS = 20
_MEANS = ("image", "tiles", "pixels", "spread", "trend")


def gate(
    new: Frames,
    reference: Frames,
    *,
    level: float = 0.01,
    target: float | None = None,
    spp: int | None = None,
    spp_reference: int | None = None,
    layer: str | None = None,
    tone_mapped: bool = False,
    rng: int = 0,
) -> xr.Dataset:
    """Test whether new renders agree with a reference in mean and noise.

    Parameters
    ----------
    new
        Independent renders of one view: a folder, a pattern, or a list of files, as for `frames`.
    reference
        Frames of the same view, or a file of `mcspectra.rendering.write_reference`.
    level
        Probability of a false alarm, from 0.0001 to below 1, for all tests together.
    target
        Relative bias of the image mean that the tests must be able to find.
        If the tests could miss a bias of this size, the verdict is undecided.
    spp, spp_reference
        Samples per pixel of the frames; by default from names and headers.
        If neither set states its samples per pixel, both are assumed to have equally many.
    layer, tone_mapped
        Same as in `frames`.
    rng
        Seed for the choice of relabelings.

    Returns
    -------
    xarray.Dataset
        On the finest tiles (y, x), which are single pixels unless the reference is a stored file:
        ``single_p``, the p-value of each tile alone, and its histogram ``p_share``;
        ``smallest_p``, the smallest p-value of all tiles around a point, corrected for all tests;
        ``difference``, new minus reference; and ``mean``, the mean of the reference.
        By test (dim ``test``): ``test_p`` (corrected for all), ``test_statistic``, ``test_size``,
        and ``detectable``, the relative bias that the test finds with 90 % probability.
        The attribute ``verdict`` is ``pass``, ``fail`` or ``undecided``.
        Further attributes are ``p``, ``method``, the numbers of frames, and ``mean_difference``.
        `mcspectra.report.gate_page.gate_findings` describes the result in words.

    Raises
    ------
    FileFormatError
        If a file is missing, broken, of another type, or tone-mapped.
    ParameterError
        If sizes differ, or an option is out of range.

    Notes
    -----
    Frames of one renderer with different seeds are exchangeable.
    The tests exchange frames between the two sets; each exchange is a relabeling.
    The tests compare the largest test statistic with its values after many relabelings.
    For any noise, the probability of a false alarm is at most `level` [WestfallYoung1993]_.
    For the level 0.01, the tests need 5 new frames and 5 reference frames, or 3 and 7, or 1 and 99.
    If the frames form pairs with equal seeds, the tests need 8 pairs.
    With fewer frames or unequal noise, t tests of the image and of wide tiles are used instead.
    """
    level = as_real("level", level, least=_LEAST_LEVEL, below=1.0)
    target = None if target is None else as_real("target", target, above=0.0)
    rng = as_integer("rng", rng, least=0)
    counts = {"spp": spp, "spp_reference": spp_reference}
    for name, value in counts.items():
        if value is not None:
            counts[name] = as_integer(name, value, least=1, most=MOST_SPP)
    readers = [FrameReader(layer=layer, tone_mapped=tone_mapped, spp=counts[n]) for n in counts]
    sources = [source_of(new, readers[0]), source_of(reference, readers[1])]
    if sources[0].shape != sources[1].shape:
        raise ParameterError(
            f"{sources[0].name} has the size {sources[0].shape}, but {sources[1].name} has "
            f"{sources[1].shape}; give frames of one view."
        )

    # Compare frames with the largest number of samples that both sets have.
    # If the sets have no number of samples in common, take the largest number of each set
    known = [{each.spp for each in source.groups} for source in sources]
    common = known[0] & known[1]
    chosen = [max(common or own, key=lambda n: n or 0) for own in known]
    size = finest_size([*zip(sources, chosen, strict=True)])
    if min(sources[0].shape) < size:
        raise ParameterError(
            f"{sources[0].name} has the size {sources[0].shape}; this reference needs at least "
            f"{size} pixels along each side."
        )
    sets = [
        read_set(source, n, size, read)
        for source, n, read in zip(sources, chosen, readers, strict=True)
    ]
    case = _case(sets[0], sets[1])
    comparable = case.why is None and not case.copy
    result = _result(case, level, rng) if comparable else _empty(case)
    trend = _trend(sources[0], case.ours, readers[0]) if comparable else []
    return _verdict(case, result, trend, level, target, rng)


@final
@dataclass(frozen=True, kw_only=True)
class _Case:
    """Two sets of frames that can be compared.

    Attributes
    ----------
    ours, theirs
        The frames that are compared.
    contrast
        The comparison.
    bad
        Tiles that lack a finite value in some frame.
    copy
        Whether the two sets are equal up to rounding.
    why
        Why the sets cannot be compared, or None if they can.
    notes
        Sentences about frames that were left out.
    """

    ours: FrameSet
    theirs: FrameSet
    contrast: Contrast
    bad: Array
    copy: bool
    why: str | None
    notes: list[str] = field(default_factory=list)


def _case(ours: FrameSet, theirs: FrameSet) -> _Case:
    """Leave out repeated frames, and find copies and pairs of frames with the same seed."""
    notes: list[str] = []
    bad = np.isnan(np.concatenate([ours.rows, theirs.rows])).any(axis=0)
    if bad.all():
        raise ParameterError(
            f"{ours.name} and {theirs.name} have no pixel that is finite in all frames of both; "
            "give other frames."
        )
    place = np.flatnonzero(~bad.ravel())
    place = place[np.linspace(0, place.size - 1, min(_SAMPLE, place.size)).astype(int)]

    def sample(frames: FrameSet) -> Array:
        return np.asarray(frames.rows.reshape(frames.count, -1)[:, place], np.float64)

    if ours.count == theirs.count and _is_copy(ours.rows, theirs.rows, bad):
        contrast = Contrast(first=ours.count, second=theirs.count, paired=True)
        return _Case(
            ours=ours, theirs=theirs, contrast=contrast, bad=bad, copy=True, why=None, notes=notes
        )
    parts = []
    for frames in (ours, theirs):
        kept = _distinct(sample(frames))
        if len(kept) < frames.count:
            gone = next(k for k in range(frames.count) if k not in kept)
            notes.append(
                f"{frames.count - len(kept)} of {frames.count} frames of {frames.name} repeat the "
                f"noise of another frame and are left out, such as {frames.names[gone]}; give "
                "every frame its own seed."
            )
        parts.append(frames.only(kept))
    ours, theirs = parts
    pairs = _pairs(sample(ours), sample(theirs))

    # Leave out new frames that are copies: their difference is zero by construction
    copies = {i for i, k in pairs if _is_copy(ours.rows[i : i + 1], theirs.rows[k : k + 1], bad)}
    if len(copies) == ours.count:
        contrast = Contrast(first=ours.count, second=theirs.count, paired=False)
        return _Case(
            ours=ours, theirs=theirs, contrast=contrast, bad=bad, copy=True, why=None, notes=notes
        )
    if copies:
        notes.append(
            f"{len(copies)} of {ours.count} new frames are copies of reference frames and are left "
            "out."
        )
        ours = ours.only([k for k in range(ours.count) if k not in copies])
        pairs = _pairs(sample(ours), sample(theirs))
    paired = len(pairs) >= _LEAST_PAIRS and 2 * len(pairs) >= ours.count
    if paired:
        notes.append(
            f"{len(pairs)} frames of the two sets have the same seeds, and are compared as pairs."
        )
        ours, theirs = (
            each.only([pair[k] for pair in pairs]) for k, each in enumerate((ours, theirs))
        )
    elif pairs and theirs.count - len(pairs) >= 2:
        shared = {second for _, second in pairs}
        theirs = theirs.only([k for k in range(theirs.count) if k not in shared])
        notes.append(
            f"{len(pairs)} frames of the reference have seeds of new frames and are left out."
        )
    contrast = Contrast(first=ours.count, second=theirs.count, paired=paired)
    return _Case(
        ours=ours,
        theirs=theirs,
        contrast=contrast,
        bad=bad,
        copy=False,
        why=_why(ours, theirs, contrast),
        notes=notes,
    )


def _is_copy(ours: Array, theirs: Array, bad: Array) -> bool:
    """Whether every frame equals the frame of the same number in the other set, up to rounding."""
    for one, other in zip(ours, theirs, strict=True):
        change = np.abs(np.where(bad, 0.0, one - other))
        limit = _COPY * float(np.abs(other[~bad]).mean())
        if float(change.max()) > limit and (change > _COPY * np.abs(other)).any():
            return False
    return True


def _distinct(sample: Array) -> list[int]:
    """Return the frames whose noise differs from that of all earlier frames."""
    count = len(sample)
    same = [[k for k in range(i) if np.array_equal(sample[k], sample[i])] for i in range(count)]
    if count > 2:
        error = sample - sample.mean(axis=0)
        size = np.sqrt((error**2).sum(axis=0))
        error /= np.where(size > 0, size, 1.0)
        length = np.sqrt((error**2).sum(axis=1))
        unit = error / np.where(length > 0, length, 1.0)[:, None]
        # Deviations from the mean of R values have the correlation −1 / (R − 1)
        own = ((unit @ unit.T) * (count - 1) + 1) / count
        for i in range(count):
            same[i] += [k for k in range(i) if own[k, i] > _ONE_SEED]
    return [i for i in range(count) if not same[i]]


def _pairs(ours: Array, theirs: Array) -> list[tuple[int, int]]:
    """Return pairs of frames (new, reference) with correlated errors, which have the same seed."""
    if len(theirs) < 2 and len(ours) < 2:
        return []
    both = [ours - ours.mean(axis=0), theirs - theirs.mean(axis=0)]
    for k, values in enumerate((ours, theirs)):
        if len(values) == 1:
            both[k] = values - (theirs, ours)[k].mean(axis=0)
    size = np.sqrt((both[0] ** 2).sum(axis=0) + (both[1] ** 2).sum(axis=0))
    first, second = (each / np.where(size > 0, size, 1.0) for each in both)
    lengths = [np.sqrt((each**2).sum(axis=1)) for each in (first, second)]
    scale = np.outer(*lengths)
    cross = np.divide(first @ second.T, scale, out=np.zeros_like(scale), where=scale > 0)
    usual = float(np.median(np.abs(cross))) / 0.6745
    usual = max(usual, 1.0 / math.sqrt(ours.shape[1]))
    limit = min(max(_RELATED, _FAR * usual), 0.6)
    found: list[tuple[int, int]] = []
    left = cross.copy()
    while left.size and float(left.max()) > limit:
        i, k = (int(v) for v in np.unravel_index(np.argmax(left), left.shape))
        found.append((i, k))
        left[i, :] = left[:, k] = -1.0
    return sorted(found)


def _why(ours: FrameSet, theirs: FrameSet, contrast: Contrast) -> str | None:
    """Return the reason why the sets cannot be compared, or None."""
    alike = ours.spp == theirs.spp
    if contrast.degrees < 2:
        return (
            f"The noise is not known: there are {counted(ours.count, 'new frame')} and "
            f"{counted(theirs.count, 'reference frame')} to use. Samples of a pixel may be "
            "correlated, so only independent renders tell their noise; give at least 2 + 2, "
            "better 5 + 5."
        )
    if min(ours.count, theirs.count) < 2 and not alike:
        return (
            f"The noise of one frame at {ours.spp or theirs.spp} samples per pixel is not known, "
            "and the other frames have another number of samples; give two or more frames of each."
        )
    return None


@final
@dataclass(frozen=True, kw_only=True)
class _Result:
    """Results of the tests, and numbers for the whole image. All frames were divided by `scale`."""

    outcome: Outcome
    method: str
    levels: list[Level]
    noise_ratio: float
    scale: float = 1.0


def _result(case: _Case, level: float, rng: int) -> _Result:
    """Run the tests of the difference between the two sets of frames.

    The tests relabel frames if enough relabelings exist and both sets have equal noise.
    Otherwise t tests are used.
    """
    ours, theirs, contrast = case.ours, case.theirs, case.contrast
    rows = np.concatenate([ours.rows, theirs.rows])
    channels = np.concatenate([ours.channels, theirs.channels])
    # In float32, squares of values near 1 neither overflow nor underflow
    scale = float(np.abs(rows[:, ~case.bad]).max()) or 1.0
    rows /= np.float32(scale)
    channels = channels / scale
    if case.bad.any() or ours.missing or theirs.missing or channels.shape[1] != 3:
        channels = channels[:, :1]
    levels = levels_of(rows, case.bad, ours.size, channels)
    alike = ours.spp == theirs.spp
    single = min(contrast.first, contrast.second) < 2
    ratio, quieter = (math.nan, False) if single else _noise(levels[0], contrast)
    if alike and relabelling_count(contrast) * level >= 1:
        most = math.ceil(_RELABELINGS / level)
        weights = contrast.relabelings(most, np.random.default_rng(rng))
        outcome = relabelled(levels, contrast, weights, level)
        unequal = not contrast.paired and quieter and max(ratio, 1 / ratio) > _EQUAL
        if not unequal:
            method = "sign flips of pairs" if contrast.paired else "relabeling"
            return _Result(
                outcome=outcome, method=method, levels=levels, noise_ratio=ratio, scale=scale
            )
        # If the noise of the sets differs, their frames are not exchangeable.
        # Relabeling is then exact for tests of the noise only, and means are tested by t values
        means = cautious(levels, contrast, level, alike=False, noise=False)
        noise = [each for each in outcome.tests if each.name not in _MEANS]
        both = [*means.tests, *noise]
        outcome = replace(means, tests=both, p=min(each.p for each in both))
        return _Result(
            outcome=outcome,
            method="t tests, unequal noise",
            levels=levels,
            noise_ratio=ratio,
            scale=scale,
        )
    outcome = cautious(levels, contrast, level, alike=alike, noise=alike)
    method = "t tests" if alike else "t tests, unequal samples per pixel"
    return _Result(outcome=outcome, method=method, levels=levels, noise_ratio=ratio, scale=scale)


def _noise(finest: Level, contrast: Contrast) -> tuple[float, bool]:
    """Return the ratio of the noise variances, and whether the noise differs significantly."""
    from scipy.ndimage import uniform_filter
    from scipy.special import stdtr

    first = contrast.first
    power = frame_features(finest)["noise"]
    ours, theirs = power[:first], power[first:]
    spread = math.hypot(
        ours.std(ddof=1) / math.sqrt(ours.size), theirs.std(ddof=1) / math.sqrt(theirs.size)
    )
    t = (ours.mean() - theirs.mean()) / max(spread, 1e-300)
    differs = 2.0 * float(stdtr(max(min(ours.size, theirs.size) - 1, 1), -abs(t))) < _DOUBT

    # Compare the variances of the two sets by a weighted mean over pixels.
    # The weight of a pixel comes from the variance in its neighborhood.
    # Weights from the variance of only the pixel itself would bias the ratio toward 1
    rows, valid = finest.rows, finest.valid
    total = uniform_filter(np.where(valid, rows.var(axis=0, dtype=np.float64), 0.0), 5)
    weight = np.divide(1.0, total, out=np.zeros_like(total), where=valid & (total > 0))
    sums = [
        float((part.var(axis=0, ddof=1, dtype=np.float64) * weight).sum())
        for part in (rows[:first], rows[first:])
    ]
    ratio = sums[0] / sums[1] if sums[1] > 0 else math.inf
    differs = differs or not 0.1 < ratio < 10.0
    return max(ratio, 1e-12), differs


def _empty(case: _Case) -> _Result:
    """Return a result without tests, for sets that cannot be compared."""
    rows = np.concatenate([case.ours.rows, case.theirs.rows])
    rows[:, case.bad] = 0.0
    nothing = np.full(case.bad.shape, np.nan)
    level = Level(size=case.ours.size, rows=rows, valid=~case.bad)
    outcome = Outcome(p=math.nan, relabelings=0, tests=[], smallest=nothing, single=nothing)
    return _Result(outcome=outcome, method="none", levels=[level], noise_ratio=math.nan)


def _trend(source: Source, ours: FrameSet, read: FrameReader) -> list[tuple[int, float, float]]:
    """Compare the image mean at other numbers of samples with the chosen number, by Welch's test.

    Returns samples per pixel, relative difference and p-value for each other number of samples.
    """
    from scipy.special import stdtr

    found = []
    for group in source.groups:
        if group.spp == ours.spp or group.spp is None or ours.count < 2 or len(group.files) < 2:
            continue
        other = read_set(source, group.spp, ours.size, read)
        a, b = (np.nanmean(each.rows, axis=(1, 2), dtype=np.float64) for each in (ours, other))
        error = math.hypot(a.std(ddof=1) / math.sqrt(a.size), b.std(ddof=1) / math.sqrt(b.size))
        change = float(b.mean() - a.mean())
        error = max(error, _COPY * abs(float(a.mean())))
        p = 2.0 * float(stdtr(min(a.size, b.size) - 1, -abs(change / error)))
        found.append((group.spp, change / float(a.mean() or 1.0), p))
    return [(n, change, min(1.0, p * len(found))) for n, change, p in found]


def _verdict(
    case: _Case,
    result: _Result,
    trend: list[tuple[int, float, float]],
    level: float,
    target: float | None,
    rng: int,
) -> xr.Dataset:
    """Decide on the verdict, and return all results as a dataset."""
    outcome, finest = result.outcome, result.levels[0]
    tests = list(outcome.tests)
    if trend:
        # The significance level is split between the test of a trend and all other tests
        tests = [replace(each, p=min(1.0, each.p / (1.0 - _TREND_SHARE))) for each in tests]
        least = min(trend, key=lambda each: each[2])
        tests.append(
            Found(
                name="trend", size=0, p=min(1.0, least[2] / _TREND_SHARE), statistic=abs(least[1])
            )
        )
    p = min((each.p for each in tests), default=math.nan)
    image = next((each for each in tests if each.name == "image"), None)
    seen = image.detectable if image else math.nan
    region = _region(tests, case.ours.shape)
    copy = case.copy
    if case.why is not None:
        verdict = "undecided"
    elif copy:
        verdict, p = "pass", 1.0
    elif p <= level:
        verdict = "fail"
    elif not seen < (1.0 if target is None else target):
        verdict = "undecided"
    else:
        verdict = "pass"

    # A detectable bias is reported only if no bias was found
    hidden = copy or verdict == "fail"

    first = case.contrast.first
    ours, theirs = (
        result.scale * part.mean(axis=0, dtype=np.float64)
        for part in np.split(finest.rows, [first])
    )
    valid = finest.valid
    means = [float(each[valid].mean()) for each in (ours, theirs)]
    place = [(np.arange(k) + 0.5) * finest.size - 0.5 for k in valid.shape]
    single = np.full(valid.shape, np.nan) if copy else outcome.single
    share, edges = np.histogram(single[np.isfinite(single)], bins=_BINS, range=(0.0, 1.0))
    variables: dict[str, tuple[tuple[str, ...], Any]] = {
        "single_p": (("y", "x"), single),
        "smallest_p": (("y", "x"), np.where(valid, 1.0, np.nan) if copy else outcome.smallest),
        "difference": (("y", "x"), np.where(valid, ours - theirs, np.nan)),
        "mean": (("y", "x"), np.where(valid, theirs, np.nan)),
        "p_share": (("bin",), share / max(int(share.sum()), 1)),
        "test_p": (("test",), np.array([1.0 if copy else each.p for each in tests])),
        "test_statistic": (("test",), np.array([each.statistic for each in tests])),
        "test_size": (("test",), np.array([each.size for each in tests], dtype=np.int64)),
        "detectable": (
            ("test",),
            np.array([math.nan if hidden else each.detectable for each in tests]),
        ),
    }
    return dataset(
        variables,
        {
            "y": place[0],
            "x": place[1],
            "bin": coordinate("bin", (edges[:-1] + edges[1:]) / 2, "p-value, center of the bin"),
            "test": np.array([_name(each) for each in tests], dtype=object),
        },
        verdict=verdict,
        p=None if math.isnan(p) else p,
        level=level,
        target=target,
        method="comparison" if copy else result.method,
        relabelings=outcome.relabelings,
        why=case.why,
        copy=int(copy),
        paired=int(case.contrast.paired),
        new=case.ours.name,
        reference=case.theirs.name,
        frames_new=case.ours.count,
        frames_reference=case.theirs.count,
        spp_new=case.ours.spp,
        spp_reference=case.theirs.spp,
        finest=finest.size,
        missing_new=case.ours.missing,
        missing_reference=case.theirs.missing,
        excluded=int((~valid).sum()),
        mean_difference=means[0] / means[1] - 1.0 if means[1] else None,
        noise_ratio=None if math.isnan(result.noise_ratio) else result.noise_ratio,
        trend=[list(each) for each in trend] or None,
        detectable_image=None if hidden else _number(seen),
        detectable_region=None if hidden else _number(region),
        notes=case.notes or None,
        seed=rng,
    )


def _name(test: Found) -> str:
    return f"{test.name} {test.size}" if test.size else test.name


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _region(tests: list[Found], shape: tuple[int, int]) -> float:
    """Return the smallest relative bias that is found in a square region of 1 % of the image.

    The region may lie anywhere. A region at least twice as wide as a tile covers a whole tile.
    A narrower region overlaps some tile in a square that is at least half as wide as the region.
    """
    half = 0.05 * math.sqrt(shape[0] * shape[1])
    known = [
        each.detectable / min(1.0, half / each.size) ** 2
        for each in tests
        if each.name in ("tiles", "pixels") and math.isfinite(each.detectable)
    ]
    return min(known, default=math.nan)
