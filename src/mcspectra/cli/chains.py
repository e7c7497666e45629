"""The verb of Markov chains: files of draws, what their means are worth, and why."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.cli.common import Answer, option, text_table, verb
from mcspectra.cli.texts import data_of
from mcspectra.core.errors import (
    FileFormatError,
    McspectraError,
    UnknownName,
    close_match_hint,
    reason_of,
)

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["chains_"]

_FORMATS = ".npy, .csv, .nc, .zarr"
_COUNTERS = {"draw", "iteration", ".draw", ".iteration", ""}  # columns that are no quantities


@verb(
    option("FILE", "draws: .npy, .csv, .nc or .zarr", dest="files", nargs="+"),
    option("--quantity NAME", "one of several quantities; may be repeated", repeated="all"),
    option("--weights NAME", "column or variable of the weights, or a .npy file of them"),
    option("--out FILE", "write the figure: .svg, .png or .pdf"),
)
def chains_(options: argparse.Namespace) -> Answer:
    """Error of the means of Markov chains, the frequencies that it comes from, and what is wrong.

    A .npy file holds one chain (n,), or (chain, draw), or (chain, draw, quantity). A .csv file has a
    column for each quantity, a row for each draw, and names in the first line; a column 'chain' tells
    chains apart, or each is a file of its own, as Stan writes them. A .nc or .zarr store has the dims
    chain and draw, itself or in its group posterior, as ArviZ writes it.
    """
    from mcspectra.plots.backend_matplotlib import write
    from mcspectra.plots.kinds import describe
    from mcspectra.variance.chains import chain_error

    # Read the draws, files of one chain side by side, and take weights and quantities out of them
    draws, weights = _read(options.files), None
    if options.weights is not None and options.weights.endswith(".npy"):
        weights = _read([options.weights])
    elif options.weights is not None:
        weights = _chosen(draws, [options.weights])[options.weights]
        draws = draws.drop_vars(options.weights)
    if options.quantity:
        draws = _chosen(draws, options.quantity)
    result = chain_error(draws, weights=weights)
    if options.out:
        write(describe("chains", result), options.out)

    # A line for each quantity, its causes below, and the bands where there is one alone
    single = "quantity" not in result.dims
    known = result.expand_dims(quantity=["mean"]) if single else result
    rows, causes = [], []
    for k, name in enumerate(map(str, known["quantity"].values)):
        one = known.isel(quantity=k)
        figures = [f"{float(one[key]):.6g}" for key in ("mean", "mcse", "ess")]
        low, high = one["ess_ci"].values
        rows.append([name, one["cause"].item(), *figures, f"{low:.4g} … {high:.4g}"])
        if said := one["evidence"].item():
            causes.append(said if single else f"{name}: {said}")
    header = ["quantity", "cause", "mean", "± error", "effective draws", "95 %"]
    title = f"{result.attrs['chains']} × {result.attrs['draws']} draws"
    parts = [title, text_table(header, rows), *causes]
    if known.sizes["quantity"] == 1:
        one = known.isel(quantity=0)
        shares = zip(*(one[k].values for k in ("band", "error_share", "draw_share")), strict=True)
        bands = [[band, "", f"{100 * e:.1f} %", f"{100 * d:.1f} %"] for band, e, d in shares]
        parts.append(text_table(["period in draws", "", "of the error", "of the draws"], bands))
    return Answer("\n".join([*parts, *filter(None, [result.attrs.get("note")])]), data_of(result))


def _read(files: Sequence[str]) -> Any:
    """The draws of one file, or of several with a chain each: an array, or a dataset by name."""
    import xarray as xr

    found = [_draws(Path(file)) for file in files]
    if len(found) == 1:
        return found[0]
    tables = [each for each in found if isinstance(each, xr.Dataset)]
    arrays = [each for each in found if isinstance(each, np.ndarray)]
    kinds = {(*each, *each.sizes.items()) for each in tables} | {each.shape for each in arrays}
    chained = any("chain" in each.dims for each in tables) or any(each.ndim > 1 for each in arrays)
    if len(kinds) > 1 or chained:
        raise FileFormatError(
            f"{', '.join(files[:3])} do not hold one chain each, of the same quantities and length; "
            "give files that do, or one file of all."
        )
    return xr.concat(tables, "chain") if tables else np.stack(arrays)


def _draws(file: Path) -> Any:
    """An array or a dataset of what a file holds."""
    import xarray as xr

    try:
        match file.suffix.lower():
            case ".npy":
                return np.load(file, allow_pickle=False)
            case ".csv":
                return _table(file)
            case ".nc" if file.read_bytes()[:3] == b"CDF":  # netCDF 3, which has no groups
                return xr.open_dataset(file, engine="scipy")
            case ".nc" | ".zarr":
                tree = xr.open_datatree(file)
                return getattr(tree, "posterior", tree).to_dataset()
    except McspectraError:
        raise
    except Exception as error:  # noqa: BLE001 - readers of formats raise anything
        reason = getattr(error, "strerror", None) or reason_of(error)
        raise FileFormatError(f"{file} cannot be read as {file.suffix}: {reason}.") from None
    raise FileFormatError(f"{file} has the extension {file.suffix!r}; draws are {_FORMATS} files.")


def _table(file: Path) -> xr.Dataset:
    """Columns of a .csv file as quantities, by draw, and by chain where a column tells these apart."""
    import xarray as xr

    text = file.read_text(encoding="utf-8-sig")
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    names = [name.strip().strip('"') for name in lines[0].split(",")] if lines else []
    values = np.loadtxt(lines[1:], delimiter=",", ndmin=2)
    if len(set(names)) < len(names) or values.shape[1:] != (len(names),):
        raise FileFormatError(
            f"{file} has {len(names)} names in its first line and {values.shape[1]} columns; name "
            "each column differently in the first line."
        )
    columns = dict(zip(names, values.T, strict=True))
    chain = next((columns.pop(name) for name in ("chain", ".chain") if name in columns), None)
    split, sizes = [np.arange(len(values))], {len(values)}
    if chain is not None:
        split = [np.flatnonzero(chain == label) for label in np.unique(chain)]
        sizes = {len(rows) for rows in split}
    if len(sizes) > 1:
        raise FileFormatError(
            f"{file} has chains of {min(sizes)} to {max(sizes)} draws; cut all alike."
        )
    # Stan's diagnostics end in __
    kept = {k: v for k, v in columns.items() if k not in _COUNTERS and not k.endswith("__")}
    dims = ("draw",) if chain is None else ("chain", "draw")
    shape = (-1,) if chain is None else (len(split), -1)
    order = np.concatenate(split)
    return xr.Dataset({k: (dims, v[order].reshape(shape)) for k, v in kept.items()})


def _chosen(draws: Any, names: Sequence[str]) -> Any:
    """The variables of these names."""
    known = list(map(str, getattr(draws, "data_vars", ())))
    for name in names:
        if name not in known:
            hint, close = close_match_hint(name, known)
            raise UnknownName(f"The draws have no quantity {name!r}.{hint if known else ''}", close)
    return draws[list(names)]
