from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from exact_results import exact_result
from flashed_machines import folding, within

from drive_id.analysis.machine import IronLoss, MachineModel
from drive_id.analysis.operation import Operation
from drive_id.bench.machines import MACHINES, machine_map
from drive_id.common.messages import Message
from drive_id.core.full.effects.effect import Calibration
from drive_id.core.maps.flux_models import positive_definite
from drive_id.errors import ConfigurationError
from drive_id.types import MachineMap


@pytest.fixture(scope="module", params=["ipm", "spm", "pmsyrm"])
def known(request):
    """A model and the analytic machine behind it."""
    return MachineModel.of(exact_result(machine_map(request.param))), MACHINES[request.param]


def in_disc(i_max, count=400, seed=3):
    rng = np.random.default_rng(seed)
    radius, angle = i_max * np.sqrt(rng.uniform(0, 1, count)), rng.uniform(-np.pi, np.pi, count)
    return radius * np.cos(angle), radius * np.sin(angle)


def test_fluxes_and_torque_are_those_of_the_machine(known):
    model, machine = known
    i_d, i_q = in_disc(machine.i_max)
    angles = np.linspace(0, 2 * np.pi / 6, 24, endpoint=False)[:, None]
    psi_d, psi_q = (flux.mean(axis=0) for flux in machine.flux(i_d, i_q, angles))
    found_d, found_q = model.psi_dq(i_d, i_q)
    np.testing.assert_allclose(found_d, psi_d, atol=1e-5 * np.abs(psi_d).max())
    np.testing.assert_allclose(found_q, psi_q, atol=1e-5 * np.abs(psi_q).max())
    # the flux of each phase turns with the rotor: power of the induced voltages over the mechanical speed
    theta = np.linspace(0, 2 * np.pi, 36, endpoint=False)[:, None]
    phases = [0, -2 * np.pi / 3, 2 * np.pi / 3]
    power = sum(
        -(psi_d * np.sin(theta + shift) + psi_q * np.cos(theta + shift))
        * (i_d * np.cos(theta + shift) - i_q * np.sin(theta + shift))
        for shift in phases
    ).mean(axis=0)
    np.testing.assert_allclose(model.torque(i_d, i_q), machine.pole_pairs * power, rtol=2e-4, atol=1e-4 * power.max())


def test_inductances_are_slopes_also_beyond_the_grid(known):
    model, machine = known
    i_d, i_q = (3 * current for current in in_disc(machine.i_max))
    step = 1e-4 * machine.i_max
    by_d, by_q = (
        (np.stack(model.psi_dq(i_d + a, i_q + b)) - np.stack(model.psi_dq(i_d - a, i_q - b))) / (2 * step)
        for a, b in ((step, 0), (0, step))
    )
    slopes = np.moveaxis(np.stack([by_d, by_q]), (0, 1), (-1, -2))
    np.testing.assert_allclose(model.inductances(i_d, i_q), slopes, atol=1e-4 * np.abs(slopes).max())


def test_apparent_inductances_give_the_fluxes_back_and_are_finite_at_zero(known):
    model, machine = known
    i_d, i_q = in_disc(machine.i_max)
    l_d, _ = model.apparent_inductances(i_d, i_q)
    np.testing.assert_allclose(l_d * i_d + model.psi_dq(0, i_q)[0], model.psi_dq(i_d, i_q)[0], rtol=1e-9)
    at_zero = model.apparent_inductances(0.0, 0.0)
    near = model.apparent_inductances(1e-3 * machine.i_max, 1e-3 * machine.i_max)
    np.testing.assert_allclose(at_zero, near, rtol=2e-3)


def test_the_inverse_map_gives_the_currents_back(known):
    model, machine = known
    i_d, i_q = in_disc(1.2 * machine.i_max)
    found = model.current(*model.psi_dq(i_d, i_q))
    np.testing.assert_allclose(found, (i_d, i_q), atol=1e-6 * machine.i_max)
    assert np.isnan(model.current(np.nan, 0.1)).all()


def test_a_map_that_is_not_monotone_is_inverted_by_the_nearest_that_is():
    machine = machine_map("pmsyrm")
    grid = np.stack(np.meshgrid(machine.i_d, machine.i_q, indexing="ij"), -1)
    dip = 0.3 * np.exp(-((grid[..., 0] + 10) ** 2 + (grid[..., 1] - 25) ** 2) / 30)
    thinned = {name: getattr(machine, name)[::6] for name in ("i_d", "i_q")}
    fluxes = {"psi_d": machine.psi_d[::6, ::6], "psi_q": (machine.psi_q + dip)[::6, ::6]}
    flat = {"theta": None, "psi_d_theta": None, "psi_q_theta": None}
    model = MachineModel.of(exact_result(replace(machine, **thinned, **fluxes, **flat)))
    assert not model.monotone
    i_d, i_q = in_disc(machine.i_max, 60)
    psi_d, psi_q = model.psi_dq(i_d, i_q)
    d, q = model.current(psi_d, psi_q)
    far = np.hypot(i_d + 10, i_q - 25) > 20
    assert np.abs(np.stack([d - i_d, q - i_q]))[:, far].max() < 0.1 * machine.i_max
    steps = (
        np.stack([np.subtract.outer(x, x) for x in (d, q)]),
        np.stack([np.subtract.outer(x, x) for x in (psi_d, psi_q)]),
    )
    assert (np.sum(steps[0] * steps[1], axis=0) >= -1e-9).all()  # monotone


def test_inside_tells_where_there_are_data():
    machine = machine_map("ipm")
    result = exact_result(machine)
    whole = result.flux_map
    grid = whole.grid()
    disc = np.hypot(grid[..., 0], grid[..., 1]) <= 250.0
    holed = replace(whole, inside=disc, psi_d=np.where(disc, whole.psi_d, 9.0))  # what lies outside must not matter
    model = MachineModel.of(replace(result, drive=replace(result.drive, flux_map=holed)))
    np.testing.assert_array_equal(model.inside([100.0, -240.0, 400.0], [50.0, 200.0, 0.0]), [True, False, False])
    assert model.psi_dq(-100.0, 50.0)[0] == pytest.approx(MachineModel.of(result).psi_dq(-100.0, 50.0)[0], rel=1e-5)
    assert model.psi_dq(260.0, 30.0)[0] == pytest.approx(MachineModel.of(result).psi_dq(260.0, 30.0)[0], rel=0.03)


def test_all_currents_of_i_max_lie_inside_where_the_disc_is_covered():
    """Of the rim, 15 % lie in grid cells with a corner beyond the disc: they were told to be without data."""
    result = exact_result(machine_map("ipm"))
    grid = result.flux_map.grid()
    angle = np.linspace(0.0, 2 * np.pi, 721)
    rim = result.i_max * np.cos(angle), result.i_max * np.sin(angle)
    for covered in (result.i_max, 0.9 * result.i_max):
        disc = np.hypot(grid[..., 0], grid[..., 1]) <= covered
        flux_map = replace(result.flux_map, inside=disc)
        model = MachineModel.of(replace(result, drive=replace(result.drive, flux_map=flux_map)))
        assert model.inside(*rim).all() == (covered == result.i_max)
        assert not model.inside(1.01 * rim[0], 1.01 * rim[1]).all()


def test_the_drop_takes_the_power_that_the_phases_lose():
    def drop(i):
        return 4.0 * np.tanh(i / 3.0) + 0.5 * np.tanh(i / 40.0)

    result = exact_result(machine_map("ipm"), drop=drop)
    model, curve = MachineModel.of(result), result.inverter_curve

    def recorded(i):
        return np.interp(i, curve.current, curve.voltage)

    theta = np.linspace(0, 2 * np.pi, 7200, endpoint=False)
    for i_d, i_q in ((-3.0, 1.0), (-120.0, 160.0), (0.0, 299.0)):
        phase = np.hypot(i_d, i_q) * np.cos(theta)
        drop_d, drop_q = model.inverter_drop(i_d, i_q)
        assert 1.5 * (drop_d * i_d + drop_q * i_q) == pytest.approx(3 * np.mean(phase * recorded(phase)), rel=0.003)
        assert drop_d * i_q == pytest.approx(drop_q * i_d)
    assert model.inverter_drop(0.0, 0.0) == (0.0, 0.0)


def test_temperature_acts_on_resistance_and_magnet():
    result = exact_result(machine_map("spm"), magnet_coefficient=(-1e-4, 1e-6))
    cold, hot = MachineModel.of(result), MachineModel.of(result, temperature=120.0)
    assert hot.resistance == pytest.approx(cold.resistance * 1.393)
    assert hot.psi_dq(3.0, -5.0)[0] == pytest.approx(cold.psi_dq(3.0, -5.0)[0] - 1e-2)
    assert hot.psi_dq(3.0, -5.0)[1] == pytest.approx(cold.psi_dq(3.0, -5.0)[1])
    mixed = MachineModel.of(result, temperature=120.0, magnet_temperature=20.0)
    assert mixed.psi_dq(3.0, -5.0)[0] == pytest.approx(cold.psi_dq(3.0, -5.0)[0])


def test_iron_loss_that_was_identified_is_taken_over():
    found = Calibration("iron_loss_conductance", 0.2, 0.01, "S", True, Message.told(""))
    result = exact_result(machine_map("ipm"), calibrations=(found,))
    iron = MachineModel.of(result).iron
    assert iron == IronLoss(conductance=0.2)
    np.testing.assert_allclose(iron.current(np.array([3.0, -4.0]), np.array(100.0)), [0.6, -0.8])
    several = IronLoss(0.1, 20.0, 2.0).current(np.array([3.0, -4.0]), np.array(-100.0))
    np.testing.assert_allclose(several, 0.7 * np.array([3.0, -4.0]))
    assert np.isfinite(IronLoss(0.1, 20.0, 2.0).current(np.zeros(2), np.array(0.0))).all()


@pytest.mark.parametrize(("temperature", "factor"), [(None, 1.0), (120.0, 1.393)])
def test_a_resistance_that_rises_with_the_speed_counts_in_losses_and_voltages(temperature, factor):
    """Rising the less, the warmer the copper is."""
    rise, speed, i_dq = 2e-8, np.array([0.0, 200.0]), np.array([-30.0, 40.0])
    found = Calibration("resistance_by_speed", rise, 1e-10, "ohm s^2/rad^2", True, Message.told(""))
    with_rise, without = (
        MachineModel.of(exact_result(machine_map("ipm"), calibrations=each), temperature=temperature)
        for each in ((found,), ())
    )
    points, usual = (Operation.at(model, i_dq, speed) for model in (with_rise, without))
    more = rise / factor * (speed * with_rise.known_pole_pairs()) ** 2
    np.testing.assert_allclose(points.copper - usual.copper, 1.5 * more * 50.0**2)
    np.testing.assert_allclose(points.u_dq - usual.u_dq, more[:, None] * i_dq, atol=1e-12)
    np.testing.assert_allclose(points.power, points.mechanical + points.losses)


def test_what_is_unknown_is_named():
    result = exact_result(machine_map("ipm"))
    unknown = MachineModel.of(replace(result, provenance=replace(result.provenance, pole_pairs=None, u_dc=None)))
    with pytest.raises(ConfigurationError, match="--pole-pairs"):
        unknown.torque(1.0, 2.0)
    with pytest.raises(ConfigurationError, match="--u-dc"):
        unknown.known_u_dc()
    for wrong in ({"pole_pairs": 0}, {"u_dc": -3.0}, {"temperature": np.nan}, {"magnet_temperature": 1e9}):
        with pytest.raises(ConfigurationError, match=next(iter(wrong))):
            MachineModel.of(result, **wrong)
    with pytest.raises(ConfigurationError, match="broadcast"):
        unknown.psi_dq([1.0, 2.0], [1.0, 2.0, 3.0])


def without_zero_row():
    """Return a result of a map whose rows of i_q do not contain zero, and its fluxes as functions."""
    i_d, i_q = np.arange(-20.0, 15.1, 2.5), np.arange(-16.5, 16.6, 3.0)

    def flux(d, q):
        s = np.sqrt(1 + (d / 20) ** 2 + (q / 6) ** 2)
        return 0.1 + 0.0075 * d / s + 0.002 * d, 3 / 36 * q / s + 0.003 * q

    psi_d, psi_q = flux(*np.meshgrid(i_d, i_q, indexing="ij"))
    return exact_result(MachineMap("rowless", i_d, i_q, psi_d, psi_q, 0.45, 3, 15.0, 320.0)), flux


def test_within_the_data_there_is_one_evaluation_of_a_map():
    """The continuation beyond the data changes neither fluxes nor inductances within them."""
    result, flux = without_zero_row()
    model = MachineModel.of(result)
    d, q = np.meshgrid(np.linspace(-20, 15, 71), np.linspace(-16.5, 16.5, 67), indexing="ij")
    np.testing.assert_allclose(model.psi_dq(d, q), result.flux_map.psi_dq(d, q), rtol=0, atol=1e-13)
    np.testing.assert_allclose(model.inductances(d, q), result.flux_map.inductances(d, q), rtol=0, atol=1e-13)
    h = 1e-4
    true = (flux(d + h, q)[0] - flux(d - h, q)[0]) / (2 * h)
    assert np.abs(model.inductances(d, q)[..., 0, 0] - true).max() < 0.9e-3


def test_the_continuation_goes_on_without_a_step():
    model = MachineModel.of(without_zero_row()[0])
    along = np.linspace(-18.0, 18.0, 301)
    for at in (-20.0, -17.5, 0.0, 15.0):
        before, after = (np.array(model.psi_dq(at + shift, along)) for shift in (-1e-7, 1e-7))
        np.testing.assert_allclose(before, after, rtol=0, atol=1e-8)


def test_derivatives_are_those_of_the_values():
    model = MachineModel.of(without_zero_row()[0])
    d, q = in_disc(17.0, 500)
    h = 1e-5
    by_d = (np.array(model.psi_dq(d + h, q)) - np.array(model.psi_dq(d - h, q))) / (2 * h)
    by_q = (np.array(model.psi_dq(d, q + h)) - np.array(model.psi_dq(d, q - h))) / (2 * h)
    found = model.inductances(d, q)
    np.testing.assert_allclose(found[..., 0].T, by_d, rtol=0, atol=1e-7)
    np.testing.assert_allclose(found[..., 1].T, by_q, rtol=0, atol=1e-7)


def test_a_map_for_simulation_is_monotone_between_the_points_of_a_coarse_grid_too():
    """Splines through samples of the nearest monotone map fell between them: 6 % of the inductances were indefinite."""
    model = MachineModel.of(within(folding(2.0, 0.2)))
    assert not model.monotone_inside
    i_d, i_q = np.meshgrid(*[np.linspace(-1.0, 1.0, 201) * model.i_max] * 2, indexing="ij")
    assert positive_definite(model.rising.inductances(i_d, i_q)).all()
