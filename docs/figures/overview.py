"""Draw overview.png, the picture of the README: a function with points, and its variance against n.

Run the script from the root of the repository: ``python docs/figures/overview.py``.
"""

from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np

import mcspectra as mcs

f = mcs.integrand("formula(expression='exp(-x**2) * (x + y < 0.8)')", dims=2)
samplers = ["random", "latin-hypercube", "jittered", "sobol | owen"]
curve = mcs.convergence(f, samplers, [16, 64, 256, 1024, 4096], realizations=400)

mpl.rcParams.update({"font.size": 10, "figure.dpi": 110})
figure, (left, right) = plt.subplots(1, 2, figsize=(9.2, 3.9), width_ratios=(1, 1.45))

# The function in gray, with 64 points of the best sampler
middles = (np.arange(256) + 0.5) / 256
values = f(np.stack(np.meshgrid(middles, middles), axis=-1))
left.imshow(values, origin="lower", extent=(0, 1, 0, 1), cmap="gray", vmin=-0.4, vmax=1.1)
points = mcs.sampler("sobol | owen", dims=2).draw(64, rng=3)[0]
left.plot(*points.T, "o", ms=4.5, color="#0072B2", mec="white", mew=0.6)
left.set(title="f(x, y), and 64 points of sobol | owen", xlabel="x", ylabel="y")
left.set(xticks=[0, 0.5, 1], yticks=[0, 0.5, 1])

curve.mcspectra.plot(axes=right)
right.set_title("measured variance, and fitted exponents of n")
figure.tight_layout()
figure.savefig(Path(__file__).with_suffix(".png"))
