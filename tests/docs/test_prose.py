"""The check of the prose: each pattern is found, plain sentences pass, and code is left out."""

import pytest
from tests import prose

AWKWARD = {
    "no subject": ["of the budget for the probes", "By them all together", "Beside the variance"],
    "what as a noun": [
        "The rest is made of what is left.",
        "What is rare was not met.",
        "Names and what is known of them",
    ],
    "from … on": ["The threshold from which on it matters", "Counts from 64 on are used"],
    "is none": ["The correction is none.", "Of the terms there are none"],
    "pointers": ["The rates of those of the others", "Means of those that remain"],
    "inverted": ["Predicted is the variance of f.", "Of the sets the first is the given one."],
    "as that of": ["The options are as those of `render`."],
    "so many": ["A sum of so many terms"],
    "false friend": [
        "The error is held against the bound.",
        "It is surely less.",
        "The others are removed, too.",
        "A table beside the picture",
    ],
    "talking code": ["Nets see what g does.", "The result says how many were drawn."],
}

PLAIN = [
    "Fraction of the budget spent on line probes",
    "Return the covariance of the coefficients.",
    "What does the cross term change?",
    "For smooth integrands the variance falls as 1/n².",
    "The error is small if n is large.",
    "In 1-D, a shift costs half of the rate",
    "The message says that the file is missing.",
    "There are as many realizations as seeds.",
]


@pytest.mark.parametrize("name", prose.PATTERNS)
def test_each_pattern_is_found(name):
    for sentence in AWKWARD[name]:
        assert name in prose.hits(sentence), sentence


@pytest.mark.parametrize("sentence", PLAIN)
def test_plain_sentences_pass(sentence):
    assert prose.hits(sentence) == []


def test_sentences_of_python_are_comments_and_docstrings(tmp_path):
    path = tmp_path / "one.py"
    path.write_text(
        '"""A module of examples.\n\nIt has\ntwo sentences. This is one.\n"""\n'
        "x = 'a string that is no docstring'  # one comment per line\n"
        "# A comment of\n# two lines\n# noqa: E501\n",
        encoding="utf-8",
    )
    assert {each.text for each in prose.sentences(path)} == {
        "A module of examples.",
        "It has two sentences.",
        "This is one.",
        "one comment per line A comment of two lines",
    }


def test_sentences_of_markdown_are_paragraphs_and_items(tmp_path):
    path = tmp_path / "one.md"
    path.write_text(
        "---\nfile_format: mystnb\n---\n# A heading of words\n\nThe first\nparagraph has `code`.\n"
        "```python\n>>> code of what is left\n```\n\n* An item with [a link](what.md) here.\n"
        "  It goes on.\n\n| a | table of words |\n",
        encoding="utf-8",
    )
    assert [each.text for each in prose.sentences(path)] == [
        "The first paragraph has X.",
        "An item with a link here.",
        "It goes on.",
    ]


def test_a_share_above_the_limit_fails(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(prose, "ROOT", tmp_path)
    plain, bad = "The error is small.\n\n" * 98, "Nets see what g does.\n\n"
    (tmp_path / "README.md").write_text(plain + bad, encoding="utf-8")
    assert prose.main(["README.md"]) == 0
    assert "README.md:197: [talking code] Nets see what g does." in capsys.readouterr().out
    (tmp_path / "README.md").write_text(plain + 8 * bad, encoding="utf-8")
    assert prose.main(["README.md"]) == 1
    assert "above the limit" in capsys.readouterr().out
