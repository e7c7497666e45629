"""How to cite the package, the paper it implements and the methods it uses (BibTeX)."""

from __future__ import annotations

import argparse

from mcspectra.cli.common import Answer
from mcspectra.version import __version__

__all__ = ["add_arguments", "run"]

REFERENCES = {
    "mcspectra": f"""@software{{mcspectra,
  title   = {{mcspectra: a profiler for Monte Carlo noise}},
  author  = {{{{The mcspectra authors}}}},
  version = {{{__version__}}},
  year    = {{2026}}
}}""",
    "the three terms under importance sampling": """@article{Singh2019,
  title   = {Fourier Analysis of Correlated Monte Carlo Importance Sampling},
  author  = {Singh, Gurprit and Subr, Kartic and Coeurjolly, David and Ostromoukhov, Victor and
             Jarosz, Wojciech},
  journal = {Computer Graphics Forum},
  year    = {2019},
  doi     = {10.1111/cgf.13613}
}""",
    "non-uniform FFT": """@article{Barnett2019,
  title   = {A Parallel Nonuniform Fast Fourier Transform Library Based on an ``Exponential of
             Semicircle'' Kernel},
  author  = {Barnett, Alexander H. and Magland, Jeremy and af Klinteberg, Ludvig},
  journal = {SIAM Journal on Scientific Computing},
  volume  = {41},
  number  = {5},
  pages   = {C479--C504},
  year    = {2019},
  doi     = {10.1137/18M120885X}
}""",
    "multiple importance sampling": """@inproceedings{VeachGuibas1995,
  title     = {Optimally Combining Sampling Techniques for {Monte Carlo} Rendering},
  author    = {Veach, Eric and Guibas, Leonidas J.},
  booktitle = {Proceedings of SIGGRAPH 95},
  pages     = {419--428},
  year      = {1995},
  doi       = {10.1145/218380.218498}
}""",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb has no options of its own."""


def run(options: argparse.Namespace) -> Answer:  # noqa: ARG001
    """Give the references."""
    listed = [{"for": what, "bibtex": entry} for what, entry in REFERENCES.items()]
    return Answer("\n\n".join(f"% {what}\n{entry}" for what, entry in REFERENCES.items()), listed)
