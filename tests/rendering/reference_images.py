"""Reference images with variances, and a z-test of other renders against them.

The idea is that of Mitsuba's regression tests: a pixel's difference from the reference is divided
by its standard error, which the variance of the reference gives. p-values of all pixels are
compared with a level that is corrected for their number [Sidak1967]_.
An image passes if nearly all pixels do.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from mcspectra.core.streams import Stream
from mcspectra.rendering.paths import Tracer
from mcspectra.rendering.plugin import register_samplers
from mcspectra.rendering.rendered import Film, RenderedPixels, chosen_tiles
from mcspectra.rendering.scenes import as_scene

LEVEL = 0.01  # of all pixels together
PASSING = 0.9975  # share of the pixels that must not differ
OURS = (
    {"type": "mcspectra"},
    {"type": "mcspectra", "spec": "sobol | owen"},
    {"type": "mcspectra", "spec": "sobol | owen", "joint_dims": 0},
    {"type": "mcspectra", "spec": "sobol | owen", "joint_dims": 8},
    {"type": "mcspectra", "spec": "halton | permute"},
    {"type": "mcspectra", "spec": "pmj02"},
)
BATCH = 256  # samples per pixel of one independent render of the reference


@dataclass(frozen=True)
class Reference:
    """Means of pixels by `count` independent samples each, and the variance of one sample."""

    mean: np.ndarray
    variance: np.ndarray
    count: int

    def p_values(self, mean, count, own=0.0):
        """p-value of each pixel of an image with `count` samples per pixel.

        A pixel whose variance `own` exceeds the variance of random samples is judged by `own`:
        points of a sampler may suit a pixel badly without a bias.
        """
        # Float32 sums of equal values differ by rounding
        floor = (1e-5 * np.abs(self.mean)) ** 2
        ours = np.maximum(self.variance / count, own)
        error = np.sqrt(ours + self.variance / self.count + floor)
        z = np.abs(mean - self.mean) / np.where(error > 0.0, error, 1.0)
        return 2.0 * ndtr(-z)

    def passes(self, mean, count, own=0.0):
        """Whether an image has no bias that the test sees, and the share of pixels that agree."""
        p = self.p_values(mean, count, own)
        single = -np.expm1(np.log1p(-LEVEL) / p.size)
        share = float((p > single).mean())
        return share >= PASSING, share


class Pixels:
    """All pixels of a scene, as Mitsuba renders them."""

    def __init__(self, scene, width, height):
        register_samplers()
        self.scene = as_scene(scene(width=width, height=height))
        film = Film.of(self.scene)
        self.tracer = Tracer(self.scene, "scene", "luminance", (width, height))
        self.rendered = RenderedPixels(self.tracer, film)
        self.tiles, self.side = chosen_tiles(film, width * height, Stream.from_rng(0))

    def renders(self, plugin, spp, renders, seed):
        """Luminance of independent renders, (renders, pixels), from a seed or a stream."""
        stream = seed if isinstance(seed, Stream) else Stream.from_rng(seed)
        return self.rendered.estimates(plugin, spp, self.tiles, self.side, renders, stream)

    def image(self, plugin, spp, renders, seed):
        """Mean of independent renders, and its estimated variance, each (pixels,)."""
        values = self.renders(plugin, spp, renders, seed)
        return values.mean(axis=0), values.var(axis=0, ddof=1) / renders

    def reference(self, spp, seed=1):
        """The reference by Mitsuba's independent sampler, in batches."""
        values = self.renders("independent", BATCH, spp // BATCH, seed)
        return Reference(values.mean(axis=0), BATCH * values.var(axis=0, ddof=1), spp)

    def scaled(self, factor, spp, seed):
        """Means of an image whose random numbers are all multiplied by a factor."""
        dims = len(self.tracer.dimensions(tuple(map(tuple, self.tiles.tolist()))))
        u = factor * np.random.default_rng(seed).random((1, spp, dims))
        return self.tracer.means(u, self.tiles)[0]
