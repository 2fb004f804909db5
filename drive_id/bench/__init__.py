"""The simulated drive: machine, inverter, sensors and current controller, with known ground truth."""
