"""Configuration of Fast DDS: without the type lookup service, which crashes processes at their end."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_VARIABLE = "FASTDDS_DEFAULT_PROFILES_FILE"
_PROFILES = b"""<?xml version="1.0" encoding="UTF-8"?>
<dds xmlns="http://www.eprosima.com"><profiles><participant profile_name="drive_id" is_default_profile="true"><rtps>
  <propertiesPolicy><properties>
    <property><name>fastdds.type_propagation</name><value>disabled</value></property>
  </properties></propertiesPolicy>
</rtps></participant></profiles></dds>
"""


@contextmanager
def without_type_lookup() -> Iterator[None]:
    """Switch off the type lookup service of Fast DDS 3 for nodes created in the body.

    Fast DDS 3.2 (Kilted) deletes the service's writer before it stops the service's thread: a node that ends just after
    another participant has discovered it dies of SIGSEGV. ROS 2 does not use the service. Users' own Fast DDS profiles
    take precedence, and other middleware ignores the variable.
    """
    own = os.environ.get(_VARIABLE) or os.environ.get("FASTRTPS_DEFAULT_PROFILES_FILE")
    if own or Path("DEFAULT_FASTDDS_PROFILES.xml").exists():
        yield
        return
    with tempfile.NamedTemporaryFile(prefix="drive_id_fast_dds_", suffix=".xml") as file:
        file.write(_PROFILES)
        file.flush()
        os.environ[_VARIABLE] = file.name
        try:
            yield
        finally:
            del os.environ[_VARIABLE]
