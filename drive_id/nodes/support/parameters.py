"""Settings dataclasses as ROS parameters: one source for names, types, defaults, descriptions and bounds."""

from __future__ import annotations

import copy
import dataclasses
import math
import typing
from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeVar

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    ParameterValue,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python

from drive_id.common.settings import from_mapping
from drive_id.errors import ConfigurationError

Settings = TypeVar("Settings")

_TYPES = {
    bool: Parameter.Type.BOOL,
    int: Parameter.Type.INTEGER,
    float: Parameter.Type.DOUBLE,
    str: Parameter.Type.STRING,
}
_ARRAYS = {python: Parameter.Type[f"{kind.name}_ARRAY"] for python, kind in _TYPES.items()}
_LARGEST = 1.7e308  # bound of a DOUBLE without bounds: nearly the largest float, so that infinity is refused


def declare_settings(node: Node, cls: type[Settings], *, read_only: Iterable[str] = ()) -> Settings:
    """Declare a ROS parameter for each field of a settings dataclass and return the settings of this start.

    None is NaN as a parameter, because ROS deletes parameters that are set to nothing. Later changes are checked as a
    whole by the dataclass, see :func:`on_change`.

    Parameters
    ----------
    cls : type
        Settings dataclass; its fields carry description, unit and bounds.
    read_only : iterable of str
        Fields that cannot change while the node runs.

    Raises
    ------
    ConfigurationError
        When the values given at start are inconsistent.
    """
    hints = typing.get_type_hints(cls)
    fixed = set(read_only)
    for field in dataclasses.fields(cls):  # type: ignore[arg-type]  # a settings dataclass
        kind, optional = _parameter_type(hints[field.name])
        descriptor = _descriptor(field, kind, optional=optional, read_only=field.name in fixed)
        default = list(field.default) if isinstance(field.default, tuple) else field.default
        if isinstance(default, list):
            _declare_array(node, field.name, kind, descriptor, default)
        else:
            node.declare_parameter(field.name, math.nan if default is None else default, descriptor)
    return read_settings(node, cls)


def _declare_array(
    node: Node, name: str, kind: Parameter.Type, descriptor: ParameterDescriptor, default: list[Any]
) -> None:
    """Declare an array, which may be empty: rclpy takes ``[]`` for a byte array, and in a file for no value."""
    changeable = copy.copy(descriptor)
    changeable.read_only = False
    if node.declare_parameter(name, kind, changeable).type_ is Parameter.Type.NOT_SET:
        given = name in node._parameter_overrides  # noqa: SLF001  # the only place that shows that [] was given
        node.set_parameters([Parameter(name, kind, [] if given else default)])
    node.set_descriptor(name, descriptor)


def read_settings(node: Node, cls: type[Settings], changes: Iterable[Parameter] = ()) -> Settings:
    """Return the settings from the node's parameters, with changes that are about to be made.

    Raises ConfigurationError when they are inconsistent.
    """
    values = {name: node.get_parameter(name).value for name in _names(cls)}
    values |= {parameter.name: parameter.value for parameter in changes if parameter.name in values}
    return _made(cls, values, node.get_name())


def settings_of(cls: type[Settings], read: Callable[[list[str]], Iterable[ParameterValue]], node: str) -> Settings:
    """Return the settings of another node, whose parameters of some names are ``read``.

    Raises ConfigurationError when they are inconsistent, or the node lacks one.
    """
    names = _names(cls)
    values = [parameter_value_to_python(value) for value in read(names)]
    if len(values) < len(names):  # rclpy answers nothing at all where one is missing
        raise ConfigurationError(f"{node} lacks some of its parameters: start it from the same version of drive_id.")
    return _made(cls, dict(zip(names, values, strict=True)), node)


def _names(cls: type[Settings]) -> list[str]:
    return [field.name for field in dataclasses.fields(cls)]  # type: ignore[arg-type]  # a settings dataclass


def _made(cls: type[Settings], values: Mapping[str, Any], node: str) -> Settings:
    hints = typing.get_type_hints(cls)
    plain = {name: _plain(value, hints[name]) for name, value in values.items()}
    return from_mapping(cls, plain, f"the parameters of {node}")


def on_change(
    node: Node, cls: type[Settings], check: Callable[[Settings], object], apply: Callable[[Settings], None]
) -> None:
    """Refuse inconsistent changes of parameters, and report accepted ones.

    Parameters
    ----------
    cls : type
        Settings dataclass.
    check : callable
        Further check of new settings; raises ConfigurationError to refuse them.
    apply : callable
        Called with the new settings.
    """

    def refuse(changes: list[Parameter]) -> SetParametersResult:
        try:
            check(read_settings(node, cls, changes))
        except ConfigurationError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def tell(changes: list[Parameter]) -> None:
        if any(parameter.name in cls.__dataclass_fields__ for parameter in changes):  # type: ignore[attr-defined]
            apply(read_settings(node, cls))

    node.add_on_set_parameters_callback(refuse)
    node.add_post_set_parameters_callback(tell)


def _parameter_type(hint: Any) -> tuple[Parameter.Type, bool]:
    """Return the type of a parameter, and whether the field may be None."""
    options = [option for option in typing.get_args(hint) if option is not type(None)]
    if options and typing.get_origin(hint) is not tuple:
        return _parameter_type(options[0])[0], True
    if typing.get_origin(hint) is tuple:
        return _ARRAYS[typing.get_args(hint)[0]], False
    return _TYPES[hint], False


def _descriptor(
    field: dataclasses.Field[Any], kind: Parameter.Type, *, optional: bool, read_only: bool
) -> ParameterDescriptor:
    unit = f" [{field.metadata['unit']}]" if field.metadata.get("unit") else ""
    descriptor = ParameterDescriptor(
        type=kind.value, description=field.metadata.get("description", "") + unit, read_only=read_only
    )
    low, high = field.metadata.get("minimum"), field.metadata.get("maximum")
    limits = [f"at {words} {limit:g}" for words, limit in (("least", low), ("most", high)) if limit is not None]
    if optional:
        descriptor.additional_constraints = ", ".join([*limits, "nan: the default"])
    elif kind in _ARRAYS.values():
        descriptor.additional_constraints = f"each {', '.join(limits)}" if limits else ""
    elif kind is Parameter.Type.DOUBLE:
        least, most = -_LARGEST if low is None else float(low), _LARGEST if high is None else float(high)
        descriptor.floating_point_range = [FloatingPointRange(from_value=least, to_value=most)]  # also refuses NaN
    elif kind is Parameter.Type.INTEGER and (low is not None or high is not None):
        first, last = -(2**63) if low is None else int(low), 2**63 - 1 if high is None else int(high)
        descriptor.integer_range = [IntegerRange(from_value=first, to_value=last)]
    if field.metadata.get("choices"):
        entries = "each one of " if kind in _ARRAYS.values() else "one of "
        descriptor.additional_constraints = entries + ", ".join(field.metadata["choices"])
    return descriptor


def _plain(value: Any, hint: Any) -> Any:
    """Return a parameter's value as YAML represents it for a field of this type."""
    if typing.get_origin(hint) is tuple:
        return list(value)
    optional = type(None) in typing.get_args(hint)
    return None if optional and isinstance(value, float) and math.isnan(value) else value
