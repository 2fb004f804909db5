"""Settings of the identification, one source for files, command line and nodes."""

from __future__ import annotations

from dataclasses import dataclass

from drive_id.errors import ConfigurationError
from drive_id.settings import check, setting

_MOST_FUNCTIONS = 1024


@dataclass(frozen=True)
class FitSettings:
    """What can be chosen about a fit."""

    method: str = setting("joint", "psm: flux and resistance; joint: with the inverter", choices=("psm", "joint"))
    flux_model: str = setting(
        "spline",
        "spline: tensor-product cubic B-splines; polynomial: of total degree polynomial_degree; "
        "linear: magnet flux plus inductance matrix",
        choices=("spline", "polynomial", "linear"),
    )
    splines_d: int = setting(8, "cubic B-splines along i_d", minimum=4, maximum=64)
    splines_q: int = setting(8, "cubic B-splines along i_q", minimum=4, maximum=64)
    polynomial_degree: int = setting(5, "total degree of the polynomial flux model", minimum=1, maximum=12)
    inverter_current_scale: float = setting(1.0, "i_s in u_e tanh(i / i_s)", unit="A", minimum=1e-6)
    i_max: float | None = setting(
        None,
        "radius of the current disc; by default that of the recorded references, or the largest measured amplitude",
        unit="A",
        minimum=1e-3,
    )
    longest_rest: float = setting(
        0.02,
        "samples after a longer rest below 2 % of i_max are left out, where the foot of the inverter's curve "
        "would outweigh everything else",
        unit="s",
        minimum=0.0,
    )
    grid_points: int = setting(65, "points of the map along each axis", minimum=9, maximum=1025)

    def __post_init__(self) -> None:
        check(self)
        if self.splines_d * self.splines_q > _MOST_FUNCTIONS:
            raise ConfigurationError(
                f"splines_d x splines_q is {self.splines_d} x {self.splines_q}: choose at most {_MOST_FUNCTIONS} "
                "functions, more do not fit the memory."
            )
