"""Make the page of samplers: an overview by family with thumbnails, then a card for each sampler.

Run ``python docs/samplers/make.py`` from the root of the repository.
The script takes minutes, because it measures all samplers.
With the option ``--overview`` it makes the overview only, from pictures of existing cards.
"""

import re
import sys
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt

from mcspectra.report.sampler_cards import QUICK, write_cards

FOLDER = Path(__file__).parent
END = "<!-- end of the overview -->\n\n"

# Title, description and members of each family; a test checks that each sampler occurs once
FAMILIES = """\
Random and stratified
  These points are independent, or lie in the cells of a grid. With one random point in each square
  cell, the variance of smooth integrands in d dims falls as n^(−1−2/d).
  * random
  * jittered
  * multi-jittered
  * correlated-multi-jittered
  * antithetic-jittered
  * uniform-jitter
  * box-jitter
  * gaussian-jitter
  * regular
  * hexagonal

Latin hypercubes and orthogonal arrays
  These points are stratified along each axis or each pair of axes, in any number of dims.
  * latin-hypercube
  * latin-hypercube(strength=2)
  * n-rooks
  * orthogonal-array

Digital nets and sequences
  These points are balanced in elementary intervals. With Owen scrambling the variance of smooth
  integrands falls as about n^−3.
  * sobol
  * sobol | owen
  * sobol | owen(method='hash')
  * sobol | lms
  * niederreiter
  * faure
  * larcher-pillichshammer
  * halton
  * halton | owen
  * halton | permute
  * hammersley
  * van-der-corput

Progressive sets
  Every prefix of the set is well stratified.
  * pmj
  * pmj02
  * pmj02-blue-noise

Lattices
  A lattice is a regular pattern on the torus. It suits periodic or folded integrands.
  * rank1-lattice
  * rank1-lattice | shift | mirror(mode='fold')
  * korobov
  * fibonacci
  * kronecker

Poisson disks and candidates
  These are random points that keep a distance from each other.
  * dart-throwing
  * poisson-disk
  * poisson-disk(boundary='bounded')
  * best-candidate

Optimized blue noise
  These points are moved until they are evenly spread.
  * lloyd
  * farthest-point
  * bnot
  * gaussian-blue-noise
  * projective-blue-noise
  * sliced-optimal-transport
  * ldbn
  * void-and-cluster

Prescribed spectra and hyperuniform sets
  These points have a given power spectrum or pair correlation, or little power at low
  frequencies.
  * step-blue-noise
  * target-spectrum
  * target-pcf
  * stealthy-hyperuniform
  * perturbed-lattice
  * determinantal
"""


def overview(page: str) -> str:
    """Return the overview as Markdown, with links to the sections of a page of cards."""
    pictures = _pictures(page)
    lines = [
        "This page shows all samplers: first an overview by family, then one card for each sampler",
        "with its points, spectrum, rates, quality and speed. Click a thumbnail to see its card.",
        "",
    ]
    for family in FAMILIES.strip().split("\n\n"):
        title, *rest = family.splitlines()
        text = " ".join(line.strip() for line in rest if not line.startswith("  * "))
        lines += [f"**{title}.** {text}", ""]
        for name in (line[4:] for line in rest if line.startswith("  * ")):
            thumbnail = f"thumbnails/{pictures[name]}"
            lines.append(f"[![Points and spectrum of {name}]({thumbnail})](#{anchor(name)})")
        lines.append("")
    lines += [
        "Each thumbnail shows about 256 points, and to the right n · power (dark where it is low).",
        "",
        END,
    ]
    return "\n".join(lines)


def anchor(name: str) -> str:
    """Return the anchor of a card's heading, as GitHub and MyST make it."""
    return re.sub(r"[^\w\- ]", "", name.lower()).strip().replace(" ", "-")


def draw_thumbnails(page: str) -> None:
    """Cut the points and the spectrum out of each card's picture, and add the name."""
    folder = FOLDER / "thumbnails"
    folder.mkdir(exist_ok=True)
    mpl.rcParams.update({"font.size": 8, "figure.dpi": 100})
    for name, picture in _pictures(page).items():
        card = plt.imread(FOLDER / picture)
        figure = plt.figure(figsize=(1.85, 1.12))
        for k, (left, right) in enumerate(((31, 259), (319, 546))):
            axes = figure.add_axes((0.01 + 0.5 * k, 0.01, 0.48, 0.8))
            axes.imshow(card[26:254, left:right])
            axes.axis("off")
        size = 8 if len(name) < 26 else 6 if len(name) < 34 else 5
        figure.text(0.5, 0.97, name, ha="center", va="top", fontsize=size)
        figure.savefig(folder / picture)
        plt.close(figure)


def _pictures(page: str) -> dict[str, str]:
    """File names of the pictures of all cards, by sampler."""
    return dict(re.findall(r"^## `(.+?)`\n.*?\]\((.+?\.png)\)", page, re.MULTILINE | re.DOTALL))


def main(arguments: list[str]) -> None:
    """Write the page; measure the cards first unless ``--overview`` is given."""
    if "--overview" not in arguments:
        write_cards(FOLDER, effort=QUICK)
    path = FOLDER / "index.md"
    page = path.read_text(encoding="utf-8").replace("# Samplers\n\n", "", 1)
    page = page.partition(END)[2] or page
    draw_thumbnails(page)
    path.write_text(f"# Samplers\n\n{overview(page)}{page}", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
