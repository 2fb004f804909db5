"""Results, samples and figures as objects of pandas and xarray, which are loaded only then."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from drive_id.common.arguments import expect
from drive_id.core.maps.flux_map import FluxMap
from drive_id.errors import ConfigurationError
from drive_id.types import Samples

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

_UNITS = {"psi_d": "Wb", "psi_q": "Wb", "sigma_d": "Wb", "sigma_q": "Wb", "i_d": "A", "i_q": "A"}


def pandas_library() -> Any:
    """Import pandas; raises ConfigurationError when it is not installed."""
    try:
        import pandas as pd  # noqa: PLC0415  # optional
    except ImportError as error:
        raise ConfigurationError("This needs pandas, which is not installed: run pip install pandas.") from error
    return pd


def map_dataset(flux_map: FluxMap, attributes: Mapping[str, Any]) -> xr.Dataset:
    """Return a map over coordinates ``i_d``, ``i_q``, A: fluxes, Wb, NaN without data, inductances, H, and errors."""
    try:
        import xarray  # noqa: PLC0415  # optional
    except ImportError as error:
        raise ConfigurationError("This needs xarray, which is not installed: run pip install xarray.") from error
    grid = np.moveaxis(flux_map.grid(), -1, 0)
    slopes = flux_map.inductances(*grid)
    values = {name: np.where(flux_map.inside, getattr(flux_map, name), np.nan) for name in list(_UNITS)[:4]}
    values |= {f"L_{a}{b}": slopes[..., m, n] for m, a in enumerate("dq") for n, b in enumerate("dq")}
    dims = ("i_d", "i_q")
    arrays = {name: (dims, x, {"units": _UNITS.get(name, "H")}) for name, x in values.items()}
    axes = {name: (name, getattr(flux_map, name), {"units": "A"}) for name in dims}
    found: xr.Dataset = xarray.Dataset(arrays, axes, dict(attributes))
    return found


def samples_frame(samples: Samples) -> pd.DataFrame:
    """Return samples as rows over the time since the first, s; column ``run`` counts the gap-free runs."""
    expect(samples, Samples, "samples", "give drive_id.Samples, as of drive_id.read_bag")
    pandas = pandas_library()
    columns: dict[str, Any] = {
        f"{name}_{phase}": x[:, k]
        for name, x in (("i", samples.i_abc), ("u", samples.u_abc))
        for k, phase in enumerate("abc")
    }
    columns |= {"angle": samples.angle, "speed": samples.speed}
    if samples.i_dq_reference is not None:
        columns |= {f"i_{axis}_reference": samples.i_dq_reference[:, k] for k, axis in enumerate("dq")}
    columns |= samples.scalars()
    columns["run"] = np.searchsorted(samples.run_starts, np.arange(len(samples)), side="right") - 1
    time = pandas.Index((samples.stamp - samples.stamp[0]) * 1e-9, name="time")
    found: pd.DataFrame = pandas.DataFrame(columns, index=time)
    return found
