"""Rates at a pixel of Veach's scene: diffuse wall, widest light, jittered points."""

from __future__ import annotations

import mcspectra as mcs

COUNTS = (4, 16, 64, 256, 1024, 4096)
WALL = "pixel(scene='veach', x=568, y=100, light='light-3', strategy='{}')"


def main() -> None:
    """Print for each strategy the rate over the last four counts, its interval and the mean."""
    estimators = {
        "light": mcs.Estimator(WALL.format("light")),
        "BSDF": mcs.Estimator(WALL.format("bsdf")),
        "MIS": mcs.estimators.TechniqueSum([WALL.format("mis-light"), WALL.format("mis-bsdf")]),
    }
    for name, estimator in estimators.items():
        for sampler in ("jittered", "sobol | owen"):
            d = mcs.convergence(estimator, sampler, COUNTS, realizations=500, rng=1, fit_last=4)
            low, high = d["rate_ci"].values
            mean, se = float(d["mean"][-1]), float(d["mean_se"][-1])
            print(
                f"{name:6s} {sampler:13s} rate {float(d['rate']):+.3f} ({low:+.3f} … {high:+.3f})  "
                f"mean {mean:.6f} ± {se:.1e}"
            )


if __name__ == "__main__":
    main()
