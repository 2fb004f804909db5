"""Messages for displays: the map as a point cloud, and operating points."""

from __future__ import annotations

import array

import numpy as np
from drive_id_msgs.msg import FluxMap, OperatingPoint
from sensor_msgs.msg import PointCloud2, PointField

from drive_id.live.identification.operating_points import Point
from drive_id.nodes.support.signal_messages import headed

FIELDS = ("x", "y", "z", "i_d", "i_q", "psi_d", "psi_q", "sigma", "coverage")
"""Of each point, float32; see :func:`flux_map_points`."""


def flux_map_points(flux_map: FluxMap) -> PointCloud2:
    """Return a map as a point cloud.

    ``x`` and ``y`` are i_d and i_q relative to i_max, ``z`` is the flux linkage relative to the largest one, so that a
    view with equal axes shows the shape. ``sigma`` is the standard error of the flux vector, Wb, NaN without data;
    ``coverage`` is 1 where the recorded currents cover the point, else 0.
    """
    shape = len(flux_map.i_d), len(flux_map.i_q)
    i_d, i_q = np.meshgrid(flux_map.i_d, flux_map.i_q, indexing="ij")
    psi_d, psi_q, sigma_d, sigma_q = (
        np.frombuffer(column, np.float64).reshape(shape)
        for column in (flux_map.psi_d, flux_map.psi_q, flux_map.sigma_d, flux_map.sigma_q)
    )
    inside = np.array(flux_map.inside, np.bool_).reshape(shape)
    psi = np.hypot(psi_d, psi_q)
    largest = psi[inside].max() if inside.any() else psi.max(initial=1.0)
    columns = (
        i_d / flux_map.i_max, i_q / flux_map.i_max, psi / (largest or 1.0), i_d, i_q, psi_d, psi_q,
        np.hypot(sigma_d, sigma_q), inside,
    )  # fmt: skip
    points = np.stack([column.astype(np.float32) for column in columns], axis=-1)
    step = 4 * len(FIELDS)
    return PointCloud2(
        header=flux_map.header,
        height=shape[0],
        width=shape[1],
        fields=[
            PointField(name=name, offset=4 * k, datatype=PointField.FLOAT32, count=1) for k, name in enumerate(FIELDS)
        ],
        is_bigendian=False,
        point_step=step,
        row_step=step * shape[1],
        data=array.array("B", points.astype("<f4").tobytes()),
        is_dense=bool(np.isfinite(points).all()),
    )


def operating_point_message(point: Point, frame_id: str) -> OperatingPoint:
    """Return the message of an operating point."""
    return headed(OperatingPoint(i_d=point.i_d, i_q=point.i_q, speed=point.speed), point.stamp, frame_id)
