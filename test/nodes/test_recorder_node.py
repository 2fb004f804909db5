"""The node ``recorder``: recordings by service, counts, publishers that do not fit, disks, and its end."""

from __future__ import annotations

import errno
import os
import resource
import shutil
import signal
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from recorder_blocks import PERIOD, START, TOPICS, block, metadata, stock_messages
from ros_bench import DEADLINE, ros_bench
from rosbags.rosbag2 import Reader

from drive_id.files.read.several import read_recording
from drive_id.files.write.recover import recover_bag

MODULE = "drive_id.nodes.recorder"


@pytest.fixture
def ros():
    with ros_bench() as bench:
        yield bench


class Bench:
    """Publishes blocks on the four topics from the test's own node, once somebody listens."""

    def __init__(self, ros, *, namespace="", best_effort=()):
        from drive_id_msgs import msg

        from drive_id.nodes.support.qos import STREAM, STREAM_BEST_EFFORT

        self.ros = ros
        self.next = 0
        self.publishers = {}
        for topic in TOPICS:
            kind = getattr(msg, topic.type_name.rsplit("/", 1)[-1])
            qos = STREAM_BEST_EFFORT if topic.name in best_effort else STREAM
            self.publishers[topic.name] = ros.node.create_publisher(kind, namespace + topic.name, qos)

    def wait_for_listeners(self):
        publishers = self.publishers.values()
        self.ros.wait(lambda: all(p.get_subscription_count() for p in publishers), "the recorder's subscriptions")

    def wait_until_delivered(self):
        """Wait until the recorder has acknowledged everything; it need not have looked at it yet."""
        from rclpy.duration import Duration

        for publisher in self.publishers.values():
            assert publisher.wait_for_all_acked(Duration(seconds=DEADLINE))

    def publish(self, count, *, size=100, lose=()):
        for _ in range(count):
            for topic in TOPICS:
                if (self.next, topic.name) not in lose and topic.name in self.publishers:
                    self.publishers[topic.name].publish(block(topic.type_name, self.next * size, size))
            self.next += 1


class Recorder:
    """The node, in a process of its own or not, and what it says on ``/diagnostics``."""

    def __init__(self, ros, *, namespace="", process=False, **parameters):
        from diagnostic_msgs.msg import DiagnosticArray

        self.ros = ros
        self.name = f"{namespace}/recorder"
        self.data = ros.folder / "data"
        self.status = None
        self.subscription = ros.node.create_subscription(DiagnosticArray, "/diagnostics", self._hear, 10)
        parameters = {"data_directory": str(self.data), **parameters}
        self.node = (ros.start if process else ros.host)(MODULE, parameters=parameters, namespace=namespace)

    def _hear(self, array):
        for status in array.status:
            if status.name == self.name:
                self.status = status

    def start(self, name=""):
        from drive_id_msgs.srv import StartRecording

        return self.ros.call(StartRecording, f"{self.name}/start", name=name)

    def stop(self):
        from drive_id_msgs.srv import StopRecording

        reply = self.ros.call(StopRecording, f"{self.name}/stop")
        while "call stop again" in reply.message:  # the disk is slow
            reply = self.ros.call(StopRecording, f"{self.name}/stop")
        return reply

    def set(self, name, value):
        assert self.ros.set_parameters(self.name, **{name: value}).successful

    def wait_for_status(self, text, level=None):
        """Wait for a status that contains the text."""

        def fits():
            if self.status is None or level not in (None, ord(self.status.level)):
                return False
            assert self.status.message.count(". ") <= 1, "at most two sentences"
            return any(text in said for said in (self.status.message, *(v.value for v in self.status.values)))

        self.ros.wait(fits, f"'{text}' in diagnostics (now: {self.status and self.status.message})")
        return {value.key: value.value for value in self.status.values}

    def wait_for_samples(self, **samples):
        """Wait until so many samples are written, by topic."""

        def fits():
            values = {value.key: value.value for value in self.status.values} if self.status else {}
            return all(values.get(f"/{name}: samples written") == str(count) for name, count in samples.items())

        self.ros.wait(fits, f"{samples} written")


def contents(path):
    return sorted((topic, data) for topic, _, data in stock_messages(path))


def test_a_recording_by_service(ros):
    recorder, bench = Recorder(ros), Bench(ros)
    reply = recorder.stop()
    assert (reply.success, reply.message) == (False, "Nothing is being recorded: start a recording first.")
    bench.wait_for_listeners()
    bench.publish(20)  # before the start: not recorded, and not lost
    bench.wait_until_delivered()
    reply = recorder.start("first")
    assert reply.success, reply.message
    assert reply.uri == str(recorder.data / "first")
    again = recorder.start("second")
    assert (again.success, again.uri) == (False, "")
    assert "first is being recorded: stop it first" in again.message
    bench.publish(50)
    recorder.wait_for_samples(phase_currents=5000, phase_voltages=5000, resolver=5000, current_reference=5000)
    assert recorder.wait_for_status("Recording")["samples dropped"] == "0"
    reply = recorder.stop()
    assert reply.success, reply.message
    assert (reply.samples, reply.dropped, reply.uri) == (5000, 0, str(recorder.data / "first"))
    assert reply.duration == pytest.approx(0.4999, abs=1e-9)
    expected = [(topic.name, block(topic.type_name, number * 100)) for topic in TOPICS for number in range(20, 70)]
    assert contents(recorder.data / "first") == sorted(expected)
    assert not (recorder.data / "second").exists()
    assert "Recording" in recorder.node.output


def test_a_recording_holds_what_arrived_between_start_and_stop(ros):
    """Even what the executor comes to only after the request."""
    from drive_id_msgs.srv import StartRecording, StopRecording

    recorder, bench = Recorder(ros), Bench(ros)
    bench.wait_for_listeners()

    def ask(kind, service, **fields):
        """Ask, and publish before the executor has come to it."""
        future = ros.call_async(kind, f"/recorder/{service}", **fields)
        bench.publish(10)
        bench.wait_until_delivered()
        ros.wait(future.done, service)
        return future.result()

    assert ask(StartRecording, "start", name="bag").success
    first = bench.next
    bench.publish(50)
    reply = ask(StopRecording, "stop")
    assert (reply.success, reply.samples, reply.dropped) == (True, 6000, 0), reply.message
    expected = [(topic.name, block(topic.type_name, (first + k) * 100)) for topic in TOPICS for k in range(60)]
    assert contents(recorder.data / "bag") == sorted(expected)


def test_names_are_confined(ros):
    recorder = Recorder(ros)
    (recorder.data / "there").mkdir(parents=True)
    for name, said in (
        ("../out", "is not a name"), ("/tmp/out", "is not a name"), ("a/b", "is not a name"),
        ("there", "exists already"),
    ):  # fmt: skip
        reply = recorder.start(name)
        assert (reply.success, reply.uri) == (False, "")
        assert said in reply.message
    reply = recorder.start()
    assert reply.success
    assert Path(reply.uri).parent == recorder.data
    assert Path(reply.uri).name.startswith("recording_")
    reply = recorder.stop()
    assert (reply.success, reply.code, reply.samples) == (False, "no_message", 0)
    assert "nothing came on /phase_currents" in reply.message


def test_losses_and_silence_are_told(ros):
    recorder, bench = Recorder(ros, silence=0.5, max_file_duration=1e-3), Bench(ros)
    bench.wait_for_listeners()
    assert recorder.start("bag").success
    recorder.wait_for_status("No message has come on /resolver yet", 1)
    bench.publish(30, lose={(7, "/resolver"), (8, "/resolver"), (20, "/phase_voltages")})
    values = recorder.wait_for_status("Lost 200 samples of /resolver in 1 place", 1)
    assert values["/phase_voltages: samples lost"] == "100"
    recorder.wait_for_status("No message has come on /phase_currents for", 1)
    reply = recorder.stop()
    assert (reply.success, reply.samples, reply.dropped) == (True, 3000, 300)
    assert "these samples were lost: 100 of /phase_voltages, 200 of /resolver" in reply.message
    information = metadata(recorder.data / "bag")
    assert information["custom_data"]["samples_lost:/resolver"] == "200"
    assert len(information["relative_file_paths"]) > 1  # split by duration
    assert any("missing in 1 place" in text for text in read_recording(recorder.data / "bag").warnings)


@pytest.fixture
def stranger(ros):
    """A node that is apart from the test's own, as if in another process."""
    from rclpy.context import Context
    from rclpy.node import Node

    context = Context()
    context.init(args=[], domain_id=int(ros.environment["ROS_DOMAIN_ID"]))
    node = Node("stranger", context=context)
    yield node
    node.destroy_node()
    context.try_shutdown()


def test_publishers_that_do_not_fit_are_named(ros, stranger):
    from std_msgs.msg import String

    from drive_id.nodes.support.qos import STREAM

    wrong = stranger.create_publisher(String, "/current_reference", STREAM)
    bench = Bench(ros, best_effort={"/resolver"})
    ros.node.destroy_publisher(bench.publishers.pop("/current_reference"))
    recorder = Recorder(ros)
    bench.wait_for_listeners()
    said = "/stranger publishes std_msgs/msg/String on /current_reference instead of drive_id_msgs"
    recorder.wait_for_status(said, 2)
    recorder.wait_for_status("/test_bench offers /resolver as best effort only", 2)
    assert recorder.start("bag").success
    bench.publish(5)
    recorder.wait_for_samples(resolver=500, phase_currents=500)
    assert recorder.stop().success
    with Reader(recorder.data / "bag") as reader:
        qos = {c.topic: c.ext.offered_qos_profiles[0].reliability.name for c in reader.connections}
    assert qos["/resolver"] == "BEST_EFFORT"
    assert qos["/phase_currents"] == "RELIABLE"
    stranger.destroy_publisher(wrong)
    recorder.wait_for_status("Not recording. /test_bench offers /resolver", 1)


def test_an_optional_signal_that_joins_a_running_recording(ros):
    """Whoever publishes it comes late; the other three are not missed. Its block is one that rclpy has serialized."""
    from drive_id_msgs.msg import ScalarSamples

    from drive_id.nodes.support.qos import STREAM

    recorder, bench = Recorder(ros), Bench(ros)
    bench.wait_for_listeners()
    assert recorder.start("bag").success
    bench.publish(50)
    recorder.wait_for_samples(phase_currents=5000)
    recorder.wait_for_status("Recording", 0)
    thermometer = ros.node.create_publisher(ScalarSamples, "/winding_temperature", STREAM)
    ros.wait(thermometer.get_subscription_count, "the recorder's subscription")
    message = ScalarSamples(first_sample=7, sample_period=0.25, value=[40.0, 41.0])
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(START, 10**9)
    thermometer.publish(message)
    recorder.wait_for_samples(winding_temperature=2)
    bench.publish(50)
    bench.wait_until_delivered()
    reply = recorder.stop()
    assert (reply.success, reply.samples, reply.dropped) == (True, 10_000, 0), reply.message
    assert "nothing came on" not in reply.message
    with Reader(recorder.data / "bag") as reader:
        assert {c.topic for c in reader.connections} == {*(topic.name for topic in TOPICS), "/winding_temperature"}
    samples = read_recording(recorder.data / "bag").samples
    expected = np.minimum(40 + 4 * PERIOD * np.arange(10_000), 41.0)
    np.testing.assert_allclose(samples.winding_temperature, expected, rtol=1e-6)


def test_a_namespace(ros):
    recorder, bench = Recorder(ros, namespace="/drive_1"), Bench(ros, namespace="/drive_1")
    other = Bench(ros)
    bench.wait_for_listeners()
    assert recorder.start("bag").success
    other.publish(3)
    bench.publish(4)
    bench.wait_until_delivered()
    assert recorder.stop().success
    messages = stock_messages(recorder.data / "bag")
    assert len(messages) == 16
    assert {topic for topic, _, _ in messages} == {f"/drive_1{topic.name}" for topic in TOPICS}


def test_a_clock_that_is_not_there_or_stops(ros):
    """As rosbag2 does, nothing is recorded without a clock; one that stops is told at once and at the end."""
    from rosgraph_msgs.msg import Clock

    recorder, bench = Recorder(ros, use_sim_time=True, flush_period=0.1), Bench(ros)
    bench.wait_for_listeners()
    reply = recorder.start("none")
    assert (reply.success, reply.uri) == (False, "")
    assert "nobody publishes /clock" in reply.message
    assert not (recorder.data / "none").exists()
    clock = ros.node.create_publisher(Clock, "/clock", 10)
    message = Clock()

    def started():
        message.clock.sec += 1
        clock.publish(message)
        return recorder.start("bag").success

    ros.wait(started, "a start by the clock")
    bench.publish(5)
    recorder.wait_for_status("The clock has stood still for", 2)
    bench.publish(5)
    recorder.wait_for_samples(phase_currents=1000)
    reply = recorder.stop()
    assert "The clock stood still for" in reply.message
    with Reader(recorder.data / "bag") as reader:
        times = {stamp for _, stamp, _ in reader.messages()}
    assert 0 not in times
    assert len(times) == 1


def test_further_topics_of_any_type_with_their_definitions(ros):
    """One of before the recording (transient local), one that comes up during it, one that nobody publishes."""
    from geometry_msgs.msg import TransformStamped
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    from sensor_msgs.msg import Temperature

    from drive_id.nodes.support.qos import LATCHED, STREAM

    mount = ros.node.create_publisher(TransformStamped, "/mount", LATCHED)
    transform = TransformStamped(child_frame_id="motor")
    transform.transform.translation.z = 0.25
    mount.publish(transform)
    recorder, bench = Recorder(ros, extra_topics=["mount", "/resolver", "motor/temperature", "/nobody"]), Bench(ros)
    bench.wait_for_listeners()
    ros.wait(mount.get_subscription_count, "the recorder's subscription")
    recorder.wait_for_status("Nobody publishes the extra topic /nobody", 1)
    assert recorder.start("bag").success
    bench.publish(20)
    thermometer = ros.node.create_publisher(Temperature, "/motor/temperature", STREAM)
    ros.wait(thermometer.get_subscription_count, "the recorder's subscription")
    for number in range(5):
        thermometer.publish(Temperature(temperature=40.0 + number))
    recorder.wait_for_samples(phase_currents=2000, resolver=2000)
    reply = recorder.stop()
    assert (reply.success, reply.samples, reply.dropped) == (True, 2000, 0), reply.message
    store, values = get_typestore(Stores.EMPTY), {"/mount": [], "/motor/temperature": []}
    with Reader(recorder.data / "bag") as reader:
        kinds = {connection.topic: connection.msgtype for connection in reader.connections}
        for connection in reader.connections:
            new = get_types_from_msg(connection.msgdef.data, connection.msgtype)
            store.register({name: kind for name, kind in new.items() if name not in store.types})
            assert connection.digest == store.hash_rihs01(connection.msgtype), connection.topic
        for connection, _, data in reader.messages():
            if connection.topic in values:
                values[connection.topic].append(store.deserialize_cdr(data, connection.msgtype))
    assert kinds["/mount"] == "geometry_msgs/msg/TransformStamped"
    assert [message.transform.translation.z for message in values["/mount"]] == [0.25]
    assert [message.temperature for message in values["/motor/temperature"]] == [40.0, 41.0, 42.0, 43.0, 44.0]
    assert "/nobody" not in kinds
    result = ros.set_parameters("/recorder", extra_topics=["what is this?"])
    assert not result.successful
    assert "not the name of a topic" in result.reason


def test_pause_resume_and_split(ros):
    from drive_id_msgs.srv import Command

    def ask(name):
        return ros.call(Command, f"/recorder/{name}")

    recorder, bench = Recorder(ros), Bench(ros)
    bench.wait_for_listeners()
    for name in ("pause", "resume", "split_bagfile"):
        reply = ask(name)
        assert (reply.success, reply.code) == (False, "not_recording")
        assert "start a recording first" in reply.message
    assert recorder.start("bag").success
    for paused in (False, True, False):
        if paused:
            assert ask("pause").code == "ok"
            assert ask("pause").success
        bench.publish(10)
        bench.wait_until_delivered()
        if paused:
            recorder.wait_for_status("Paused", 0)
            assert ask("resume").code == "ok"
            assert ask("split_bagfile").code == "ok"
    recorder.wait_for_samples(phase_currents=2000)
    assert ask("split_bagfile").success  # nothing follows
    reply = recorder.stop()
    assert (reply.success, reply.samples, reply.dropped) == (True, 2000, 0), reply.message
    numbers = [*range(10), *range(20, 30)]
    expected = [(topic.name, block(topic.type_name, number * 100)) for topic in TOPICS for number in numbers]
    assert contents(recorder.data / "bag") == sorted(expected)
    files = sorted(path.name for path in (recorder.data / "bag").glob("*.mcap"))
    assert files == ["bag_0.mcap", "bag_1.mcap"]
    with Reader(recorder.data / "bag") as reader:
        assert reader.message_count == 80


# -- ends ----------------------------------------------------------------------------------------------------------


@pytest.mark.process
def test_a_full_disk(ros):
    recorder, bench = Recorder(ros, process=True, chunk_size=8192, flush_period=0.1), Bench(ros)
    bench.wait_for_listeners()
    no_disk = os.strerror(errno.EFBIG)
    for limit in (155_000, 158_000, 161_000):
        name = f"bag_{limit}"
        assert recorder.start(name).success
        resource.prlimit(recorder.node.popen.pid, resource.RLIMIT_FSIZE, (limit, 10**9))
        recorder.status = None
        bench.publish(300)
        recorder.wait_for_status(no_disk, 2)
        resource.prlimit(recorder.node.popen.pid, resource.RLIMIT_FSIZE, (10**9, 10**9))
        reply = recorder.stop()
        assert not reply.success
        assert f"cannot be written ({no_disk})" in reply.message
        if "complete it with 'drive-id recover'" not in reply.message:
            break  # else the last record happened to end so near the limit that the end mark had no room: one in 200
    assert "complete and readable" in reply.message
    assert 0 < reply.samples < 30000
    topics = [topic for topic, _ in contents(recorder.data / name)]
    assert topics.count("/phase_currents") * 100 == reply.samples
    assert len(read_recording(recorder.data / name).samples) > 0
    assert recorder.stop().message.startswith("Nothing is being recorded")
    assert recorder.start("next").success
    bench.publish(2)
    recorder.wait_for_samples(phase_currents=200)
    assert recorder.stop().success
    assert f"cannot be written ({no_disk})" in recorder.node.output


@pytest.mark.process
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_node_ends_during_a_recording(ros, number):
    recorder, bench = Recorder(ros, process=True), Bench(ros)
    bench.wait_for_listeners()
    assert recorder.start("bag").success
    bench.publish(10)
    recorder.wait_for_samples(phase_currents=1000, resolver=1000)
    code, _ = recorder.node.interrupt(number=number)
    assert code == 0
    assert "Traceback" not in recorder.node.output
    assert len(read_recording(recorder.data / "bag").samples) == 1000
    assert read_recording(recorder.data / "bag").warnings == ()


@pytest.mark.process
def test_a_recorder_that_is_killed_and_started_again(ros):
    """What was flushed can be read, and whoever comes next tells of the recording that broke off."""
    recorder, bench = Recorder(ros, process=True, flush_period=0.2), Bench(ros)
    bench.wait_for_listeners()
    assert recorder.start("bag").success
    bench.publish(100)
    path = recorder.data / "bag"

    def flushed():
        try:
            return len(read_recording(path).samples) == 10000
        except Exception:  # noqa: BLE001  # nothing there yet
            return False

    ros.wait(flushed, "the flush of 10000 samples")
    bench.publish(1)
    recorder.node.popen.send_signal(signal.SIGKILL)
    recorder.node.popen.wait()
    recording = read_recording(path)
    assert "was not completed" in recording.warnings[0]
    assert 10000 <= len(recording.samples) <= 10100
    recovery = recover_bag(path)
    assert len(stock_messages(recovery.output)) == sum(recovery.topics.values()) >= 400

    ros.forget_clients()
    again = Recorder(ros)
    broken = f"The recorder died while it recorded {path}, which breaks off there"
    again.wait_for_status(broken, 2)
    ros.wait(lambda: broken in again.node.output, "a word in the log")
    reply = again.stop()
    assert (reply.success, reply.code) == (False, "not_recording")
    assert reply.message.startswith(broken)
    reply = again.start("bag")
    assert (reply.success, reply.code) == (False, "output")
    assert "exists already" in reply.message
    assert again.start("next").success
    bench.publish(2)
    again.wait_for_samples(phase_currents=200)
    assert again.stop().success
    for told in (lambda: again, lambda: Recorder(ros)):  # of the one that was killed, DDS knows for 20 s: a warning
        node = told()
        node.wait_for_status("Not recording.")
        ros.wait(lambda: broken not in str(node.status), "a status without what broke off")  # noqa: B023
        node.node.end()
    assert not list(recorder.data.glob(".recording*"))


def test_a_disk_with_little_space(ros):
    free = shutil.disk_usage(ros.folder).free / 1e6
    recorder, bench = Recorder(ros, least_free_space=free / 3), Bench(ros)
    bench.wait_for_listeners()
    assert recorder.start("bag").success
    bench.publish(2)
    recorder.wait_for_status("MB left", 1)
    recorder.set("least_free_space", 2 * free)  # for the next recording
    reply = recorder.start("next")
    assert (reply.success, reply.code) == (False, "busy")
    assert recorder.stop().success
    reply = recorder.start("next")
    assert (reply.success, reply.code) == (False, "output")
    assert "MB left, less than least_free_space" in reply.message
    assert not (recorder.data / "next").exists()


# -- the lifecycle -------------------------------------------------------------------------------------------------


def test_the_lifecycle(ros):
    from drive_id_msgs.srv import Command

    recorder = Recorder(ros, autostart=False)
    change, bench = partial(ros.change_state, recorder.name), Bench(ros)
    reply = recorder.start("bag")
    assert (reply.success, reply.code) == (False, "inactive")
    assert "configure and activate it" in reply.message
    recorder.wait_for_status("The node is unconfigured", 0)
    assert not change("activate")
    assert change("configure")
    assert recorder.start("bag").code == "inactive"
    assert change("activate")
    bench.wait_for_listeners()
    assert recorder.start("bag").success
    bench.publish(5)
    recorder.wait_for_samples(phase_currents=500, resolver=500)
    assert change("deactivate")
    assert len(read_recording(recorder.data / "bag").samples) == 500
    assert recorder.stop().code == "not_recording"
    for name in ("pause", "resume", "split_bagfile"):
        reply = ros.call(Command, f"{recorder.name}/{name}")
        assert (reply.success, reply.code) == (False, "inactive")
        assert "The node is inactive: activate it" in reply.message
    for _ in range(3):
        assert change("cleanup")
        ros.wait(lambda: not any(p.get_subscription_count() for p in bench.publishers.values()), "no subscription")
        assert change("configure")
        bench.wait_for_listeners()
    assert change("activate")
    assert recorder.start("second").success
    bench.publish(3)
    recorder.wait_for_samples(phase_currents=300)
    assert change("shutdown")
    assert len(read_recording(recorder.data / "second").samples) == 300


# -- parameters ----------------------------------------------------------------------------------------------------


def test_which_parameters_change_and_which_values_are_refused(ros):
    ros.host(MODULE)
    assert ros.set_parameters("/recorder", max_file_size=5.0).successful
    for name, value in (("chunk_size", 10**6), ("compression", "zip"), ("flush_period", 0.0), ("queue_depth", 2000)):
        assert not ros.set_parameters("/recorder", **{name: value}).successful, name
