"""A client of the nodes for supervisory software: run an experiment and identify the drive from a script.

>>> from drive_id.ros import Bench
>>> with Bench(namespace="/drive_1") as bench:  # doctest: +SKIP
...     bench.wait_until_ready()
...     recording = bench.run_experiment()
...     result = bench.identify(bags=[recording.uri]).load()
"""

from drive_id.ros.bench import Bench, Identified, Progress, Recording

__all__ = ["Bench", "Identified", "Progress", "Recording"]
