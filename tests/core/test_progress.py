"""Progress: the innermost listener receives it from any thread; bars appear in interactive use."""

import re
import sys
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import pytest

import mcspectra as mcs
from mcspectra.core import progress
from mcspectra.core.errors import ParameterError
from mcspectra.core.progress import ProgressBars, listening, progress_bars, report
from mcspectra.samplers import as_sampler


def test_reports_reach_the_innermost_listener():
    outer, inner = [], []
    report("nobody listens", 0.5)
    with listening(lambda *heard: outer.append(heard)):
        with listening(lambda *heard: inner.append(heard)):
            report("inside", 0.25)
        report("outside", 1.0)
    report("nobody listens", 1.0)
    assert inner == [("inside", 0.25)]
    assert outer == [("outside", 1.0)]


def test_reports_of_threads_reach_the_listener():
    heard = []
    with listening(lambda *what: heard.append(what)), ThreadPoolExecutor(2) as pool:
        list(pool.map(lambda k: report(str(k), 0.0), range(8)))
    assert sorted(heard) == [(str(k), 0.0) for k in range(8)]


@pytest.fixture
def clock(monkeypatch):
    """Seconds that pass only when the test advances them."""
    now = [100.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(progress, "_automatic", ProgressBars())
    monkeypatch.setenv("COLUMNS", "100")

    def wait(seconds):
        now[0] += seconds

    return wait


@pytest.fixture
def terminal(monkeypatch):
    """Standard error is a terminal."""
    monkeypatch.setattr(progress, "_somebody_waits", lambda: True)


def _seen(capsys):
    """Return the text on standard error, without codes of colors and positions."""
    return re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", capsys.readouterr().err)


@pytest.mark.parametrize("closes", [True, False])
def test_short_work_draws_nothing(closes, clock, terminal, capsys):
    bars = ProgressBars(closes=closes)
    for fraction in (0.0, 0.5, 1.0):
        bars("quick", fraction)
        clock(0.2)
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("closes", [True, False])
def test_long_work_draws_a_bar_and_wipes_it(closes, clock, terminal, capsys):
    bars = ProgressBars(closes=closes)
    bars("long", 0.0)
    clock(1.0)
    bars("long", 0.25)
    assert re.fullmatch(r"(\rlong ━+╺?━+ +25% \S+ *|long ━+╺?━+ +25% \S+ *)+", _seen(capsys))
    bars("long", 1.0)
    assert "long" not in _seen(capsys)
    bars("long", 1.0)
    assert _seen(capsys) == ""


def test_a_bar_is_drawn_ten_times_a_second_at_most(clock, terminal, capsys):
    bars = ProgressBars()
    bars("long", 0.0)
    clock(1.0)
    for k in range(1000):
        bars("long", k / 1000)
        clock(0.001)
    assert 9 <= _seen(capsys).count("long") <= 11


def test_work_inside_work_shows_both(clock, terminal, capsys):
    bars = ProgressBars()
    bars("outer", 0.5)
    bars("inner", 0.0)
    clock(1.0)
    bars("inner", 0.75)
    line = _seen(capsys)
    assert line.index("outer") < line.index("50%") < line.index("inner") < line.index("75%")
    bars("outer", 1.0)
    clock(1.0)
    bars("inner", 0.8)
    line = _seen(capsys)
    assert "outer" not in line
    assert "inner" in line


def test_abandoned_work_is_dropped(clock, terminal, capsys):
    bars = ProgressBars()
    bars("given up", 0.5)
    clock(40.0)
    bars("next", 0.0)
    clock(1.0)
    bars("next", 0.5)
    assert "given up" not in _seen(capsys)


def test_silent_work_inside_a_block_is_kept(clock, terminal, capsys):
    with progress_bars():
        report("study", 0.0)
        clock(400.0)
        report("study", 0.5)
        assert "study" in _seen(capsys)
        print("a warning", file=sys.stderr)
    assert "a warning\n" in _seen(capsys)
    report("study", 0.6)
    assert sys.stderr.__class__.__name__ != "FileProxy"


def test_an_exception_ends_the_bars_of_a_block(clock, terminal, capsys):
    before = sys.stderr

    def fails():
        report("study", 0.0)
        clock(1.0)
        report("study", 0.5)
        assert sys.stderr is not before  # other output appears above the bar
        raise ValueError("it")

    with pytest.raises(ValueError, match="it"), progress_bars():
        fails()
    assert sys.stderr is before


def test_without_a_terminal_a_line_is_printed_every_ten_seconds(clock, capsys):
    with progress_bars():
        for k in range(100):
            report("study", k / 100)
            clock(0.5)
        report("study", 1.0)
    lines = capsys.readouterr().err.splitlines()
    assert lines == [f"mcspectra: study {k}%" for k in (21, 42, 63, 84)]


def test_names_are_not_read_as_markup(clock, terminal, capsys):
    bars = ProgressBars()
    bars("a[red]b", 0.0)
    clock(1.0)
    bars("a[red]b", 0.5)
    assert "a[red]b" in _seen(capsys)


@pytest.mark.parametrize("closes", [True, False])
def test_fractions_out_of_range_and_a_missing_stream_do_no_harm(closes, clock, monkeypatch):
    bars = ProgressBars(closes=closes)
    bars("odd", -3.0)
    clock(1.0)
    bars("odd", 0.5)
    clock(1.0)
    monkeypatch.setattr(sys, "stderr", None)
    bars("odd", 0.9)
    bars("odd", 7.0)
    bars.close()


def test_bars_appear_automatically_in_interactive_use(clock, capsys, monkeypatch):
    report("script", 0.0)
    clock(1.0)
    report("script", 0.5)
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(sys, "ps1", ">>> ", raising=False)
    report("prompt", 0.0)
    clock(1.0)
    report("prompt", 0.5)
    assert "prompt" in capsys.readouterr().err
    with progress_bars(False):
        clock(1.0)
        report("prompt", 0.6)
        report("prompt", 1.0)
    assert capsys.readouterr().err == ""
    report("prompt", 1.0)


@pytest.mark.parametrize("running", [True, False])
def test_notebooks_are_recognized(running, clock, capsys, monkeypatch):
    shell = SimpleNamespace(get_ipython=lambda: object() if running else None)
    monkeypatch.setitem(sys.modules, "IPython", shell)
    report("cell", 0.0)
    clock(1.0)
    report("cell", 0.5)
    report("cell", 1.0)
    assert ("cell" in capsys.readouterr().err) is running


@pytest.mark.parametrize("shown", [None, 1, "yes"])
def test_shown_is_true_or_false(shown):
    with pytest.raises(ParameterError, match="give True, or False"):
        progress_bars(shown)


ANALYSES = {
    "convergence": lambda: mcs.convergence("disk", "jittered", [16, 64], realizations=9),
    "variance_terms": lambda: mcs.variance_terms("disk", "jittered", 16, half_width=2),
    "power_spectrum": lambda: mcs.power_spectrum("jittered", 16, half_width=2),
    "pair_correlation": lambda: mcs.pair_correlation("jittered", 16, realizations=9),
    "remedies": lambda: mcs.remedies("disk", "jittered", 64, realizations=100, kinds=["sampler"]),
}


@pytest.mark.parametrize("what", ANALYSES)
def test_analyses_report_from_little_to_all(what):
    heard = []
    with listening(lambda *each: heard.append(each)):
        ANALYSES[what]()
    fractions = [fraction for name, fraction in heard if name == what]
    assert fractions == sorted(fractions)
    assert fractions[0] < 1.0 == fractions[-1] or len(fractions) == 1
    assert fractions[-1] == 1.0


def test_a_sampler_that_takes_long_reports_its_progress(monkeypatch):
    monkeypatch.setattr("mcspectra.samplers.optimised.cached_array", lambda _, make: make())
    heard = []
    with listening(lambda *each: heard.append(each)):
        as_sampler("bnot(iterations=6, tolerance=0.0)", 2).draw(30, realizations=1, rng=7)
    assert {what for what, _ in heard} == {"bnot, 30 points, set 0"}
    fractions = [fraction for _, fraction in heard]
    assert fractions == sorted(fractions)
    assert len(set(fractions)) == 7  # one for each of six moves, and the end


def test_the_bar_of_a_convergence_covers_all_its_counts():
    heard = []
    with listening(lambda *each: heard.append(each)):
        mcs.convergence("disk", "jittered", [16, 64, 256], realizations=9)
    # work is proportional to n: 16, 80 and 336 of 336
    ends = {round(336 * fraction) for _, fraction in heard}
    assert ends >= {16, 80, 336}
