"""GNU Octave loads the MATLAB files, and its own interpolation finds the values at points without symmetry."""

from __future__ import annotations

import shutil
import subprocess

import numpy as np
import pytest
from exchange_machine import AT, PAIRS, flux, result, torque

from drive_id.exchange.exports.exporting import content_of
from drive_id.exchange.exports.options import ExportOptions

OCTAVE = shutil.which("octave-cli")
pytestmark = pytest.mark.skipif(OCTAVE is None, reason="GNU Octave is not installed: there is no octave-cli")
AXES = ExportOptions(np.arange(-15.0, 15.1, 2.5), np.arange(-15.0, 15.1, 1.5))
NAMES = (
    "syre",
    "syre-model",
    "simscape",
    "simscape-2d",
    "motor-control",
    "powertrain",
    "powertrain-controller",
    "plecs",
)
AT_TEXT = f"d = [{' '.join(map(str, AT[0]))}]; q = [{' '.join(map(str, AT[1]))}];\n"
SCRIPT = (
    AT_TEXT
    + r"""
function say(name, values)
  printf("%s", name); printf(" %.12g", values); printf("\n");
end
s = load("syre.mat");
say("syre_d", interp2(s.Id, s.Iq, s.Fd, d, q)); say("syre_q", interp2(s.Id, s.Iq, s.Fq, d, q));
say("syre_T", interp2(s.Id, s.Iq, s.T, d, q));
s = load("syre-model.mat").motorModel;
say("model_q", interp2(s.FluxMap_dq.Id, s.FluxMap_dq.Iq, s.FluxMap_dq.Fq, d, q)); say("model_p", s.data.p);
s = load("simscape.mat");
say("fem_d", interpn(s.idVec2, s.iqVec2, s.fluxD_dq0(:, :, 2), d, q));
say("fem_q", interpn(s.idVec2, s.iqVec2, s.fluxQ_dq0(:, :, 2), d, q)); say("fem_x", s.xVec2([1 end]));
s = load("simscape-2d.mat");
say("ld_d", interpn(s.idVec, s.iqVec, s.LdMatrix, d, q) .* d + interpn(s.idVec, s.iqVec, s.pmFluxMatrix, d, q));
s = load("motor-control.mat").pmsm;
say("lut_d", interpn(s.PMSMLUT.idVec, s.PMSMLUT.iqVec, s.PMSMLUT.FluxDTable, d, q));
say("lut_q", interpn(s.PMSMLUT.idVec, s.PMSMLUT.iqVec, s.PMSMLUT.FluxQTable, d, q));
say("lut_size", [size(s.PMSMLUT.idVec) size(s.PMSMLUT.iqVec)]); say("lut_method", double(s.PMSMLUT.method));
s = load("powertrain.mat");
[fd, fq] = deal(PSI_D, PSI_Q);
say("inverse_d", interpn(s.flux_d, s.flux_q, s.id, fd, fq));
say("inverse_q", interpn(s.flux_d, s.flux_q, s.iq, fd, fq));
s = load("powertrain-controller.mat");
say("lambda_q", interpn(s.id_index, s.iq_index, s.lambda_q, d, q));
say("ref", [interpn(s.wbp, s.tbp, s.id_ref, 0, 5) interpn(s.wbp, s.tbp, s.iq_ref, 0, 5)]);
s = load("plecs.mat");
say("plecs_d", interpn(s.id, s.iq, s.psid, d, q)); say("plecs_q", interpn(s.id, s.iq, s.psiq, d, q));
"""
)


@pytest.fixture(scope="module")
def said(tmp_path_factory):
    folder = tmp_path_factory.mktemp("octave")
    for name in NAMES:
        (folder / f"{name}.mat").write_bytes(content_of(result(), name, AXES)[0])
    inner = [flux(AT[0][1:] * 0.5, AT[1][1:] * 0.5)[k] for k in range(2)]
    script = SCRIPT
    for name, values in zip(("PSI_D", "PSI_Q"), inner, strict=True):
        script = script.replace(name, f"[{' '.join(map(repr, values.tolist()))}]")
    (folder / "read.m").write_text(script)
    command = [OCTAVE, "--no-gui", "--norc", "--quiet", "read.m"]
    ran = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120, check=False)
    assert ran.returncode == 0, ran.stderr
    lines = [line.split() for line in ran.stdout.splitlines()]
    return {words[0]: np.array([float(word) for word in words[1:]]) for words in lines}


@pytest.mark.parametrize("name", ["syre_d", "fem_d", "ld_d", "lut_d", "plecs_d"])
def test_psi_d(said, name):
    np.testing.assert_allclose(said[name], flux(*AT)[0], atol=1e-8)


@pytest.mark.parametrize("name", ["syre_q", "model_q", "fem_q", "lut_q", "plecs_q", "lambda_q"])
def test_psi_q(said, name):
    np.testing.assert_allclose(said[name], flux(*AT)[1], atol=1e-8)


def test_the_rest(said):
    np.testing.assert_allclose(said["syre_T"], torque(*AT), rtol=1e-6)
    assert said["model_p"].tolist() == [PAIRS]
    np.testing.assert_allclose(said["fem_x"], [0, 120 / PAIRS])
    assert said["lut_size"].tolist() == [13, 1, 1, 21]
    assert bytes(said["lut_method"].astype(np.uint8)) == b"FluxDQ"
    np.testing.assert_allclose(said["inverse_d"], AT[0][1:] * 0.5, atol=0.3)  # linear between coarse points
    np.testing.assert_allclose(said["inverse_q"], AT[1][1:] * 0.5, atol=0.3)
    assert torque(*said["ref"]) == pytest.approx(5.0, abs=0.2)
