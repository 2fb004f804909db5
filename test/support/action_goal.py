"""Goals of the actions of the nodes."""

from __future__ import annotations

import time


class SentGoal:
    """A goal that was accepted, its feedback and its result."""

    def __init__(self, ros, client, goal):
        self.ros, self.feedback, self.times = ros, [], []
        self.ros.wait(client.server_is_ready, "the action server")
        self.begun = time.monotonic()
        sent = client.send_goal_async(goal, feedback_callback=self._heard)
        self.ros.wait(sent.done, "the acceptance of a goal")
        self.handle = sent.result()
        assert self.handle.accepted
        self.future = self.handle.get_result_async()

    def _heard(self, message):
        self.feedback.append(message.feedback)
        self.times.append(time.monotonic())

    def wait(self, within=180.0):
        """Return status and result."""
        self.ros.wait(self.future.done, f"the result of a goal, {self.feedback[-1:]}", within)
        return self.future.result().status, self.future.result().result

    def wait_for(self, stage):
        def there():
            words = (getattr(entry, "phase", "") or getattr(entry, "stage", "") for entry in self.feedback)
            return self.future.done() or stage in words

        self.ros.wait(there, f"stage {stage}")
        assert not self.future.done(), self.future.result().result.message


def experiment(ros, client, **fields):
    """Send a goal of the node ``experiment``."""
    from drive_id_msgs.action import Experiment

    return SentGoal(ros, client, Experiment.Goal(**fields))
