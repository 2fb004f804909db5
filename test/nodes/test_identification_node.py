"""The node ``identification``: live samples, recordings, bad requests, and a fit that is in the way."""

from __future__ import annotations

import shutil
import struct
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from simulated_time import stamp_of

from drive_id.core.fit_settings import FitSettings
from drive_id.errors import DriveIdError
from drive_id.files.storage.bag import open_bag
from drive_id.files.write.writer import write_recording
from drive_id.fitting.fit import fit_bags
from drive_id.fitting.result import load
from drive_id.fitting.sources import Sources

MODULE = "drive_id.nodes.identification"
TOPICS = ("/phase_currents", "/phase_voltages", "/resolver")
I_MAX = 300.0


@pytest.fixture(scope="module")
def node(ros, bag):
    data = ros.folder / "data"
    shutil.copytree(bag, data / "bag")
    folders = {"data_directory": str(data), "output_directory": str(ros.folder / "results")}
    parameters = folders | {"i_max": I_MAX, "method": "joint"}
    return ros.host(MODULE, parameters=parameters)


def messages_of(path):
    """The serialized messages of a recording, by topic, in order."""
    with open_bag(path) as bag:
        return [(message.topic, bytes(message.data)) for message in bag.messages(frozenset(TOPICS))]


LOST = 30.0
"""Time after which publishers that no subscription has met are made anew, s: a busy machine can lose a discovery."""


class Player:
    """Publishes serialized messages as a drive would."""

    def __init__(self, ros, *, namespace=""):
        from drive_id_msgs.msg import PhaseCurrents, PhaseVoltages, Resolver

        from drive_id.nodes.support.qos import STREAM

        self.ros, self.namespace, self.qos = ros, namespace, STREAM
        self.kinds = dict(zip(TOPICS, (PhaseCurrents, PhaseVoltages, Resolver), strict=True))
        self.publishers = {}
        self.open()

    def open(self):
        for topic, kind in self.kinds.items():
            self.publishers[topic] = self.ros.node.create_publisher(kind, self.namespace + topic, self.qos)

    def wait_for_listeners(self):
        begun = [time.monotonic()]

        def heard():
            if time.monotonic() - begun[0] > LOST:
                self.close()
                self.open()
                begun[0] = time.monotonic()
            return all(publisher.get_subscription_count() for publisher in self.publishers.values())

        self.ros.wait(heard, "subscriptions")

    def play(self, messages):
        for topic, data in messages:
            self.publishers[topic].publish(data)

    def close(self):
        for publisher in self.publishers.values():
            self.ros.node.destroy_publisher(publisher)


@pytest.fixture
def player(ros, node):  # noqa: ARG001  # which it plays to
    from drive_id_msgs.srv import Command

    assert ros.call(Command, "/identification/reset").code == "ok"
    player = Player(ros)
    player.wait_for_listeners()
    yield player
    player.close()


def identify_all(ros, samples, node="/identification"):
    """Ask for live samples when so many have arrived on each topic."""
    with Diagnosis(ros, node) as diagnosis:
        diagnosis.wait(lambda *_: min(map(diagnosis.samples, TOPICS)) >= samples, f"{samples} live samples")
    reply = ros.identify(node=node)
    assert reply.report.samples_read >= samples
    return reply


def assert_close(reply, identification, tolerance=1e-9):
    flux_map = identification.flux_map
    scale = np.abs(flux_map.psi_d).max()
    for component in ("d", "q"):
        psi = np.array(getattr(reply.flux_map, f"psi_{component}")).reshape(flux_map.inside.shape)
        np.testing.assert_allclose(psi, getattr(flux_map, f"psi_{component}"), rtol=0, atol=tolerance * scale)
    assert reply.flux_map.resistance == pytest.approx(identification.resistance, rel=tolerance)
    assert reply.flux_map.voltage_error == pytest.approx(identification.voltage_error, rel=tolerance)
    assert reply.flux_map.sigma_resistance == pytest.approx(identification.sigma_resistance, rel=1e-6)
    np.testing.assert_array_equal(reply.flux_map.inside, flux_map.inside.ravel())
    report = identification.report
    assert (reply.report.samples_read, reply.report.samples_used, reply.report.rows, reply.report.gaps) == (
        report.samples_read, report.samples_used, report.rows, report.gaps
    )  # fmt: skip
    assert reply.report.coverage == reply.flux_map.coverage == pytest.approx(report.coverage)
    assert share_of_the_disc(reply.flux_map) == pytest.approx(report.coverage, abs=0.03)
    assert reply.flux_map.i_max == identification.i_max
    assert list(reply.flux_map.warnings) == list(reply.report.warnings)
    found = identification.calibrations
    for message in (reply.report, reply.flux_map):
        assert list(message.calibration_names) == [entry.name for entry in found]
        assert list(message.calibration_units) == [entry.unit for entry in found]
        assert list(message.calibration_applied) == [entry.applied for entry in found]
        assert message.calibration_values == pytest.approx([entry.value for entry in found], rel=1e-4, abs=1e-6)
    assert list(reply.flux_map.harmonic_orders) == [harmonic.order for harmonic in flux_map.harmonics]
    for name in ("psi_d_cos", "psi_d_sin", "psi_q_cos", "psi_q_sin"):
        sent = np.array(getattr(reply.flux_map, f"harmonic_{name}")).reshape(-1, *flux_map.inside.shape)
        for amplitude, harmonic in zip(sent, flux_map.harmonics, strict=True):
            np.testing.assert_allclose(amplitude, getattr(harmonic, name), rtol=0, atol=tolerance * scale)


def share_of_the_disc(message):
    """The share of the nodes in the disc that are inside."""
    i_d, i_q = np.meshgrid(message.i_d, message.i_q, indexing="ij")
    disc = np.hypot(i_d, i_q) <= message.i_max
    return np.array(message.inside).reshape(disc.shape)[disc].mean()


def test_live_samples_give_what_the_bag_of_them_gives(ros, player, bag, simulation):
    """They all come before the node looks at the first one, as if it had been held up: none is lost."""
    player.play(messages_of(bag))
    live = identify_all(ros, 20_000)
    assert (live.success, live.code) == (True, "ok"), live.message
    assert not [warning for warning in live.report.warnings if "dropped" in warning]
    offline = fit_bags(Sources([bag]), None, FitSettings("joint", i_max=I_MAX))
    assert_close(live, offline.drive)
    recorded = ros.identify("bag")
    assert (recorded.success, recorded.code) == (True, "ok"), recorded.message
    assert_close(recorded, offline.drive)
    assert recorded.report.mad_d == pytest.approx(offline.drive.report.mad_d, rel=1e-9)
    assert recorded.flux_map.machine == "ipm"
    for reply in (live, recorded):
        assert reply.flux_map.header.frame_id == "drive"
        assert {path.name for path in Path(reply.output).iterdir()} == {
            "identification.json", "flux_map.npz", "diagnostics.npz"
        }  # fmt: skip
        assert len(reply.flux_map.inverter_current) == len(reply.flux_map.inverter_voltage) > 0
    last = int(simulation.samples.stamp[-1])
    stamp = live.flux_map.header.stamp
    assert stamp.sec * 10**9 + stamp.nanosec == last
    assert live.output != recorded.output
    assert Path(live.output).parent == ros.folder / "results"


def test_the_method_of_a_request(ros, player, bag):
    player.play(messages_of(bag))
    identify_all(ros, 20_000)
    live, recorded = ros.identify(method="psm"), ros.identify("bag", method="psm")
    assert live.flux_map.method == recorded.flux_map.method == "psm"
    assert live.flux_map.resistance == pytest.approx(recorded.flux_map.resistance, rel=1e-9)
    assert live.flux_map.voltage_error == 0
    assert len(live.flux_map.inverter_current) == 0


def test_a_request_names_the_machine_and_its_recording(ros, player, bag):
    player.play(messages_of(bag))
    identify_all(ros, 20_000)
    from drive_id.nodes.support.replies import NAMES

    names = {"machine": "motor A", "serial": "17", "bench": "B 2", "operator": "A. N. Other", "notes": "cold"}
    request = {NAMES[name]: text for name, text in names.items()}
    for reply in (ros.identify(**request), ros.identify("bag", **request)):
        assert reply.flux_map.machine == "motor A"
        known = load(reply.output).provenance
        assert known.machine == "motor A"
        assert {name: getattr(known.settings, name) for name in names} == names
    unnamed = ros.identify()
    assert (unnamed.flux_map.machine, load(unnamed.output).provenance.settings.serial) == ("", "")


def test_method_full_needs_what_only_it_gathers(ros, player, bag):
    player.play(messages_of(bag))
    identify_all(ros, 20_000)
    live = ros.identify(method="full")
    assert (live.success, live.code) == (False, "configuration")
    assert "accumulated for method joint" in live.message


def test_pictures_are_drawn_for_whom_wants_them(ros, bag):
    folders = {"data_directory": str(bag.parent), "output_directory": str(ros.folder / "drawn")}
    node = ros.host(MODULE, parameters=folders | {"method": "psm", "picture": True}, namespace="/drawing")
    reply = ros.identify(bag.name, node="/drawing/identification")
    assert {path.name for path in Path(reply.output).glob("*.png")} == {"flux_map.png", "diagnostics.png"}
    node.end()


def test_a_node_of_defaults_fits_by_method_full_and_serves_the_others(ros, bag, fitted_in_full):
    node = "/desk/identification"
    folders = {"data_directory": str(bag.parent), "output_directory": str(ros.folder / "desk")}
    process = ros.host(MODULE, parameters=folders | {"i_max": I_MAX}, namespace="/desk")
    player = Player(ros, namespace="/desk")
    player.wait_for_listeners()
    player.play(messages_of(bag))
    live = identify_all(ros, 20_000, node)
    assert live.success, live.message
    assert live.flux_map.method == "full"
    assert_close(live, fitted_in_full, tolerance=1e-6)
    assert (Path(live.output) / "harmonics.npz").exists()
    assert len(live.flux_map.harmonic_orders) > 0
    for method in ("joint", "psm"):
        assert ros.identify(method=method, node=node).flux_map.method == method
    player.close()
    process.end()


@pytest.mark.usefixtures("player")
def test_bad_requests_are_answered_and_the_node_goes_on(ros):
    outside = ros.folder / "outside"
    outside.mkdir()
    (ros.folder / "data" / "link").symlink_to(outside)
    (ros.folder / "data" / "empty").mkdir()
    (ros.folder / "data" / "text.mcap").write_text("nothing of the kind")
    cases = [
        (["missing"], "", "not_a_bag"),
        (["../outside"], "", "configuration"),
        ([str(outside)], "", "configuration"),
        (["/etc/passwd"], "", "configuration"),
        (["link"], "", "configuration"),
        ([""], "", "configuration"),
        (["a\nb" * 300], "", "not_a_bag"),
        (["empty"], "", "not_a_bag"),
        (["text.mcap"], "", "not_a_bag"),
        (["bag", "bag"], "", "configuration"),
        (["bag"], "best", "configuration"),
        ([], "best", "configuration"),
        ([], "", "empty_topic"),
    ]
    for bags, method, code in cases:
        reply = ros.identify(*bags, method=method)
        assert (reply.success, reply.code) == (False, code), (bags, method, reply.message)
        assert reply.message.endswith((".", "?"))
        assert "\n" not in reply.message
        assert len(reply.flux_map.psi_d) == 0
        assert reply.output == ""
    assert ros.identify("bag").success


class Diagnosis:
    """What the node says on ``/diagnostics`` while somebody is interested."""

    def __init__(self, ros, name="/identification"):
        self.ros, self.name = ros, name
        self.status, self.values = None, {}

    def __enter__(self):
        from diagnostic_msgs.msg import DiagnosticArray

        self.subscription = self.ros.node.create_subscription(DiagnosticArray, "/diagnostics", self._hear, 10)
        return self

    def __exit__(self, *_):
        self.ros.node.destroy_subscription(self.subscription)

    def _hear(self, array):
        for status in array.status:
            if status.name == self.name:
                self.status = status
                self.values = {value.key: value.value for value in status.values}

    def samples(self, topic):
        namespace = self.name.rpartition("/")[0]
        return int(self.values.get(f"{namespace}{topic}: samples", 0))

    def wait(self, condition, what):
        """Wait until status and values meet a condition."""
        self.what = what
        self.ros.wait(lambda: self.status is not None and condition(self.status, self.values), self)

    def __str__(self):
        """Tell what was awaited and what the node says instead, when a wait fails."""
        return f"{self.what}; {self.name} says {self.status and self.status.message!r}: {self.values}"


def test_only_currents_so_far(ros, player, bag):
    player.play([message for message in messages_of(bag) if message[0] == TOPICS[0]])
    with Diagnosis(ros) as diagnosis:
        diagnosis.wait(lambda _, values: values["/phase_currents: samples"] == "20000", "all currents")
    reply = ros.identify()
    assert reply.code == "empty_topic"
    assert "/phase_voltages" in reply.message


def test_garbage_and_foreign_types_do_no_harm(ros, player, bag):
    player.play([(topic, b"\x00\x01\x00\x00" + bytes(range(40))) for topic in TOPICS])
    player.play(messages_of(bag))
    reply = identify_all(ros, 20_000)
    assert reply.success
    assert reply.report.gaps == 0


@pytest.mark.usefixtures("node")
def test_a_late_joiner_gets_the_map_and_its_points(ros):
    from drive_id_msgs.msg import FluxMap
    from sensor_msgs.msg import PointCloud2

    from drive_id.nodes.support.qos import LATCHED

    reply = ros.identify("bag")
    got, clouds = [], []
    subscriptions = [
        ros.node.create_subscription(FluxMap, "/flux_map", got.append, LATCHED),
        ros.node.create_subscription(PointCloud2, "/flux_map_points", clouds.append, LATCHED),
    ]
    ros.wait(lambda: got and clouds, "the map and its points")
    for subscription in subscriptions:
        ros.node.destroy_subscription(subscription)
    assert got[-1].psi_q == reply.flux_map.psi_q
    assert got[-1].header == reply.flux_map.header
    cloud, sent = clouds[-1], reply.flux_map
    assert cloud.header == sent.header
    assert (cloud.height, cloud.width) == (len(sent.i_d), len(sent.i_q))
    names = [field.name for field in cloud.fields]
    assert {"x", "y", "z", "i_d", "i_q", "psi_d", "psi_q", "sigma", "coverage"} == set(names)
    assert {(field.datatype, field.count) for field in cloud.fields} == {(7, 1)}  # FLOAT32
    assert len(cloud.data) == cloud.row_step * cloud.height
    for j, k in ((0, 0), (20, 41), (32, 32), (47, 11)):
        at = j * cloud.row_step + k * cloud.point_step
        point = {f.name: struct.unpack_from("<f", cloud.data, at + f.offset)[0] for f in cloud.fields}
        index = j * len(sent.i_q) + k
        assert point["i_d"] == pytest.approx(sent.i_d[j])
        assert point["i_q"] == pytest.approx(sent.i_q[k])
        assert point["x"] == pytest.approx(sent.i_d[j] / I_MAX)
        assert point["y"] == pytest.approx(sent.i_q[k] / I_MAX)
        assert point["psi_d"] == pytest.approx(sent.psi_d[index])
        assert point["psi_q"] == pytest.approx(sent.psi_q[index])
        assert point["coverage"] == float(sent.inside[index])
        sigma = np.hypot(sent.sigma_d[index], sent.sigma_q[index])
        assert point["sigma"] == pytest.approx(sigma, rel=1e-5, nan_ok=True)


def test_operating_points_are_those_of_the_samples(ros, player, bag, simulation):
    from drive_id_msgs.msg import OperatingPoint

    from drive_id.nodes.support.qos import STREAM

    got = []
    subscription = ros.node.create_subscription(OperatingPoint, "/operating_point", got.append, STREAM)
    ros.wait(lambda: ros.node.count_publishers("/operating_point"), "the publisher")
    messages = messages_of(bag)
    position = 0

    def play():  # 0.1 s of the drive at a time, until some are seen
        nonlocal position
        player.play(messages[position : position + 30])
        position = min(position + 30, len(messages))
        return position == len(messages)

    ros.wait(play, "all blocks")
    ros.wait(lambda: got and stamp_of(got[-1]) > simulation.samples.stamp[-300], "the last point")
    ros.node.destroy_subscription(subscription)
    stamps = np.array([stamp_of(point) for point in got])
    assert len(stamps) > 20
    assert np.diff(stamps).min() > 0
    assert len(stamps) <= 102  # 50 a second for two seconds
    index = np.searchsorted(simulation.samples.stamp, stamps)
    np.testing.assert_array_equal(simulation.samples.stamp[index], stamps)
    i_abc, angle = simulation.samples.i_abc[index], simulation.samples.angle[index]
    turned = i_abc @ np.exp(2j * np.pi / 3 * np.arange(3)) * 2 / 3 * np.exp(-1j * angle)
    np.testing.assert_allclose([point.i_d for point in got], turned.real, atol=1e-2)
    np.testing.assert_allclose([point.i_q for point in got], turned.imag, atol=1e-2)
    np.testing.assert_allclose([point.speed for point in got], simulation.samples.speed[index], rtol=1e-5)


def test_a_second_request_is_told_that_the_node_is_busy_and_no_sample_is_lost_meanwhile(ros, player, simulation):
    """Blocks of 10 at full rate, 3000 messages a second, while bags are fitted and pictures drawn."""
    samples = replace(simulation.samples, stamp=simulation.samples.stamp + 10**18)
    path = ros.folder / "blocks_of_ten"
    write_recording(path, samples, block_size=10)
    messages = messages_of(path)
    with Diagnosis(ros) as diagnosis:
        fits = Fits(ros, diagnosis)
        start = time.monotonic()
        for k, (topic, data) in enumerate(messages):
            player.publishers[topic].publish(data)
            if k % 30 == 29:
                due = start + (k + 1) / 3000  # as a drive does
                ros.wait(
                    lambda due=due, sent=(k + 1) * 10 // 3: (
                        time.monotonic() >= due and sent - min(map(diagnosis.samples, TOPICS)) < 9000
                    ),
                    "a node that keeps up: a topic holds 1000 messages",
                )
                fits.go_on(again=k < 5000)
        ros.wait(lambda: fits.go_on(again=False), "the last fit")
        assert all(reply.success for reply in fits.replies)
        assert fits.busy == len(fits.replies) > 0
        assert fits.in_time == fits.busy
        assert fits.accompanied > 0
    reply = identify_all(ros, len(samples))
    assert reply.success
    assert (reply.report.samples_read, reply.report.gaps) == (len(samples), 0)
    assert not any("missing" in warning for warning in reply.report.warnings)


class Fits:
    """One fit of a recording after another, and during each a second request."""

    def __init__(self, ros, diagnosis):
        self.ros, self.diagnosis = ros, diagnosis
        self.replies, self.busy = [], 0
        self.in_time = 0  # second requests that were answered before the first one
        self.accompanied = 0  # fits during which live samples were taken
        self._pending = None

    def go_on(self, *, again):
        """Look after the fit, and begin another one if wanted; tell whether none is under way."""
        from drive_id_msgs.srv import Identify

        if self._pending is not None and self._pending.done() and self._second.done():
            self.replies.append(self._pending.result())
            self.busy += self._second.result().code == "busy"
            self.in_time += self._order[0] == "second"
            self.accompanied += self.diagnosis.samples(TOPICS[0]) > self._before
            self._pending = None
        if self._pending is None and again:
            name = "/identification/identify"
            self._before, self._order = self.diagnosis.samples(TOPICS[0]), []
            self._pending = self.ros.call_async(Identify, name, bags=["bag"])
            self._second = self.ros.call_async(Identify, name)
            self._pending.add_done_callback(lambda _, order=self._order: order.append("first"))
            self._second.add_done_callback(lambda _, order=self._order: order.append("second"))
        return self._pending is None


def test_diagnostics_tell_of_losses(ros, player, bag):
    messages = messages_of(bag)
    del messages[150:153]
    player.play(messages)
    identify_all(ros, 19_000)

    def told(status, values):
        lost = [values[f"{topic}: samples lost"] for topic in TOPICS]
        return lost == ["100"] * 3 and "are missing in 1 place" in status.message and status.level == b"\x01"

    with Diagnosis(ros) as diagnosis:
        diagnosis.wait(told, "a warning of the loss")


def test_settings_of_the_fit_can_change_and_nonsense_is_refused(ros, player, bag):
    from rcl_interfaces.srv import GetParameters

    def set_parameter(name, value):
        return ros.set_parameters("/identification", **{name: value})

    player.play(messages_of(bag))
    identify_all(ros, 20_000)
    assert set_parameter("method", "psm").successful
    reply = ros.identify()
    assert (reply.success, reply.flux_map.method, reply.report.samples_read) == (True, "psm", 20_000)
    assert set_parameter("method", "joint").successful
    nonsense = {"i_max": -1.0, "splines_d": 2, "data_directory": "/"}
    for name, value in (("method", "best"), ("method", "static"), *nonsense.items()):
        assert not set_parameter(name, value).successful, name
    assert set_parameter("splines_d", 9).successful
    assert ros.identify().code == "empty_topic"  # the samples are forgotten
    assert set_parameter("splines_d", 8).successful
    value = ros.call(GetParameters, "/identification/get_parameters", names=["i_max"]).values[0]
    assert value.double_value == I_MAX


@pytest.mark.process
def test_a_fit_does_not_hold_up_the_end(ros, bag):
    """Splines of 32 x 32 keep the solver at work for a long time."""
    from drive_id_msgs.srv import Identify

    results = ros.folder / "results_of_other"
    parameters = {
        "data_directory": str(bag.parent), "output_directory": str(results), "splines_d": 32, "splines_q": 32,
        "i_max": I_MAX, "method": "joint",
    }  # fmt: skip
    process = ros.start(MODULE, parameters=parameters, namespace="/other")
    future = ros.call_async(Identify, "/other/identification/identify", bags=[bag.name])
    with Diagnosis(ros, "/other/identification") as diagnosis:
        diagnosis.wait(lambda status, _: "Solving" in status.message, "the solver")
        assert diagnosis.status.message.startswith("Solving. ")  # without a percentage
    assert ros.identify(node="/other/identification").code == "busy"
    assert not future.done()
    assert process.interrupt()[0] == 0, process.output
    assert not results.exists()  # nobody waited for the fit
    assert "Traceback" not in process.output


@pytest.mark.parametrize(
    ("name", "value", "words"), [("i_max", -1.0, "i_max"), ("method", "static", "Method static fits operating points")]
)
def test_nonsense_at_start_is_one_sentence(ros, name, value, words):
    from rclpy.exceptions import ParameterException

    with pytest.raises((DriveIdError, ParameterException), match=words):
        ros.host(MODULE, parameters={name: value}, namespace="/fourth")
