"""Cards of samplers: measurements, pages and files."""

import json
import re
import sys
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import McspectraError, ParameterError, StoreError
from mcspectra.report.sampler_cards import QUICK, all_samplers, measure_card, write_cards
from mcspectra.samplers import SAMPLERS

TINY = replace(QUICK, n=16, spectra=6, rates=40, counts=(4, 16, 64))
PNG = b"\x89PNG\r\n\x1a\n"


def test_a_card_agrees_with_the_analyses():
    card = measure_card("jittered", effort=TINY, rng=3)
    assert card.n == 16
    np.testing.assert_array_equal(card.points, mcs.sampler("jittered").draw(16, rng=3)[0])
    spectrum = mcs.power_spectrum("jittered", 16, half_width=8, realizations=6, rng=3)
    np.testing.assert_array_equal(card.spectrum["power"], spectrum["power"])
    curve = mcs.convergence(mcs.Estimator("disk"), "jittered", [4, 16, 64], realizations=40, rng=3)
    assert card.rates["disk"] == (float(curve["rate"]), *curve["rate_ci"].values.tolist())
    assert card.projected.shape == (16, 2)
    assert card.speed > 0


def test_deterministic_sets_are_randomized_for_their_rates():
    net, lattice = (measure_card(s, effort=TINY) for s in ("sobol", "rank1-lattice"))
    assert (net.randomized, lattice.randomized) == ("sobol | owen", "rank1-lattice | shift")
    assert net.spectrum.attrs["realizations"] == 1
    assert net.rates["gaussian"][0] < -1.5


def test_given_points_have_a_card(tmp_path):
    sets = np.random.default_rng(1).random((3, 20, 2))
    np.savez(tmp_path / "mine.npz", points=sets)
    card = measure_card(f"points(path='{(tmp_path / 'mine.npz').as_posix()}')", effort=TINY)
    assert card.n == 20
    assert card.spectrum.attrs["realizations"] == 3
    assert card.rates == {}  # one count has no rate


def test_all_samplers_need_no_parameters_or_packages():
    heads = {spec.partition("|")[0].partition("(")[0].strip() for spec in all_samplers()}
    outside = {"command", "points", "python", "scipy", "qmcpy", "mitsuba", "digital-net"}
    assert heads == set(SAMPLERS) - outside - {"shared-cells"}
    assert "van-der-corput" not in all_samplers([2])
    assert "multi-jittered" not in all_samplers([3])


class Reader(HTMLParser):
    """Collect anchors, links and resources that the page would load."""

    def __init__(self):
        super().__init__()
        self.ids, self.links, self.loaded = set(), set(), []

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.ids.add(given.get("id"))
        if tag == "a":
            self.links.add(given["href"])
        self.loaded += [given[k] for k in ("src", "srcset", "data") if given.get(k)]


def test_the_page_is_self_contained(bench_page):
    text = bench_page.read_text(encoding="utf-8")
    reader = Reader()
    reader.feed(text)
    assert bench_page.name == "index.html"
    inside = {link for link in reader.links if not link.startswith("https://doi.org/")}
    assert {link.removeprefix("#") for link in inside} <= reader.ids
    assert (
        len(reader.loaded) == 2 + 7
    )  # cards; convergence, 4 of spectra and pairs, quality, points
    assert text.count("<table") == 2
    assert "Rate on gaussian" not in text  # the bench has rates
    assert (bench_page.parent / "bench.csv").stat().st_size > 1000
    assert all(source.startswith("data:image/png;base64,") for source in reader.loaded)
    assert not re.search(r"url\(|@import|<script src|<link", text)
    assert "sobol | owen" in text
    assert "Joe and Kuo (2008)" in text
    assert "https://doi.org/10.1137/070709359" in reader.links


def test_markdown_has_an_image_and_facts_for_each_sampler(tmp_path):
    page = write_cards(tmp_path, ["random", "halton"], effort=TINY)
    text = page.read_text(encoding="utf-8")
    for name in re.findall(r"\]\((.*?\.png)\)", text):
        assert (tmp_path / name).read_bytes().startswith(PNG)
    assert text.count("## `") == text.count(".png)") == 2
    assert "* Rate on gaussian (randomized by owen(base=[2, 3])): −" in text
    assert "* Counts: any" in text


def test_numbers_are_written_as_json(tmp_path):
    write_cards(tmp_path, ["random"], effort=TINY)
    (card,) = json.loads((tmp_path / "gallery.json").read_text(encoding="utf-8"))
    assert card["name"] == card["spec"] == card["randomized"] == "random"
    assert len(card["rates"]["disk"]) == 3
    assert card["facts"]["dims"] == "any"


@pytest.mark.parametrize("specs", [["nothing"], ["sobol(x=1)"], ["points"], ["random |"]])
def test_samplers_that_cannot_be_made_write_nothing(tmp_path, specs):
    with pytest.raises(McspectraError):
        write_cards(tmp_path / "out", specs, effort=TINY)
    assert not (tmp_path / "out").exists()


def test_an_empty_list_of_samplers_gives_an_error():
    with pytest.raises(ParameterError, match="give at least one"):
        write_cards("unused", [])


def test_a_folder_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("here")
    with pytest.raises(StoreError, match="cannot be written"):
        write_cards(tmp_path / "file", ["random"], effort=TINY)


def test_a_program_with_two_dims_has_a_card(tmp_path):
    program = tmp_path / "mine.py"
    program.write_text(
        "import sys\n"
        "n = int(sys.argv[1])\n"
        "for k in range(n):\n"
        "    print((k + 0.5) / n, (k * 0.618033988749895) % 1.0)\n"
    )
    run = f"{sys.executable} {program} {{n}}"
    mcs.samplers.allow_code(run)
    card = measure_card(f"command({run!r}, name='mine')", effort=TINY)
    assert card.projected is None  # the program always prints two coordinates
    assert card.randomized.endswith("| shift")
    assert card.speed > 0
    assert card.points[0].tolist() == [0.5 / card.n, 0.0]
