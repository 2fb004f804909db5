"""What the tables say of a free shaft, the inertia aside, which the headline holds."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:  # drive-id info does without the numerics
    from drive_id.core.result.identification import Mechanics


def shaft_values(mechanics: Mechanics) -> list[tuple[str, tuple[float, float, str]]]:
    """Return name, value, standard error and unit of all that the motion tells."""
    terms = (
        ("True torque / torque of the map", mechanics.gain, mechanics.sigma_gain, ""),
        ("Coulomb friction", mechanics.friction, mechanics.sigma_friction, "Nm"),
        ("Viscous friction", mechanics.viscous_friction, mechanics.sigma_viscous_friction, "Nm s/rad"),
        ("Load torque", mechanics.load, mechanics.sigma_load, "Nm"),
    )
    found = [(name, (x, sigma, unit)) for name, x, sigma, unit in terms if x is not None and sigma is not None]
    cogging = [(f"Cogging and mean ripple, order {c.order}", (c.amplitude, c.sigma, "Nm")) for c in mechanics.cogging]
    return [*found, *cogging]
