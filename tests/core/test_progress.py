"""Progress: the innermost listener hears it, from any thread."""

from concurrent.futures import ThreadPoolExecutor

from mcspectra.core.progress import listening, report


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


def test_reports_of_threads_are_heard():
    heard = []
    with listening(lambda *what: heard.append(what)), ThreadPoolExecutor(2) as pool:
        list(pool.map(lambda k: report(str(k), 0.0), range(8)))
    assert sorted(heard) == [(str(k), 0.0) for k in range(8)]
