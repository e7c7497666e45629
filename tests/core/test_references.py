"""Cited works: docstrings cite existing works, entries are complete, and texts show them."""

import re
from pathlib import Path

import pytest
import yaml

import mcspectra
from mcspectra.core.references import ADDRESS, FILE, address, entries, works, written_out
from mcspectra.version import __version__

PLACES = {"journal", "booktitle", "publisher", "school", "note", "eprint", "url"}


def test_docstrings_cite_works_that_exist():
    files = Path(mcspectra.__file__).parent.rglob("*.py")
    cited = {key for path in files for key in re.findall(r"\[(\w+)\]_", path.read_text("utf-8"))}
    assert len(cited) > 100
    assert cited <= set(works())


def test_every_entry_is_read_whole():
    source = FILE.read_text(encoding="utf-8")
    keys = re.findall(r"^@\w+\{([^,]+),", source, re.MULTILINE)
    assert sorted(works()) == sorted(keys)
    assert len(set(keys)) == len(keys)
    names = re.findall(r"^\s*(\w+) *=", source, re.MULTILINE)
    # no entry is lost, and no field appears twice
    assert sum(map(len, works().values())) == len(names)


@pytest.mark.parametrize("key", works())
def test_entries_are_well_formed(key):
    fields = works()[key]
    assert fields["title"]
    assert not re.search(r"[{}\\]", " ".join(fields.values()))
    assert re.fullmatch(r"(1[89]|20)\d\d", fields["year"])
    assert key.endswith(fields["year"])
    assert all(re.fullmatch(r"[^,]+(, [^,]+)?", name) for name in fields["author"].split(" and "))
    assert PLACES & set(fields)
    assert re.fullmatch(r"10\.\d{4,}/[^\s,;]+[^\s.,:;]", fields.get("doi", "10.1000/none"))
    assert not address(fields) or ADDRESS.fullmatch(address(fields))


def test_dois_stand_once():
    dois = [fields["doi"].lower() for fields in works().values() if "doi" in fields]
    assert len(set(dois)) == len(dois)


def test_accents_are_letters():
    source = r"""@article{A2000,
  title = {{\"U}ber {PCM} -- two},
  author = {Sk{\v r}ivan, Ond{\v{r}}ej and M{\o}ller, J{\'i}},
}
"""
    plain = {"title": "Über PCM – two", "author": "Skřivan, Ondřej and Møller, Jí"}
    assert entries(source) == {"A2000": plain}


def test_texts_show_works():
    text = "[Haber1966]_, [Chiu1994]_,\n[Singh2019]_, section 4. [Nosuch1900]_"
    assert written_out(text) == (
        "Haber (1966), A Modified Monte-Carlo Quadrature, "
        "https://doi.org/10.1090/S0025-5718-1966-0210285-0; "
        "Chiu et al. (1994), Multi-Jittered Sampling; "
        "Singh et al. (2019), Fourier Analysis of Correlated Monte Carlo Importance Sampling, "
        "https://doi.org/10.1111/cgf.13613, section 4. [Nosuch1900]"
    )


def test_the_citation_file_names_this_version_and_the_paper():
    root = Path(__file__).parents[2]
    cited = yaml.safe_load((root / "CITATION.cff").read_text("utf-8"))
    assert cited["version"] == __version__
    (paper,) = cited["references"]
    fields = works()["Singh2019"]
    assert paper["doi"] == fields["doi"] == "10.1111/cgf.13613"
    assert (paper["title"], str(paper["year"])) == (fields["title"], fields["year"])
    names = [f"{a['family-names']}, {a['given-names']}" for a in paper["authors"]]
    assert " and ".join(names) == fields["author"]
