"""A study to begin with: it runs as it is, and says in comments what else there is."""

from __future__ import annotations

from pathlib import Path

from mcspectra.core.errors import ConfigError

__all__ = ["TEMPLATE", "write_template"]

TEMPLATE = """\
# A study: estimators × samplers × analyses. Run it with
#   mcspectra run study.toml            results, figures and report.html in out/study
#   mcspectra run study.toml --dry-run  what it would take
#   mcspectra run study.toml --set convergence.realizations=100
# All keys: docs/studies.md, or the schema that `mcspectra schema` prints.
# Names of samplers, densities and integrands: mcspectra list samplers, ...

title = "my study"
seed = 1
samplers = ["random", "jittered", "jittered | shift"]

# Analyses of all estimators; a table inside an estimator replaces the one here.
[convergence]                  # variance against n and its rate
counts = [16, 64, 256]
realizations = 200
# relative_error = 0.1         # stop early, once the variance is known this well
# fit_last = "auto"            # fit the rate to those counts that lie on a line

[terms]                        # dc, power and cross term, predicted and measured
n = 64
half_width = 16
realizations = 200
# basis = "auto"               # fourier, cosine, walsh, haar, or what fits the sampler
# bands = "anova"              # radial, dyadic, anova, wedge

# [spectrum]                   # power spectrum of the points
# n = 64
# half_width = 32
# realizations = 50

# [pcf]                        # pair correlation of the points
# n = 64

# [anova]                      # which axes the variance comes from
# realizations = 1000

# [exact]                      # closed forms, where there are
# counts = [16, 64]

# [remedies]                   # what would lower the noise, measured and ranked
# budget = 64
# realizations = 200

[[estimators]]
name = "plain"
integrand = "gaussian(width=0.25)"
dims = 2

[[estimators]]
name = "importance-sampled"
integrand = "gaussian(width=0.25)"
dims = 2
density = "truncated-normal(mean=0.5, sigma=0.35)"

[[estimators]]
name = "multiple importance sampling"
integrand = "gaussian(width=0.25)"
dims = 2
densities = ["uniform", "truncated-normal(mean=0.5, sigma=0.35)"]
heuristic = "balance"          # power(beta=2), cutoff, maximum, optimal, variance-aware
# technique_counts = [1, 4]
# one_sample = true            # each point chooses its technique

# One estimator for each value; names get the values.
# [[estimators]]
# name = "step at {at}"
# integrand = "step(at={at})"
# dims = 1
# grid = { at = [0.25, 0.3] }
# mirror = "integrand"         # or "random", "uniform"
# smoothed = 0.05              # ramps in place of jumps

# Pixels and maps of scenes need the extra render: pip install 'mcspectra[render]'
# [[estimators]]
# name = "a pixel"
# integrand = "pixel(scene='veach', x=568, y=100, light='light-3', strategy='light')"

# [[maps]]
# name = "map of the penumbra"
# scene = "penumbra"
# samplers = ["jittered"]
# size = [32, 32]
"""


def write_template(path: str | Path) -> Path:
    """Write the template to a new file.

    Raises
    ------
    ConfigError
        The file is there already, or it cannot be written.
    """
    file = Path(path)
    if file.suffix != ".toml":
        raise ConfigError(f"{str(file)!r} must end in .toml, as study files do.")
    try:
        with file.open("x", encoding="utf-8") as stream:
            stream.write(TEMPLATE)
    except FileExistsError:
        raise ConfigError(f"{str(file)!r} is there already; give another name.") from None
    except OSError as error:
        raise ConfigError(f"{str(file)!r} cannot be written: {error.strerror}.") from None
    return file
