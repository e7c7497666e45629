"""Inversion along a Hilbert curve through the cells of a table.

Legend: `borders` (n+1,) is the cdf of the cells in the order of the curve, `order` (n,) their
flat indices, `headings` (n,) where the curve goes next: 0 +x_0, 1 −x_0, 2 +x_1, 3 −x_1. `guide` holds the
cell of each of 2^g equal shares, so that a search starts within a cell or two [ChenAsau1974]_.
"""

from __future__ import annotations

from mcspectra.core.checks import Array
from mcspectra.core.jit import kernel
from mcspectra.densities._kernels import below, cell_at, last_at_most

__all__ = ["follow", "places_on_curve", "return_along"]


@kernel
def _position(side: int, column: int, row: int) -> int:
    """Number of a cell along the curve through side × side cells, side a power of two.

    Quadrant by quadrant: each is entered after those before it, turned so that its curve fits.
    """
    found = 0
    step = side >> 1
    while step > 0:
        right, down = int(column & step > 0), int(row & step > 0)
        found += step * step * ((3 * right) ^ down)
        if down == 0:
            if right == 1:
                column, row = step - 1 - (column & (step - 1)), step - 1 - (row & (step - 1))
            column, row = row & (step - 1), column & (step - 1)
        step >>= 1
    return found


@kernel
def places_on_curve(side: int, height: int, width: int, places: Array, headings: Array) -> None:
    """Fill the curve's numbers (height · width,) of the cells and their headings.

    The heading is found by asking the four neighbors; the curve's last cell goes on as before.
    """
    last = side * side - 1
    for row in range(height):
        for column in range(width):
            k = row * width + column
            here = _position(side, column, row)
            places[k] = here
            step = 1 if here < last else -1
            for heading in range(4):
                x = column + (1 if heading == 0 else -1 if heading == 1 else 0)
                y = row + (1 if heading == 2 else -1 if heading == 3 else 0)
                inside = 0 <= x < side and 0 <= y < side
                if inside and _position(side, x, y) == here + step:
                    headings[k] = heading if step == 1 else heading ^ 1


@kernel
def _search(borders: Array, guide: Array, u: float) -> int:
    """k with borders[k] <= u < borders[k+1]; u · 2^g is exact, so the guide's bracket holds u."""
    g = int(u * (guide.size - 1))
    return last_at_most(borders, guide[g], guide[g + 1] + 1 - guide[g], u)


@kernel
def follow(
    borders: Array,
    guide: Array,
    order: Array,
    headings: Array,
    height: int,
    width: int,
    u: Array,
    x: Array,
) -> None:
    """Fill x (N, 2) from u (N, 2), in [0,1)."""
    for k in range(u.shape[0]):
        i = _search(borders, guide, u[k, 0])
        rest = (u[k, 0] - borders[i]) / (borders[i + 1] - borders[i])
        row, column = divmod(order[i], width)
        along = 1.0 - rest if headings[i] & 1 else rest
        a, b = (u[k, 1], along) if headings[i] & 2 else (along, u[k, 1])
        x[k, 0] = min((column + a) / width, below((column + 1) / width))
        x[k, 1] = min((row + b) / height, below((row + 1) / height))


@kernel
def return_along(
    borders: Array,
    places: Array,
    headings: Array,
    height: int,
    width: int,
    x: Array,
    u: Array,
) -> None:
    """Undo `follow`; `places` is the inverse of `order`."""
    for k in range(x.shape[0]):
        column, row = cell_at(x[k, 0], width), cell_at(x[k, 1], height)
        i = places[row * width + column]
        a = max(x[k, 0] * width - column, 0.0)
        b = max(x[k, 1] * height - row, 0.0)
        along, across = (b, a) if headings[i] & 2 else (a, b)
        rest = 1.0 - along if headings[i] & 1 else along
        u[k, 0] = borders[i] + rest * (borders[i + 1] - borders[i])
        u[k, 1] = across
