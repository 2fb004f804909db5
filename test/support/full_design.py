"""The regression of method full as dense matrices, which the fit never forms."""

from __future__ import annotations

from scipy import sparse

from drive_id.core.full.model import FullModel, ModelSpec, map_basis, own_basis
from drive_id.core.full.windows import Windows
from drive_id.types import FloatArray


def design(model: FullModel, windows: Windows) -> FloatArray:
    """Return the rows Z of N windows, (N, 2, size): real parts in [:, 0], imaginary parts in [:, 1]."""
    return model.design_times(windows, sparse.eye_array(model.size, format="csr"), model.orders)


def basis(model: FullModel, spec: ModelSpec) -> sparse.csr_array:
    """Return T (size, M), from the unknowns of a variant to the columns of the regression."""
    return sparse.csr_array(model.expansion @ sparse.hstack([map_basis(model, spec), own_basis(model, spec)]))
