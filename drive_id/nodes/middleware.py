"""What Fast DDS is told before it begins: no type lookup service, for processes die of it."""

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
    """Have the node that is made meanwhile do without the type lookup service of Fast DDS 3, as Fast DDS 2 does.

    The service answers other participants' questions in a thread of its own, which Fast DDS 3.2 (Kilted) stops only
    after having deleted what it writes with: a node that ends while somebody has just discovered it dies of SIGSEGV.
    Nothing of ROS 2 needs it. Whoever has given Fast DDS profiles of their own keeps these, and other middleware does
    not look at the variable.
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
