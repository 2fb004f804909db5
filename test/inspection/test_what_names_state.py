"""Units, commanded or measured, temperatures: what names say, drafts take, and what they leave open is marked."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from column_files import columns, write_csv

from drive_id.core import frames
from drive_id.core.fit_settings import FitSettings
from drive_id.files.messages.signals_file import parse_signals
from drive_id.files.read.several import read_recording
from drive_id.fitting.fit import fit
from drive_id.inspection.inspect import check


@pytest.fixture(scope="module")
def samples(simulation):
    made = simulation.samples
    return replace(made.part(0, 12_000), truth=None, stamp=made.stamp[:12_000] - made.stamp[0])


def drafted(samples, tmp_path, **changed):
    """Return what the draft of a CSV file with these columns, besides the usual ones or in place of them, reads."""
    table = columns(samples, **changed)
    path = write_csv(tmp_path / "log.csv", table)
    draft = check(path).draft
    recording = read_recording(path, parse_signals(draft.text, "the draft"))
    return recording.samples, draft, recording.warnings


def phases(samples, name, suffix, factor=1.0):
    """Return three columns with the phases of currents or voltages under another name, and remove the usual ones."""
    x = samples.i_abc if name == "i" else samples.u_abc
    new = {f"{name}{phase}{suffix}": factor * x[:, k] for k, phase in enumerate("abc")}
    return dict.fromkeys((f"{name}{phase}" for phase in "abc"), None) | new


def test_a_unit_with_a_number_is_a_factor(samples, tmp_path):
    changed = phases(samples, "i", " [0.1A]", 10.0) | phases(samples, "u", " [0,01 V]", 100.0)
    found, draft, _ = drafted(samples, tmp_path, **changed)
    assert np.abs(found.i_abc - samples.i_abc[: len(found)]).max() < 1e-3
    assert np.abs(found.u_abc - samples.u_abc[: len(found)]).max() < 1e-3
    assert "EDIT" not in draft.text


def test_currents_in_percent_are_a_guess(samples, tmp_path):
    _, draft, warnings = drafted(samples, tmp_path, **phases(samples, "i", " [%]", 100 / 300))
    assert "EDIT: A per %, the unit that their names state" in draft.text
    assert "guessed_setting" in [message.code for message in warnings]


@pytest.mark.parametrize(("commanded", "measured"), [("_cmd", "_meas"), ("_ref", "_act"), ("_soll", "_ist")])
def test_commanded_voltages_are_taken_whatever_their_place(commanded, measured, samples, tmp_path):
    both = phases(samples, "u", measured, 1.02) | phases(samples, "u", commanded)
    found, draft, _ = drafted(samples, tmp_path, **both)
    assert np.abs(found.u_abc - samples.u_abc[: len(found)]).max() < 1e-3
    assert any(f"ua{measured}" in sentence and "named for voltages" in sentence for sentence in draft.unsure)


def test_filtered_currents_and_estimated_angles_are_not_taken(samples, tmp_path):
    later = phases(samples, "i", "_filt", 0.98) | {
        f"i{phase}": x for phase, x in zip("abc", samples.i_abc.T, strict=True)
    }
    table = {"theta_est": np.mod(samples.angle + 0.01, 2 * np.pi)} | later
    _, draft, _ = drafted(samples, tmp_path, **table)
    assert "fields: [ia, ib, ic]" in draft.text
    assert "theta_est" not in draft.text


@pytest.mark.parametrize("unit", ["", " [K]", " [degC]"])
def test_a_temperature_is_neither_link_nor_speed_but_a_temperature(unit, samples, tmp_path):
    """100 degrees: 5 times the speed in rpm with 20 pole pairs, and as steady as a DC link."""
    rng, kelvin = np.random.default_rng(1), 273.15 * ("K" in unit)
    temperature = 100.0 + kelvin + 0.05 * rng.standard_normal(len(samples))
    found, draft, _ = drafted(samples, tmp_path, omega=None, **{f"T_winding{unit}": temperature})
    assert found.winding_temperature == pytest.approx(temperature[: len(found)] - kelvin, abs=0.01)
    assert "dc_link" not in draft.text
    assert "\n  speed: " not in draft.text


def test_a_table_in_long_format_is_to_be_pivoted(samples, tmp_path):
    table = columns(samples)
    time, signals = table.pop("time_s"), np.arange(len(table))
    values = np.column_stack(list(table.values()))
    long = {"time": np.repeat(time, len(table)), "signal": np.tile(signals, len(time)), "value": values.ravel()}
    found = check(write_csv(tmp_path / "log.csv", long)).findings
    assert any("pivot it" in finding for finding in found if finding.code == "no_draft")


def test_a_second_drive_in_the_table_is_told(samples, tmp_path):
    second = {f"M2_i{phase}": x for phase, x in zip("abc", np.roll(samples.i_abc, 500, axis=0).T, strict=True)}
    _, draft, _ = drafted(samples, tmp_path, **second)
    assert any("M2_ia, M2_ib, M2_ic are named for currents, too" in sentence for sentence in draft.unsure)


@pytest.mark.parametrize(
    ("name", "unit", "shaft", "marked"),
    [
        ("speed_rps", "rev/s", True, False), ("n [rpm]", "rpm", True, False), ("omega_m", "rad/s", True, True),
        ("omega", "rad/s", False, True), ("vel_estimate", "rad/s", False, True), ("erpm", "rpm", False, False),
        ("w_el [rad/s]", "rad/s", False, False), ("speed", "rpm", True, True),
    ],
)  # fmt: skip
def test_the_unit_of_a_slow_speed_is_marked_unless_it_is_stated(name, unit, shaft, marked, tmp_path):
    """The fluxes follow it, and each fit says so as long as it is a guess. Voltages are setpoints, as of ODrive."""
    t = 0.01 * np.arange(400)
    i = np.repeat(np.array([[0.0, 5], [-5, 5], [-5, 10], [0, 10], [-10, 3], [3, 3], [-3, -6], [2, 8]]), 50, axis=0)
    table = {"t": t, "Id_measured": i[:, 0], "Iq_measured": i[:, 1], "Vd_setpoint": i[:, 0], "Vq_setpoint": 9 + i[:, 1]}
    path = write_csv(tmp_path / "slow.csv", table | {name: 100.0 + 0.01 * np.sin(t)})
    draft = check(path).draft
    assert draft.static
    line = next(line for line in draft.text.splitlines() if "speed_unit" in line)
    assert f"speed_unit: {unit}" in line
    assert ("EDIT" in line) == marked
    assert ("\n  mechanical: true" in draft.text) == shaft
    assert "[Vd_setpoint, Vq_setpoint]" in draft.text


def test_every_line_of_a_guess_is_named(samples, tmp_path):
    i, u = (frames.space_vector(x) for x in (samples.i_abc, samples.u_abc))
    none = dict.fromkeys((f"{name}{phase}" for name in "iu" for phase in "abc"), None)
    vectors = {"i_alpha": i.real, "i_beta": i.imag, "u_alpha": u.real, "u_beta": u.imag}
    _, draft, warnings = drafted(samples, tmp_path, **none, **vectors)
    marked = [n for n, line in enumerate(draft.text.splitlines(), 1) if re.match(r"\s*scale: 1\s+# EDIT", line)]
    assert len(marked) == 2
    assert any(f"scale: 1 in lines {marked[0]}, {marked[1]} of" in warning for warning in warnings)


def test_an_impossible_flux_and_other_pole_pairs_are_told(simulation):
    """The speed in another unit scales the flux, and fits as well; pole pairs scale the torque."""
    settings = FitSettings(method="joint", pole_pairs=7)
    sound = fit([simulation.samples], settings=settings)
    assert "large_flux" not in [message.code for message in sound.warnings]
    thousandfold = replace(simulation.samples, u_abc=1e3 * simulation.samples.u_abc, truth=None)
    told = {message.code: message for message in fit([thousandfold], settings=settings).warnings}
    assert told["large_flux"].values["flux"] == pytest.approx(1e3 * np.abs(sound.drive.flux_map.psi).max(), rel=0.3)
    recorded = replace(simulation.samples, truth=simulation.truth)
    told = {message.code: message for message in fit([recorded], settings=settings).warnings}
    assert told["other_pole_pairs"].values == {"given": 7, "recorded": 4}


def test_ticks_of_a_timer_that_starts_again_are_a_time_whose_unit_is_a_guess(samples, tmp_path):
    ticks = (100 * np.arange(len(samples)) + 60_000) % 65_536
    found, draft, warnings = drafted(samples, tmp_path, time_s=None, tick=ticks)
    assert "stamp_bits: 16" in draft.text
    assert "stamp_unit: us" in draft.text
    assert any("stamp_unit: us" in warning for warning in warnings)
    assert np.ptp(found.stamp) == np.ptp(samples.stamp[: len(found)])


def test_rows_that_are_not_in_the_order_of_their_times_are_told(samples, tmp_path):
    """Their angle was said to move as none."""
    order = np.random.default_rng(0).permutation(len(samples))
    path = write_csv(tmp_path / "log.csv", {name: x[order] for name, x in columns(samples).items()})
    found = check(path)
    assert found.draft is None
    assert any("are not in the order of their times, time_s: sort them." in finding for finding in found.findings)


@pytest.mark.parametrize("factor", [np.sqrt(2), 1e-3])
def test_references_in_rms_or_in_milliamperes_are_references(factor, samples, tmp_path):
    """They were said to be missing."""
    wanted = {name: samples.i_dq_reference[:, k] / factor for k, name in enumerate(("id_ref", "iq_ref"))}
    found, draft, _ = drafted(samples, tmp_path, **wanted)
    assert draft.unsure == ()
    assert np.abs(found.i_dq_reference - samples.i_dq_reference[: len(found)]).max() < 1e-3


@pytest.mark.parametrize(
    ("current", "voltage", "said"),
    [
        ("i{}_ma", "u{}_mv", "EDIT: 1, if ma in the name is no unit"), ("cur_mA_{}", "volt_mV_{}", ""),
        ("i_ma[{}]", "u_mv[{}]", "EDIT: 1, if ma in the name is no unit"),
    ],
)  # fmt: skip
def test_units_are_read_wherever_names_have_them(current, voltage, said, samples, tmp_path):
    """In small letters they may be words. The motor was one of some 3000 A."""
    renamed = dict.fromkeys((f"{name}{phase}" for name in "iu" for phase in "abc"), None)
    for name, x in ((current, samples.i_abc), (voltage, samples.u_abc)):
        renamed |= {name.format(k if "[" in name else "abc"[k]): 10 * x[:, k] for k in range(3)}
    found, draft, _ = drafted(samples, tmp_path, **renamed)
    assert np.abs(found.i_abc - 0.01 * samples.i_abc[: len(found)]).max() < 1e-3
    assert np.abs(found.u_abc - 0.01 * samples.u_abc[: len(found)]).max() < 1e-3
    assert ("EDIT" in draft.text) == bool(said)
    assert said in draft.text


@pytest.mark.parametrize(
    ("suffix", "said"),
    [
        (" [V]", "A per V, the unit that their names state"), (" [Arms]", "1.41421, if these are rms"),
        (" [A/10]", "or what ia [A/10] says"), (" (10mV/A)", "or what ia (10mV/A) says"),
        (" (x0.1A)", "or what ia (x0.1A) says"), (" *10", "or what ia *10 says"),
    ],
)  # fmt: skip
def test_currents_in_another_unit_or_with_a_factor_are_a_guess(suffix, said, samples, tmp_path):
    _, draft, warnings = drafted(samples, tmp_path, **phases(samples, "i", suffix))
    assert said in draft.text
    assert "guessed_setting" in [message.code for message in warnings]


def duties(samples, **links):
    """Return duty cycles of a link of 400 V in place of voltages, and columns about these values."""
    rng = np.random.default_rng(0)
    near = {name: value * (1 + 1e-4 * rng.standard_normal(len(samples))) for name, value in links.items()}
    own = {f"drive2_duty_{phase}": 0.5 + x / 400.0 for phase, x in zip("abc", samples.u_abc.T, strict=True)}
    return dict.fromkeys(("ua", "ub", "uc")) | own | near


@pytest.mark.parametrize(
    ("links", "said"),
    [
        ({"Vdc_half": 200.0}, "as its name says: half"), ({"Udc_plus": 200.0, "Udc_minus": -200.0}, "plus"),
        ({"U_24V": 24.1}, "U_24V was taken for the DC link by its values"),
        ({"drive1_udc": 320.0, "drive2_udc": 400.0}, "or drive1_udc, named for a DC link as well"),
    ],
)  # fmt: skip
def test_a_link_that_may_be_another_voltage_is_a_guess(links, said, samples, tmp_path):
    """R and flux were half, silently, or a sixteenth."""
    found, draft, warnings = drafted(samples, tmp_path, **duties(samples, **links))
    assert said in draft.text
    assert "guessed_setting" in [message.code for message in warnings]
    if "drive2_udc" in links:
        off = frames.space_vector(found.u_abc) - frames.space_vector(samples.u_abc[: len(found)])
        assert np.abs(off).max() < 0.5


def test_a_link_that_is_named_leaves_nothing_open(samples, tmp_path):
    _, draft, _ = drafted(samples, tmp_path, **duties(samples, u_dc=400.0))
    assert "EDIT" not in draft.text


@pytest.mark.parametrize("suffix", ["_ff", "_pi", "_hat"])
def test_parts_of_a_voltage_are_not_taken_for_it(suffix, samples, tmp_path):
    others = phases(samples, "u", suffix, 0.9)
    voltages = {f"u{phase}": x for phase, x in zip("abc", samples.u_abc.T, strict=True)}
    _, draft, _ = drafted(samples, tmp_path, **(others | voltages))
    assert "fields: [ua, ub, uc]\n" in draft.text


def test_voltages_that_names_do_not_tell_apart_are_a_guess(samples, tmp_path):
    other = {f"u{phase}2": 0.9 * x for phase, x in zip("abc", samples.u_abc.T, strict=True)}
    _, draft, _ = drafted(samples, tmp_path, **other)
    assert re.search(r"fields: \[ua, ub, uc\] +# EDIT: or ua2, ub2, uc2, named alike", draft.text)


@pytest.mark.parametrize(("unit", "seconds"), [("min", 60.0), ("h", 3600.0)])
def test_a_time_may_be_in_minutes(unit, seconds, samples, tmp_path):
    time = (samples.stamp - samples.stamp[0]) * 1e-9 / seconds
    found, draft, _ = drafted(samples, tmp_path, time_s=None, **{f"Time [{unit}]": time})
    assert found.sample_period == pytest.approx(samples.sample_period, rel=1e-4)
    assert f"stamp_unit: {unit}" in draft.text


def test_a_limit_is_no_temperature_and_fahrenheit_are_converted(samples, tmp_path):
    rng = np.random.default_rng(1)
    celsius = 100.0 + 0.05 * rng.standard_normal(len(samples))
    table = {"T_winding_limit [degC]": np.full(len(samples), 155.0), "Temp_Wdg [°F]": 32 + 1.8 * celsius}
    found, _, _ = drafted(samples, tmp_path, **table)
    assert found.winding_temperature == pytest.approx(celsius[: len(found)], abs=0.01)


def test_columns_of_every_row_are_of_every_row_beside_sparser_ones(samples, tmp_path):
    """The period of the angle was written for all, and the fit refused its own draft."""
    sparse = np.where(np.arange(len(samples)) % 5 == 0, np.mod(samples.angle, 2 * np.pi), np.nan)
    found, draft, _ = drafted(samples, tmp_path, theta=sparse, omega=None)
    assert found.sample_period == pytest.approx(samples.sample_period)
    assert "interpolate: true" in draft.text
    off = frames.wrapped(found.angle - samples.angle[: len(found)])
    assert np.abs(off[10:-10]).max() < 0.01


def test_speed_and_references_are_those_of_the_same_axis(samples, tmp_path):
    """The speed of the other shaft gave eight pole pairs, and its references were rms values."""
    t = np.arange(len(samples)) * samples.sample_period
    own = columns(samples, omega=None)
    axis = {f"R.{name}": own[name] for name in own if name != "time_s"}
    speed = 30 / np.pi / 4 * samples.speed
    other = {"L.speed_rpm": 0.5 * speed, "L.id_ref": own["id_ref"] / 2**0.5, "L.iq_ref": own["iq_ref"] / 2**0.5}
    path = write_csv(tmp_path / "log.csv", {"t": t} | other | axis | {"R.speed_rpm": speed})
    draft = check(path).draft
    assert "fields: [R.id_ref, R.iq_ref]" in draft.text
    assert re.search(r"pole_pairs: 4 +# by R.speed_rpm", draft.text)


def in_milliamperes(path, table):
    """Write currents in mA to a file of a kind that states units beside the names."""
    names, values = list(table), np.column_stack(list(table.values()))
    units = ["s", *["mA"] * 3, *["V"] * 3, "deg"]
    rows = "\n".join("\t".join(f"{x:.9g}" for x in row) for row in values)
    if path.suffix == ".lvm":
        head = "LabVIEW Measurement\nSeparator\tTab\n***End_of_Header***\n\nChannels\t7\n"
        head += "\t".join(["Y_Unit_Label", *units[1:]]) + "\n***End_of_Header***\n"
        path.write_text(head + "\t".join(["X_Value", *names[1:]]) + "\n" + rows + "\n", encoding="ascii")
    elif path.suffix == ".csv":
        head = (
            "Model,MSO58\nHorizontal Units,s,,,,,,\n"
            + ",".join(["Vertical Units", *units[1:]])
            + "\n\n"
            + ",".join(names)
            + "\n"
        )
        path.write_text(head + rows.replace("\t", ",") + "\n", encoding="ascii")
    elif path.suffix == ".parquet":
        import pyarrow as pa
        import pyarrow.parquet as pq

        fields = [pa.field(n, pa.float64(), metadata={"unit": unit}) for n, unit in zip(names, units, strict=True)]
        pq.write_table(pa.Table.from_arrays([pa.array(x) for x in values.T], schema=pa.schema(fields)), path)
    else:
        from scipy.io import savemat

        kind = [(field, object) for field in ("Name", "Data", "Unit")]
        y = np.array(list(zip(names[1:], values.T[1:], units[1:], strict=True)), dtype=kind)
        x = np.array([(names[0], values[:, 0], "s")], dtype=kind)
        savemat(path, {"log": {"X": x, "Y": y}})


@pytest.mark.parametrize("kind", ["lvm", "csv", "parquet", "mat"])
def test_units_beside_the_names_are_read(kind, samples, tmp_path):
    """A motor of 3 A was one of 3000 A, silently."""
    if kind == "parquet":
        pytest.importorskip("pyarrow")
    t = np.arange(len(samples)) * samples.sample_period
    table = {"t": t} | {f"I{phase}": 10 * x for phase, x in zip("uvw", samples.i_abc.T, strict=True)}
    table |= {f"U{phase}": x for phase, x in zip("uvw", samples.u_abc.T, strict=True)}
    path = tmp_path / f"log.{kind}"
    in_milliamperes(path, table | {"theta": np.rad2deg(np.mod(samples.angle, 2 * np.pi))})
    draft = check(path).draft
    found = read_recording(path, parse_signals(draft.text, "the draft")).samples
    assert np.abs(found.i_abc - 0.01 * samples.i_abc[: len(found)]).max() < 1e-3
    assert "EDIT" not in draft.text
