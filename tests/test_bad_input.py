"""Every row of the table of bad input gives its message in every interface, without a traceback."""

import pytest

from tests.bad_input import GIVEN, HEAD, ROWS, TABLE, answer, line
from tests.processes import python

LINES = TABLE.read_text(encoding="utf-8").splitlines()


@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{row.door}: {row.given[-60:]!r}")
def test_bad_input_raises_one_sentence(row, tmp_path):
    code, text = answer(row, tmp_path)
    assert row.words in text, text
    assert line(row, code, text) in LINES, "the table is current"
    assert "Traceback" not in text
    assert "Unexpected" not in text
    if row.door != "python":
        assert code == "2"
        left = {path.name for path in tmp_path.iterdir()}
        assert left <= GIVEN, "what is refused leaves nothing behind"
    if row.given:
        assert len(text.splitlines()) == 1, "one sentence"
        assert len(text) < 400


def test_the_table_has_a_line_for_each_row():
    assert LINES[: len(HEAD)] == HEAD
    assert len(LINES) == len(HEAD) + len(ROWS) > 30


def test_a_real_process_answers_the_same():
    """The exit code and the message of the installed command, not of a call."""
    done = python("-m", "mcspectra", "points", "jittered", "-n", "250")
    assert done.returncode == 2
    assert "225 and 256" in done.stderr
    assert "Traceback" not in done.stderr
    assert done.stdout == ""
