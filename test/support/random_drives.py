"""Good drives by chance: shipped machines and others with every parameter changed, speeds, rates, noise, inverters."""

from __future__ import annotations

import numpy as np

from drive_id.bench.machines import MACHINES, CoEnergyMachine
from drive_id.bench.settings import SimulationSettings
from drive_id.core.experiment.trajectories import Lissajous
from drive_id.fitting.simulated import run_experiment
from drive_id.types import Samples

OTHERS = {
    machine.name: machine
    for machine in (
        CoEnergyMachine(  # a reluctance machine without a magnet, its larger inductance on d
            "synrm", 0.0, 0.0, (45e-3, 8e-3), 8.0, (3e-3, 2.5e-3), ((6, 0.01, 0.008),),
            resistance=0.4, pole_pairs=2, i_max=30.0, u_dc=540.0,
        ),
        CoEnergyMachine(  # of 80 uH
            "slotless", 0.02, 0.0, (20e-6, 20e-6), 400.0, (60e-6, 60e-6), (),
            resistance=0.12, pole_pairs=1, i_max=15.0, u_dc=48.0,
        ),
        CoEnergyMachine(
            "fast", 0.02, 5.0, (0.1e-3, 0.15e-3), 150.0, (0.05e-3, 0.05e-3), ((6, 0.01, 0.005),),
            resistance=15e-3, pole_pairs=5, i_max=120.0, u_dc=400.0,
        ),
    )
}  # fmt: skip


def random_machine(rng: np.random.Generator) -> CoEnergyMachine:
    """Choose a machine and change its parameters by some 30 %."""
    base = list((MACHINES | OTHERS).values())[rng.integers(len(MACHINES) + len(OTHERS))]

    def changed(value: float) -> float:
        return float(value * np.exp(0.3 * rng.normal()))

    return CoEnergyMachine(
        base.name,
        changed(base.magnet_flux),
        changed(base.magnet_current),
        (changed(base.main_inductance[0]), changed(base.main_inductance[1])),
        changed(base.saturation_current),
        base.linear_inductance,
        base.harmonics,
        resistance=changed(base.resistance),
        pole_pairs=base.pole_pairs,
        i_max=base.i_max,
        u_dc=1e4,  # the voltage is never limited
    )


def random_recording(seed: int, longest: float = 15.0) -> tuple[str, Samples]:
    """Record a random good drive for between 2 s and so many; return a description of it, too."""
    rng = np.random.default_rng(seed)
    machine = random_machine(rng)
    volts = (MACHINES | OTHERS)[machine.name].u_dc
    speed = float(rng.choice([-1, 1]) * np.exp(rng.uniform(np.log(60), np.log(3000))))
    settings = SimulationSettings(
        sample_period=float(rng.choice([2e-4, 1.25e-4, 1e-4, 6.25e-5, 5e-5])),
        speeds=(speed,) if rng.random() < 0.8 else (speed, -0.5 * speed),
        current_noise=float(rng.choice([0.0, 1e-3, 2e-3, 5e-3])),
        inverter=str(rng.choice(["none", "tanh", "dead_time", "two_stage"])),
        inverter_voltage=0.01 * volts,
        device_voltage=0.0025 * volts,
        device_resistance=0.002 * volts / machine.i_max,
        inverter_compensation=bool(rng.random() < 0.3),
        voltage_delay=float(rng.choice([0.0, 0.0, 0.0, 0.5, 1.0, -1.0])),
        harmonics=float(rng.random()),
        speed_ripple=float(rng.choice([0.0, 0.0, 0.01, 0.03])),
        seed=seed,
    )
    frequencies = [(3.7, 1.1), (7.3, 2.3), (1.1, 3.7), (13.0, 0.7)][rng.integers(4)]
    form = "smooth" if rng.random() < 0.7 else "printed"
    trajectory = Lissajous(frequency_d=frequencies[0], frequency_q=frequencies[1], form=form)
    samples = run_experiment(machine.to_map(), settings, trajectory, float(rng.uniform(2.0, longest))).samples
    described = f"{seed}: {machine.name}, {speed:.0f} rpm, {1e-3 / settings.sample_period:g} kHz, {settings.inverter}"
    return described, samples
