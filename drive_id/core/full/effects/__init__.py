"""Effects of real drives that the model lacks, each as a few columns of the same regression.

With psi_s = e^{j theta} f(i), a small effect changes the voltage balance of a window, to first order, by a known vector
times an unknown; the class of each effect says which. [x] is the difference of x between the ends of the window, f' the
Jacobian of the present estimate of the map, i the current in the rotor frame, and e = u - R i - drop the induced
voltage. All columns use earlier samples only; e uses the voltage held before. The controller responds to the noise of a
sample with voltage and current, which would bias them.

An angle that is off by eps changes the flux in the stator frame by ``e^{j theta} (j f - f'(i) j i) eps``, its tilt.

For effects of several percent of the current, the second order matters. Let di and eps be the changes of current and
angle by the effects, both at the estimate. The remainder is the exact change of the flux minus its linear part,
``[e^{j (theta + eps)} f((i + di) e^{-j eps}) - e^{j theta} (f + ...)]``, and what the current does between samples, see
``between_samples.py``. It has no unknown of its own and makes the repeated linearization converge to the nonlinear
model. A filter of the currents passes H i, H = 1 / (1 + j omega tau), of a current and H f of its flux: it replaces
e^{j eps}, and harmonics, the slope of the current and the inverter's drop are filtered as their frequencies are.
"""
