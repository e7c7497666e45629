"""What figures take: results of one estimator with one or several samplers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeAlias

from mcspectra.core.errors import ParameterError

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Group", "as_group", "channel_note", "frequency_dims"]

Group: TypeAlias = "xr.Dataset | Mapping[str, xr.Dataset]"
"""One dataset (which may have a dim sampler), or datasets by the name of their sampler."""


def as_group(data: Group, *needed: str) -> dict[str, xr.Dataset]:
    """Return datasets by sampler, of several channels the first, after checking their variables.

    Raises
    ------
    ParameterError
        There is no dataset, or one lacks a variable that the figure shows.
    """
    import xarray as xr

    given: Any = data
    group: dict[str, Any]
    if isinstance(given, xr.Dataset):
        group = _split(given)
    elif isinstance(given, Mapping) and given:
        group = {str(name): each for name, each in given.items()}
    else:
        raise ParameterError(
            f"A figure needs a dataset or a mapping of sampler names to datasets, not {data!r:.80}."
        )
    for name, each in group.items():
        missing = [v for v in needed if not isinstance(each, xr.Dataset) or v not in each]
        if missing:
            raise ParameterError(
                f"The result for {name!r} has no {' and no '.join(missing)}; "
                "give a result of the analysis that this figure shows."
            )
    return {name: _first_channel(each) for name, each in group.items()}


def _split(data: xr.Dataset) -> dict[str, xr.Dataset]:
    if "sampler" in data.dims and "sampler" in data.coords:
        return {str(s): data.sel(sampler=s) for s in data["sampler"].values}
    name = data.attrs.get("sampler_spec", data.attrs.get("sampler", "sampler"))
    return {str(name): data}


def _first_channel(data: xr.Dataset) -> xr.Dataset:
    return data.isel(channel=0) if "channel" in data.dims else data


def channel_note(data: Group) -> str:
    """Return ``"channel 0 of 3"`` where only the first of several channels is shown, else nothing."""
    import xarray as xr

    each = data if isinstance(data, xr.Dataset) else next(iter(data.values()))
    channels = each.sizes.get("channel", 0)
    return f"channel 0 of {channels}" if channels > 1 else ""


def frequency_dims(data: xr.Dataset) -> list[str]:
    """Names of the frequency dims of a map: m0, m1, …"""
    return sorted(str(d) for d in data.dims if str(d)[0] == "m" and str(d)[1:].isdigit())
