"""Configuration of Fast DDS: without what crashes, blocks or deafens processes."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path

from rclpy.utilities import get_rmw_implementation_identifier

_PROFILES_2 = "FASTRTPS_DEFAULT_PROFILES_FILE"  # read by Fast DDS 2
_PROFILES_3 = "FASTDDS_DEFAULT_PROFILES_FILE"  # read by Fast DDS 3
_RECEIVE_BUFFER = 4 << 20
"""Of a UDP socket, bytes, as far as net.core.rmem_max permits: some 270 messages fill the usual buffer of 208 KiB."""
_RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
_ANYWHERE = "SYSTEM_DEFAULT"
_PROFILE = """<?xml version="1.0" encoding="UTF-8"?>
<dds xmlns="http://www.eprosima.com"><profiles>{transports}
<participant profile_name="drive_id" is_default_profile="true"><rtps>{settings}</rtps></participant></profiles></dds>
"""
_NO_TYPE_LOOKUP = _PROFILE.format(
    transports="",
    settings="""<propertiesPolicy><properties>
  <property><name>fastdds.type_propagation</name><value>disabled</value></property>
</properties></propertiesPolicy>""",
)
_UDP = _PROFILE.format(
    transports="",
    settings=f"""
  <listenSocketBufferSize>{_RECEIVE_BUFFER}</listenSocketBufferSize>
  <builtinTransports>UDPv4</builtinTransports>""",  # in this order: the second one takes the first one along
)
_UDP_LOCALHOST = _PROFILE.format(
    transports=f"""<transport_descriptors><transport_descriptor>
  <transport_id>localhost</transport_id><type>UDPv4</type><maxInitialPeersRange>32</maxInitialPeersRange>
  <receiveBufferSize>{_RECEIVE_BUFFER}</receiveBufferSize>
  <interfaceWhiteList><address>127.0.0.1</address></interfaceWhiteList>
</transport_descriptor></transport_descriptors>""",
    settings="""
  <userTransports><transport_id>localhost</transport_id></userTransports>
  <useBuiltinTransports>false</useBuiltinTransports>
  <builtin>
    <metatrafficUnicastLocatorList><locator/></metatrafficUnicastLocatorList>
    <initialPeersList><locator><udpv4><address>127.0.0.1</address></udpv4></locator></initialPeersList>
  </builtin>""",
)
"""What rmw_fastrtps sets for the range LOCALHOST, but without shared memory."""


@contextmanager
def fast_dds(*, shared_memory: bool = True) -> Iterator[None]:
    """Configure Fast DDS for a context and its nodes that are created in the body.

    The type lookup service is switched off: Fast DDS 3.2 (Kilted) deletes the service's writer before it stops the
    service's thread, and a node that ends just after another participant has discovered it dies of SIGSEGV. ROS 2 does
    not use the service.

    Shared memory couples processes (Fast DDS 2.14, Jazzy): one that is stopped or killed at a bad moment blocks
    whoever publishes to it for seconds, and one that was held up for a second may be deaf afterwards, see
    :mod:`~.shared_memory`. Users' own Fast DDS profiles take precedence, and other middleware ignores all of this.

    Parameters
    ----------
    shared_memory : bool
        False: use UDP only, with Fast DDS 2.
    """
    own = os.environ.get(_PROFILES_2) or os.environ.get(_PROFILES_3)
    if own or Path("DEFAULT_FASTDDS_PROFILES.xml").exists() or Path("DEFAULT_FASTRTPS_PROFILES.xml").exists():
        yield
        return
    with ExitStack() as stack:
        variables = {_PROFILES_3: stack.enter_context(_file(_NO_TYPE_LOOKUP))}
        if not shared_memory and _is_fast_dds_2():
            profile, discovery = _without_shared_memory()
            variables |= {_PROFILES_2: stack.enter_context(_file(profile)), **discovery}
        stack.enter_context(_environment(variables))
        yield


def _without_shared_memory() -> tuple[str, dict[str, str]]:
    """Return a profile, and the variables that it needs: rmw_fastrtps adds shared memory to any, by range LOCALHOST."""
    if os.environ.get(_RANGE, "").upper() != "LOCALHOST" or os.environ.get("ROS_STATIC_PEERS"):
        return _UDP, {}
    return _UDP_LOCALHOST, {_RANGE: _ANYWHERE}


def _is_fast_dds_2() -> bool:
    get_rmw_implementation_identifier()  # loads it
    try:
        return "/libfastrtps.so" in Path("/proc/self/maps").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return False


@contextmanager
def _file(text: str) -> Iterator[str]:
    with tempfile.NamedTemporaryFile("w", prefix="drive_id_fast_dds_", suffix=".xml", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        yield file.name


@contextmanager
def _environment(variables: Mapping[str, str]) -> Iterator[None]:
    """Set environment variables in the body, and restore what was there before."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
