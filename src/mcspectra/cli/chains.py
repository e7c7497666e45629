"""The verb of Markov chains: files of draws, what their means are worth, and why."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.cli.common import Answer, option, verb
from mcspectra.cli.texts import data_of, table_of_anything
from mcspectra.core.errors import (
    FileFormatError,
    MissingDependency,
    UnknownName,
    close_match_hint,
    reason_of,
)
from mcspectra.core.registry import optional_package

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["chains_"]


@verb(
    option("FILE", "draws: .npy, .csv, .nc or .zarr", dest="files", nargs="+"),
    option("--weights NAME", "column or variable of the weights, or a .npy file of them"),
    option("-o, --out FILE", "figure: .png, .svg, .pdf, .pgf; .csv, .tex: its curve; .npz; .html"),
)
def chains_(options: argparse.Namespace) -> Answer:
    """Error of the means of Markov chains, the frequencies that it comes from, and what is wrong.

    A .npy file holds one chain (n,), or (chain, draw), or (chain, draw, quantity). A .csv file has a
    column for each quantity, a row for each draw, and names in the first line; chains are files of
    their own, as Stan writes them, or told apart by a column 'chain'. A .nc or .zarr store has the
    dims chain and draw, itself or in its group posterior, as ArviZ writes it.
    """
    from mcspectra.report.result_files import check_result_file, write_result_file
    from mcspectra.variance.chains import chain_error

    check_result_file(options.out)

    # Read the draws, files of one chain each side by side, and take the weights out of them
    found = [_draws(file) for file in options.files]
    draws, weights, named = found[0], None, options.weights
    if len(found) > 1:
        import xarray as xr

        arrays = all(isinstance(each, np.ndarray) and each.ndim == 1 for each in found)
        tables = all(isinstance(each, xr.Dataset) and "chain" not in each.dims for each in found)
        held = {x.shape if arrays else (*x, *x.sizes.values()) for x in found if arrays or tables}
        if len(held) != 1:
            raise FileFormatError(
                f"The {len(found)} files do not hold one chain each, of the same length and quantities; "
                "give files that do, or one file of all."
            )
        draws = np.stack(found) if arrays else xr.concat(found, "chain")
    if named is not None and named.endswith(".npy"):
        weights = _draws(named)
    elif named is not None:
        known = list(map(str, getattr(draws, "data_vars", ())))
        if named not in known:
            hint, close = close_match_hint(named, known)
            raise UnknownName(f"The draws have no column {named!r}.{hint if known else ''}", close)
        weights, draws = draws[named].values, draws.drop_vars(named)

    result = chain_error(draws, weights=weights)
    if options.out:
        write_result_file(result, options.out, "mcspectra chains")
    several = "quantity" in result.dims
    shown = result.drop_dims("band") if several else result
    names, said = (np.atleast_1d(result[key].values) for key in ("cause", "evidence"))
    lines = [f"{result.attrs['chains']} × {result.attrs['draws']} draws"]
    lines.append(table_of_anything(shown).text)
    for k, name in enumerate(names):
        start = f"{result['quantity'].values[k]}: " if several else ""
        lines.append(f"{start}{said[k] or f'cause: {name}'}.")
    return Answer("\n".join(lines), data_of(result))


def _draws(name: str) -> Any:
    """An array or a dataset of what a file holds."""
    import xarray as xr

    file = Path(name)
    try:
        match file.suffix.lower():
            case ".npy":
                return np.load(file, allow_pickle=False)
            case ".csv":
                return _table(file)
            case ".nc" | ".zarr":
                if file.suffix.lower() == ".zarr":
                    optional_package("zarr", "store", "Files .zarr need")
                tree = xr.open_datatree(file)
                return getattr(tree, "posterior", tree).to_dataset()
    except MissingDependency:
        raise
    except Exception as error:  # noqa: BLE001 - readers of formats raise anything
        reason = getattr(error, "strerror", None) or reason_of(error)
        raise FileFormatError(f"{file} cannot be read as {file.suffix}: {reason}.") from None
    raise FileFormatError(
        f"{file} has the extension {file.suffix!r}; draws are .npy, .csv, .nc or .zarr files."
    )


def _table(file: Path) -> xr.Dataset:
    """Columns of a .csv file as quantities, but Stan's diagnostics, which end in __, and counters."""
    import xarray as xr

    lines = [line for line in file.read_text("utf-8-sig").splitlines() if line.strip()]
    lines = [line.replace('"', "") for line in lines if line[0] != "#"]
    if len(lines) < 2:
        raise ValueError(
            "it holds no draws; give a line of names and a line of numbers for each draw"
        )
    table = np.genfromtxt(lines, delimiter=",", names=True, deletechars="", ndmin=1)
    columns = {name: ("draw", table[name]) for name in table.dtype.names or ()}
    _, chain = columns.pop("chain", ("", np.zeros(table.size)))
    kept = [name for name in columns if name != "draw" and not name.endswith("__")]
    data = xr.Dataset({name: columns[name] for name in kept})
    split = [data.isel(draw=np.flatnonzero(chain == label)) for label in np.unique(chain)]
    return xr.concat(split, "chain") if len(split) > 1 else data
