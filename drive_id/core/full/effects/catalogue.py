"""All effects that ``full`` looks for: another one is a class beside these, and a line here."""

from __future__ import annotations

from collections.abc import Iterable

from drive_id.core.full.effects.clocks import FastClock
from drive_id.core.full.effects.effect import DriveEffect
from drive_id.core.full.effects.heat import (
    CopperHeating,
    CopperRecordings,
    LateMagnetHeating,
    MagnetHeating,
    MagnetRecordings,
)
from drive_id.core.full.effects.iron import Coercivity, EddyCurrents, Hysteresis
from drive_id.core.full.effects.link import (
    DcLink,
    DeviceSag,
    DropByLink,
    DropBySag,
    LinkDrift,
    LinkRipple,
    LinkRise,
    LinkSag,
)
from drive_id.core.full.effects.parts import AngleOfParts, DropOfParts, UnlikeParts
from drive_id.core.full.effects.phases import (
    CurrentFilters,
    DropAsymmetry,
    PhaseInductance,
    PhaseResistance,
    UnequalDrops,
    VoltageGains,
)
from drive_id.core.full.effects.resolver import Eccentricity, EccentricRotor, ResolverOrder
from drive_id.core.full.effects.sensors import CurrentGains, CurrentOffset, CurrentRotation
from drive_id.core.full.effects.skin import SkinEffect
from drive_id.core.full.effects.timing import (
    AngleTracking,
    CurrentFrame,
    CurrentLatency,
    FluxLag,
    LateCompensation,
    Latency,
    LateShape,
    LongFluxLag,
    ReferenceCompensation,
    SamplingInstant,
    VoltageFrame,
)
from drive_id.core.full.integrals import LAGS

CATALOGUE: dict[str, DriveEffect] = {
    effect.name: effect
    for effect in (
        EddyCurrents("iron_loss", "iron_loss_conductance", "S"),
        Hysteresis("hysteresis", "iron_loss_hysteresis", "S rad/s"),
        Coercivity("coercivity", "iron_loss_current", "A"),
        CurrentLatency("current_latency"),
        Latency("angle_latency"),
        AngleTracking("angle_tracking"),
        VoltageFrame("voltage_frame", "voltages"),
        CurrentFrame("current_frame", "currents"),
        FastClock("voltage_clock", "voltages", 1.0, 0.0),
        FastClock("angle_clock", "angle", 0.0, 1.0),
        FastClock("current_clock", "currents", -1.0, -1.0),
        LateCompensation("late_compensation", "Wb"),
        LateShape("late_shape"),
        ReferenceCompensation("reference_compensation", "V"),
        SamplingInstant("sampling_instant"),
        FluxLag("flux_lag"),
        *(LongFluxLag(f"flux_lag_{1e3 * lag:g}ms", lag) for lag in LAGS),
        CopperHeating("copper_heating"),
        MagnetHeating("magnet_heating"),
        LateMagnetHeating("late_magnet_heating"),
        CopperRecordings("copper_recordings"),
        MagnetRecordings("magnet_recordings"),
        AngleOfParts("angle_of_parts"),
        DropOfParts("drop_of_parts"),
        UnlikeParts("unlike_parts"),
        Eccentricity("eccentricity"),
        Eccentricity("second_mechanical", 2),
        EccentricRotor("eccentric_rotor"),
        ResolverOrder("resolver_first", 1),
        ResolverOrder("resolver_second", 2),
        DcLink("dc_link"),
        DropByLink("drop_by_link"),
        LinkDrift("link_drift"),
        LinkRipple("link_ripple"),
        LinkSag("link_sag", "link_sag"),
        DeviceSag("device_sag", "link_sag_of_devices"),
        DropBySag("drop_by_sag", "inverter_drop_sag"),
        LinkRise("link_rise"),
        PhaseResistance("phase_resistance"),
        PhaseInductance("phase_inductance"),
        UnequalDrops("phase_drop"),
        SkinEffect("skin_effect"),
        DropAsymmetry("drop_asymmetry"),
        VoltageGains("voltage_gains"),
        CurrentRotation("current_rotation", "rad", slice(0, 1)),
        CurrentGains("current_gains", "1", slice(1, 3), "current_gain_mismatch"),
        CurrentOffset("current_offset", "A", slice(3, 5), "current_offset"),
        CurrentFilters("current_filters"),
    )
}
"""By name, in the order of their columns."""


def without(names: Iterable[str], member: str) -> tuple[str, ...]:
    """Return effects less one of them, and what comes beside that only."""
    return tuple(name for name in names if member not in (name, CATALOGUE[name].beside))
