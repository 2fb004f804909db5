"""Fits in the background of the node ``identification``: diagnostics, provisional maps, replies meanwhile."""

from __future__ import annotations

import numpy as np
from test_identification_node import I_MAX, MODULE, Diagnosis, Player, messages_of


def start(ros, namespace, **parameters):
    known = {"output_directory": str(ros.folder / "results"), "i_max": I_MAX, "method": "joint"}
    return ros.host(MODULE, parameters=known | parameters, namespace=namespace)


def play(ros, namespace, bag, diagnosis):
    """Publish a recording, and wait until the node has taken it all."""
    player = Player(ros, namespace=namespace)
    player.wait_for_listeners()
    player.play(messages_of(bag))
    topics = [f"/{name}" for name in ("phase_currents", "phase_voltages", "resolver")]
    diagnosis.wait(lambda *_: min(map(diagnosis.samples, topics)) >= 20_000, "all samples")
    return player


def test_the_map_is_there_before_anybody_asks_and_stops_with_the_samples(ros, bag):
    from drive_id_msgs.msg import FluxMap

    from drive_id.nodes.support.qos import LATCHED

    node = "/early/identification"
    process = start(ros, "/early", refit_share=1.0, provisional_map_period=0.1)
    maps = []
    ros.node.create_subscription(FluxMap, "/early/flux_map", maps.append, LATCHED)
    with Diagnosis(ros, node) as diagnosis:
        player = play(ros, "/early", bag, diagnosis)
        diagnosis.wait(lambda _, values: float(values.get("fit: age [s]", 0)) > 3.0, "no further fits of old samples")
        last = diagnosis.values
    assert int(last["fit: samples"]) > 15_000
    assert 0.5 < float(last["fit: coverage"]) <= 1.0
    reply = ros.identify(node=node)
    assert reply.success, reply.message
    assert reply.report.samples_read == 20_000
    assert reply.flux_map.method == "joint"
    provisional = [one for one in maps if one.provisional]
    assert provisional
    sigma = np.array(reply.flux_map.sigma_d)
    off = np.abs(np.array(provisional[-1].psi_d) - np.array(reply.flux_map.psi_d)) / sigma
    assert np.nanmedian(off) < 1.0
    assert all(one.method == "joint" for one in maps)
    ros.wait(lambda: not maps[-1].provisional, "the requested map on the topic")
    player.close()
    process.end()
