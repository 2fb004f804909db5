"""netCDF 3: what xarray opens as a data set, with units, standard errors and rotor-position harmonics."""

from __future__ import annotations

import io

import numpy as np

from drive_id.exchange.exports.options import ExportOptions
from drive_id.exchange.exports.table import MapTable

_TEXTS = {
    "title": "flux map of an electric machine, written by drive_id",
    "conventions": "peak values, d on the magnet axis, q leads d by 90 degrees electrical",
}
_PARTS = ("psi_d_cos", "psi_d_sin", "psi_q_cos", "psi_q_sin")


def write(table: MapTable, _: ExportOptions) -> bytes:
    """Write coordinates ``i_d``, ``i_q``, and variables over them; ``inside`` is 1 where there are data."""
    from scipy.io import netcdf_file  # noqa: PLC0415  # only this format needs it

    stream = io.BytesIO()
    with netcdf_file(stream, "w", version=2) as file:
        for name, axis in (("i_d", table.i_d), ("i_q", table.i_q)):
            file.createDimension(name, len(axis))
            variable = file.createVariable(name, "d", (name,))
            variable[:] = axis
            variable.units, variable.long_name = "A", f"peak current, {name[-1]} axis"
        for name, (values, unit, text) in table.quantities.items():
            variable = file.createVariable(name, "d", ("i_d", "i_q"))
            variable[:] = values
            variable.units, variable.long_name = unit, text
        variable = file.createVariable("inside", "b", ("i_d", "i_q"))
        variable[:] = table.inside.astype(np.int8)
        variable.long_name = "1 where there are data"
        if table.harmonics:
            file.createDimension("order", len(table.harmonics))
            file.createVariable("order", "i", ("order",))[:] = [order for order, _ in table.harmonics]
            for part, name in enumerate(_PARTS):
                variable = file.createVariable(name, "d", ("order", "i_d", "i_q"))
                variable[:] = np.stack([amplitudes[..., part] for _, amplitudes in table.harmonics])
                variable.units = "Wb"
        for name, value in (_TEXTS | table.facts()).items():
            setattr(file, name, value.encode() if isinstance(value, str) else value)
        file.flush()
        return stream.getvalue()
