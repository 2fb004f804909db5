"""Message definitions for any bag: embedded in it, from a signals file, or from a ROS distribution."""

from __future__ import annotations

import re
import struct
from functools import lru_cache
from typing import TYPE_CHECKING

from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from drive_id.errors import MessageTypeError
from drive_id.files.messages.messages import DEFINITIONS, message_typestore
from drive_id.files.messages.signals_file import SignalMap
from drive_id.files.storage.container import TopicInfo

if TYPE_CHECKING:
    from rosbags.interfaces.typing import Typesdict

_TYPE_NAME = re.compile(r"[A-Za-z]\w*(/[A-Za-z]\w*){1,3}", re.ASCII)
_FIELD_NAME = re.compile(r"[A-Za-z]\w*", re.ASCII)
_ERRORS = (TypesysError, ValueError, LookupError, TypeError, AssertionError, RecursionError, SyntaxError, struct.error)
_LONGEST = 1 << 19
"""Characters of a definition: all messages of ROS have a hundredth of that."""
_MOST_FIELDS = 10_000
"""Lines or semicolons of a definition: likewise."""
_IDL_SEPARATOR = "=" * 80 + "\n"


def typestore_for(topic: TopicInfo, signals: SignalMap) -> Typestore:
    """Return a typestore that can deserialize the messages of a topic.

    Raises MessageTypeError when the definition is missing or cannot be parsed.
    """
    name = topic.type_name
    if not _TYPE_NAME.fullmatch(name):
        shown = " ".join(name.split())[:80]
        raise MessageTypeError(f"{topic.name} is of type '{shown}', which is not a message type: name another topic.")
    try:
        for text in (topic.definition, *signals.definitions.values()):
            if len(text) > _LONGEST or max(map(text.count, "\n;")) > _MOST_FIELDS:
                raise ValueError("it is too long")
        if name in signals.definitions or not topic.definition:
            store = _known(name, signals)
        else:
            store = _embedded(name, topic.definition_format, topic.definition)
        if name not in store.fielddefs:
            raise MessageTypeError(
                f"The bag holds no definition of {name} on {topic.name}, and '{signals.typestore}' has none: "
                "give it under 'definitions' in a signals file."
            )
        store.get_msgdef(name)
    except _ERRORS as error:
        raise MessageTypeError(
            f"The definition of {name} on {topic.name} cannot be understood ({' '.join(str(error).split())[:120]}): "
            "give it under 'definitions' in a signals file."
        ) from error
    return store


def _known(name: str, signals: SignalMap) -> Typestore:
    if name in DEFINITIONS and name not in signals.definitions:
        return message_typestore()
    store = get_typestore(Stores[f"ROS2_{signals.typestore.upper()}" if signals.typestore != "latest" else "LATEST"])
    for given, text in signals.definitions.items():
        _register(store, get_types_from_msg(text, given))
    return store


@lru_cache(maxsize=64)
def _embedded(name: str, form: str, definition: str) -> Typestore:
    store = get_typestore(Stores.ROS1_NOETIC if form == "ros1msg" else Stores.EMPTY)
    if form in ("ros1msg", "ros2msg"):
        _register(store, get_types_from_msg(definition, name))
    elif form in ("ros2idl", "omgidl"):
        for part in definition.split(_IDL_SEPARATOR):
            text = part.split("\n", 1)[1] if part.startswith("IDL: ") else part
            if text.strip():
                _register(store, get_types_from_idl(text))
    else:
        raise ValueError(f"it is written in '{form[:40]}'")
    return store


def _register(store: Typestore, types: Typesdict) -> None:
    """Register parsed types, after checking all names: rosbags generates Python source from them."""
    for name, (constants, fields) in types.items():
        members = [str(member[0]) for member in (*constants, *fields)]
        if not _TYPE_NAME.fullmatch(name) or not all(_FIELD_NAME.fullmatch(member) for member in members):
            raise ValueError(f"'{name[:80]}' or one of its fields is not a name")
    store.register(types)
