"""A client of the nodes for supervisory software: run an experiment and identify the drive from a script.

>>> from drive_id.ros import Bench
>>> with Bench(namespace="/drive_1") as bench:  # doctest: +SKIP
...     bench.wait_until_ready()
...     recording, found = bench.characterize(i_max=200.0, serial="0017")
...     result = found.load()
"""

from drive_id.ros.bench import Bench, Identified
from drive_id.ros.calls import Progress
from drive_id.ros.conductor import Recording

__all__ = ["Bench", "Identified", "Progress", "Recording"]
