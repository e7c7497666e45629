"""Colors and labels."""

from mcspectra.plots.style import DASHES, PALETTE, labels, line_widths, sampler_styles


def test_sampler_styles__distinct_per_name():
    names = [f"s{i}" for i in range(len(PALETTE) * len(DASHES))]
    styles = sampler_styles([*names, "s0"])
    assert list(styles) == names
    assert len(set(styles.values())) == len(names)
    assert len({s.color for s in list(styles.values())[: len(PALETTE)]}) == len(PALETTE)


def test_sampler_styles__more_names_than_styles_repeat():
    assert len(sampler_styles([f"s{i}" for i in range(60)])) == 60


def test_labels__short_and_distinct():
    names = ["sobol(" + "x" * 60 + f"{i}" + "y" * 60 + ")" for i in range(3)]
    made = labels([*names, "$a$"], 20)
    assert len(set(made.values())) == 4
    assert all(len(text) <= 20 for text in made.values())
    assert made["$a$"] == "$a$"


def test_line_widths__the_first_line_is_visible_below_the_last():
    widths = line_widths(3)
    assert widths == sorted(widths, reverse=True)
    assert len(line_widths(0)) == 0
