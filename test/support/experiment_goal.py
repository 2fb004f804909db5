"""Goals of experiments."""

from __future__ import annotations

import time


class Goal:
    """A goal of the node ``experiment``, its feedback and its result."""

    def __init__(self, ros, client, **fields):
        from drive_id_msgs.action import Experiment

        self.ros, self.feedback, self.times = ros, [], []
        self.ros.wait(client.server_is_ready, "the action server")
        self.begun = time.monotonic()
        sent = client.send_goal_async(Experiment.Goal(**fields), feedback_callback=self._heard)
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

    def wait_for(self, phase):
        def there():
            return self.future.done() or any(entry.phase == phase for entry in self.feedback)

        self.ros.wait(there, f"phase {phase}")
        assert not self.future.done(), self.future.result().result.message
